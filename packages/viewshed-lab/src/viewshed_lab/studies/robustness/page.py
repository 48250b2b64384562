"""The page of the robustness study: its pictures and values; the text is in ``page.md``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isnan
from typing import Any

import numpy as np

from viewshed.preprocess.leveling import level
from viewshed_lab._page import facts
from viewshed_lab.studies import figures
from viewshed_lab.studies.cases import MIXTURE, budget_cases, corruption_cases
from viewshed_lab.studies.formatting import commits
from viewshed_lab.studies.pages import Picture, Table, fill_template
from viewshed_lab.studies.records import BENIGN, PAPER, WEDGE, Case, Domain, Results
from viewshed_lab.studies.robustness import tables
from viewshed_lab.studies.robustness.jobs import evaluation_of
from viewshed_lab.studies.robustness.plan import PARTS, RobustnessPlan
from viewshed_lab.studies.robustness.verdicts import MAX_F1_LOSS, MAX_WEDGE_LOSS, MODEST, AttackedDomain, domains_of
from viewshed_lab.studies.runner import Job
from viewshed_lab.studies.store import ResultStore
from viewshed_lab.studies.suite import TESTED, strict_suite
from viewshed_lab.threats.attacks import ATTACKS, FAMILY

DRAWN = ("quantized", "concave_hull", "first_blocker", "shadow_map", "majority_vote")
"""Estimators in the pictures of single sweeps."""

PAPERS_FARTHEST = ("paper_quantized", "paper_continuous", "paper_concave_hull")
"""The paper's methods that depend on the farthest return of each direction."""

FARTHEST = ("quantized", "continuous", "concave_hull")
"""Our methods of the same kind."""

BUDGETS = {f"Up to {MODEST} returns": MODEST, "Up to a full wedge": None}
"""By heading, the maximum number of returns of an attacker; None for any number."""


def violin_picture(domains: Sequence[AttackedDomain], protocol: str) -> Picture:
    """Return violins of precision and AUPRC for every domain: benign against the paper's mixture, or all attacks."""
    paper, panels = protocol == PAPER, dict[str, figures.Violins]()
    for domain in domains:
        results = domain.paper if paper else domain
        methods = {name.replace("paper_", "paper: "): name for name in results.methods}
        panels |= figures.violins_of(results, methods, [MIXTURE] if paper else list(domain.strongest.values()))
    attacked = "the paper's attacks" if paper else "every attack at its largest budget"
    png = figures.violin_figure(panels, 2, attacked)
    return Picture(f"robustness_violins_{protocol}.png", png, f"Precision and AUPRC, benign and under {attacked}")


def budget_picture(domain: AttackedDomain) -> Picture:
    """Return curves of F1 in the whole view over the budget, one panel per attack."""
    return _curves(domain, "f1", "F1 over the budget of each attack", "F1", _budgets(domain), _f1)


def wedge_picture(domain: AttackedDomain) -> Picture:
    """Return curves of precision in the attacker's wedge over the budget, one panel per attack that has a wedge."""
    words = "precision in the attacker's wedge over the budget of each attack"
    panels = {title: cases for title, cases in _budgets(domain).items() if any(map(domain.has_wedge, cases))}
    return _curves(domain, "wedge", words, "precision in the wedge", panels, _wedge_precision)


def corruption_picture(domain: AttackedDomain) -> Picture:
    """Return curves of F1 over the severity, one panel per corruption; benign first."""
    plan = domain.plan
    panels = {name: [BENIGN, *corruption_cases((name,), plan.severities)] for name in plan.corruptions}
    return _curves(domain, "corruptions", "F1 over the severity of each corruption", "F1", panels, _f1)


def _budgets(domain: AttackedDomain) -> dict[str, list[Case]]:
    """Return the cases of each attack that has a budget, by title."""
    names = [name for name, case in domain.strongest.items() if case.kind == "attack"]
    return {f"{name} ({FAMILY[name]})": budget_cases(name, domain.plan.budgets) for name in names}


def _f1(domain: Domain[Any], method: str, case: Case) -> float:
    return domain.counts(method, case).f1


def _wedge_precision(domain: Domain[Any], method: str, case: Case) -> float:
    return domain.counts(method, case, WEDGE).precision


def _curves(
    domain: AttackedDomain, stem: str, words: str, label: str, panels: dict[str, list[Case]], value: figures.CaseValue
) -> Picture:
    """Return a picture with curves of a value of every estimator over the cases of each panel."""
    curves = {
        title: figures.curves_of(domain, domain.methods, {case.level or "benign": case for case in cases}, value)
        for title, cases in panels.items()
    }
    place = "".join(letter if letter.isalnum() else "_" for letter in domain.name)
    png = figures.curve_figure(curves, 5, label)
    return Picture(f"robustness_{stem}_{place}.png", png, f"{domain.name}: {words}")


def scene_picture(store: ResultStore[RobustnessPlan]) -> Picture:
    """Return the picture of the first sweep of the first domain under the strongest case of one attack per family."""
    plan, first = store.plan, dict[int, str]()
    for name in ATTACKS:
        if name in plan.attacks:
            first.setdefault(FAMILY[name], name)
    scenes = [_scene(store, plan.strongest(name)) for name in first.values()]
    alt = f"One sweep of {plan.domains[0]} under one attack of each family, the truth and what estimators say"
    return Picture("robustness_scenes.png", figures.scene_figure(scenes), alt)


def _scene(store: ResultStore[RobustnessPlan], case: Case) -> figures.PictureRow:
    evaluation = evaluation_of(Job(store.plan, store.folder, ("attacks", store.plan.domains[0], "0")))
    tampered, suite, sample = evaluation.tampered(case), strict_suite(evaluation.suite.grid, DRAWN), evaluation.sample
    leveled = level(tampered.sweep, suite.grid)
    claims = {
        name: evaluation.reference.prob_of(estimate) >= np.float32(suite.threshold)
        for name, estimate in suite.estimates(leveled).items()
    }
    wedge = None if tampered.wedge is None else (tampered.wedge.azimuth, tampered.wedge.width)
    return figures.PictureRow(
        f"{FAMILY[case.name]}  {case.name}\n{case.level}", suite.grid, sample.truth.visible(), sample.known,
        leveled.points[:, :2], tampered.added[leveled.rows], wedge, claims,
    )  # fmt: skip


def files_of(store: ResultStore[RobustnessPlan], stem: str = "robustness") -> dict[str, bytes]:
    """Return the files of the study by name: pictures, and the Markdown page ``stem`` last."""
    results = store.results()
    store.require(results)
    domains, plan = domains_of(results), results.plan
    adaptive = [domain for domain in domains if domain.met("adaptive").methods]
    unaware = [domain for domain in domains if domain.met("unaware").methods]
    paper = [domain for domain in domains if len(domain.paper.cases) > 1]
    page = fill_template(
        "robustness/page.md", plan=plan, store=store, tables=tables, extent=_extent(results), domains=domains,
        adaptive_domains=adaptive, unaware_domains=unaware, paper_domains=paper, budgets=BUDGETS,
        attacks_on_defenses=plan.adaptive_against_defenses if unaware else (), max_f1_loss=MAX_F1_LOSS,
        max_wedge_loss=MAX_WEDGE_LOSS,
        adaptive_sweeps=", ".join(f"{one.name} {one.met('adaptive').results.sweeps(one.name)}" for one in adaptive),
        withstood_at=withstood_at, withstood_adaptive=withstood_adaptive, finding=_finding,
        violin_picture=violin_picture, scene_picture=scene_picture, budget_picture=budget_picture,
        wedge_picture=wedge_picture, corruption_picture=corruption_picture, refused=refused_table(results),
    )  # fmt: skip
    return page.files(f"{stem}.md", facts(**provenance(results)))


def provenance(results: Results[RobustnessPlan]) -> dict[str, str]:
    """Return the provenance of the pages by name."""
    return {
        "study": f"{results.plan.name}, seed {results.plan.seed}",
        "samples": ", ".join(f"{domain.name} {results.sweeps(domain.name)}" for domain in domains_of(results))
        or "none",
        "target": "car",
        "commits of the run": commits(results),
        "jobs": f"{len(results.facts)} of {len(results.plan.job_keys())}",
    }


def _extent(results: Results[RobustnessPlan]) -> str:
    """Return sentences on the extent of the study and on unfinished jobs."""
    plan, done, jobs = results.plan, len(results.facts), len(results.plan.job_keys())
    words = f"{sum(results.sweeps(domain.name) for domain in domains_of(results))} sweeps with {len(plan.attacks)} "
    words += f"attacks, {len(plan.corruptions)} corruptions and {len(plan.defenses)} defenses."
    if done < jobs:
        words += f" **Not finished: {done} of {jobs} jobs are done; a sample has up to {len(PARTS)}.**"
    return words


def withstood_at(domains: Sequence[AttackedDomain], max_budget: int | None) -> str:
    """Return a list of the attacks that each estimator withstands in every domain, up to a budget."""

    def withstands(name: str, attack: str) -> bool:
        return all(domain.verdict(name, attack, max_budget).withstands for domain in domains)

    return _withstood(domains[0].attacks, withstands)


def withstood_adaptive(plan: RobustnessPlan, domains: Sequence[AttackedDomain]) -> str | None:
    """Return a list of the adaptive attacks that each estimator withstands in every domain; None without domains."""

    def withstands(name: str, attack: str) -> bool:
        return all(domain.withstands_adaptive(name, attack) for domain in domains)

    return _withstood(plan.adaptive, withstands) if domains else None


def _withstood(attacks: Sequence[str], withstands: Callable[[str, str], bool]) -> str:
    withstood = {name: [attack for attack in attacks if withstands(name, attack)] for name in TESTED}
    lines = [
        f"- **{name}** withstands {len(names)} of {len(attacks)} in every domain: {_listed(names)}."
        for name, names in withstood.items()
        if names
    ]
    none = [name for name, names in withstood.items() if not names]
    if none:
        lines.append(f"- Withstand 0 of {len(attacks)} in every domain: {', '.join(f'**{name}**' for name in none)}.")
    by_none = [attack for attack in attacks if not any(attack in names for names in withstood.values())]
    return "\n".join([*lines, f"- Withstood in all domains by no single classical estimator: {_listed(by_none)}."])


def _listed(names: Sequence[str]) -> str:
    return ", ".join(f"`{name}`" for name in names) or "none"


def _finding(plan: RobustnessPlan, domain: AttackedDomain) -> str:
    """Return a sentence on the loss of precision of the farthest-return methods at 100 to 150 uniform points."""
    levels = [str(points) for points in plan.paper_points if 100 <= points <= 150]

    def falls(kind: str, methods: Sequence[str]) -> str:
        falls = [100 * tables.fall_of(domain, name, Case(kind, "uniform", n)) for name in methods for n in levels]
        known = [fall for fall in falls if not isnan(fall)]
        return f"{min(known):.0f} to {max(known):.0f} %" if known else "an amount not measured here"

    return (
        f"- **{domain.name}**: at 100 to 150 uniform points, precision of the paper's farthest-return methods against "
        f"its label falls by {falls('paper', PAPERS_FARTHEST)} (the paper: 18 to 60 %); of ours of the same kind "
        f"against exact truth by {falls('attack', FARTHEST)}."
    )


def refused_table(results: Results[RobustnessPlan]) -> Table | None:
    """Return the table of impossible cases with the number of samples and the reason; None without any."""
    rows = [
        [domain, case.name, case.level, case.defense, str(count), why]
        for (domain, case, why), count in sorted(results.refused.items())
    ]
    return Table(["domain", "attack or corruption", "level", "defense", "samples", "why"], rows) if rows else None
