"""Many sweeps at once: on a processor one a core, on a graphics card the network once for a batch."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from itertools import islice
from typing import Any, TypeVar

from viewshed._jobs import cores
from viewshed.estimators.base import BatchSteps, Estimator
from viewshed.fov.estimate import FovEstimate
from viewshed.sweep import Sweep

BATCH = 16
"""Sweeps that are taken at once where no number is given."""

MOST = 1024
"""Largest batch."""

T = TypeVar("T")

R = TypeVar("R")

Failed = Callable[[Exception], None]
"""Is told why there is no estimate of a sweep, when it would have come."""


def estimate_all(
    estimator: Estimator,
    sweeps: Iterable[Sweep],
    batch: int = BATCH,
    threads: int | None = None,
    on_error: Failed | None = None,
) -> Iterator[FovEstimate]:
    """Return the estimates of many sweeps in their order, each as ``estimator.estimate(sweep)`` makes it.

    Sweeps are taken as they are needed, at most ``2 · batch`` ahead of the estimate that comes next, so that they may
    be more than fit into memory. On a processor each thread does whole sweeps, with a network that runs in it alone:
    batches are slower there, as what a layer tells of many sweeps does not stay in the cache. On a graphics card, and
    with OpenVINO, channels are made in threads, those of the next batch while the network is run for this one.

    Args:
        estimator: any that takes each sweep by itself.
        sweeps: what the sensors measured; iterated once, in this thread.
        batch: sweeps that are taken at once, and that a graphics card runs the network for at once, in [1, 1024].
        threads: threads beside this one; None is one for each core.
        on_error: is told why a sweep has no estimate, which is then left out; without it the error is raised. Both
            happen where the estimate would have come. After an error of ``sweeps`` itself there is none.

    Raises:
        ValueError: ``batch`` or ``threads`` lies outside its range, or the estimator remembers earlier sweeps.
    """
    if not 1 <= batch <= MOST:
        raise ValueError(f"batch must lie in [1, {MOST}], got {batch}")
    if threads is not None and threads < 1:
        raise ValueError(f"threads must be at least 1, got {threads}")
    return _estimates(estimator.batch_steps(), sweeps, batch, threads or cores(), on_error or _raised)


def in_order(work: Callable[[T], R], items: Iterable[T], ahead: int, threads: int) -> Generator[Future[R], None, None]:
    """Yield for each item, in their order, what is done with it in threads, ``ahead`` so many items.

    An error of ``items`` itself is that of the last one.
    """
    waiting: deque[Future[R]] = deque()
    pool = ThreadPoolExecutor(threads, thread_name_prefix="viewshed")
    try:
        for each in _begun(pool, work, items):
            waiting.append(each)
            if len(waiting) > ahead:
                yield waiting.popleft()
        while waiting:
            yield waiting.popleft()
    finally:
        pool.shutdown(cancel_futures=True)


def _estimates(
    steps: BatchSteps, sweeps: Iterable[Sweep], batch: int, threads: int, on_error: Failed
) -> Iterator[FovEstimate]:
    with closing(in_order(steps.prepare, sweeps, batch, threads)) as prepared:
        while part := [_tried(each.result) for each in islice(prepared, batch)]:
            results = iter(steps.infer([each for each in part if not isinstance(each, Exception)]))
            for each in part:
                found = each if isinstance(each, Exception) else _tried(steps.finish, each, next(results))
                if isinstance(found, Exception):
                    on_error(found)
                else:
                    yield found


def _begun(pool: ThreadPoolExecutor, work: Callable[[T], R], items: Iterable[T]) -> Iterator[Future[R]]:
    try:
        for each in items:
            yield pool.submit(work, each)
    except Exception as error:
        failed: Future[R] = Future()
        failed.set_exception(error)
        yield failed


def _tried(work: Callable[..., Any], *arguments: Any) -> Any:
    """Return what ``work`` returns, or the error that it raises."""
    try:
        return work(*arguments)
    except Exception as error:
        return error


def _raised(error: Exception) -> None:
    raise error
