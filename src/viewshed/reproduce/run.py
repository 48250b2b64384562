"""The study from start to end: what is there stays, the rest is done step after step and job after job."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

from viewshed.engines import Engine, LocalEngine
from viewshed.reproduce.data import SPLITS, make_archive, open_archive, preset_of
from viewshed.reproduce.jobs import STEPS, Job, do_job, keys_of, needed
from viewshed.reproduce.models import check_training
from viewshed.reproduce.plan import StudyPlan
from viewshed.reproduce.protocols import PROTOCOLS
from viewshed.reproduce.store import JobStore, Key

THREADS = "OMP_NUM_THREADS"
"""What tells a process how many threads a training has."""
Told = Callable[[str, int, int], None]
"""Is told the step, how many of its parts are there, and how many there are."""


@dataclass(frozen=True, slots=True)
class Scope:
    """What of a study is done, and with what.

    Attributes:
        steps: of ``STEPS``.
        protocols: of ``PROTOCOLS``.
        device: ``cpu`` or ``cuda``, for trainings and networks.
        workers: jobs under way at a time; None is one for each core.

    Raises:
        ValueError: a name is not known.
    """

    steps: tuple[str, ...] = STEPS
    protocols: tuple[str, ...] = PROTOCOLS
    device: str = "cpu"
    workers: int | None = None

    def __post_init__(self) -> None:
        for name, given, known in (("only", self.steps, STEPS), ("protocol", self.protocols, PROTOCOLS),
                                   ("device", (self.device,), ("cpu", "cuda"))):  # fmt: skip
            for word in given:
                if word not in known:
                    raise ValueError(f"{name} must be among {', '.join(known)}, got {word!r}")
        LocalEngine(self.workers)

    def engine(self, step: str, plan: StudyPlan) -> Engine:
        """Return what does the jobs of a step; what needs the GPU, processes of its own or all cores is done here."""
        alone = step == "trade" or (step == "models" and plan.workers > 0) or (self.device != "cpu" and step != "data")
        return LocalEngine(1 if alone else self.workers)


def run_steps(store: JobStore[StudyPlan], scope: Scope, told: Told) -> Iterator[str]:
    """Do what is not there yet, and yield one line for each job that failed or could not be done, as it happens.

    Args:
        store: of the study.
        scope: what of it is done.
        told: is told of what is there.

    Raises:
        ValueError: there is no such device, or data of another plan lie in the folder.
        ImportError: trainings are wanted and the extra for them is not installed.
        OSError: something cannot be written.
    """
    if {"models", "trade"} & set(scope.steps) or scope.device != "cpu":
        check_training(scope.device)
    if "data" in scope.steps:
        make_data(store, scope, told)
    working = [step for step in STEPS[1:-1] if step in scope.steps]
    if working:
        _check_data(store)
    for step in working:
        yield from run_step(store, scope, step, told)


def _check_data(store: JobStore[StudyPlan]) -> None:
    for domain in store.plan.domains:
        for split in SPLITS:
            try:
                open_archive(store.folder, domain, split)
            except (ValueError, OSError) as error:
                raise ValueError(f"{error}; the other steps need the step data") from error


def make_data(store: JobStore[StudyPlan], scope: Scope, told: Told) -> None:
    """Simulate the sweeps of all domains, as far as they are not there."""
    parts = [(domain, split) for domain in store.plan.domains for split in SPLITS]
    total, done = sum(preset_of(store.plan, *part).sweeps for part in parts), 0

    def more(sweeps: int) -> None:
        nonlocal done
        done += sweeps
        told("data", done, total)

    for part in parts:
        make_archive(store.plan, store.folder, part, scope.engine("data", store.plan), more)


def run_step(store: JobStore[StudyPlan], scope: Scope, step: str, told: Told) -> Iterator[str]:
    """Do the jobs of a step that are not there, and yield one line for each that failed or has nothing to start from.

    Args:
        store: of the study.
        scope: what of it is done.
        step: of ``STEPS``.
        told: is told of what is there.
    """
    done = store.keys()
    every = [Job(store.plan, store.folder, key, scope.device) for key in keys_of(store.plan, step, scope.protocols)]
    left = [job for job in every if job.key not in done]
    ready = [job for job in left if all(key in done for key in needed(job))]
    yield from (f"{' '.join(job.key)}: not all of its models are trained" for job in left if job not in ready)
    if every:
        told(step, len(every) - len(left), len(every))
        there = Counted(len(every) - len(left), len(every), lambda done, total: told(step, done, total))
        yield from run_jobs(store, do_job, ready, scope.engine(step, store.plan), there)


class Keyed(Protocol):
    """Work with a name."""

    @property
    def key(self) -> Key:
        """Its name."""
        ...


K = TypeVar("K", bound=Keyed)


@dataclass(slots=True)
class Counted:
    """How many jobs of a step are done, and who is told.

    Attributes:
        done: of them.
        total: how many there are.
        told: is given both after each job.
    """

    done: int
    total: int
    told: Callable[[int, int], None]

    def one_more(self) -> None:
        """Count a job."""
        self.done += 1
        self.told(self.done, self.total)


def run_jobs(
    store: JobStore[Any], work: Callable[[K], dict[str, Any]], jobs: Sequence[K], engine: Engine, there: Counted
) -> Iterator[str]:
    """Do jobs, keep what each finds, and yield one line for each that failed."""
    with _one_thread_each(engine), contextlib.closing(engine.run(work, jobs)) as run:
        for finished in run:
            key = jobs[finished.index].key
            if finished.result is None:
                yield f"{' '.join(key)}: {finished.error}"
            else:
                store.append(key, finished.result)
            there.one_more()


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


def named_steps(words: str | None) -> tuple[str, ...]:
    """Return the steps named with commas, all of them for none.

    >>> named_steps("data,models"), named_steps(None) == STEPS
    (('data', 'models'), True)
    """
    return STEPS if words is None else tuple(words.split(","))


def folder_of(out: Path) -> Path:
    """Return the folder of a study with its whole path: jobs may be done elsewhere."""
    return out.expanduser().resolve()
