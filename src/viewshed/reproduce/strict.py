"""The strict table: every in-domain model under every attack, beside every classical estimator, against exact truth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from viewshed.attacks import ATTACKS, SEVERITIES, Knowledge
from viewshed.bev import polar_of_cells
from viewshed.estimate import FovEstimator
from viewshed.level import level_sweep
from viewshed.networks.spec import Runner
from viewshed.reproduce.contestants import passes_of
from viewshed.reproduce.plan import StudyPlan
from viewshed.reproduce.protocols import Model, Setting
from viewshed.vulnerability.cases import BENIGN, Case, Trial, apply, generator
from viewshed.vulnerability.contestants import Contestants, Probs
from viewshed.vulnerability.scoring import COUNTS, Reference, counts, score
from viewshed.vulnerability.subjects import Subject

DEFAULT = "default"
"""Level of an attack with the budget that it has of itself."""
Row = list[float | int | None]


def strict_cases(plan: StudyPlan) -> list[Case]:
    """Return the cases: benign, every attack with its default budget, and where the plan says so its strengths."""
    strengths = [
        Case("strength", name, f"{attribute} {value:g}")
        for name, values in SEVERITIES.items()
        for attribute, value in values
    ]
    return [BENIGN, *(Case("attack", name, DEFAULT) for name in ATTACKS), *(strengths if plan.strengths else [])]


def strict_estimators(plan: StudyPlan, setting: Setting, runners: Mapping[Model, Runner]) -> dict[str, FovEstimator]:
    """Return the estimators of the strict table by name: networks of the domain, then the classical ones.

    Args:
        plan: of the study.
        setting: of the domain.
        runners: of its models.
    """
    from viewshed.estimators.learned import UnetEstimator

    found: dict[str, FovEstimator] = {
        short_name(model): UnetEstimator(runner, passes_of(plan, model), plan.test_seed, short_name(model))
        for model, runner in runners.items()
    }
    return found | {name: make(setting.grid) for name, make in setting.classical().items()}


def short_name(model: Model) -> str:
    """Return a model's name in tables of its own domain.

    >>> short_name(Model("strict", "mcd", "benign", "ugv"))
    'mcd-benign'
    """
    return f"{model.variant}-{model.mixture}"


def field_of(setting: Setting, subject: Subject, estimators: Mapping[str, FovEstimator]) -> Contestants:
    """Return the contestants on the truth's grid, against exact truth of ``probe``, car."""
    sample = subject.sample
    reference = Reference.of(sample.truth.visible(), sample.known, polar_of_cells(setting.grid)[1])
    pose = level_sweep(sample.sweep, setting.grid).world_from_level
    return Contestants(setting.grid, setting.threshold, estimators, reference, pose)


def trial_of(case: Case, subject: Subject, rng: np.random.Generator) -> Trial:
    """Return the subject's sweep as a case leaves it.

    Raises:
        ValueError: the attack cannot be made of this sweep.
    """
    if case.level != DEFAULT:
        return apply(case, subject, rng)
    knowledge = Knowledge(subject.earlier[:1], half_extent_m=subject.sample.truth.grid.half_extent_m)
    tampered = ATTACKS[case.name](None, knowledge).apply(subject.sample.sweep, rng)
    return Trial(tampered.sweep, tampered.added, tampered.wedge)


def strict_line(plan: StudyPlan, subject: Subject, field: Contestants, place: tuple[str, int]) -> dict[str, Any]:
    """Return what every contestant says of one sweep in every case, as plain values.

    Args:
        plan: of the study.
        subject: the sweep.
        field: the contestants.
        place: its domain and number.
    """
    clean = field.probs(subject.sample.sweep)
    cases = [dict(_entry(plan, subject, (field, clean), (case, place))) for case in strict_cases(plan)]
    return {"scene": subject.sample.scene, "cases": cases}


def _entry(
    plan: StudyPlan, subject: Subject, field: tuple[Contestants, Probs], what: tuple[Case, tuple[str, int]]
) -> Iterator[tuple[str, Any]]:
    case, (domain, number) = what
    yield "case", [case.kind, case.name, case.level]
    try:
        trial = trial_of(case, subject, generator(plan.test_seed, domain, number, case))
    except ValueError as error:
        yield "refused", " ".join(str(error).split())
        return
    yield "scores", _scores(field[0], field[1], trial, case)


def _scores(field: Contestants, clean: Probs, trial: Trial, case: Case) -> dict[str, Row]:
    """Return 13 numbers each: view, wedge, average precision, and the wedge with no return touched."""
    reference = field.reference
    probs = clean if case == BENIGN else field.probs(trial.sweep)
    wedge = None if trial.wedge is None else trial.wedge.holds(reference.azimuth)
    rows: dict[str, Row] = {}
    for name, prob in probs.items():
        before: tuple[int, ...] = (0,) * COUNTS
        if wedge is not None:
            claimed = clean[name][reference.among] >= np.float32(field.threshold)
            before = counts(claimed[wedge], reference.visible[wedge])
        rows[name] = [*score(prob, field.threshold, reference, wedge), *before]
    return rows
