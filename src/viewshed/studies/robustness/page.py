"""The report of a study: what it says in words, its tables and its figures.

The figures of the report: from results to panels, and one attacked sweep of each family.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from math import isnan

import numpy as np

from viewshed._page import Heading, PageBlock, Picture, Table, Text
from viewshed.preprocess.leveling import level
from viewshed.studies import figures as plot_study
from viewshed.studies import suite as contestants
from viewshed.studies.cases import BENIGN, Case, apply, budgets_of, generator, strongest_case
from viewshed.studies.robustness import tables
from viewshed.studies.robustness import tables as tables_adaptive
from viewshed.studies.robustness import tables as tables_short
from viewshed.studies.robustness.plan import PARTS
from viewshed.studies.robustness.results import (
    MAX_F1_LOSS,
    MAX_WEDGE_LOSS,
    MODEST,
    Block,
    Floats,
    Key,
    Results,
    adaptive_verdict,
    attacks_of,
    has_wedge,
    precision,
    verdict_of,
)
from viewshed.studies.robustness.tables import estimators_of
from viewshed.studies.suite import ENTRANTS, Subject, subject_of
from viewshed.threats.attacks import ATTACKS, FAMILY

DRAWN = ("quantized", "concave_hull", "first_blocker", "shadow_map", "majority_vote")
"""Estimators in the pictures of single sweeps."""

Value = Callable[[Key], float]


def violin_picture(results: Results, block: Block) -> Picture:
    """Return violins of precision and AUPRC for every domain: benign against the paper's mixture, or all attacks."""
    paper = block == "paper"
    panels = []
    for domain in results.domains:
        cases = (
            [Case("paper", "mixture")]
            if paper
            else [strongest_case(results.study, name) for name in attacks_of(results, domain)]
        )
        for word, values in (("precision", _precisions), ("AUPRC", _areas)):
            pairs = {
                name.replace("paper_", "paper: "): (
                    values(results, [Key(domain, block, BENIGN, name)]),
                    values(results, [Key(domain, block, case, name) for case in cases]),
                )
                for name in estimators_of(results, domain, block)
            }
            panels.append(plot_study.Violins(f"{domain}: {word}", pairs))
    attacked = "the paper's attacks" if paper else "every attack at its largest budget"
    png = plot_study.violin_figure(panels, 2, attacked)
    return Picture(f"vulnerability_violins_{block}.png", png, f"Precision and AUPRC, benign and under {attacked}")


def _precisions(results: Results, keys: Iterable[Key]) -> Floats:
    return np.concatenate([np.empty(0), *(results.each(key, precision) for key in keys)])


def _areas(results: Results, keys: Iterable[Key]) -> Floats:
    return np.concatenate([np.empty(0), *(results.areas(key) for key in keys)])


def budget_picture(results: Results, domain: str) -> Picture:
    """Return curves of F1 in the whole view over the budget, one panel an attack."""
    attacks = [name for name in attacks_of(results, domain) if strongest_case(results.study, name).kind == "attack"]
    panels = [_over_budgets(results, domain, name, lambda key: results.tally(key).f1) for name in attacks]
    png = plot_study.curve_figure(panels, 5, "F1")
    return Picture(f"vulnerability_f1_{_word(domain)}.png", png, f"{domain}: F1 over the budget of each attack")


def wedge_picture(results: Results, domain: str) -> Picture:
    """Return curves of precision in the attacker's wedge over the budget, one panel an attack that has a wedge."""
    first = estimators_of(results, domain)[0]
    attacks = [
        name for name in attacks_of(results, domain)
        if strongest_case(results.study, name).kind == "attack"
        and has_wedge(results, Key(domain, "strict", strongest_case(results.study, name), first))
    ]  # fmt: skip
    panels = [
        _over_budgets(results, domain, name, lambda key: results.tally(key, "wedge").precision) for name in attacks
    ]
    png = plot_study.curve_figure(panels, 5, "precision in the wedge")
    alt = f"{domain}: precision in the attacker's wedge over the budget of each attack"
    return Picture(f"vulnerability_wedge_{_word(domain)}.png", png, alt)


def _over_budgets(results: Results, domain: str, attack: str, value: Value) -> plot_study.Curves:
    levels = budgets_of(attack, results.study.budgets)
    cases = [Case("attack", attack, level) for level in levels]
    return _curves(results, domain, f"{attack} ({FAMILY[attack]})", cases, value)


def _curves(results: Results, domain: str, title: str, cases: list[Case], value: Value) -> plot_study.Curves:
    values = {
        name: [value(Key(domain, "strict", case, name)) for case in cases] for name in estimators_of(results, domain)
    }
    return plot_study.Curves(title, [case.level or "benign" for case in cases], values)


def corruption_picture(results: Results, domain: str) -> Picture:
    """Return curves of F1 over the severity, one panel a corruption; benign first."""
    panels = [
        _curves(
            results, domain, name,
            [BENIGN, *(Case("corruption", name, str(severity)) for severity in results.study.severities)],
            lambda key: results.tally(key).f1,
        )
        for name in results.study.corruptions
    ]  # fmt: skip
    png = plot_study.curve_figure(panels, 5, "F1")
    alt = f"{domain}: F1 over the severity of each corruption"
    return Picture(f"vulnerability_corruptions_{_word(domain)}.png", png, alt)


def scene_picture(results: Results, number: int = 0) -> Picture:
    """Return one sweep of the first domain under one attack of each family, at its largest budget."""
    study = results.study
    domain = study.domains[0]
    subject = subject_of(domain, number, study.samples[0], study.seed)
    first: dict[int, str] = {}
    for name in ATTACKS:
        if name in study.attacks:
            first.setdefault(FAMILY[name], name)
    cases = [strongest_case(results.study, name) for name in first.values()]
    scenes = [_scene(results, subject, case, number) for case in cases]
    alt = f"One sweep of {domain} under one attack of each family, the truth and what estimators say"
    return Picture("vulnerability_scenes.png", plot_study.scene_figure(scenes), alt)


def _scene(results: Results, subject: Subject, case: Case, number: int) -> plot_study.Scene:
    study, sample = results.study, subject.sample
    trial = apply(case, subject, generator(study.seed, study.domains[0], number, case))
    field = contestants.strict(sample, DRAWN)
    claims = {name: prob >= np.float32(field.threshold) for name, prob in field.probs(trial.sweep).items()}
    leveled = level(trial.sweep, field.grid)
    added = np.zeros(len(trial.sweep), np.bool_) if trial.added is None else trial.added
    wedge = None if trial.wedge is None else (trial.wedge.azimuth, trial.wedge.width)
    return plot_study.Scene(
        f"{FAMILY[case.name]}  {case.name}\n{case.level}", field.grid, sample.truth.visible(), sample.known,
        leveled.points[:, :2], added[leveled.rows], wedge, claims,
    )  # fmt: skip


def _word(domain: str) -> str:
    return "".join(letter if letter.isalnum() else "_" for letter in domain)


TITLE = "Vulnerability of the classical estimators"

LONG_TITLE = "Vulnerability: the long tables"

_INTRODUCTION = """\
Each estimator is given the same sweeps clean, attacked, corrupted, and behind defenses, and is held against exact truth
(`probe`, car, where it is known). Samples are pooled: precision, recall and F1 are of all cells together. *Over* and
*under*: what is claimed and not visible, visible and not claimed. *In the wedge*: only cells in the azimuths that the
attacker reaches. Intervals are 95 %, by a bootstrap over the samples (1,000 draws, one sample a scene). A budget is a
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

_DUEL = """\
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


def blocks_of(results: Results, failed: Sequence[str] = ()) -> Iterator[PageBlock]:
    """Yield the main page of the report, chapter by chapter.

    Args:
        results: what is told.
        failed: jobs that failed, one line each.
    """
    yield Text(_INTRODUCTION)
    yield Text(_extent(results, failed))
    yield Heading(2, "In short")
    yield Text(_SHORT.format(severity=results.study.defended_severity))
    for domain in results.domains:
        yield Heading(3, f"{domain}, in short")
        yield tables_short.summary_table(results, domain)
    yield from _verdicts(results)
    yield from _adaptive(results)
    yield Heading(2, "The bar for a learned estimator")
    yield Text(_BAR)
    yield Heading(3, "The bar in the whole view")
    yield tables_short.bar_overview(results, "view")
    yield Heading(3, "The bar in the wedge")
    yield tables_short.bar_overview(results, "wedge")
    yield from _paper_block(results)
    yield from _strict_block(results)
    yield Heading(2, "Corruptions")
    yield Text(_CORRUPTIONS)
    for domain in results.domains:
        yield corruption_picture(results, domain)
    yield from _defenses(results)
    yield from _refused(results)


def details_of(results: Results) -> Iterator[PageBlock]:
    """Yield the long tables, domain by domain: losses, budgets, areas, strengths, severities, defenses."""
    yield Text(_LONG)
    for domain in results.domains:
        yield Heading(2, domain)
        for most, words in _LEVELS:
            yield Heading(3, f"Who withstands what, {words}, {domain}")
            yield tables.verdict_table(results, domain, most)
        yield Heading(3, f"F1, mean over the budgets, {domain}")
        yield tables.budget_table(results, domain)
        yield Heading(3, f"In the wedge at the largest budget, precision / recall, {domain}")
        yield tables.wedge_table(results, domain)
        yield Heading(3, f"More area over-claimed / under-claimed at the largest budget, m², {domain}")
        yield tables.area_table(results, domain)
        if results.study.strengths:
            yield Heading(3, f"Sectors, shares and offsets, precision / recall in the wedge, {domain}")
            yield tables.strength_table(results, domain)
        yield Heading(3, f"F1 by severity of the corruption, {domain}")
        yield tables.corruption_table(results, domain)
        for name in results.study.defended:
            yield Heading(3, f"{name} behind each defense: F1 of the view (in the wedge), {domain}")
            yield tables.defense_table(results, domain, name)
        yield Heading(3, f"What the defenses drop, {domain}")
        yield Text(_CAUGHT)
        yield tables.caught_table(results, domain)


def told(results: Results) -> dict[str, str]:
    """Return what the report rests on, by name."""
    study = results.study
    counts = ", ".join(f"{domain} {results.samples(domain)}" for domain in results.domains)
    return {
        "study": f"{study.name}, seed {study.seed}",
        "samples": counts or "none",
        "target": "car",
        "commits of the run": ", ".join(commit[:7] for commit in results.commits) or "unknown",
        "jobs": f"{results.done} of {len(study.jobs())}",
    }


def _extent(results: Results, failed: Sequence[str]) -> str:
    study, jobs = results.study, len(results.study.jobs())
    said = f"{sum(results.samples(domain) for domain in results.domains)} sweeps with {len(study.attacks)} attacks, "
    said += f"{len(study.corruptions)} corruptions and {len(study.defenses)} defenses."
    if results.done < jobs:
        said += f" **Not finished: {results.done} of {jobs} jobs are done; a sample has up to {len(PARTS)}.**"
    return said + (f" {len(failed)} jobs failed: {'; '.join(failed[:3])}." if failed else "")


def _verdicts(results: Results) -> Iterator[PageBlock]:
    yield Heading(2, "What withstands what, where the attacker does not know the victim")
    yield Text(_RULE)
    attacks = attacks_of(results, results.domains[0]) if results.domains else []
    for most, words in _LEVELS:
        yield Heading(3, words.capitalize())
        yield Text(_summary(attacks, partial(_everywhere, results, most=most)))


def _summary(attacks: Sequence[str], holds: Callable[[str, str], bool]) -> str:
    """Say in a list what each estimator withstands in every domain, and what none does."""
    lines, by_any = [], set()
    for name in ENTRANTS:
        held = [attack for attack in attacks if holds(attack, name)]
        by_any.update(held)
        lines.append(f"- **{name}** withstands {len(held)} of {len(attacks)} in every domain: {_listed(held)}.")
    nobody = [attack for attack in attacks if attack not in by_any]
    return "\n".join([*lines, f"- Withstood in all domains by no single classical estimator: {_listed(nobody)}."])


def _adaptive(results: Results) -> Iterator[PageBlock]:
    study = results.study
    domains = [domain for domain in results.domains if results.met(domain, "adaptive").scores]
    if not domains:
        return
    yield Heading(2, "Attackers who ask their victim first")
    counts = ", ".join(f"{domain} {results.met(domain, 'adaptive').samples(domain)}" for domain in domains)
    yield Text(_ASKING.format(queries=study.adaptive_queries, budget=study.adaptive_budget, counts=counts))
    yield Text(_summary(study.adaptive, partial(_asked_everywhere, results, domains)))
    yield Text(_ASKED)
    for domain in domains:
        yield Heading(3, f"What asking adds, {domain}")
        yield tables_adaptive.adaptive_table(results, domain)


def _asked_everywhere(results: Results, domains: Sequence[str], attack: str, estimator: str) -> bool:
    return all(
        tables_short.met_by(results, domain, attack, estimator)
        and adaptive_verdict(results, domain, attack, estimator).withstands
        for domain in domains
    )


def _defenses(results: Results) -> Iterator[PageBlock]:
    yield Heading(2, "Defenses")
    yield Text(_GAINS)
    for domain in results.domains:
        yield Heading(3, f"Behind defenses, {domain}")
        yield tables.gain_table(results, domain)
    for attack in results.study.adaptive_against_defenses:
        domains = [domain for domain in results.domains if results.met(domain, "unaware").scores]
        if domains:
            yield Text(_DUEL.format(attack=attack))
        for domain in domains:
            yield Heading(3, f"Attackers who ask, with and without knowing the defense, {domain}")
            yield tables_adaptive.duel_table(results, domain, attack)


def _everywhere(results: Results, attack: str, estimator: str, most: int | None) -> bool:
    return all(verdict_of(results, domain, attack, estimator, most).withstands for domain in results.domains)


def _listed(names: Sequence[str]) -> str:
    return ", ".join(f"`{name}`" for name in names) or "none"


def _paper_block(results: Results) -> Iterator[PageBlock]:
    domains = [domain for domain in results.domains if tables.paper_cases(results, domain)]
    if not domains:
        return
    yield Heading(2, "The paper's block")
    yield Text(_PAPER)
    yield Text("\n".join(_finding(results, domain) for domain in domains))
    yield violin_picture(results, "paper")
    for domain in domains:
        yield Heading(3, f"Precision against the paper's label, {domain}")
        yield tables.paper_table(results, domain)


def _finding(results: Results, domain: str) -> str:
    """Say by how much precision of the farthest-return methods falls at 100 to 150 uniform points."""
    levels = [str(points) for points in results.study.paper_points if 100 <= points <= 150]
    ours = ("quantized", "continuous", "concave_hull")
    papers = _falls(results, domain, [Case("paper", "uniform", level) for level in levels], tables.PAPERS_FARTHEST)
    exact = _falls(results, domain, [Case("attack", "uniform", level) for level in levels], ours)
    return (
        f"- **{domain}**: at 100 to 150 uniform points, precision of the paper's farthest-return methods against its "
        f"label falls by {papers} (the paper: 18 to 60 %); of ours of the same kind against exact truth by {exact}."
    )


def _falls(results: Results, domain: str, cases: Sequence[Case], names: Sequence[str]) -> str:
    falls = [100 * tables.fall_of(results, domain, name, case) for name in names for case in cases]
    there = [fall for fall in falls if not isnan(fall)]
    return f"{min(there):.0f} to {max(there):.0f} %" if there else "an amount not measured here"


def _strict_block(results: Results) -> Iterator[PageBlock]:
    if not results.domains:
        return
    yield Heading(2, "The strict block")
    yield violin_picture(results, "strict")
    yield scene_picture(results)
    for domain in results.domains:
        yield Heading(3, f"Clean sweeps, {domain}")
        yield tables.benign_table(results, domain)
        yield budget_picture(results, domain)
        yield wedge_picture(results, domain)


def _refused(results: Results) -> Iterator[PageBlock]:
    if not results.refused:
        return
    yield Heading(2, "What could not run")
    rows = [
        [domain, case.name, case.level, case.defense, str(count), why]
        for (domain, case, why), count in sorted(results.refused.items())
    ]
    yield Table(["domain", "attack or corruption", "level", "defense", "samples", "why"], rows)


def pictures_of(blocks: Sequence[PageBlock]) -> list[Picture]:
    """Return the pictures among the blocks."""
    return [block for block in blocks if isinstance(block, Picture)]
