"""Parallel estimates of many sweeps: one per CPU core, or the network once per batch on a GPU."""

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
"""Default batch size in sweeps."""

MAX_BATCH = 1024
"""Maximum batch size in sweeps."""

T = TypeVar("T")

R = TypeVar("R")

OnError = Callable[[Exception], None]
"""Callback that receives the error of a sweep, in place of its estimate."""


def estimate_all(
    estimator: Estimator,
    sweeps: Iterable[Sweep],
    batch: int = BATCH,
    threads: int | None = None,
    on_error: OnError | None = None,
) -> Iterator[FovEstimate]:
    """Yield the estimates of many sweeps in order, equal to ``estimator.estimate(sweep)`` of each.

    Sweeps are read lazily, at most ``2 · batch`` ahead of the next estimate, so they need not fit into memory. On a CPU
    each thread computes whole estimates with a single-threaded network: batches would be slower, because the
    activations of many sweeps do not fit into the cache. On a GPU the threads compute the features of the next batch
    while the network runs on the current one.

    Args:
        estimator: an estimator that keeps no state between sweeps.
        sweeps: the sweeps; iterated once, in this thread.
        batch: number of sweeps per batch, in [1, 1024]; a GPU runs the network once per batch.
        threads: number of worker threads; None is one per core.
        on_error: called with the error of a sweep, in place of its estimate; the sweep is then skipped. None raises
            the error. An error of the iterable ``sweeps`` itself ends the estimates.

    Raises:
        ValueError: ``batch`` or ``threads`` is out of range, or the estimator keeps earlier sweeps.
    """
    if not 1 <= batch <= MAX_BATCH:
        raise ValueError(f"batch must lie in [1, {MAX_BATCH}], got {batch}")
    if threads is not None and threads < 1:
        raise ValueError(f"threads must be at least 1, got {threads}")
    return _estimates(estimator.batch_steps(), sweeps, batch, threads or cores(), on_error or _raise)


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def in_order(work: Callable[[T], R], items: Iterable[T], ahead: int, threads: int) -> Generator[Future[R], None, None]:
    """Yield the futures of ``work(item)`` in the order of ``items``, submitting at most ``ahead`` items ahead.

    If iterating ``items`` raises, the last future has that error.
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
        # An error takes the place of its sweep's result, so errors are reported in order.
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
    """Return the result of ``work``, or the exception that it raises."""
    try:
        return work(*arguments)
    except Exception as error:
        return error


def _raise(error: Exception) -> None:
    raise error
