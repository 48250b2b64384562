"""The published detector on the same drives: the deviation of Monte Carlo dropout, fitted, calibrated and tried."""

from __future__ import annotations

from functools import lru_cache

from viewshed.estimators.unet import UnetEstimator, load_network
from viewshed.fov.visibility import TARGETS
from viewshed.monitor.deviation import DeviationMonitor, load_monitor, save_monitor
from viewshed.sweep import Sweep
from viewshed_lab.studies.cases import DEFAULT
from viewshed_lab.studies.monitor.drives import Drive
from viewshed_lab.studies.monitor.plan import FRAMES, PUBLISHED, MonitorPlan
from viewshed_lab.studies.runner import Job
from viewshed_lab.studies.store import JobResult

FILE = "published.npz"

METHOD, PASSES = "mc_dropout", 20
"""The network whose deviation is watched, and its number of passes."""

LAST = FRAMES - 1
"""The sweep of each drive that is looked at: the detector looks at no other."""

UNATTACKED = ""


def run_published(job: Job[MonitorPlan]) -> JobResult:
    """Fit the detector on benign sweeps of training drives, or score a drive as it is and under its attacks."""
    plan, path, domain = job.plan, job.folder / FILE, job.plan.domains[0]
    estimator = _estimator(plan)
    if job.key == (PUBLISHED, "fit"):
        drives = (Drive.simulate(plan, domain, "train", number) for number in range(plan.published[0]))
        save_monitor(DeviationMonitor.fit(estimator.estimate(drive.sweeps[LAST]) for drive in drives), path)
        return JobResult(facts={"sweeps": plan.published[0]})
    _, split, number = job.key
    drive = Drive.simulate(plan, domain, split, int(number))
    sweeps: dict[str, Sweep] = {UNATTACKED: drive.sweeps[LAST]}
    for case in plan.cases_of(domain, split, int(number)):
        if case.kind == "attack" and case.level == DEFAULT:
            try:
                *_, last = drive.tamper(case)
            except ValueError:
                continue
            sweeps[case.name] = last.sweep
    monitor = load_monitor(path)
    return JobResult(facts={name: monitor.score(estimator.estimate(sweep)) for name, sweep in sweeps.items()})


@lru_cache(maxsize=1)
def _estimator(plan: MonitorPlan) -> UnetEstimator:
    grid = plan.preset(plan.domains[0]).grid
    return load_network(METHOD, grid, TARGETS["car"], passes=PASSES, seed=plan.seed)
