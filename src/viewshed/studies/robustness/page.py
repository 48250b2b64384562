"""The pages of the study: what they say in words, their tables and their pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from math import isnan

import numpy as np

from viewshed._page import Heading, PageBlock, Picture, Table, Text, facts, to_html, to_markdown
from viewshed.preprocess.leveling import level
from viewshed.studies import figures
from viewshed.studies.cases import MIXTURE, budget_cases, corruption_cases
from viewshed.studies.records import BENIGN, PAPER, STRICT, VIEW, WEDGE, Case, Results
from viewshed.studies.robustness import tables
from viewshed.studies.robustness.jobs import evaluation_of
from viewshed.studies.robustness.plan import PARTS, RobustnessPlan
from viewshed.studies.robustness.verdicts import MAX_F1_LOSS, MAX_WEDGE_LOSS, MODEST, Domain, domains_of
from viewshed.studies.runner import Job
from viewshed.studies.statistics import Floats, precision
from viewshed.studies.store import ResultStore
from viewshed.studies.suite import TESTED, strict_suite
from viewshed.threats.attacks import ATTACKS, FAMILY

DRAWN = ("quantized", "concave_hull", "first_blocker", "shadow_map", "majority_vote")
"""Estimators in the pictures of single sweeps."""


def violin_picture(domains: Sequence[Domain], protocol: str) -> Picture:
    """Return violins of precision and AUPRC for every domain: benign against the paper's mixture, or all attacks."""
    paper = protocol == PAPER
    panels = []
    for domain in domains:
        cases = [MIXTURE] if paper else list(domain.strongest.values())
        for word, values in (("precision", _precisions), ("AUPRC", _areas)):
            pairs = {
                name.replace("paper_", "paper: "): (
                    values(domain, name, [BENIGN], protocol), values(domain, name, cases, protocol),
                )
                for name in (domain.paper_methods if paper else domain.methods)
            }  # fmt: skip
            panels.append(figures.Violins(f"{domain.name}: {word}", pairs))
    attacked = "the paper's attacks" if paper else "every attack at its largest budget"
    png = figures.violin_figure(panels, 2, attacked)
    return Picture(f"robustness_violins_{protocol}.png", png, f"Precision and AUPRC, benign and under {attacked}")


def _precisions(domain: Domain, method: str, cases: Iterable[Case], protocol: str) -> Floats:
    found = (domain.results.each(domain.series(method, case, VIEW, protocol), precision) for case in cases)
    return np.concatenate([np.empty(0), *found])


def _areas(domain: Domain, method: str, cases: Iterable[Case], protocol: str) -> Floats:
    found = (domain.results.numbers(domain.series(method, case, VIEW, protocol), "auprc") for case in cases)
    return np.concatenate([np.empty(0), *found])


def budget_picture(domain: Domain) -> Picture:
    """Return curves of F1 in the whole view over the budget, one panel an attack."""
    panels = [_over_budgets(domain, name, lambda m, case: domain.counts(m, case).f1) for name in _budgeted(domain)]
    png = figures.curve_figure(panels, 5, "F1")
    return Picture(f"robustness_f1_{_word(domain)}.png", png, f"{domain.name}: F1 over the budget of each attack")


def wedge_picture(domain: Domain) -> Picture:
    """Return curves of precision in the attacker's wedge over the budget, one panel an attack that has a wedge."""
    attacks = [name for name in _budgeted(domain) if domain.has_wedge(domain.strongest[name])]
    panels = [_over_budgets(domain, name, lambda m, case: domain.counts(m, case, WEDGE).precision) for name in attacks]
    png = figures.curve_figure(panels, 5, "precision in the wedge")
    alt = f"{domain.name}: precision in the attacker's wedge over the budget of each attack"
    return Picture(f"robustness_wedge_{_word(domain)}.png", png, alt)


def _budgeted(domain: Domain) -> list[str]:
    return [name for name, case in domain.strongest.items() if case.kind == "attack"]


def _over_budgets(domain: Domain, attack: str, value: Callable[[str, Case], float]) -> figures.Curves:
    return _curves(domain, f"{attack} ({FAMILY[attack]})", budget_cases(attack, domain.plan.budgets), value)


def _curves(domain: Domain, title: str, cases: Sequence[Case], value: Callable[[str, Case], float]) -> figures.Curves:
    values = {name: [value(name, case) for case in cases] for name in domain.methods}
    return figures.Curves(title, [case.level or "benign" for case in cases], values)


def corruption_picture(domain: Domain) -> Picture:
    """Return curves of F1 over the severity, one panel a corruption; benign first."""
    panels = [
        _curves(
            domain, name, [BENIGN, *corruption_cases((name,), domain.plan.severities)],
            lambda m, case: domain.counts(m, case).f1,
        )
        for name in domain.plan.corruptions
    ]  # fmt: skip
    png = figures.curve_figure(panels, 5, "F1")
    alt = f"{domain.name}: F1 over the severity of each corruption"
    return Picture(f"robustness_corruptions_{_word(domain)}.png", png, alt)


def scene_picture(store: ResultStore[RobustnessPlan]) -> Picture:
    """Return the first sweep of the first domain under one attack of each family, at its largest budget."""
    plan, first = store.plan, dict[int, str]()
    for name in ATTACKS:
        if name in plan.attacks:
            first.setdefault(FAMILY[name], name)
    scenes = [_scene(store, plan.strongest(name)) for name in first.values()]
    alt = f"One sweep of {plan.domains[0]} under one attack of each family, the truth and what estimators say"
    return Picture("robustness_scenes.png", figures.scene_figure(scenes), alt)


def _scene(store: ResultStore[RobustnessPlan], case: Case) -> figures.Scene:
    evaluation = evaluation_of(Job(store.plan, store.folder, ("attacks", store.plan.domains[0], "0")))
    tampered, suite, sample = evaluation.tampered(case), strict_suite(evaluation.suite.grid, DRAWN), evaluation.sample
    leveled = level(tampered.sweep, suite.grid)
    claims = {
        name: evaluation.reference.prob_of(estimate) >= np.float32(suite.threshold)
        for name, estimate in suite.estimates(leveled).items()
    }
    wedge = None if tampered.wedge is None else (tampered.wedge.azimuth, tampered.wedge.width)
    return figures.Scene(
        f"{FAMILY[case.name]}  {case.name}\n{case.level}", suite.grid, sample.truth.visible(), sample.known,
        leveled.points[:, :2], tampered.added[leveled.rows], wedge, claims,
    )  # fmt: skip


def _word(domain: Domain) -> str:
    return "".join(letter if letter.isalnum() else "_" for letter in domain.name)


TITLE = "Robustness of the classical estimators"

LONG_TITLE = "Robustness: the long tables"

_INTRODUCTION = """\
Each estimator is given the same sweeps clean, attacked, corrupted, and behind defenses, and is held against exact truth
(`probe`, car, where it is known). Samples are pooled: precision, recall and F1 are of all cells together. *Over* and
*under*: what is claimed and not visible, visible and not claimed. *In the wedge*: only cells in the azimuths that the
attacker reaches. Intervals are 95 %, by a bootstrap over the scenes (1,000 draws; one sample a scene). A budget is a
number of returns, *full* every beam of the wedge. All long tables are apart: the page beside this one, or the end of
the HTML file. `shadow_map_unknown` is `shadow_map` where a beam without a return says nothing; the bar is the better
of the two."""

_SHORT = """\
One line an estimator, the best of each column in bold: the bar for a learned one. *Attacked*: mean over all attacks at
their largest budget; *in the wedge*: mean over those that have one; *corrupted*: mean over all corruptions of severity
{severity}. *Withstands*: of how many attacks, see the next chapter; *asked*: of attackers who ask the estimator before
they attack it."""

_RULE = f"""\
**These attackers do not know whom they attack:** they do the same to every estimator. Those who do know are in the next
chapter. To withstand means: at no budget does F1 of the view fall by more than {MAX_F1_LOSS}, nor precision or recall
in the wedge (of the view where there is no wedge) by more than {MAX_WEDGE_LOSS}, against the same sweeps with no return
touched. To withstand is not to be right: who claims little has little to lose. The losses are in the long tables."""

_ASKING = """\
These attackers ask: each tries at most {queries} plans on the very estimator that it attacks, sees what the estimator
makes of them, and carries out the one that is worth most to it (`BlackBox`, evolution), with range noise and lost beams
that it could not foresee. Their wedge is that of the far wall, their budget {budget} returns; names that end in `_free`
put points anywhere in the wedge, the others keep to the beams. They know no truth, and more questions would find more:
these losses are lower bounds. Samples: {counts}. The verdict is by the rule above."""

_ASKED = """\
How many m² a sweep are over-claimed (under-claimed) that were not before, and in brackets how much precision (recall)
falls in the wedge. Beside it the worst of the attacks that do not ask, with the same budget on the same sweeps."""

_KNOWN_DEFENSE = """\
Behind each defense, `{attack}`: precision / recall in the wedge when no return is
touched, when the attacker asked the estimator and did not know of the defense, and when it asked both together. Where a
defense raises an alarm, the attacker who knows it also keeps it silent."""

_BAR = """\
The best classical F1 under each attack at its largest budget, and whose it is. The best is chosen after the fact, for
each attack anew; no single estimator reaches all of these."""

_LONG = """\
Who withstands what: *yes*, or the worst loss over the budgets: *over* of precision (false corridors, the dangerous
one), *under* of recall (false shadows), *F1* of the view alone."""

_LEVELS = ((MODEST, f"up to {MODEST} returns"), (None, "up to a full wedge"))

_PAPER = """\
The profile of arXiv 2503.07375 on our sweeps: its grid, its crop, a threshold of .7, and as truth its label, the
farthest return in 100 × 100 polar bins about the centroid of the *clean* points. Attacked are the points: the paper's
mixture (uniform, p .6; one cluster, p .2; nothing, p .2), and uniform points and one cluster with a fixed number.
Cells: precision, and its relative change. `paper_label` scores 1 on clean sweeps because it is the truth there. Ours
are held against that label as well: where they differ from it, it may be the label that is wrong."""

_GAINS = """\
What each defense adds to F1 of the view: on clean sweeps / on average over the attacks at their largest budget, whose
attackers know neither estimator nor defense. `temporal` compares with the sweep half a second earlier, which nobody
attacked: its best case. `empty_sector` drops nothing, it alarms."""

_CAUGHT = """\
Share of the attacker's returns that the defense drops / of all other returns; or how often it alarms."""

_CORRUPTIONS = """\
Who is held against what: `fewer_beams` and `dead_rings` leave another sensor, so the truth counts only the beams that
are left. `glass` takes returns away where beams still end, and `slope` raises the world and the beams together; for
both the truth stays what it was. `vegetation` puts bushes before surfaces: the truth does not know them, and a part of
what is over-claimed behind them is the truth's own. All others spoil the measurement alone."""


def files_of(
    store: ResultStore[RobustnessPlan], failed: Sequence[str] = (), stem: str = "robustness"
) -> dict[str, bytes]:
    """Return the files of the study by name: one HTML file, pictures, the long tables, and the main page last.

    Args:
        store: of the study.
        failed: jobs that failed, one line each.
        stem: of the names of the pages.

    Raises:
        ValueError: there are no results.
    """
    results = store.results()
    if not results.series():
        raise ValueError(f"{store.path} must hold results, got none; run without --no-run")
    blocks, details = list(blocks_of(store, results, failed)), list(details_of(results))
    about = facts(**provenance(results))
    files = {"index.html": to_html(TITLE, about, [*blocks, *details]).encode()}
    files |= {block.name: block.png for block in blocks if isinstance(block, Picture)}
    files |= {f"{stem}_tables.md": to_markdown(LONG_TITLE, about, details).encode()}
    return files | {f"{stem}.md": to_markdown(TITLE, about, blocks).encode()}


def blocks_of(
    store: ResultStore[RobustnessPlan], results: Results[RobustnessPlan], failed: Sequence[str] = ()
) -> Iterator[PageBlock]:
    """Yield the main page, chapter by chapter."""
    domains, plan = domains_of(results), results.plan
    yield Text(_INTRODUCTION)
    yield Text(_extent(results, failed))
    yield Heading(2, "In short")
    yield Text(_SHORT.format(severity=plan.defended_severity))
    for domain in domains:
        yield Heading(3, f"{domain.name}, in short")
        yield tables.summary_table(domain)
    yield Heading(2, "What withstands what, where the attacker does not know the victim")
    yield Text(_RULE)
    for most, words in _LEVELS:
        yield Heading(3, words.capitalize())
        yield Text(_summary(domains[0].attacks if domains else [], partial(_withstands, domains, most=most)))
    yield from _adaptive(plan, [domain for domain in domains if domain.met("adaptive").methods])
    if domains:
        yield Heading(2, "The bar for a learned estimator")
        yield Text(_BAR)
        yield Heading(3, "The bar in the whole view")
        yield tables.bar_overview(domains, VIEW)
        yield Heading(3, "The bar in the wedge")
        yield tables.bar_overview(domains, WEDGE)
    yield from _paper_protocol(plan, [domain for domain in domains if domain.paper_cases])
    if domains:
        yield Heading(2, "The strict block")
        yield violin_picture(domains, STRICT)
        yield scene_picture(store)
    for domain in domains:
        yield Heading(3, f"Clean sweeps, {domain.name}")
        yield tables.benign_table(domain)
        yield budget_picture(domain)
        yield wedge_picture(domain)
    yield Heading(2, "Corruptions")
    yield Text(_CORRUPTIONS)
    yield from map(corruption_picture, domains)
    yield from _defenses(plan, domains)
    if results.refused:
        yield Heading(2, "What could not run")
        rows = [
            [domain_, case.name, case.level, case.defense, str(count), why]
            for (domain_, case, why), count in sorted(results.refused.items())
        ]
        yield Table(["domain", "attack or corruption", "level", "defense", "samples", "why"], rows)


def details_of(results: Results[RobustnessPlan]) -> Iterator[PageBlock]:
    """Yield the long tables, domain by domain: losses, budgets, areas, strengths, severities, defenses."""
    yield Text(_LONG)
    for domain in domains_of(results):
        name = domain.name
        yield Heading(2, name)
        for most, words in _LEVELS:
            yield Heading(3, f"Who withstands what, {words}, {name}")
            yield tables.verdict_table(domain, most)
        yield Heading(3, f"F1, mean over the budgets, {name}")
        yield tables.budget_table(domain)
        yield Heading(3, f"In the wedge at the largest budget, precision / recall, {name}")
        yield tables.wedge_table(domain)
        yield Heading(3, f"More area over-claimed / under-claimed at the largest budget, m², {name}")
        yield tables.area_table(domain)
        if results.plan.strengths:
            yield Heading(3, f"Sectors, shares and offsets, precision / recall in the wedge, {name}")
            yield tables.strength_table(domain)
        yield Heading(3, f"F1 by severity of the corruption, {name}")
        yield tables.corruption_table(domain)
        for method in results.plan.defended:
            yield Heading(3, f"{method} behind each defense: F1 of the view (in the wedge), {name}")
            yield tables.defense_table(domain, method)
        yield Heading(3, f"What the defenses drop, {name}")
        yield Text(_CAUGHT)
        yield tables.caught_table(domain)


def provenance(results: Results[RobustnessPlan]) -> dict[str, str]:
    """Return what the pages rest on, by name."""
    counts = ", ".join(f"{domain.name} {results.sweeps(domain.name)}" for domain in domains_of(results))
    return {
        "study": f"{results.plan.name}, seed {results.plan.seed}",
        "samples": counts or "none",
        "target": "car",
        "commits of the run": ", ".join(sorted(commit[:7] for commit in results.commits)) or "unknown",
        "jobs": f"{len(results.facts)} of {len(results.plan.job_keys())}",
    }


def _extent(results: Results[RobustnessPlan], failed: Sequence[str]) -> str:
    plan, done, jobs = results.plan, len(results.facts), len(results.plan.job_keys())
    words = f"{sum(results.sweeps(domain.name) for domain in domains_of(results))} sweeps with {len(plan.attacks)} "
    words += f"attacks, {len(plan.corruptions)} corruptions and {len(plan.defenses)} defenses."
    if done < jobs:
        words += f" **Not finished: {done} of {jobs} jobs are done; a sample has up to {len(PARTS)}.**"
    return words + (f" {len(failed)} jobs failed: {'; '.join(failed[:3])}." if failed else "")


def _summary(attacks: Sequence[str], withstands: Callable[[str, str], bool]) -> str:
    """Return a list of what each estimator withstands in every domain, and what none does."""
    lines, by_any = [], set[str]()
    for name in TESTED:
        held = [attack for attack in attacks if withstands(attack, name)]
        by_any.update(held)
        lines.append(f"- **{name}** withstands {len(held)} of {len(attacks)} in every domain: {_listed(held)}.")
    nobody = [attack for attack in attacks if attack not in by_any]
    return "\n".join([*lines, f"- Withstood in all domains by no single classical estimator: {_listed(nobody)}."])


def _withstands(domains: Sequence[Domain], attack: str, method: str, most: int | None) -> bool:
    return all(domain.verdict(method, attack, most).withstands for domain in domains)


def _withstands_asked(domains: Sequence[Domain], attack: str, method: str) -> bool:
    return all(
        domain.met_attacker(method, attack) and domain.losses(method, domain.asked(attack)).withstands
        for domain in domains
    )


def _listed(names: Sequence[str]) -> str:
    return ", ".join(f"`{name}`" for name in names) or "none"


def _adaptive(plan: RobustnessPlan, domains: Sequence[Domain]) -> Iterator[PageBlock]:
    if not domains:
        return
    yield Heading(2, "Attackers who ask their victim first")
    counts = ", ".join(f"{domain.name} {domain.met('adaptive').results.sweeps(domain.name)}" for domain in domains)
    yield Text(_ASKING.format(queries=plan.adaptive_queries, budget=plan.adaptive_budget, counts=counts))
    yield Text(_summary(plan.adaptive, partial(_withstands_asked, domains)))
    yield Text(_ASKED)
    for domain in domains:
        yield Heading(3, f"What asking adds, {domain.name}")
        yield tables.adaptive_table(domain)


def _defenses(plan: RobustnessPlan, domains: Sequence[Domain]) -> Iterator[PageBlock]:
    yield Heading(2, "Defenses")
    yield Text(_GAINS)
    for domain in domains:
        yield Heading(3, f"Behind defenses, {domain.name}")
        yield tables.gain_table(domain)
    for attack in plan.adaptive_against_defenses:
        met = [domain for domain in domains if domain.met("unaware").methods]
        if met:
            yield Text(_KNOWN_DEFENSE.format(attack=attack))
        for domain in met:
            yield Heading(3, f"Attackers who ask, with and without knowing the defense, {domain.name}")
            yield tables.known_defense_table(domain, attack)


def _paper_protocol(plan: RobustnessPlan, domains: Sequence[Domain]) -> Iterator[PageBlock]:
    if not domains:
        return
    yield Heading(2, "The paper's block")
    yield Text(_PAPER)
    yield Text("\n".join(_finding(plan, domain) for domain in domains))
    yield violin_picture(domains, PAPER)
    for domain in domains:
        yield Heading(3, f"Precision against the paper's label, {domain.name}")
        yield tables.paper_table(domain)


def _finding(plan: RobustnessPlan, domain: Domain) -> str:
    """Return by how much precision of the farthest-return methods falls at 100 to 150 uniform points."""
    levels = [str(points) for points in plan.paper_points if 100 <= points <= 150]
    ours = ("quantized", "continuous", "concave_hull")
    papers = _falls(domain, [Case("paper", "uniform", level) for level in levels], tables.PAPERS_FARTHEST)
    exact = _falls(domain, [Case("attack", "uniform", level) for level in levels], ours)
    return (
        f"- **{domain.name}**: at 100 to 150 uniform points, precision of the paper's farthest-return methods against "
        f"its label falls by {papers} (the paper: 18 to 60 %); of ours of the same kind against exact truth by {exact}."
    )


def _falls(domain: Domain, cases: Sequence[Case], methods: Sequence[str]) -> str:
    falls = [100 * tables.fall_of(domain, name, case) for name in methods for case in cases]
    falls = [fall for fall in falls if not isnan(fall)]
    return f"{min(falls):.0f} to {max(falls):.0f} %" if falls else "an amount not measured here"
