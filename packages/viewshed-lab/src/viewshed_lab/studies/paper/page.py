"""The two pages of the study: their pictures and values; the text is in ``page.md`` and ``strict.md``."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from viewshed.grid import BevGrid
from viewshed_lab._page import facts
from viewshed_lab.studies.cases import TOUCHING, strength_cases
from viewshed_lab.studies.evaluate import Evaluation
from viewshed_lab.studies.figures import (
    Curves,
    Map,
    Violins,
    curve_figure,
    curves_of,
    map_figure,
    trade_figure,
    violin_figure,
    violins_of,
)
from viewshed_lab.studies.formatting import commits
from viewshed_lab.studies.pages import Picture, fill_template
from viewshed_lab.studies.paper import tables
from viewshed_lab.studies.paper.data import archive_path, evaluation_of
from viewshed_lab.studies.paper.jobs import ATTACKED, tampered_of
from viewshed_lab.studies.paper.models import (
    WEIGHTS,
    NetworkAlone,
    chosen_of,
    fold_scores,
    load_runner,
    network_of,
    trade_name,
)
from viewshed_lab.studies.paper.plan import MIXTURES, STEPS, Model
from viewshed_lab.studies.paper.protocols import setting_of
from viewshed_lab.studies.paper.published import OTHERS, SUB_TABLES, PaperResults
from viewshed_lab.studies.records import BENIGN, PAPER, STRICT, VIEW, WEDGE, Case, Domain
from viewshed_lab.threats.attacks import ATTACKS, SEVERITIES
from viewshed_lab.threats.attacks.base import Tampered
from viewshed_lab.training.figures import convergence_figure, fold_figure

TEMPLATES = {PAPER: "paper/page.md", STRICT: "paper/strict.md"}

STEMS = {PAPER: "paper", STRICT: "paper_strict"}
"""File names of the pages, and prefixes of those of their pictures."""

SHOWN = "far_wall"
"""Attack of the strict protocol's maps: a false corridor."""

SPOOFED = "100"
"""Number of spoofed points in the pictures of the paper's protocol."""

UNIFORM = Case("paper", "uniform", SPOOFED)

SPREAD = 50
"""Maximum number of sweeps that the picture of the spread overlays."""

CURVED = 9
"""Maximum number of curves in severity pictures: all networks, and the classical estimators best on benign sweeps."""

LATENCY = "latency, ms, 2 threads"


def violin_picture(results: PaperResults, protocol: str) -> Picture:
    """Return violins of precision and AUPRC of single sweeps by domain: benign against attacked."""
    panels = dict[str, Violins]()
    for domain in results.domains:
        methods = tables.pair_methods(results, protocol, domain).items()
        labeled = {short.replace("paper_", "paper: "): name for short, name in methods}
        panels |= violins_of(results.pairs_in(protocol, domain), labeled, [ATTACKED])
    attacked = "the paper's attacks" if protocol == PAPER else "one attack each, all in turn"
    return Picture(
        f"{STEMS[protocol]}_violins.png", violin_figure(panels, 2, attacked),
        f"Precision and AUPRC of single sweeps, benign and under {attacked}, networks and classical estimators",
    )  # fmt: skip


def spread_picture(results: PaperResults) -> Picture | None:
    """Return maps of the points that the published attack adds to one sweep, and to all held-out ones of a domain.

    None if the archive of the domain is missing.
    """
    plan, folder = results.plan, results.store.folder
    domain = plan.domains[0]
    if not archive_path(folder, domain, "test").exists():
        return None
    setting, rows = setting_of(plan, PAPER, domain), {}
    numbers = range(plan.pair_frames[0])[:SPREAD]
    for name in ("uniform", "cluster"):
        case, added = Case("paper", name, SPOOFED), np.zeros(setting.grid.shape)
        for number in numbers:
            evaluation = evaluation_of(plan, folder, setting, setting.suite({}), number)
            tampered = tampered_of(evaluation, case, plan.test_seed)
            added += setting.grid.count(tampered.sweep.points[tampered.added])
            if number == numbers[0]:
                maps = [
                    Map(title, "returns", np.minimum(setting.grid.count(points), 1))
                    for title, points in (
                        ("one sweep", evaluation.sample.sweep.points),
                        ("attacked", tampered.sweep.points),
                        ("added points", tampered.sweep.points[tampered.added]),
                    )
                ]
        rows[name] = [*maps, Map(f"added to {len(numbers)} sweeps", "returns", np.minimum(added, 1))]
    alt = f"{SPOOFED} spoofed points, uniform and as a cluster, on one sweep of {domain} and on {len(numbers)}"
    return Picture("paper_spread.png", map_figure(rows), alt)


def fold_pictures(results: PaperResults) -> Iterator[Picture]:
    """Yield pictures of the validation loss of each fold over its epochs, and of the F1 of all folds, by setting."""
    folds = results.store.results("crossval").facts
    if not folds:
        return
    curves: dict[str, list[list[float]]] = {}
    for key, training in folds.items():
        losses = [epoch["validation_loss"] for epoch in training["history"]]
        curves.setdefault(f"dropout {key[1]}, learning rate {key[2]}", []).append(losses)
    alt = "Validation loss of every fold over its epochs, by dropout and learning rate"
    yield Picture("paper_folds.png", convergence_figure(curves), alt)
    scores = fold_scores(results.plan, results.store.folder)
    chosen = chosen_of(results.plan, results.store.folder)
    values = {setting.name: [score.f1 for score in scores[setting]] for setting in sorted(scores)}
    png = fold_figure("cross-validation", values, "" if chosen is None else chosen.name)
    yield Picture("paper_crossval.png", png, "F1 of every fold, by setting; the chosen one in color")


def resolution_picture(results: PaperResults) -> Picture | None:
    """Return maps of input, truth, probability and mask of one sweep by resolution of the trade study; None without."""
    plan, folder, rows = results.plan, results.store.folder, {}
    base = setting_of(plan, PAPER, plan.trade_domain)
    width = min(plan.trade_widths, key=lambda one: abs(one - plan.width))
    for cells in plan.trade_cells:
        shape = (width, plan.trade_depths[-1], cells)
        if ("trade", *map(str, shape)) in results.trade.facts:
            setting = replace(base, grid=BevGrid(cells, base.grid.half_extent_m))
            runner = load_runner(folder / "trade" / f"trade-{trade_name(shape)}" / WEIGHTS)
            evaluation = evaluation_of(plan, folder, setting, setting.suite({}), 0)
            estimate = NetworkAlone(runner, setting.card(runner.card), 1, 0).estimate(evaluation.sample.sweep)
            rows[f"{cells} cells"] = [
                Map("input", "returns", np.minimum(setting.grid.count(evaluation.sample.sweep.points), 1)),
                Map("truth", "truth", evaluation.reference.visible),
                Map("probability", "probability", estimate.visible_prob),
                Map(f"mask, p ≥ {setting.threshold:g}", "truth", estimate.visible_prob >= setting.threshold),
            ]
    alt = f"Input, truth, probability and mask of one sweep of {plan.trade_domain} by resolution"
    return Picture("paper_resolutions.png", map_figure(rows), alt) if rows else None


def mcd_picture(results: PaperResults, protocol: str) -> Picture | None:
    """Return maps of mean and deviation on one sweep, benign and attacked, by networks of both training mixtures.

    None if a network is not trained.
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
    attack = setting.attack(evaluation.number).name if protocol == STRICT else f"{SPOOFED} uniform points"
    alt = f"Monte Carlo dropout on one sweep of {domain}, benign and under {attack}: mean and deviation"
    return Picture(f"{STEMS[protocol]}_mcd.png", map_figure(rows), alt)


def _shown_sweep(results: PaperResults, protocol: str, domain: str) -> tuple[Evaluation, Tampered]:
    """Return evaluation and attacked sweep of the maps: the first with uniform points, or (strict) under ``SHOWN``."""
    plan, folder, setting = results.plan, results.store.folder, setting_of(results.plan, protocol, domain)
    number = 0 if protocol == PAPER else TOUCHING.index(SHOWN)
    attack = UNIFORM if protocol == PAPER else setting.attack(number)
    evaluation = evaluation_of(plan, folder, setting, setting.suite({}), number)
    return evaluation, tampered_of(evaluation, attack, plan.test_seed)


def trade_picture(results: PaperResults) -> Picture | None:
    """Return the picture of precision, accuracy and F1 of the trade study over latency; None without results."""
    dots = {}
    for shape, counts in tables.trade_counts(results).items():
        rates = {"precision": counts.precision, "accuracy": counts.accuracy, "F1": counts.f1}
        dots[shape] = rates | {LATENCY: tables.trade_facts(results, shape)["ms, 2 threads"]}
    alt = "Precision, accuracy and F1 over the latency of one pass, by resolution, depth and width"
    return (
        Picture("paper_trade.png", trade_figure(dots, LATENCY, ("precision", "accuracy", "F1")), alt) if dots else None
    )


def severity_pictures(domain: tables.StrictDomain) -> Iterator[Picture]:
    """Yield pictures of F1 in the view and in the wedge over the strength of each attack that has strengths."""
    classical = [name for name in domain.methods if name not in tables.NETWORKS]
    best = sorted(classical, key=lambda name: -domain.counts(name).f1)
    chosen = best[: CURVED - (len(domain.methods) - len(classical))]
    methods = [name for name in domain.methods if name not in classical or name in chosen]
    for region in (VIEW, WEDGE):
        panels = _severities(domain, methods, region)
        if panels:
            png = curve_figure(panels, 4, f"F1 in the {region}")
            alt = f"{domain.name}: F1 in the {region} over the strength of each attack"
            yield Picture(f"paper_strict_{region}_{domain.name}.png", png, alt)


def _severities(domain: tables.StrictDomain, methods: list[str], region: str) -> dict[str, Curves]:
    """Return curves of F1 in a region over the strengths of each attack, by title."""
    panels = {}
    for name in ATTACKS:
        for attribute in dict.fromkeys(attribute for attribute, _ in SEVERITIES.get(name, ())):
            cases = [case for case in strength_cases(name, attribute) if case in domain.cases]
            if cases and (region == VIEW or domain.has_wedge(cases[0])):
                steps = {"benign": BENIGN} if region == VIEW else {}
                steps |= {case.level.removeprefix(f"{attribute} "): case for case in cases}
                panels[f"{name}, {attribute}"] = curves_of(
                    domain, methods, steps, lambda domain, method, case: domain.counts(method, case, region).f1
                )
    return panels


def files_of(results: PaperResults, protocol: str) -> dict[str, bytes]:
    """Return the files of a protocol's page by name: pictures first, the page last."""
    if not results.pairs.series(protocol=protocol):
        raise ValueError(f"{results.store.folder} must hold pairs of the {protocol} protocol, got none; run step pairs")
    every = (*SUB_TABLES, *OTHERS)
    page = fill_template(
        TEMPLATES[protocol], results=results, plan=results.plan, protocol=protocol, tables=tables,
        unfinished=_unfinished(results, protocol), domains=results.domains, attacks=len(ATTACKS),
        published_tables=SUB_TABLES, other_tables=OTHERS,
        every_table=[replace(one, title=one.title.replace("Left out by the paper: t", "T")) for one in every],
        strict_domains=[Domain(results.strict, name) for name in results.domains] if results.strict.facts else (),
        violin_picture=violin_picture, mcd_picture=mcd_picture, trade_picture=trade_picture,
        spread_picture=spread_picture, fold_pictures=fold_pictures, resolution_picture=resolution_picture,
        severity_pictures=severity_pictures, refused=_refused,
    )  # fmt: skip
    return page.files(f"{STEMS[protocol]}.md", facts(**provenance(results, protocol)))


def provenance(results: PaperResults, protocol: str) -> dict[str, str]:
    """Return the provenance of a page: plan, seeds, network, training, data and attacks, by name."""
    plan, chosen = results.plan, chosen_of(results.plan, results.store.folder)
    of, by = (plan, "") if chosen is None else (chosen, ", chosen by cross-validation")
    shape = f"{plan.cells} × {plan.cells} cells, width {plan.width}, depth {plan.depth}, dropout {of.dropout:g}{by}"
    seen = ", ".join(plan.trained_attacks)
    attacks = {
        PAPER: "the paper's mixture, in training and test",
        STRICT: f"trained on {seen} ({100 * plan.attack_share:.0f} % of the sweeps); the others are never seen",
    }
    return {
        "plan": f"{plan.name}: {plan.about}", "seeds": f"{plan.seed} trained, {plan.test_seed} tested",
        "network": f"{shape}; {plan.passes} passes for MCD",
        "training": f"at most {plan.epochs} epochs of {plan.frames_per_epoch} sweeps, batches of {plan.batch}, "
        f"{plan.loss}, Adam {of.learning_rate:g}{by} ({plan.schedule}), stopped after {plan.patience} without gain",
        **({"hours of the jobs, added up": hours} if (hours := _hours(results, protocol)) else {}),
        "held-out sweeps": ", ".join(_held_out_words(results, protocol)), "attacks": attacks[protocol],
        "commits of the run": commits(results.pairs, results.strict, results.trade, results.monitor),
    }  # fmt: skip


def _hours(results: PaperResults, protocol: str) -> str:
    """Return the summed hours of the timed jobs of each step, as text."""
    facts = {**results.store.results("crossval").facts, **results.pairs.facts, **results.trade.facts}
    facts |= {("models", *name): of for name, of in results.models.items()}
    words = []
    for step, name in {"crossval": "folds", "models": "trainings", "pairs": "pairs", "trade": "trade study"}.items():
        keys = results.plan.job_keys_of(step, [protocol])
        seconds = [facts[key]["seconds"] for key in keys if "seconds" in facts.get(key, ())]
        words += [f"{name} {sum(seconds) / 3600:.2f}"] if seconds else []
    return ", ".join(words)


def _held_out_words(results: PaperResults, protocol: str) -> Iterator[str]:
    """Yield the numbers of scored sweeps and scenes of each domain, as text; of MCD too if it has fewer."""
    for domain in sorted(results.plan.domains):
        series, words = results.pairs.series(domain, protocol), []
        for mcd in (False, True):
            scenes_of = [results.pairs.scenes(s) for s in series if results.plan.is_mcd(s.method) == mcd]
            if scenes := max(scenes_of, key=len, default=[]):
                words.append(f"{len(scenes)} of {len(set(scenes))} scenes")
        if words:
            yield f"{domain} {words[0]}" + "".join(f" (MCD {word})" for word in words[1:] if word != words[0])


def _unfinished(results: PaperResults, protocol: str) -> str:
    """Return a sentence that lists the unfinished steps; an empty string without any."""
    done, words = results.store.keys(), []
    for step in STEPS:
        keys = results.plan.job_keys_of(step, [protocol])
        count = sum(key in done for key in keys)
        if count < len(keys):
            words.append(f"{step} {count} of {len(keys)}")
    return f"**Not finished:** {', '.join(words)}." if words else ""


def _refused(results: PaperResults) -> str | None:
    """Return a sentence that lists impossible attacks with the number of sweeps and the reason; None without any."""
    refused = sorted(results.strict.refused.items())
    words = [f"{case.name} in {domain} ({count} times: {why})" for (domain, case, why), count in refused]
    return f"Could not be made: {'; '.join(words)}." if words else None
