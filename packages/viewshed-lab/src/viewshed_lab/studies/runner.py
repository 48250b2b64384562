"""Runs the jobs of a study that are not yet in its store, on an engine, and stores each result."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Generic

from viewshed_lab._jobs import Engine, LocalEngine
from viewshed_lab.data.archive.schema import code_version
from viewshed_lab.studies.plan import JobKey
from viewshed_lab.studies.store import JobResult, P, ResultStore

THREADS = "OMP_NUM_THREADS"
"""Environment variable that sets the number of threads of a process."""

Progress = Callable[[str, int, int], None]
"""Progress callback: name of the step, number of finished jobs, number of all jobs."""


@dataclass(frozen=True, slots=True)
class Job(Generic[P]):
    """One job of a study; its result is one file of the store."""

    plan: P  # of the study
    folder: Path  # of the study
    key: JobKey  # its step, then its names within the step
    device: str = "cpu"  # ``cpu`` or ``cuda``


def lacking(needed: Set[JobKey], what: str) -> Callable[[JobKey, set[JobKey]], str]:
    """Return the ``missing`` function of :func:`run_jobs` for jobs that all need the same ``needed`` jobs.

    >>> lacking({("drive", "1"), ("drive", "2")}, "drives are not measured")(("score",), {("drive", "1")})
    '1 drives are not measured'
    """

    def missing(_key: JobKey, done: set[JobKey]) -> str:
        count = len(needed - done)
        return f"{count} {what}" if count else ""

    return missing


def run_jobs(
    store: ResultStore[P],
    work: Callable[[Job[P]], JobResult],
    keys: Sequence[JobKey],
    engine: Engine,
    on_progress: Progress = lambda *_: None,
    *,
    step: str = "",
    device: str = "cpu",
    missing: Callable[[JobKey, set[JobKey]], str] = lambda _key, _done: "",
) -> Iterator[str]:
    """Run the jobs that are not in the store; yield one line for each failed job as it happens.

    The stored results do not depend on the engine or on the number of workers, except those of trainings: torch sums in
    another order for each number of threads, so their last digits differ. One local worker has all threads of the
    process, others have one each.

    Args:
        store: receives the results.
        work: runs one job.
        keys: keys of the jobs.
        engine: runs the jobs.
        on_progress: is called after each job.
        step: name of the step, for ``on_progress``.
        device: ``cpu`` or ``cuda``.
        missing: takes a key and the finished keys; returns what the job still needs, or an empty string. A job that
            needs something is skipped, and its line yielded.
    """
    done = store.keys()
    pending = [key for key in keys if key not in done]
    waiting = {key: reason for key in pending if (reason := missing(key, done))}
    yield from (f"{' '.join(key)}: {reason}" for key, reason in waiting.items())
    if not keys:
        return
    finished = len(keys) - len(pending)
    on_progress(step, finished, len(keys))
    jobs = [Job(store.plan, store.folder, key, device) for key in pending if key not in waiting]
    with _one_thread_each(engine), contextlib.closing(engine.run(partial(_with_commits, work), jobs)) as run:
        for outcome in run:
            key = jobs[outcome.index].key
            if outcome.result is None:
                yield f"{' '.join(key)}: {outcome.error}"
            else:
                store.append(key, *outcome.result)
            finished += 1
            on_progress(step, finished, len(keys))


def _with_commits(work: Callable[[Job[P]], JobResult], job: Job[P]) -> tuple[JobResult, list[str]]:
    """Return the result of a job and the commits of the code that ran it."""
    return work(job), list(code_version()["commits"])


@contextlib.contextmanager
def _one_thread_each(engine: Engine) -> Iterator[None]:
    """Limit processes started in this context to one thread each, as several jobs share the cores."""
    before = os.environ.get(THREADS)
    if engine != LocalEngine(1):
        os.environ[THREADS] = "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(THREADS, None)
        else:
            os.environ[THREADS] = before
