"""Engines: run one function over many jobs, in processes of this machine or on a Ray cluster, with the same results.

A job says all that its work needs (seeds, place, number), so results do not depend on the engine, on the number of
workers or on the order. To add an engine, write a class and add a line to :data:`ENGINES`.

The local engine is ours because a killed worker must cost one job: the pools of concurrent.futures and loky break as a
whole, and fail every job that is not finished; that of multiprocessing waits for ever.
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
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from viewshed._extras import needed_for

if TYPE_CHECKING:
    from multiprocessing.context import ForkServerContext, SpawnContext

    import ray


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


def _check_workers(workers: int | None) -> None:
    if workers is not None and workers < 1:
        raise ValueError(f"workers must be at least 1, got {workers}")


@dataclass(slots=True)
class _Pending:
    """The numbers of the jobs that nobody has, with how often each was begun: lost ones first, then new ones."""

    count: int
    next_new: int = 0
    lost: list[tuple[int, int]] = field(default_factory=list)

    def __bool__(self) -> bool:
        return bool(self.lost) or self.next_new < self.count

    def take(self) -> tuple[int, int]:
        """Return a job to be begun, and how often it was begun before."""
        if self.lost:
            return self.lost.pop()
        self.next_new += 1
        return self.next_new - 1, 0

    def lose(self, index: int, tries: int, end: str) -> Iterator[Done[Any]]:
        """Take back a job whose worker died, begun so many times; yield it failed where it was begun often enough."""
        if tries < TRIES:
            self.lost.append((index, tries))
        else:
            yield Done(index, None, f"the worker died {TRIES} times over this job, at last with {end}")


_GRACE_S = 2.0  # for a worker to remove what it has half written


@dataclass(frozen=True, slots=True)
class LocalEngine:
    """Runs jobs in ``workers`` processes, None is one for each core; with one worker in this process, without any.

    Processes are spawned, so a script must call it below ``if __name__ == "__main__":``. Ctrl-C or closing the iterator
    ends them, and they end by themselves soon after this process is gone.

    Attributes:
        workers: number of processes.
        preload: modules that the work needs. A process that does nothing else imports them while this one goes on, and
            workers are forked from it. There is one for all engines of a program, which keeps to what the first one
            was given, and to its environment. Windows cannot fork: workers are spawned there.

    Raises:
        ValueError: ``workers`` is below 1.
    """

    workers: int | None = None
    preload: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        _check_workers(self.workers)
        if self._forks and self._size > 1:
            from multiprocessing import forkserver

            multiprocessing.set_forkserver_preload(list(self.preload))
            with _without_interrupts():
                forkserver.ensure_running()

    def run(self, work: Callable[[J], R], jobs: Sequence[J]) -> Generator[Done[R], None, None]:
        """Yield one ``Done`` for every job as they finish, see :class:`Engine`; an OSError if workers cannot start."""
        if self._size == 1:
            return (attempt(work, index, job) for index, job in enumerate(jobs))
        context = multiprocessing.get_context("forkserver") if self._forks else multiprocessing.get_context("spawn")
        return _Pool(context, pickle.dumps(work), _Pending(len(jobs))).run(jobs, min(self._size, len(jobs)))

    @property
    def _size(self) -> int:
        return cores() if self.workers is None else self.workers

    @property
    def _forks(self) -> bool:
        return bool(self.preload) and "forkserver" in multiprocessing.get_all_start_methods()


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


@dataclass(slots=True, eq=False)
class _Worker:
    """One process, the pipe to it and the job that it has."""

    process: BaseProcess
    pipe: Connection
    ready: bool = False
    index: int | None = None
    tries: int = 0


@dataclass(slots=True, eq=False)
class _Pool:
    """The workers of one run, and the jobs that are pending."""

    context: SpawnContext | ForkServerContext
    work: bytes
    pending: _Pending
    workers: list[_Worker] = field(default_factory=list)
    failed_starts: int = 0

    def run(self, jobs: Sequence[J], size: int) -> Generator[Done[R], None, None]:
        try:
            self.workers.extend(_start(self.context, self.work) for _ in range(size))
            while self.pending or any(worker.index is not None for worker in self.workers):
                ready = set(wait([worker.pipe for worker in self.workers]))
                for worker in [worker for worker in self.workers if worker.pipe in ready]:
                    yield from self._receive(worker, jobs)
        finally:
            _stop(self.workers)

    def _receive(self, worker: _Worker, jobs: Sequence[J]) -> Iterator[Done[R]]:
        """Receive a message of a worker (that it is ready, or a job done) and assign it the next job."""
        try:
            done: Done[R] | None = pickle.loads(worker.pipe.recv_bytes())  # noqa: S301 - from our own process
        except (EOFError, OSError):
            yield from self._replace(worker)
            return
        worker.ready, worker.index = True, None
        self.failed_starts = 0
        if done is not None:
            yield done
        yield from self._assign(worker, jobs)

    def _assign(self, worker: _Worker, jobs: Sequence[J]) -> Iterator[Done[R]]:
        while worker.index is None and self.pending:
            index, tries = self.pending.take()
            try:
                message = pickle.dumps((index, jobs[index]))
            except Exception as error:
                yield Done(index, None, f"job {index} cannot be sent to a worker: {reason(error)}")
                continue
            worker.index, worker.tries = index, tries + 1
            with contextlib.suppress(OSError):  # it is dead: seen when we next listen
                worker.pipe.send_bytes(message)

    def _replace(self, worker: _Worker) -> Iterator[Done[R]]:
        worker.process.join()
        worker.pipe.close()
        self.workers.remove(worker)
        end = _describe_exit(worker.process.exitcode)
        if not worker.ready:
            self.failed_starts += 1
        if self.failed_starts >= TRIES:
            raise OSError(
                f"a worker process must start, got {end} {TRIES} times; call the engine below"
                ' if __name__ == "__main__":, give it more memory, or use 1 worker'
            )
        if worker.index is not None:
            yield from self.pending.lose(worker.index, worker.tries, end)
        self.workers.append(_start(self.context, self.work))


def _describe_exit(exitcode: int | None) -> str:
    if exitcode is None or exitcode >= 0:
        return f"exit status {exitcode}"
    hint = " (out of memory?)" if -exitcode == signal.SIGKILL else ""
    return f"signal {-exitcode}{hint}"


def _start(context: SpawnContext | ForkServerContext, work: bytes) -> _Worker:
    """Start a worker that never hears Ctrl-C: that is for its parent, who ends it."""
    ours, theirs = context.Pipe()
    process = context.Process(target=_run_worker, args=(theirs, work), daemon=True)
    with _without_interrupts():
        process.start()
    theirs.close()
    return _Worker(process, ours)


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


def _stop(workers: list[_Worker]) -> None:
    for worker in workers:
        worker.pipe.close()
        worker.process.terminate()
    end_s = time.monotonic() + _GRACE_S
    for worker in workers:
        worker.process.join(max(0.0, end_s - time.monotonic()))
        worker.process.kill()
        worker.process.join()


def _run_worker(pipe: Connection, work: bytes) -> None:
    """Do jobs until there are no more, in a process of its own."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that half-written files are removed
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with contextlib.suppress(EOFError, OSError):
        pipe.send_bytes(pickle.dumps(None))
        while True:
            pipe.send_bytes(_run_job(work, pipe.recv_bytes()))
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # nothing is half-written now, and to raise while ending is noise


def _run_job(work: bytes, message: bytes) -> bytes:
    index = -1
    try:
        index, job = pickle.loads(message)  # noqa: S301 - from our own process
        return pickle.dumps(attempt(pickle.loads(work), index, job))  # noqa: S301 - from our own process
    except Exception as error:
        return pickle.dumps(Done(index, None, f"job {index} cannot travel between processes: {reason(error)}"))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(_GRACE_S)
        os._exit(1)


_CONNECT_S = 10.0

_RAY_ENVIRONMENT = {
    "RAY_USAGE_STATS_ENABLED": "0",  # nothing is sent to anybody
    "RAY_DEDUP_LOGS_SKIP_REGEX": "^",  # print no line of another process, not even when a node dies; read at import
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # our tasks ask for no accelerator; Ray warns about that otherwise
}


@dataclass(frozen=True, slots=True)
class RayEngine:
    """Runs jobs as Ray tasks of one core each, at most ``workers`` at a time; None is one for each core of the cluster.

    Uses the cluster that the program has already joined or that ``RAY_ADDRESS`` names or that runs on this machine;
    where there is none, starts one on this machine and ends it afterwards. Every machine of the cluster needs the same
    versions of Python, Ray and viewshed.

    Raises:
        ValueError: ``workers`` is below 1.
        ImportError: Ray is not installed.
    """

    workers: int | None = None

    def __post_init__(self) -> None:
        _check_workers(self.workers)
        with needed_for("engine ray"):
            import ray  # noqa: F401

    def run(self, work: Callable[[J], R], jobs: Sequence[J]) -> Generator[Done[R], None, None]:
        """Yield one ``Done`` for every job as they finish, see :class:`Engine`; an OSError if there is no cluster."""
        with _cluster():
            yield from _Tasks(work, jobs).run(self.workers)


class _Tasks:
    """The tasks of one run: which are under way, and which jobs are pending."""

    def __init__(self, work: Callable[[J], R], jobs: Sequence[J]) -> None:
        import ray

        self._ray = ray
        self._jobs, self._pending = jobs, _Pending(len(jobs))
        self._work = ray.put(work)
        # We begin lost tasks again ourselves: Ray would do so without end for those that run out of memory.
        self._task: Any = ray.remote(num_cpus=1, max_retries=0, scheduling_strategy="SPREAD")(attempt)
        self._running: dict[ray.ObjectRef[Any], tuple[int, int]] = {}

    def run(self, workers: int | None) -> Generator[Done[R], None, None]:
        try:
            while self._pending or self._running:
                while self._pending and len(self._running) < (workers or self._cores()):
                    yield from self._begin(*self._pending.take())
                if self._running:
                    finished, _ = self._ray.wait(list(self._running), num_returns=1)
                    yield from self._finish(finished[0])
        finally:
            for task in self._running:
                self._ray.cancel(task, force=True)

    def _cores(self) -> int:
        """Cores of the cluster as it is now: nodes come and go."""
        return max(1, int(self._ray.cluster_resources().get("CPU", 1)))

    def _begin(self, index: int, tries: int) -> Iterator[Done[R]]:
        try:
            task = self._task.remote(self._work, index, self._jobs[index])
        except Exception as error:
            yield Done(index, None, f"job {index} cannot be sent to a worker: {reason(error)}")
            return
        self._running[task] = index, tries + 1

    def _finish(self, task: ray.ObjectRef[Any]) -> Iterator[Done[R]]:
        index, tries = self._running.pop(task)
        try:
            yield self._ray.get(task)
        except self._ray.exceptions.RayTaskError as error:
            yield Done(index, None, f"job {index} cannot travel between processes: {reason(error.cause or error)}")
        except self._ray.exceptions.RayError as error:
            yield from self._pending.lose(index, tries, f"{type(error).__name__}: {reason(error)}"[:300])


@contextlib.contextmanager
def _cluster() -> Iterator[None]:
    """Join a cluster or start one, quietly; leave what we joined."""
    with _environment(_RAY_ENVIRONMENT):
        import ray
    if ray.is_initialized():
        yield
        return
    address = os.environ.get("RAY_ADDRESS", "")
    try:
        _check_address(address)
        with _environment(_RAY_ENVIRONMENT):
            ray.init(include_dashboard=False, log_to_driver=False, logging_level=logging.ERROR)
    except (ray.exceptions.RayError, OSError, RuntimeError, ValueError) as error:
        problem = f"RAY_ADDRESS must name a running Ray cluster, got {address}" if address else "Ray cannot start here"
        raise OSError(f"{problem} ({reason(error)}); start one with ray start --head, or unset RAY_ADDRESS") from error
    try:
        yield
    finally:
        ray.shutdown()


def _check_address(address: str) -> None:
    """Raise an OSError soon if nobody listens at ``host:port``; Ray would try for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if host and port.isdigit():
        socket.create_connection((host.strip("[]"), int(port)), timeout=_CONNECT_S).close()


@contextlib.contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    """Set variables that are not set, and take them back."""
    added = {name: value for name, value in values.items() if name not in os.environ}
    os.environ.update(added)
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]


ENGINES: dict[str, Callable[[int | None], Engine]] = {
    "local": LocalEngine,
    "ray": RayEngine,
}
"""From a name to a function that makes the engine for a number of workers; None is one for each core."""


def engine_named(name: str, workers: int | None = None) -> Engine:
    """Return the engine with this name, for so many workers; None is one for each core of the machine or the cluster.

    Raises:
        ValueError: there is no such engine, or ``workers`` is below 1.
        ImportError: the engine needs an extra that is not installed.
    """
    if name not in ENGINES:
        raise ValueError(f"engine must be one of {', '.join(ENGINES)}, got {name!r}")
    return ENGINES[name](workers)
