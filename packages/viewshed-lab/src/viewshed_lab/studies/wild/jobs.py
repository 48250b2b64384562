"""The jobs of the wild study: one per sweep, with every method, target and knowledge."""

from __future__ import annotations

from collections.abc import Iterator

from viewshed_lab._jobs import Engine
from viewshed_lab.data.wild import WildScene, wild_tables
from viewshed_lab.studies.plan import JobKey
from viewshed_lab.studies.runner import Job, Progress, run_jobs
from viewshed_lab.studies.store import JobResult, ResultStore
from viewshed_lab.studies.wild.evaluate import rows_of
from viewshed_lab.studies.wild.openings import SetOpening
from viewshed_lab.studies.wild.plan import WildPlan


def run_study(
    store: ResultStore[WildPlan],
    engine: Engine,
    on_progress: Progress = lambda *_: None,
    opening: SetOpening | None = None,
) -> Iterator[str]:
    """Run the jobs that are not in the store; yield one line for each failed job.

    ``opening`` is required for the sealed set; the caller must have logged it before.
    """
    if store.plan.opens_sealed and opening is None:
        raise ValueError(
            f"{store.plan.name} opens the sealed set: give the reason, which is logged, with --open-sealed"
        )
    return run_jobs(store, do_job, store.plan.job_keys(), engine, on_progress, step=store.plan.name)


def scene_of(key: JobKey) -> WildScene:
    """Return the scene of a job."""
    set_name, name, number, _ = key
    domain = next(one for one in wild_tables().of_set(set_name) if one.name == name)
    return WildScene(domain, int(number))


def do_job(job: Job[WildPlan]) -> JobResult:
    """Evaluate all methods on one sweep."""
    seen = scene_of(job.key).observe(int(job.key[3]))
    return JobResult(list(rows_of(seen, job.plan)))
