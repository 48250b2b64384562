"""Jobs of a study: what is in the store stays, an engine does the rest, job after job."""

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
"""What tells a process how many threads a training has."""

Progress = Callable[[str, int, int], None]
"""Is called with the step, how many of its jobs are done, and how many there are."""


@dataclass(frozen=True, slots=True)
class Job(Generic[P]):
    """One line of results that is to be found."""

    plan: P  # of the study
    folder: Path  # of the study
    key: JobKey  # its step, and what tells it from the others of that step
    device: str = "cpu"  # ``cpu`` or ``cuda``


def lacking(needed: Set[JobKey], what: str) -> Callable[[JobKey, set[JobKey]], str]:
    """Return what ``missing`` of :func:`run_jobs` is where every job needs the same ones: how many are not done.

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
    """Do the jobs that are not in the store, and yield one line for each that failed, as it happens.

    What is stored does not depend on the engine or on the number of workers, up to the order of the lines.

    Args:
        store: where results go.
        work: does a job.
        keys: of the jobs.
        engine: does them.
        on_progress: is called after each job.
        step: name of all of them together.
        device: ``cpu`` or ``cuda``.
        missing: says what a job needs that is not done yet; such a job is left, and its line yielded.
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
        for one in run:
            key = jobs[one.index].key
            if one.result is None:
                yield f"{' '.join(key)}: {one.error}"
            else:
                store.append(key, *one.result)
            finished += 1
            on_progress(step, finished, len(keys))


def _with_commits(work: Callable[[Job[P]], JobResult], job: Job[P]) -> tuple[JobResult, list[str]]:
    """Return what a job found, and the commits of the code that did it."""
    return work(job), list(code_version()["commits"])


@contextlib.contextmanager
def _one_thread_each(engine: Engine) -> Iterator[None]:
    """Let processes that are started meanwhile use one thread each: several trainings share the cores."""
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
