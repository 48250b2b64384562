"""Many sweeps at once: on a processor one a core, on a graphics card the network once for a batch."""

from __future__ import annotations

import os
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from itertools import islice
from typing import Any, TypeVar

from viewshed.estimators.base import BatchSteps, Estimator
from viewshed.fov.estimate import FovEstimate
from viewshed.sweep import Sweep

BATCH = 16
"""Sweeps that are taken at once where no number is given."""

MOST = 1024
"""Largest batch."""

T = TypeVar("T")

R = TypeVar("R")

OnError = Callable[[Exception], None]
"""Called with the error of a sweep that has no estimate, when the estimate would have come."""


def estimate_all(
    estimator: Estimator,
    sweeps: Iterable[Sweep],
    batch: int = BATCH,
    threads: int | None = None,
    on_error: OnError | None = None,
) -> Iterator[FovEstimate]:
    """Return the estimates of many sweeps in their order, each as ``estimator.estimate(sweep)`` makes it.

    Sweeps are taken as they are needed, at most ``2 · batch`` ahead of the estimate that comes next, so that they may
    be more than fit into memory. On a processor each thread does whole sweeps, with a network that runs in it alone:
    batches are slower there, as the activations of many sweeps do not stay in the cache. On a graphics card features
    are computed in threads, those of the next batch while the network is run for this one.

    Args:
        estimator: any that takes each sweep by itself.
        sweeps: what the sensors measured; iterated once, in this thread.
        batch: sweeps that are taken at once, and that a graphics card runs the network for at once, in [1, 1024].
        threads: threads beside this one; None is one for each core.
        on_error: called with the error of a sweep, which is then skipped; without it the error is raised. Both
            happen where the estimate would have come. After an error of ``sweeps`` itself there is none.

    Raises:
        ValueError: ``batch`` or ``threads`` lies outside its range, or the estimator remembers earlier sweeps.
    """
    if not 1 <= batch <= MOST:
        raise ValueError(f"batch must lie in [1, {MOST}], got {batch}")
    if threads is not None and threads < 1:
        raise ValueError(f"threads must be at least 1, got {threads}")
    return _estimates(estimator.batch_steps(), sweeps, batch, threads or cores(), on_error or _raised)


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def in_order(work: Callable[[T], R], items: Iterable[T], ahead: int, threads: int) -> Generator[Future[R], None, None]:
    """Yield for each item, in their order, what is done with it in threads, at most ``ahead`` items ahead.

    An error of ``items`` itself is that of the last one.
    """
    waiting: deque[Future[R]] = deque()
    pool = ThreadPoolExecutor(threads, thread_name_prefix="viewshed")
    try:
        for future in _submitted(pool, work, items):
            waiting.append(future)
            if len(waiting) > ahead:
                yield waiting.popleft()
        while waiting:
            yield waiting.popleft()
    finally:
        pool.shutdown(cancel_futures=True)


def _estimates(
    steps: BatchSteps, sweeps: Iterable[Sweep], batch: int, threads: int, on_error: OnError
) -> Iterator[FovEstimate]:
    with closing(in_order(steps.prepare, sweeps, batch, threads)) as prepared:
        # An error takes the place of what it prevented, so that it is reported in its turn.
        while chunk := [_result_or_error(future.result) for future in islice(prepared, batch)]:
            results = iter(steps.infer([item for item in chunk if not isinstance(item, Exception)]))
            for item in chunk:
                failed = isinstance(item, Exception)
                estimate = item if failed else _result_or_error(steps.finish, item, next(results))
                if isinstance(estimate, Exception):
                    on_error(estimate)
                else:
                    yield estimate


def _submitted(pool: ThreadPoolExecutor, work: Callable[[T], R], items: Iterable[T]) -> Iterator[Future[R]]:
    try:
        for item in items:
            yield pool.submit(work, item)
    except Exception as error:
        failed: Future[R] = Future()
        failed.set_exception(error)
        yield failed


def _result_or_error(work: Callable[..., Any], *arguments: Any) -> Any:
    """Return the result of ``work``, or the error that it raises."""
    try:
        return work(*arguments)
    except Exception as error:
        return error


def _raised(error: Exception) -> None:
    raise error
