"""The paper's anomaly detector tried on held-out sweeps, with one of the study's networks."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from viewshed.estimators.learned import UnetEstimator
from viewshed.integrity.study import MonitorPlan, fitted, watched
from viewshed.networks.spec import Runner
from viewshed.reproduce.data import subject_of
from viewshed.reproduce.plan import StudyPlan
from viewshed.vulnerability.subjects import Subject


def monitor_line(plan: StudyPlan, folder: Path, runner: Runner) -> dict[str, Any]:
    """Return what the monitor says of benign, attacked and corrupted sweeps, as plain values.

    It is fitted on sweeps of some held-out scenes, calibrated on others, and reported on others again.

    Args:
        plan: of the study.
        folder: of the study.
        runner: of the network whose deviation is watched.
    """
    estimator = UnetEstimator(runner, plan.passes, plan.test_seed, "mcd")
    fit, calibrate, report = (_subjects(plan, folder, part) for part in range(3))
    how = MonitorPlan(
        corruptions=plan.monitor_corruptions, severity=plan.monitor_severity,
        false_alarm_rate=plan.monitor_false_alarms, seed=plan.test_seed,
    )  # fmt: skip
    monitor = fitted(estimator, fit, calibrate, how)
    lines = [watched(monitor, estimator, subject, number, how) for number, subject in enumerate(report)]
    return {"limit": monitor.limit, "lines": lines}


def _subjects(plan: StudyPlan, folder: Path, part: int) -> Iterator[Subject]:
    for number in range(part * plan.monitor_frames, (part + 1) * plan.monitor_frames):
        yield subject_of(plan, folder, plan.monitor_domain, number)
