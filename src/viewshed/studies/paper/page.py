"""The two pages: what is said of the paper's protocol and of the strict one, with their pictures."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from viewshed._page import Heading, PageBlock, Picture, Text, facts, to_markdown
from viewshed.studies.cases import TOUCHING, strength_cases
from viewshed.studies.evaluate import Evaluation
from viewshed.studies.figures import Curves, Dot, Map, Violins, curve_figure, map_figure, trade_figure, violin_figure
from viewshed.studies.monitor.page import ABOUT as ABOUT_MONITOR
from viewshed.studies.paper import tables
from viewshed.studies.paper.data import evaluation_of
from viewshed.studies.paper.jobs import tampered_of
from viewshed.studies.paper.models import network_of
from viewshed.studies.paper.plan import MIXTURES, STEPS, Model
from viewshed.studies.paper.protocols import setting_of
from viewshed.studies.paper.published import BENIGN_TABLE, OTHERS, SUB_TABLES, PaperResults, pair
from viewshed.studies.records import BENIGN, PAPER, STRICT, VIEW, WEDGE, Series
from viewshed.studies.statistics import Floats, f1, precision
from viewshed.threats.attacks import ATTACKS, SEVERITIES
from viewshed.threats.attacks.base import Tampered

STEMS = {PAPER: "paper", STRICT: "paper_strict"}
"""Names of the pages, and beginnings of those of their pictures."""

SHOWN = "far_wall"
"""Attack of the strict protocol's maps: a corridor that is not there."""

CURVED = 9
"""Contestants that the severity curves show at most, the best on benign sweeps beside all networks."""


def violin_picture(results: PaperResults, protocol: str) -> Picture:
    """Return violins of precision and AUPRC of each sweep, for every domain: benign against attacked."""
    panels = []
    for domain in results.domains:
        for word in ("precision", "AUPRC"):
            pairs = {
                short.replace("paper_", "paper: "): _both(results, protocol, domain, name, word)
                for short, name in tables.pair_methods(results, protocol, domain).items()
            }
            panels.append(Violins(f"{domain}: {word}", pairs))
    attacked = "the paper's attacks" if protocol == PAPER else "one attack each, all in turn"
    return Picture(
        f"{STEMS[protocol]}_violins.png", violin_figure(panels, 2, attacked),
        f"Precision and AUPRC of single sweeps, benign and under {attacked}, networks and classical estimators",
    )  # fmt: skip


def _both(results: PaperResults, protocol: str, domain: str, method: str, word: str) -> tuple[Floats, Floats]:
    one, other = (pair(protocol, method, mixture, domain) for mixture in MIXTURES)
    if word == "AUPRC":
        return results.pairs.numbers(one, "auprc"), results.pairs.numbers(other, "auprc")
    return results.pairs.each(one, precision), results.pairs.each(other, precision)


def mcd_picture(results: PaperResults, protocol: str) -> Picture | None:
    """Return mean and deviation on one sweep, benign and attacked, by networks trained without and with attacks.

    None if the networks are not there.
    """
    plan, folder = results.plan, results.store.folder
    domain = "nuscenes" if "nuscenes" in plan.domains else plan.domains[0]
    models = {mixture: Model(protocol, "mcd", mixture, domain) for mixture in MIXTURES}
    if any(model.key[1:] not in results.models for model in models.values()):
        return None
    evaluation, tampered = _shown_sweep(results, protocol, domain)
    grid, setting = evaluation.reference.grid, setting_of(plan, protocol, domain)
    networks = {mixture: network_of(plan, folder, model, setting) for mixture, model in models.items()}
    rows = {}
    for name, sweep in zip(MIXTURES, (evaluation.sample.sweep, tampered.sweep), strict=True):
        maps = [Map("returns", "returns", np.minimum(grid.count(sweep.points), 1)),
                Map("truth, clean sweep", "truth", evaluation.reference.visible)]  # fmt: skip
        for mixture, network in networks.items():
            estimate = network.estimate(sweep)
            maps += [Map(f"{mixture}-trained: mean", "probability", estimate.visible_prob),
                     Map("deviation", "deviation", np.nan_to_num(np.asarray(estimate.std)))]  # fmt: skip
        rows[f"{name} sweep"] = maps
    attack = setting.attack(evaluation.number).name if protocol == STRICT else "paper"
    alt = f"Monte Carlo dropout on one sweep of {domain}, benign and under {attack}: mean and deviation"
    return Picture(f"{STEMS[protocol]}_mcd.png", map_figure(rows), alt)


def _shown_sweep(results: PaperResults, protocol: str, domain: str) -> tuple[Evaluation, Tampered]:
    """Return the first held-out sweep that the mixture touches, or the first under ``SHOWN``; and it attacked."""
    plan, folder, setting = results.plan, results.store.folder, setting_of(results.plan, protocol, domain)
    numbers = range(plan.pair_frames) if protocol == PAPER else [TOUCHING.index(SHOWN)]
    found = []
    for number in numbers:
        evaluation = evaluation_of(plan, folder, setting, setting.suite({}), number)
        tampered = tampered_of(evaluation, setting.attack(number), plan.test_seed)
        found.append((evaluation, tampered))
        if tampered.sweep is not evaluation.sample.sweep:
            return found[-1]
    return found[0]


def trade_picture(results: PaperResults) -> Picture | None:
    """Return precision, accuracy and F1 of the trade study over latency; None if there are no results."""
    dots = []
    for shape in tables.trade_shapes(results):
        (width, depth, cells), (rates, latency) = shape, tables.trade_rates(results, shape)
        dots.append(Dot(cells, depth, width, rates | {"latency, ms, 2 threads": latency["2"]}))
    if not dots:
        return None
    png = trade_figure(dots, "latency, ms, 2 threads", ("precision", "accuracy", "F1"))
    alt = "Precision, accuracy and F1 over the latency of one pass, by resolution, depth and width"
    return Picture("paper_trade.png", png, alt)


def severity_pictures(results: PaperResults, domain: str) -> Iterator[Picture]:
    """Yield curves of F1 in the view and in the wedge over the strengths of the attacks that have some."""
    methods = _shown(results, domain)
    for region in (VIEW, WEDGE):
        panels = list(_severities(results, domain, methods, region))
        if panels:
            png = curve_figure(panels, 4, f"F1 in the {region}")
            alt = f"{domain}: F1 in the {region} over the strength of each attack"
            yield Picture(f"paper_strict_{region}_{domain}.png", png, alt)


def _shown(results: PaperResults, domain: str) -> list[str]:
    """Return all networks and, of the classical estimators, the best on benign sweeps."""
    names = tables.strict_methods(results, domain)
    classical = [name for name in names if name not in tables.NETWORKS]
    scored = {name: results.strict.rate(Series(domain, name), f1) for name in classical}
    chosen = sorted(classical, key=lambda name: -scored[name])[: CURVED - (len(names) - len(classical))]
    return [name for name in names if name not in classical or name in chosen]


def _severities(results: PaperResults, domain: str, methods: list[str], region: str) -> Iterator[Curves]:
    found = results.strict.cases(domain)
    for name in ATTACKS:
        for attribute in dict.fromkeys(attribute for attribute, _ in SEVERITIES.get(name, ())):
            cases = [case for case in strength_cases(name, attribute) if case in found]
            if not cases or (region == WEDGE and not tables.has_wedge(results, domain, cases[0])):
                continue
            shown = [*([BENIGN] if region == VIEW else []), *cases]
            steps = [case.level.removeprefix(f"{attribute} ") or "benign" for case in shown]
            curves = {
                method: [results.strict.rate(Series(domain, method, case, region), f1) for case in shown]
                for method in methods
            }
            yield Curves(f"{name}, {attribute}", steps, curves)


TITLES = {PAPER: "The published study, made again", STRICT: "The published study, held against exact truth"}

_PAPER = """\
arXiv 2503.07375 made again on simulated sweeps: its network, label, grid, threshold and attacks. The truth is the
paper's label, the farthest return in polar bins of the *clean* sweep, which is itself one of the contestants: agreeing
with it is not being right. What is right is on [the strict page](paper_strict.md). Rows are test sets, columns
training sets; a cell is precision, recall, accuracy (in hundredths) and F1, pooled over all cells of the held-out
sweeps. Sweeps tested on are of scenes and of a seed that nothing was trained or chosen on. Intervals are 95 %, by a
bootstrap over the scenes (1,000 draws): how far a figure depends on which scenes were drawn."""

_STRICT = """\
The same networks trained on exact truth (`probe`, car, where it is known) and held against it, on the presets' own
grids and with a threshold of .5, beside every classical estimator, **whoever wins**. Networks see counts of returns,
nothing else. What is bold is the best of its row, or of its column where columns are figures. Intervals and scenes as
on [the paper's page](paper.md)."""

_MIXTURE = """\
All held-out sweeps of the 72 pairs, networks on the domain that they were trained in, in the same table as the
classical estimators."""

_CALIBRATION = """\
Of the same sweeps. ECE: mean distance of probability and frequency over 15 bins. Brier: mean squared error. AURC: mean
share of wrong cells over all coverages, the least doubtful cells first (doubt is the distance of the probability from
.5, or the deviation). An estimator that gives a mask is calibrated where it makes no error."""

_TRADE = """\
Networks of the paper's protocol, trained without attacks and tested on benign sweeps, with fewer epochs than the
models above: compare them with each other. Latency is the median of single passes in ONNX Runtime, the input made
already. FLOPs are multiplications and additions of the convolutions."""


def files_of(results: PaperResults, protocol: str) -> dict[str, bytes]:
    """Return the files of a protocol's page by name: pictures first, the page last.

    Raises:
        ValueError: there are no results of the protocol.
    """
    if not results.pairs.series(protocol=protocol):
        raise ValueError(f"{results.store.path} must hold pairs of the {protocol} protocol, got none; run step pairs")
    blocks = [block for block in _blocks(results, protocol) if block is not None]
    files = {block.name: block.png for block in blocks if isinstance(block, Picture)}
    page = to_markdown(TITLES[protocol], facts(**provenance(results, protocol)), blocks)
    return files | {f"{STEMS[protocol]}.md": page.encode()}


def provenance(results: PaperResults, protocol: str) -> dict[str, str]:
    """Return what a page rests on, by name."""
    plan = results.plan
    sweeps = []
    for domain in sorted(plan.domains):
        if several := results.pairs.series(domain, protocol):
            count, scenes = results.pairs.sweeps(domain, protocol), results.pairs.scenes(several[0])
            sweeps.append(f"{domain} {count} of {len(scenes)} scenes")
    shape = f"{plan.cells} × {plan.cells} cells, width {plan.width}, depth {plan.depth}, dropout {plan.dropout:g}"
    seen = ", ".join(plan.trained_attacks)
    attacks = {
        PAPER: "the paper's mixture, in training and test",
        STRICT: f"trained on {seen} ({100 * plan.attack_share:.0f} % of the sweeps); the others are never seen",
    }
    every = (results.pairs, results.strict, results.trade, results.monitor)
    commits = {commit[:7] for part in every for commit in part.commits}
    return {
        "plan": f"{plan.name}: {plan.about}", "seeds": f"{plan.seed} trained, {plan.test_seed} tested",
        "network": f"{shape}; {plan.passes} passes for MCD",
        "training": f"at most {plan.epochs} epochs of {plan.frames_per_epoch} sweeps, batches of {plan.batch}, "
        f"{plan.loss}, Adam {plan.learning_rate:g} ({plan.schedule}), stopped after {plan.patience} without gain",
        "held-out sweeps": ", ".join(sweeps), "attacks": attacks[protocol],
        "commits of the run": ", ".join(sorted(commits)) or "unknown",
    }  # fmt: skip


def _blocks(results: PaperResults, protocol: str) -> Iterator[PageBlock | None]:
    yield Text(_PAPER if protocol == PAPER else _STRICT)
    yield _unfinished(results, protocol)
    yield from _paper_blocks(results) if protocol == PAPER else _strict_blocks(results)
    yield Heading(2, "Trainings")
    yield tables.training_table(results, protocol)


def _unfinished(results: PaperResults, protocol: str) -> Text | None:
    """Return which steps are not finished."""
    done, words = results.store.keys(), []
    for step in STEPS:
        keys = results.plan.job_keys_of(step, [protocol])
        count = sum(key in done for key in keys)
        if count < len(keys):
            words.append(f"{step} {count} of {len(keys)}")
    return Text(f"**Not finished:** {', '.join(words)}.") if words else None


def _paper_blocks(results: PaperResults) -> Iterator[PageBlock | None]:
    yield Heading(2, "Targets")
    yield tables.target_table(results)
    for table in SUB_TABLES:
        yield Heading(2, table.title)
        yield tables.pair_table(results, PAPER, table)
        yield tables.area_table(results, PAPER, table)
    yield Heading(2, "Beside the classical estimators")
    yield Text(_MIXTURE)
    yield violin_picture(results, PAPER)
    yield from _by_domain(results, PAPER)
    yield Heading(2, "Mean and deviation")
    yield mcd_picture(results, PAPER)
    if results.trade.facts:
        yield Heading(2, "Width, depth, resolution")
        yield Text(_TRADE)
        yield trade_picture(results)
        yield tables.trade_table(results)
    yield Heading(2, "The rest of the 72 pairs")
    for table in OTHERS:
        yield Heading(3, table.title)
        yield tables.pair_table(results, PAPER, table)


def _by_domain(results: PaperResults, protocol: str) -> Iterator[PageBlock]:
    for domain in results.domains:
        yield Heading(3, domain)
        yield tables.mixture_table(results, protocol, domain)
    yield Heading(2, "Calibration")
    yield Text(_CALIBRATION)
    for domain in results.domains:
        yield Heading(3, f"Calibration, {domain}")
        yield tables.calibration_table(results, protocol, domain)


def _strict_blocks(results: PaperResults) -> Iterator[PageBlock | None]:
    if results.strict.facts:
        yield from _attack_blocks(results)
    yield Heading(2, "72 pairs")
    yield Text("Attacked sweeps face one attack each, all that touch returns in turn, with their default budgets.")
    for table in (*SUB_TABLES, *OTHERS):
        yield Heading(3, table.title if table is BENIGN_TABLE else table.title.replace("Left out by the paper: t", "T"))
        yield tables.pair_table(results, STRICT, table)
    yield Heading(2, "All attacks together, beside the classical estimators")
    yield Text(_MIXTURE)
    yield violin_picture(results, STRICT)
    yield from _by_domain(results, STRICT)
    yield Heading(2, "Mean and deviation")
    yield mcd_picture(results, STRICT)
    if results.monitor.facts:
        plan = results.plan
        yield Heading(2, "The anomaly detector")
        rate = f"{plan.monitor_false_alarms:g}"
        domain = f"Domain {plan.monitor_domain}, calibrated for a rate of {rate} false alarms."
        yield Text(f"{ABOUT_MONITOR} Paper: no figures. {domain}")
        yield tables.monitor_table(results, "attack")
        yield Text(f"Benign corruptions of severity {plan.monitor_severity}: an alarm here is a false one.")
        yield tables.monitor_table(results, "corruption")


def _attack_blocks(results: PaperResults) -> Iterator[PageBlock]:
    plan = results.plan
    yield Heading(2, "Every attack, every contestant")
    yield Text(
        f"{plan.strict_frames} sweeps a domain under all {len(ATTACKS)} attacks with their default "
        "budgets. A star: the adversarially trained networks have seen it. *In the wedge*: only cells in the azimuths "
        "that the attacker reaches, precision / recall / F1, above the same with no return touched. Attackers do not "
        "know the estimator."
    )
    for domain in results.domains:
        yield Heading(3, f"Who wins, {domain}")
        yield tables.seen_table(results, domain)
        yield tables.winner_table(results, domain)
        yield Heading(3, f"F1 in the view, {domain}")
        yield tables.view_table(results, domain)
        yield Heading(3, f"In the wedge, {domain}")
        yield tables.wedge_table(results, domain)
        yield from severity_pictures(results, domain)
    if results.strict.refused:
        refused = sorted(results.strict.refused.items())
        words = (f"{case.name} in {domain} ({count} times: {why})" for (domain, case, why), count in refused)
        yield Text(f"Could not be made: {'; '.join(words)}.")
