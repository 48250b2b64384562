"""The jobs of the study, one a drive: what all evidence says of it goes into a file beside the results."""

from __future__ import annotations

from collections.abc import Iterator

from viewshed._jobs import Engine
from viewshed.studies.monitor.archive import FOLDER
from viewshed.studies.monitor.drives import Drive, measure_drive
from viewshed.studies.monitor.plan import MonitorPlan
from viewshed.studies.runner import Job, Progress, ignore_progress, run_jobs
from viewshed.studies.store import JobResult, ResultStore


def run_study(
    store: ResultStore[MonitorPlan], engine: Engine, on_progress: Progress = ignore_progress
) -> Iterator[str]:
    """Measure the drives that are not there yet; yield one line for each job that failed."""
    (store.folder / FOLDER).mkdir(exist_ok=True)
    yield from run_jobs(store, do_job, store.plan.job_keys(), engine, on_progress, step="drives")


def do_job(job: Job[MonitorPlan]) -> JobResult:
    """Measure a drive in its cases and write what was found."""
    _, domain, split, number = job.key
    drive = Drive.simulate(job.plan, domain, split, int(number))
    found = measure_drive(drive, job.plan.cases_of(domain, split, int(number)))
    found.save(job.folder / FOLDER)
    return JobResult(facts={"file": found.file, "cases": len(found.cases), "refused": len(found.refused)})
