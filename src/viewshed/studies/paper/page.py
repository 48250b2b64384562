"""The two pages: what is told of the paper's protocol and of the strict one, with their figures.

The figures of both pages: from results, and for the maps from the networks themselves, to PNGs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from viewshed._page import Heading, PageBlock, Picture, Text, facts, to_markdown
from viewshed.studies.cases import BENIGN, Case
from viewshed.studies.figures import Curves, Dot, Map, Violins, curve_figure, map_figure, trade_figure, violin_figure
from viewshed.studies.paper import tables
from viewshed.studies.paper import tables as other_tables
from viewshed.studies.paper import tables as strict_tables
from viewshed.studies.paper.data import Said, TestSweep, test_sweep
from viewshed.studies.paper.jobs import STEPS, keys_of
from viewshed.studies.paper.models import load_runner, network, passes_of, weights_of
from viewshed.studies.paper.protocols import MIXTURES, TOUCHING, Model, Setting, setting_of
from viewshed.studies.paper.results import (
    BENIGN_TABLE,
    OTHERS,
    SUB_TABLES,
    VIEW,
    WEDGE,
    Floats,
    PairKey,
    Results,
    StrictKey,
    accuracy,
)
from viewshed.studies.paper.tables import contestants_of, domains_of, own_name, trade_rows, who
from viewshed.studies.robustness.results import f1, precision
from viewshed.threats.attacks import ATTACKS, SEVERITIES

SHOWN = "far_wall"
"""Attack of the strict protocol's maps: a corridor that is not there."""

CURVED = 9
"""Contestants that the severity curves show at most, the best on benign sweeps beside all networks."""


def violin_picture(results: Results, protocol: str) -> Picture:
    """Return violins of precision and AUPRC of each sweep, for every domain: benign against attacked."""
    panels = []
    for domain in domains_of(results.store.plan):
        names = contestants_of(results, protocol, domain)
        for word in ("precision", "AUPRC"):
            pairs = {
                own_name(name, domain).replace("paper_", "paper: "): _both(results, protocol, (name, domain), word)
                for name in names
            }
            panels.append(Violins(f"{domain}: {word}", pairs))
    attacked = "the paper's attacks" if protocol == "paper" else "one attack each, all in turn"
    return Picture(
        f"reproduce_{protocol}_violins.png", violin_figure(panels, 2, attacked),
        f"Precision and AUPRC of single sweeps, benign and under {attacked}, networks and classical estimators",
    )  # fmt: skip


def _both(results: Results, protocol: str, who_where: tuple[str, str], word: str) -> tuple[Floats, Floats]:
    name, domain = who_where
    one, other = (results.pairs[PairKey(protocol, name, mixture, domain)] for mixture in MIXTURES)
    if word == "AUPRC":
        return one.areas, other.areas
    return precision(one.counts), precision(other.counts)


def mcd_picture(results: Results, protocol: str) -> Picture | None:
    """Return mean and deviation on one sweep, benign and attacked, by networks trained without and with attacks.

    None if the networks are not there.
    """
    plan, folder = results.store.plan, results.store.folder
    domain = "nuscenes" if "nuscenes" in plan.domains else plan.domains[0]
    models = {mixture: Model(protocol, "mcd", mixture, domain) for mixture in MIXTURES}
    if any((model.protocol, model.name) not in results.models for model in models.values()):
        return None
    setting, test = _shown_sweep(results, protocol, domain)
    predict = {
        mixture: network(load_runner(weights_of(folder, model)), setting, passes_of(plan, model), plan.test_seed)
        for mixture, model in models.items()
    }
    rows = {
        f"{name} sweep": [
            Map("returns", "returns", np.minimum(setting.grid.count(sweep.points), 1)),
            Map("truth, clean sweep", "truth", test.visible),
            *(each for mixture in MIXTURES for each in _mean_and_std(f"{mixture}-trained", predict[mixture](sweep))),
        ]
        for name, sweep in zip(MIXTURES, (test.benign, test.attacked), strict=True)
    }
    alt = f"Monte Carlo dropout on one sweep of {domain}, benign and under {test.attack}: mean and deviation"
    return Picture(f"reproduce_{protocol}_mcd.png", map_figure(rows), alt)


def _shown_sweep(results: Results, protocol: str, domain: str) -> tuple[Setting, TestSweep]:
    """Return the first held-out sweep that the paper's mixture attacks, or the first under ``SHOWN``."""
    plan, folder = results.store.plan, results.store.folder
    setting = setting_of(plan, protocol, domain)
    if protocol == "strict":
        return setting, test_sweep(plan, folder, setting, TOUCHING.index(SHOWN))
    tests = [test_sweep(plan, folder, setting, number) for number in range(plan.pair_frames)]
    return setting, next((test for test in tests if test.attacked is not test.benign), tests[0])


def _mean_and_std(title: str, said: Said) -> list[Map]:
    mean, std = said
    return [
        Map(f"{title}: mean", "probability", mean),
        Map("deviation", "deviation", np.zeros_like(mean) if std is None else std),
    ]


def trade_picture(results: Results) -> Picture | None:
    """Return precision, accuracy and F1 of the trade study over latency; None if there are no results."""
    dots = []
    for line in trade_rows(results):
        pooled, (width, depth, cells) = line["measured"].counts.sum(axis=0), line["shape"]
        rates = {"precision": precision, "accuracy": accuracy, "F1": f1}
        values = {name: float(measure(pooled)) for name, measure in rates.items()}
        dots.append(Dot(cells, depth, width, values | {"latency, ms, 2 threads": line["latency_ms"]["2"]}))
    if not dots:
        return None
    png = trade_figure(dots, "latency, ms, 2 threads", ("precision", "accuracy", "F1"))
    alt = "Precision, accuracy and F1 over the latency of one pass, by resolution, depth and width"
    return Picture("reproduce_paper_trade.png", png, alt)


def severity_pictures(results: Results, domain: str) -> Iterator[Picture]:
    """Yield curves of F1 in the view and in the wedge over the strengths of the attacks that have some."""
    names = _shown(results, domain)
    for where, columns in (("view", VIEW), ("wedge", WEDGE)):
        panels = list(_severities(results, domain, names, columns))
        if panels:
            png = curve_figure(panels, 4, f"F1 in the {where}")
            alt = f"{domain}: F1 in the {where} over the strength of each attack"
            yield Picture(f"reproduce_strict_{where}_{domain}.png", png, alt)


def _shown(results: Results, domain: str) -> list[str]:
    """Return all networks and, of the classical estimators, the best on benign sweeps."""
    names = who(results, domain)
    classical = [name for name in names if not name.startswith(("mle-", "mcd-"))]
    scored = {name: results.under(StrictKey(domain, BENIGN, name), f1) for name in classical}
    chosen = sorted(classical, key=lambda name: -scored[name])[: CURVED - (len(names) - len(classical))]
    return [name for name in names if name not in classical or name in chosen]


def _severities(results: Results, domain: str, names: Sequence[str], columns: slice) -> Iterator[Curves]:
    there = {key.case for key in results.strict if key.domain == domain}
    for name in ATTACKS:
        for attribute in dict.fromkeys(attribute for attribute, _ in SEVERITIES.get(name, ())):
            levels = [f"{a} {value:g}" for a, value in SEVERITIES[name] if a == attribute]
            cases = [case for level in levels if (case := Case("strength", name, level)) in there]
            if not cases or (columns == WEDGE and not results.has_wedge(domain, cases[0])):
                continue
            steps = [case.level.removeprefix(f"{attribute} ") for case in cases]
            first = BENIGN if columns == VIEW else None
            curves = {
                who_: [*([results.under(StrictKey(domain, first, who_), f1)] if first else []),
                       *(results.under(StrictKey(domain, case, who_), f1, columns) for case in cases)]
                for who_ in names
            }  # fmt: skip
            yield Curves(f"{name}, {attribute}", [*(["benign"] if first else []), *steps], curves)


TITLES = {"paper": "The published study, made again", "strict": "The published study, held against exact truth"}

_PAPER = """\
arXiv 2503.07375 made again on simulated sweeps: its network, label, grid, threshold and attacks. The truth is the
paper's label, the farthest return in polar bins of the *clean* sweep, which is itself one of the contestants: agreeing
with it is not being right. What is right is on [the strict page](reproduce_strict.md). Rows are test sets, columns
training sets; a cell is precision, recall, accuracy (in hundredths) and F1, pooled over all cells of the held-out
sweeps. Sweeps tested on are of scenes and of a seed that nothing was trained or chosen on. Intervals are 95 %, by a
bootstrap over the scenes (1,000 draws): how far a figure depends on which scenes were drawn."""

_STRICT = """\
The same networks trained on exact truth (`probe`, car, where it is known) and held against it, on the presets' own
grids and with a threshold of .5, beside every classical estimator, **whoever wins**. Networks see counts of returns,
nothing else. What is bold is the best of its row, or of its column where columns are figures. Intervals and scenes as
on [the paper's page](reproduce_paper.md)."""

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

_MONITOR = """\
The paper's detector: a cell is suspect if its deviation over the passes is above the threshold that it has from benign
sweeps, and the sweep's score is the share of suspect cells. Fitted, calibrated and reported on different held-out
scenes. AUROC: how often an attacked sweep scores above a benign one (.5 is chance). *Caught at 1 %*: share of the
sweeps above a limit that at most 1 % of these benign sweeps pass. *Alarms*: at the calibrated limit. *AUROC of the
mean*: of the plain mean deviation. Paper: no figures."""


def files_of(results: Results, protocol: str) -> dict[str, bytes]:
    """Return the files of a protocol's page by name: figures first, the page last.

    Raises:
        ValueError: there are no results of the protocol.
    """
    if not any(key.protocol == protocol for key in results.pairs):
        raise ValueError(f"{results.store.path} must hold pairs of the {protocol} protocol, got none; run step pairs")
    blocks = [block for block in _blocks(results, protocol) if block is not None]
    files = {block.name: block.png for block in blocks if isinstance(block, Picture)}
    page = to_markdown(TITLES[protocol], facts(**told(results, protocol)), blocks)
    return files | {f"reproduce_{protocol}.md": page.encode()}


def told(results: Results, protocol: str) -> dict[str, str]:
    """Return what a page rests on, by name."""
    plan = results.store.plan
    sweeps = ", ".join(
        f"{domain} {len(scenes)} of {len(set(scenes))} scenes"
        for (of, domain), scenes in sorted(results.scenes.items())
        if of == protocol
    )
    shape = f"{plan.cells} × {plan.cells} cells, width {plan.width}, depth {plan.depth}, dropout {plan.dropout:g}"
    seen = ", ".join(plan.trained_attacks)
    attacks = {
        "paper": "the paper's mixture, in training and test",
        "strict": f"trained on {seen} ({100 * plan.attack_share:.0f} % of the sweeps); the others are never seen",
    }
    return {
        "plan": f"{plan.name}: {plan.about}", "seeds": f"{plan.seed} trained, {plan.test_seed} tested",
        "network": f"{shape}; {plan.passes} passes for MCD",
        "training": f"at most {plan.epochs} epochs of {plan.frames_per_epoch} sweeps, batches of {plan.batch}, "
        f"{plan.loss}, Adam {plan.learning_rate:g} ({plan.schedule}), stopped after {plan.patience} without gain",
        "held-out sweeps": sweeps, "attacks": attacks[protocol],
        "commits of the run": ", ".join(sorted(commit[:7] for commit in results.commits)) or "unknown",
    }  # fmt: skip


def _blocks(results: Results, protocol: str) -> Iterator[PageBlock | None]:
    yield Text(_PAPER if protocol == "paper" else _STRICT)
    yield _unfinished(results, protocol)
    yield from _paper_blocks(results) if protocol == "paper" else _strict_blocks(results)
    yield Heading(2, "Trainings")
    yield other_tables.training_table(results, protocol)


def _unfinished(results: Results, protocol: str) -> Text | None:
    """Say which steps are not finished."""
    done, words = results.store.keys(), []
    for step in STEPS:
        keys = keys_of(results.store.plan, step, [protocol])
        there = sum(key in done for key in keys)
        if there < len(keys):
            words.append(f"{step} {there} of {len(keys)}")
    return Text(f"**Not finished:** {', '.join(words)}.") if words else None


def _paper_blocks(results: Results) -> Iterator[PageBlock | None]:
    yield Heading(2, "Targets")
    yield tables.target_table(results)
    for table in SUB_TABLES:
        yield Heading(2, table.title)
        yield tables.pair_table(results, "paper", table)
        yield tables.area_table(results, "paper", table)
    yield Heading(2, "Beside the classical estimators")
    yield Text(_MIXTURE)
    yield violin_picture(results, "paper")
    yield from _by_domain(results, "paper")
    yield Heading(2, "Mean and deviation")
    yield mcd_picture(results, "paper")
    if "trade" in results.others:
        yield Heading(2, "Width, depth, resolution")
        yield Text(_TRADE)
        yield trade_picture(results)
        yield other_tables.trade_table(results)
    yield Heading(2, "The rest of the 72 pairs")
    for table in OTHERS:
        yield Heading(3, table.title)
        yield tables.pair_table(results, "paper", table)


def _by_domain(results: Results, protocol: str) -> Iterator[PageBlock]:
    for domain in tables.domains_of(results.store.plan):
        yield Heading(3, domain)
        yield tables.mixture_table(results, protocol, domain)
    yield Heading(2, "Calibration")
    yield Text(_CALIBRATION)
    for domain in tables.domains_of(results.store.plan):
        yield Heading(3, f"Calibration, {domain}")
        yield tables.calibration_table(results, protocol, domain)


def _strict_blocks(results: Results) -> Iterator[PageBlock | None]:
    if results.strict:
        yield from _attack_blocks(results)
    yield Heading(2, "72 pairs")
    yield Text("Attacked sweeps face one attack each, all that touch returns in turn, with their default budgets.")
    for table in (*SUB_TABLES, *OTHERS):
        yield Heading(3, table.title if table is BENIGN_TABLE else table.title.replace("Left out by the paper: t", "T"))
        yield tables.pair_table(results, "strict", table)
    yield Heading(2, "All attacks together, beside the classical estimators")
    yield Text(_MIXTURE)
    yield violin_picture(results, "strict")
    yield from _by_domain(results, "strict")
    yield Heading(2, "Mean and deviation")
    yield mcd_picture(results, "strict")
    if "monitor" in results.others:
        plan = results.store.plan
        yield Heading(2, "The anomaly detector")
        rate = f"{plan.monitor_false_alarms:g}"
        yield Text(f"{_MONITOR} Domain {plan.monitor_domain}, calibrated for a rate of {rate} false alarms.")
        yield other_tables.monitor_table(results, "attack")
        yield Text(f"Benign corruptions of severity {plan.monitor_severity}: an alarm here is a false one.")
        yield other_tables.monitor_table(results, "corruption")


def _attack_blocks(results: Results) -> Iterator[PageBlock]:
    plan = results.store.plan
    yield Heading(2, "Every attack, every contestant")
    yield Text(
        f"{plan.strict_frames} sweeps a domain under all {len(ATTACKS)} attacks with their default "
        "budgets. A star: the adversarially trained networks have seen it. *In the wedge*: only cells in the azimuths "
        "that the attacker reaches, precision / recall / F1, above the same with no return touched. Attackers do not "
        "know the estimator."
    )
    for domain in tables.domains_of(plan):
        yield Heading(3, f"Who wins, {domain}")
        yield strict_tables.seen_table(results, domain)
        yield strict_tables.winner_table(results, domain)
        yield Heading(3, f"F1 in the view, {domain}")
        yield strict_tables.view_table(results, domain)
        yield Heading(3, f"In the wedge, {domain}")
        yield strict_tables.wedge_table(results, domain)
        yield from severity_pictures(results, domain)
    if results.refused:
        refused = sorted(results.refused.items())
        words = (f"{case.name} in {domain} ({count} times: {why})" for (domain, case, why), count in refused)
        yield Text(f"Could not be made: {'; '.join(words)}.")
