"""The paper's anomaly detector tried: scores of the deviation monitor on benign, attacked and corrupted sweeps."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from viewshed.attacks import ATTACKS
from viewshed.estimate import FovEstimator
from viewshed.integrity.deviation import DeviationMonitor
from viewshed.networks.spec import Runner
from viewshed.reproduce.data import subject_of
from viewshed.reproduce.plan import StudyPlan
from viewshed.reproduce.strict import DEFAULT, trial_of
from viewshed.vulnerability.cases import BENIGN, Case, generator
from viewshed.vulnerability.subjects import Subject


def monitor_cases(plan: StudyPlan) -> list[Case]:
    """Return the cases: benign, every attack with its default budget, every corruption of the plan."""
    corrupted = [Case("corruption", name, str(plan.monitor_severity)) for name in plan.monitor_corruptions]
    return [BENIGN, *(Case("attack", name, DEFAULT) for name in ATTACKS), *corrupted]


def monitor_line(plan: StudyPlan, folder: Path, runner: Runner) -> dict[str, Any]:
    """Return the scores of the monitor in every case, as plain values.

    It is fitted on sweeps of some held-out scenes, calibrated on others, and reported on others again.

    Args:
        plan: of the study.
        folder: of the study.
        runner: of the network whose deviation is watched.
    """
    from viewshed.estimators.learned import UnetEstimator

    estimator = UnetEstimator(runner, passes=plan.passes, seed=plan.test_seed, name="mcd")
    fitting, calibrating, reporting = (list(_numbers(plan, part)) for part in range(3))
    monitor = DeviationMonitor.fit(
        estimator.estimate(_subject(plan, folder, number).sample.sweep) for number in fitting
    ).calibrated(
        (estimator.estimate(_subject(plan, folder, number).sample.sweep) for number in calibrating),
        plan.monitor_false_alarms,
    )
    scores: dict[str, list[list[float | None]]] = {_word(case): [] for case in monitor_cases(plan)}
    for number in reporting:
        for word, row in _rows(plan, (monitor, estimator), _subject(plan, folder, number), number):
            scores[word].append(row)
    return {"limit": monitor.limit, "scores": scores}


def _numbers(plan: StudyPlan, part: int) -> range:
    return range(part * plan.monitor_frames, (part + 1) * plan.monitor_frames)


def _subject(plan: StudyPlan, folder: Path, number: int) -> Subject:
    return subject_of(plan, folder, plan.monitor_domain, number)


def _rows(
    plan: StudyPlan, who: tuple[DeviationMonitor, FovEstimator], subject: Subject, number: int
) -> Iterator[tuple[str, list[float | None]]]:
    """Yield for each case the monitor's score and the mean deviation of the sweep; None where it cannot be made."""
    monitor, estimator = who
    for case in monitor_cases(plan):
        try:
            sweep = trial_of(case, subject, generator(plan.test_seed, plan.monitor_domain, number, case)).sweep
        except ValueError:
            yield _word(case), [None, None]
            continue
        estimate = estimator.estimate(sweep)
        yield _word(case), [monitor.score(estimate), float(np.nanmean(np.asarray(estimate.std)))]


def _word(case: Case) -> str:
    """Return what a case is stored under.

    >>> _word(Case("corruption", "fog", "3")), _word(Case("benign"))
    ('corruption fog', 'benign')
    """
    return f"{case.kind} {case.name}".strip()
