"""Engines: run one function over many jobs, in processes of this machine or on a Ray cluster, with the same results.

A job contains everything that its work needs (seeds, location, number), so results do not depend on the engine, the
number of workers or the order. The last digits of a training depend on its number of threads. To add an engine, write a
class and add a line to :data:`ENGINES`.
"""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import pickle
import signal
import socket
import sys
import threading
import time
import traceback
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Generic, Protocol, TypeVar

from viewshed._extras import needed_for
from viewshed_lab._config import Between, Checked, one_of

J = TypeVar("J")
R = TypeVar("R")
R_co = TypeVar("R_co", covariant=True)
Running = dict[Future[bytes], tuple[int, int]]
"""Index and number of attempts of each running job."""

TRIES = 3
"""Largest number of attempts at a job whose worker dies; a job that raises is not retried."""

_GRACE_S = 2.0  # time for a worker to delete partial files
_WAIT_S = 0.5
_CONNECT_S = 10.0
_RAY_ENVIRONMENT = {
    "RAY_USAGE_STATS_ENABLED": "0",  # send no usage statistics
    "RAY_DEDUP_LOGS_SKIP_REGEX": "^",  # print no line of another process, not even when a node dies; read at import
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # no warning that our tasks use no accelerator
}


@dataclass(frozen=True, slots=True)
class Done(Generic[R_co]):
    """One finished job."""

    index: int  # of the job, from 0
    result: R_co | None  # None if it failed
    error: str | None  # one line with the reason if it failed


class Engine(Protocol):
    """Anything that runs a function over jobs."""

    def run(self, work: Callable[[J], R], jobs: Sequence[J]) -> Generator[Done[R], None, None]:
        """Yield one ``Done`` per job as they finish, in any order; raise an OSError if workers cannot start.

        ``work`` (a function of a module), jobs and results are pickled. If the work raises, that job has an ``error``
        and the others continue; a job whose worker dies is retried, up to :data:`TRIES` attempts. At most as many jobs
        as workers run at a time. Closing the iterator stops all workers.
        """


def attempt(work: Callable[[J], R], index: int, job: J) -> Done[R]:
    """Do a job and return it as ``Done``, with the error if the work raises."""
    try:
        return Done(index, work(job), None)
    except Exception as error:
        return Done(index, None, reason(error))


def reason(error: BaseException) -> str:
    """Return one line that describes an exception, with its type and location if the message is not meant for users.

    >>> reason(ValueError("cells must be positive, got 0"))
    'cells must be positive, got 0'
    """
    text = " ".join(str(error).split())
    if isinstance(error, OSError | ValueError) and text:
        return text
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {text}{where}" if text else f"{type(error).__name__}{where}"


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


@dataclass(frozen=True, slots=True)
class LocalEngine(Checked):
    """Runs jobs in ``workers`` processes (None: one per core); with one worker, in this process.

    Processes are spawned, so a script must call it below ``if __name__ == "__main__":``. Ctrl-C or closing the iterator
    ends them, and they end by themselves soon after this process has ended.
    """

    workers: Annotated[int | None, Between(1)] = None

    def __post_init__(self) -> None:
        Checked.__post_init__(self)
        if self.workers != 1:
            with needed_for("more than one worker"):
                import pebble  # noqa: F401

    def run(self, work: Callable[[J], R], jobs: Sequence[J]) -> Generator[Done[R], None, None]:
        """Yield one ``Done`` per job as they finish, see :class:`Engine`."""
        size = cores() if self.workers is None else self.workers
        if size == 1 or not jobs:
            return (attempt(work, index, job) for index, job in enumerate(jobs))
        return self._run_in_processes(pickle.dumps(work), jobs, min(size, len(jobs)))

    def _run_in_processes(self, work: bytes, jobs: Sequence[J], size: int) -> Generator[Done[R], None, None]:
        import pebble

        def started() -> pebble.ProcessPool:
            context = multiprocessing.get_context("spawn")
            pool = pebble.ProcessPool(size, initializer=_watch_parent, context=context)
            with _without_interrupts():  # only this process handles Ctrl-C, not the pool's threads and processes
                _ = pool.active  # starts the pool
            return pool

        pool = started()

        def submit(message: bytes) -> Future[bytes]:
            nonlocal pool
            if not pool.active:  # a worker died before it had a job
                pool.join()
                pool = started()
            return pool.schedule(_do_locally, (work, message))

        try:
            yield from _drive(jobs, pickle.dumps, submit, lambda: size, {})
        finally:
            pool.stop()
            pool.join()


@dataclass(frozen=True, slots=True)
class RayEngine(Checked):
    """Runs jobs as Ray tasks of one core each, at most ``workers`` at a time (None: one per core of the cluster).

    Uses the cluster that the program has already joined, or that ``RAY_ADDRESS`` names, or that runs on this machine;
    otherwise starts one on this machine and ends it afterwards. All machines of the cluster need the same versions of
    Python, Ray and viewshed.
    """

    workers: Annotated[int | None, Between(1)] = None

    def __post_init__(self) -> None:
        Checked.__post_init__(self)
        with needed_for("engine ray"):
            import ray  # noqa: F401

    def run(self, work: Callable[[J], R], jobs: Sequence[J]) -> Generator[Done[R], None, None]:
        """Yield one ``Done`` per job as they finish, see :class:`Engine`."""
        import ray

        running: Running = {}
        with _cluster():
            stored = ray.put(ray.cloudpickle.dumps(work))
            # We retry lost tasks ourselves: Ray would retry tasks that run out of memory forever.
            task: Any = ray.remote(num_cpus=1, max_retries=0, scheduling_strategy="SPREAD")(_do_pickled)
            try:
                yield from _drive(
                    jobs, ray.cloudpickle.dumps, lambda message: task.remote(stored, message).future(),
                    lambda: self.workers or int(ray.cluster_resources().get("CPU", 1)), running,
                )  # fmt: skip
            finally:
                for future in running:
                    ray.cancel(future.object_ref, force=True)  # type: ignore[attr-defined]


def _drive(
    jobs: Sequence[J],
    dumps: Callable[[object], bytes],
    submit: Callable[[bytes], Future[bytes]],
    size: Callable[[], int],
    running: Running,
) -> Generator[Done[Any], None, None]:
    """Submit as many jobs as there are workers, yield finished jobs, retry lost ones."""
    new, lost = iter(range(len(jobs))), list[tuple[int, int]]()
    while True:
        while len(running) < max(1, size()):
            index, tries = lost.pop() if lost else (next(new, -1), 0)
            if index < 0:
                break
            try:
                message = dumps((index, jobs[index]))
            except Exception as error:
                yield Done(index, None, f"job {index} cannot be sent to a worker: {reason(error)}")
                continue
            running[submit(message)] = index, tries + 1
        if not running:
            return
        # Without a timeout, a Ctrl-C just before the wait would be handled only after it.
        for future in wait(running, timeout=_WAIT_S, return_when=FIRST_COMPLETED).done:
            index, tries = running.pop(future)
            problem = future.exception()
            if problem is None:
                yield pickle.loads(future.result())  # noqa: S301 - from our own process
            elif tries < TRIES:
                lost.append((index, tries))
            else:
                yield Done(
                    index, None, f"the worker died {TRIES} times on this job, the last time with {_end(problem)}"
                )


def _end(problem: BaseException) -> str:
    """Describe how a worker ended; raise an OSError if no worker starts."""
    if isinstance(problem, BrokenProcessPool):
        raise OSError(
            f"a worker process must start, but ended before its first job {TRIES} times; call the engine below"
            ' if __name__ == "__main__":, give it more memory, or use 1 worker'
        ) from problem
    code = getattr(problem, "exitcode", None)
    if code is None:
        return f"{type(problem).__name__}: {reason(problem)}"[:300]
    hint = " (out of memory?)" if code == -9 else ""
    return f"signal {-code}{hint}" if code < 0 else f"exit status {code}"


def _do_pickled(work: bytes, message: bytes) -> bytes:
    """Do a job in a worker."""
    index = -1
    try:
        index, job = pickle.loads(message)  # noqa: S301 - from our own process
        return pickle.dumps(attempt(pickle.loads(work), index, job))  # noqa: S301 - from our own process
    except Exception as error:
        return pickle.dumps(Done(index, None, f"job {index} cannot be passed between processes: {reason(error)}"))


def _do_locally(work: bytes, message: bytes) -> bytes:
    """Do a job; on SIGTERM the worker exits normally, so that it deletes partial files."""
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    try:
        return _do_pickled(work, message)
    finally:
        signal.signal(signal.SIGTERM, before)


def _watch_parent() -> None:
    """End this worker when its parent process has ended."""

    def end_with_parent() -> None:
        if parent := multiprocessing.parent_process():
            parent.join()
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(_GRACE_S)
            os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


@contextlib.contextmanager
def _without_interrupts() -> Iterator[None]:
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def _cluster() -> Iterator[None]:
    """Join or start a cluster without log output; disconnect, or stop it, afterwards."""
    for name, value in _RAY_ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    import ray

    if ray.is_initialized():
        yield
        return
    address = os.environ.get("RAY_ADDRESS", "")
    host, _, port = address.removeprefix("ray://").rpartition(":")
    try:
        if host and port.isdigit():  # Ray would retry for minutes if nothing listens there
            socket.create_connection((host.strip("[]"), int(port)), timeout=_CONNECT_S).close()
        ray.init(include_dashboard=False, log_to_driver=False, logging_level=logging.ERROR)
    except (ray.exceptions.RayError, OSError, RuntimeError, ValueError) as error:
        problem = f"RAY_ADDRESS must name a running Ray cluster, got {address}" if address else "Ray cannot start here"
        raise OSError(f"{problem} ({reason(error)}); start one with ray start --head, or unset RAY_ADDRESS") from error
    try:
        yield
    finally:
        ray.shutdown()


ENGINES: dict[str, Callable[[int | None], Engine]] = {"local": LocalEngine, "ray": RayEngine}
"""By name, the factory of an engine for a number of workers; None is one per core."""


def engine_named(name: str, workers: int | None = None) -> Engine:
    """Return the engine with this name and number of workers; None is one per core of the machine or the cluster.

    Raises:
        ValueError: there is no such engine, or ``workers`` is below 1.
        ImportError: the engine needs an extra that is not installed.
    """
    one_of("engine", name, ENGINES)
    return ENGINES[name](workers)
