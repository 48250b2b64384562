"""The detector tried: fitted and calibrated on benign sweeps, reported on others, attacked and corrupted."""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from viewshed.attacks import ATTACKS, Knowledge, Tampered
from viewshed.bev import BevGrid, polar_of_cells
from viewshed.corruptions import CORRUPTIONS
from viewshed.datasets.sample import Sample
from viewshed.estimate import FovEstimate, FovEstimator
from viewshed.integrity.deviation import RULE, DeviationMonitor, Rule
from viewshed.integrity.study_rows import Row, rows_of
from viewshed.level import level_sweep
from viewshed.sweep import Sweep

Line = dict[str, Any]
"""What was found on one sweep, as plain values."""
Mask = NDArray[np.bool_]


class Subject(Protocol):
    """A sweep, and what the same sensor measured before."""

    @property
    def sample(self) -> Sample:
        """The sweep; its truth is not used."""
        ...

    @property
    def earlier(self) -> tuple[Sweep, ...]:
        """Earlier sweeps, the oldest first; an attacker replays the oldest."""
        ...


@dataclass(frozen=True, slots=True)
class MonitorPlan:
    """What a monitor is tried on.

    Attributes:
        attacks: names of ``ATTACKS``, each with its own budget.
        corruptions: names of ``CORRUPTIONS``.
        severity: of the corruptions, 1 to 5.
        false_alarm_rate: that it is calibrated for.
        rule: how it is fitted.
        seed: of all that is random.

    Raises:
        ValueError: there is no such attack, corruption or severity.
    """

    attacks: tuple[str, ...] = tuple(ATTACKS)
    corruptions: tuple[str, ...] = tuple(CORRUPTIONS)
    severity: int = 3
    false_alarm_rate: float = 0.05
    rule: Rule = RULE
    seed: int = 0

    def __post_init__(self) -> None:
        for what, names, table in (("attacks", self.attacks, ATTACKS), ("corruptions", self.corruptions, CORRUPTIONS)):
            if wrong := [name for name in names if name not in table]:
                raise ValueError(f"{what} must be among {', '.join(table)}, got {', '.join(wrong)}")
        CORRUPTIONS["fog"](self.severity)

    def cases(self) -> list[tuple[str, str]]:
        """Return kind and name of all that is done to a sweep, nothing first."""
        attacks = [("attack", name) for name in self.attacks]
        return [("benign", ""), *attacks, *(("corruption", name) for name in self.corruptions)]


@dataclass(frozen=True, slots=True, eq=False)
class Sets:
    """Benign sweeps for each step, no sweep in two of them, best no scene either.

    Attributes:
        fit: thresholds of the cells come from these.
        calibrate: the limit of the alarm comes from these.
        report: these are attacked, corrupted and counted.
    """

    fit: Iterable[Subject]
    calibrate: Iterable[Subject]
    report: Iterable[Subject]


def monitor_study(estimator: FovEstimator, sets: Sets, plan: MonitorPlan) -> list[Row]:
    """Return one row for benign sweeps, each attack and each corruption.

    To go on where a study was stopped, save what :func:`fitted` returns and each line of :func:`watched`, and hand the
    lines to ``rows_of``.

    Raises:
        ValueError: the estimator has no standard deviation, or there are too few sweeps for the false-alarm rate.
    """
    monitor = fitted(estimator, sets.fit, sets.calibrate, plan)
    lines = [watched(monitor, estimator, subject, number, plan) for number, subject in enumerate(sets.report)]
    return rows_of(lines, plan.seed)


def fitted(
    estimator: FovEstimator, fit: Iterable[Subject], calibrate: Iterable[Subject], plan: MonitorPlan
) -> DeviationMonitor:
    """Return a monitor fitted on one set of benign sweeps and calibrated on another. Raises as the study does."""
    monitor = DeviationMonitor.fit((estimator.estimate(each.sample.sweep) for each in fit), plan.rule)
    scored = (estimator.estimate(each.sample.sweep) for each in calibrate)
    return monitor.calibrated(scored, plan.false_alarm_rate)


def watched(
    monitor: DeviationMonitor, estimator: FovEstimator, subject: Subject, number: int, plan: MonitorPlan
) -> Line:
    """Return what the monitor says of one sweep, clean, attacked and corrupted, as plain values.

    Args:
        monitor: calibrated, for this estimator.
        estimator: with standard deviations.
        subject: a benign sweep that the monitor was neither fitted nor calibrated on.
        number: of the sweep in the study, for seeds.
        plan: what is done.
    """
    bench = _Bench.of(monitor, estimator, subject)
    found = [{"kind": kind, "name": name, **bench.case(kind, name, number, plan)} for kind, name in plan.cases()]
    return {"number": number, "scene": subject.sample.scene, "watched": int(monitor.watched.sum()), "cases": found}


@dataclass(frozen=True, slots=True, eq=False)
class _Bench:
    """One sweep, with what is known of it before anything is done to it."""

    monitor: DeviationMonitor
    estimator: FovEstimator
    sweep: Sweep
    knowledge: Knowledge
    clean: FovEstimate

    @classmethod
    def of(cls, monitor: DeviationMonitor, estimator: FovEstimator, subject: Subject) -> _Bench:
        sweep = subject.sample.sweep
        knowledge = Knowledge(subject.earlier[:1], half_extent_m=monitor.grid.half_extent_m)
        return cls(monitor, estimator, sweep, knowledge, estimator.estimate(sweep))

    def case(self, kind: str, name: str, number: int, plan: MonitorPlan) -> Line:
        """Return score, alarm and suspect cells of a case, or why it was refused."""
        words = [zlib.crc32(word.encode()) for word in (kind, name)]
        rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence([plan.seed, number, *words])))
        try:
            if kind == "attack":
                return self._attacked(ATTACKS[name](None, self.knowledge).apply(self.sweep, rng))
            if kind == "corruption":
                return self._told(CORRUPTIONS[name](plan.severity).apply(self.sweep, rng), {})
        except ValueError as error:
            return {"refused": " ".join(str(error).split())}
        return self._told(self.sweep, {})

    def _attacked(self, tampered: Tampered) -> Line:
        returns = int(tampered.added.sum()) + int(tampered.removed.sum())
        regions = dict(_regions(tampered, self.sweep, self.monitor.grid))
        return {"returns": returns, **self._told(tampered.sweep, regions)}

    def _told(self, sweep: Sweep, regions: dict[str, Mask]) -> Line:
        estimate = self.clean if sweep is self.sweep else self.estimator.estimate(sweep)
        report, seen = self.monitor.check(estimate), self.monitor.watched
        if sweep is not self.sweep:
            regions["changed"] = estimate.visible() != self.clean.visible()
        areas = {name: mask & seen for name, mask in regions.items()}
        counted = {
            name: [int(area.sum()), int((area & report.suspect).sum())] for name, area in areas.items() if area.any()
        }
        told = {"score": report.score, "mean_std": float(np.nanmean(np.asarray(estimate.std)[seen]))}
        return {**told, "alarm": report.alarm, "suspects": int(report.suspect.sum()), "regions": counted}


def _regions(tampered: Tampered, clean: Sweep, grid: BevGrid) -> Iterator[tuple[str, Mask]]:
    """Yield the cells with a return that was added or removed, and those whose azimuth the attacker's wedge holds."""
    level_from_sensor = level_sweep(clean, grid).level_from_sensor
    rows = np.concatenate([tampered.sweep.points[tampered.added], clean.points[tampered.removed]])
    cells, inside = grid.index((level_from_sensor @ rows)[:, :2])
    touched = np.zeros(grid.shape, np.bool_)
    touched[tuple(cells[inside].T)] = True
    yield "touched", touched
    if tampered.wedge is not None:
        yield "wedge", tampered.wedge.holds(polar_of_cells(grid)[1])
