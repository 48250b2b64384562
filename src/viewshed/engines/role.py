"""What an engine is, and what it says about a job."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, Protocol, TypeVar

J = TypeVar("J")
R = TypeVar("R")
R_co = TypeVar("R_co", covariant=True)

TRIES = 3
"""How often a job is begun when the worker that has it dies; a job that raises is begun once."""


@dataclass(frozen=True, slots=True)
class Done(Generic[R_co]):
    """What became of one job.

    Attributes:
        index: which of the jobs, from 0.
        result: what the work returned, or None where it failed.
        error: one line that says why it failed, or None.
    """

    index: int
    result: R_co | None
    error: str | None


class Engine(Protocol):
    """Anything that runs a function over jobs."""

    def run(self, work: Callable[[J], R], jobs: Sequence[J]) -> Generator[Done[R], None, None]:
        """Yield one ``Done`` for every job as they finish, in any order.

        ``work``, jobs and results travel between processes: ``work`` is a function of a module (or a
        ``functools.partial`` of one). Where the work raises, that job has an ``error`` and the rest goes on; where a
        worker dies, another takes its place and the job is begun again, :data:`TRIES` times in all. No more jobs are
        under way than there are workers. Closing the iterator stops all workers.
        """


def attempt(work: Callable[[J], R], index: int, job: J) -> Done[R]:
    """Return the job done, with the error where the work raises."""
    try:
        return Done(index, work(job), None)
    except Exception as error:
        return Done(index, None, reason(error))


def reason(error: BaseException) -> str:
    """Return one line that says what was raised; where, too, if the message is not meant for users.

    >>> reason(ValueError("cells must be positive, got 0"))
    'cells must be positive, got 0'
    """
    text = " ".join(str(error).split())
    if isinstance(error, OSError | ValueError) and text:
        return text
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {text}{where}" if text else f"{type(error).__name__}{where}"


def check_workers(workers: int | None) -> None:
    """Check a number of workers; None stands for all cores.

    Raises:
        ValueError: it is below 1.
    """
    if workers is not None and workers < 1:
        raise ValueError(f"workers must be at least 1, got {workers}")
