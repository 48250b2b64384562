"""The detector tried: fitted and calibrated on benign sweeps, reported on others, attacked and corrupted."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from viewshed.arrays import Mask
from viewshed.estimators.unet import UnetEstimator, load_network
from viewshed.fov.estimate import FovEstimate, FovEstimator
from viewshed.fov.visibility import TARGETS
from viewshed.grid import BevGrid, polar_of_cells
from viewshed.monitor.deviation import RULE, DeviationMonitor, load_monitor, save_monitor
from viewshed.preprocess.leveling import level
from viewshed.sweep import Sweep
from viewshed_lab._jobs import Engine, LocalEngine
from viewshed_lab.studies.cases import DEFAULT, apply, generator
from viewshed_lab.studies.deviation.plan import DeviationPlan, Trials
from viewshed_lab.studies.plan import JobKey
from viewshed_lab.studies.records import BENIGN, Case, Row, Series, row_of
from viewshed_lab.studies.runner import Job, Progress, ignore_progress, run_jobs
from viewshed_lab.studies.samples import StudySample, sample_of
from viewshed_lab.studies.store import JobResult, ResultStore
from viewshed_lab.threats.attacks.base import Tampered

MONITOR = "monitor.npz"

METHOD = "mc_dropout"
"""The network whose deviation is watched."""


def fit_monitor(
    estimator: FovEstimator, fit: Iterable[StudySample], calibrate: Iterable[StudySample], trials: Trials
) -> DeviationMonitor:
    """Return a monitor fitted on one set of benign sweeps and calibrated on another."""
    rule = replace(RULE, sigmas=trials.sigmas)
    monitor = DeviationMonitor.fit((estimator.estimate(sample.sweep) for sample in fit), rule)
    return monitor.calibrated((estimator.estimate(sample.sweep) for sample in calibrate), trials.false_alarm_rate)


def watch(
    monitor: DeviationMonitor,
    estimator: FovEstimator,
    sample: StudySample,
    trials: Trials,
    *,
    domain: str,
    method: str,
    number: int,
) -> Iterator[Row]:
    """Yield what the monitor says of one sweep, clean, attacked and corrupted.

    Args:
        monitor: calibrated, for this estimator.
        estimator: with standard deviations.
        sample: a benign sweep that the monitor was neither fitted nor calibrated on.
        trials: what is done.
        domain: of the rows.
        method: of the rows.
        number: of the sweep in the domain.
    """
    bench = _Bench(monitor, estimator, sample, estimator.estimate(sample.sweep))
    for case in trials.cases():
        of = Series(domain, method, case), sample.sample.scene, number
        try:
            tampered = bench.tampered(case, generator(trials.seed, number, case.kind, case.name), trials.severity)
        except ValueError as error:
            yield row_of(*of, refused=" ".join(str(error).split()))
            continue
        yield row_of(*of, **bench.numbers(case, tampered))


@dataclass(frozen=True, slots=True, eq=False)
class _Bench:
    """One sweep, with what is known of it before anything is done to it."""

    monitor: DeviationMonitor
    estimator: FovEstimator
    sample: StudySample
    clean: FovEstimate

    def tampered(self, case: Case, rng: np.random.Generator, severity: int) -> Tampered:
        """Return the sweep in a case; an attack has its own budget and the scale of the monitor's grid."""
        levels = {"attack": DEFAULT, "corruption": str(severity)}
        return apply(replace(case, level=levels.get(case.kind, "")), self.sample, rng, self.monitor.grid.half_extent_m)

    def numbers(self, case: Case, tampered: Tampered) -> dict[str, Any]:
        """Return score, alarm, mean deviation and suspect cells, and those of each region that the case has."""
        sweep, seen = tampered.sweep, self.monitor.watched
        estimate = self.clean if case == BENIGN else self.estimator.estimate(sweep)
        report = self.monitor.check(estimate)
        numbers: dict[str, float] = {
            "score": report.score, "alarm": int(report.alarm), "suspects": int(report.suspect_cells.sum()),
            "mean_std": float(np.nanmean(np.asarray(estimate.std)[seen])), "watched": int(seen.sum()),
        }  # fmt: skip
        regions = dict[str, Mask]()
        if case.kind == "attack":
            numbers["returns"] = int(tampered.added.sum()) + int(tampered.removed.sum())
            regions |= _regions(tampered, self.sample.sweep, self.monitor.grid)
        if case != BENIGN:
            regions["changed"] = estimate.visible() != self.clean.visible()
        for name, mask in regions.items():
            area = mask & seen
            if area.any():
                numbers |= {
                    f"{name} cells": int(area.sum()),
                    f"{name} suspects": int((area & report.suspect_cells).sum()),
                }
        return numbers


def _regions(tampered: Tampered, clean: Sweep, grid: BevGrid) -> dict[str, Mask]:
    """Return the cells with a return that was added or removed, and those whose azimuth the attacker's wedge holds."""
    level_from_sensor = level(clean, grid).level_from_sensor
    rows = np.concatenate([tampered.sweep.points[tampered.added], clean.points[tampered.removed]])
    cells, inside = grid.index((level_from_sensor @ rows)[:, :2])
    touched = np.zeros(grid.shape, np.bool_)
    touched[tuple(cells[inside].T)] = True
    regions = {"touched": touched}
    if tampered.wedge is not None:
        regions["wedge"] = tampered.wedge.holds(polar_of_cells(grid)[1])
    return regions


def run_study(
    store: ResultStore[DeviationPlan], engine: Engine, on_progress: Progress = ignore_progress
) -> Iterator[str]:
    """Fit and calibrate the monitor, then report on each sweep; yield one line for each job that failed."""
    fit, *watching = store.plan.job_keys()
    yield from run_jobs(store, do_job, [fit], LocalEngine(1), on_progress, step="fit")
    yield from run_jobs(store, do_job, watching, engine, on_progress, step="watch", missing=_missing)


def _missing(_key: JobKey, done: set[JobKey]) -> str:
    return "" if ("fit",) in done else "the monitor is not fitted"


def do_job(job: Job[DeviationPlan]) -> JobResult:
    """Return what a job found; the fitted monitor is a file beside the results."""
    plan, path = job.plan, job.folder / MONITOR
    if job.key == ("fit",):
        fit, calibrate = ([_sample(plan, part, n) for n in range(plan.frames)] for part in (0, 1))
        monitor = fit_monitor(_estimator(plan), fit, calibrate, plan)
        save_monitor(monitor, path)
        return JobResult(facts={"limit": monitor.limit})
    number = int(job.key[1])
    rows = watch(
        load_monitor(path), _estimator(plan), _sample(plan, 2, number), plan,
        domain=plan.domain, method=METHOD, number=number,
    )  # fmt: skip
    return JobResult(list(rows))


@lru_cache(maxsize=1)
def _estimator(plan: DeviationPlan) -> UnetEstimator:
    grid, target = _sample(plan, 0, 0).truth.grid, TARGETS[plan.target]
    return load_network(METHOD, grid, target, passes=plan.passes, seed=plan.seed)


def _sample(plan: DeviationPlan, part: int, number: int) -> StudySample:
    """Return a sweep of one of the three sets, each from a scene of its own."""
    return sample_of(plan.domain, part * plan.frames + number, 3 * plan.frames, plan.seed)
