"""Processes of this machine."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess

from viewshed.engines.role import TRIES, Done, J, R, attempt, check_workers, reason

_GRACE_S = 2.0  # for a worker to remove what it has half written


@dataclass(frozen=True, slots=True)
class LocalEngine:
    """Runs jobs in ``workers`` processes, None is one for each core; with one worker in this process, without any.

    Processes are spawned, so a script must call it below ``if __name__ == "__main__":``. Ctrl-C or closing the iterator
    ends them, and they end by themselves soon after this process is gone.

    Raises:
        ValueError: ``workers`` is below 1.
    """

    workers: int | None = None

    def __post_init__(self) -> None:
        check_workers(self.workers)

    def run(self, work: Callable[[J], R], jobs: Sequence[J]) -> Generator[Done[R], None, None]:
        """Yield one ``Done`` for every job as they finish; see :class:`viewshed.engines.Engine`.

        Raises:
            OSError: workers cannot start.
        """
        workers = cores() if self.workers is None else self.workers
        if workers == 1:
            return (attempt(work, index, job) for index, job in enumerate(jobs))
        return _Pool(pickle.dumps(work), min(workers, len(jobs))).run(jobs)


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


@dataclass(slots=True, eq=False)
class _Worker:
    """One process, the pipe to it and the job that it has."""

    process: SpawnProcess
    pipe: Connection
    ready: bool = False
    index: int | None = None
    tries: int = 0


@dataclass(slots=True, eq=False)
class _Pool:
    """The workers of one run, and what is left to do."""

    work: bytes
    size: int
    workers: list[_Worker] = field(default_factory=list)
    again: list[tuple[int, int]] = field(default_factory=list)  # job, tries
    next_job: int = 0
    failed_starts: int = 0

    def run(self, jobs: Sequence[J]) -> Generator[Done[R], None, None]:
        try:
            self.workers.extend(_start(self.work) for _ in range(self.size))
            while self.again or self.next_job < len(jobs) or any(worker.index is not None for worker in self.workers):
                for worker in self._signalled():
                    yield from self._heard(worker, jobs)
        finally:
            _stop(self.workers)

    def _signalled(self) -> list[_Worker]:
        ready = set(wait([worker.pipe for worker in self.workers]))
        return [worker for worker in self.workers if worker.pipe in ready]

    def _heard(self, worker: _Worker, jobs: Sequence[J]) -> Iterator[Done[R]]:
        """Take what a worker says (that it is ready, or a job done) and give it the next job."""
        try:
            done: Done[R] | None = pickle.loads(worker.pipe.recv_bytes())  # noqa: S301 - from our own process
        except (EOFError, OSError):
            yield from self._replaced(worker)
            return
        worker.ready, worker.index = True, None
        self.failed_starts = 0
        if done is not None:
            yield done
        yield from self._next(worker, jobs)

    def _next(self, worker: _Worker, jobs: Sequence[J]) -> Iterator[Done[R]]:
        while worker.index is None and (self.again or self.next_job < len(jobs)):
            index, tries = self.again.pop() if self.again else (self.next_job, 0)
            self.next_job = max(self.next_job, index + 1)
            try:
                message = pickle.dumps((index, jobs[index]))
            except Exception as error:
                yield Done(index, None, f"job {index} cannot be sent to a worker: {reason(error)}")
                continue
            worker.index, worker.tries = index, tries + 1
            with contextlib.suppress(OSError):  # it is dead: seen when we next listen
                worker.pipe.send_bytes(message)

    def _replaced(self, worker: _Worker) -> Iterator[Done[R]]:
        worker.process.join()
        worker.pipe.close()
        self.workers.remove(worker)
        end = _end(worker.process.exitcode)
        if not worker.ready:
            self.failed_starts += 1
        if self.failed_starts >= TRIES:
            raise OSError(
                f"a worker process must start, got {end} {TRIES} times; call the engine below"
                ' if __name__ == "__main__":, give it more memory, or use 1 worker'
            )
        if worker.index is not None and worker.tries < TRIES:
            self.again.append((worker.index, worker.tries))
        elif worker.index is not None:
            yield Done(worker.index, None, f"the worker died {TRIES} times over this job, at last with {end}")
        self.workers.append(_start(self.work))


def _end(exitcode: int | None) -> str:
    if exitcode is None or exitcode >= 0:
        return f"exit status {exitcode}"
    hint = " (out of memory?)" if -exitcode == signal.SIGKILL else ""
    return f"signal {-exitcode}{hint}"


def _start(work: bytes) -> _Worker:
    """Start a worker that never hears Ctrl-C: that is for its parent, who ends it."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs, work), daemon=True)
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


def _serve(pipe: Connection, work: bytes) -> None:
    """Do jobs until there are no more, in a process of its own."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that half-written files are removed
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with contextlib.suppress(EOFError, OSError):
        pipe.send_bytes(pickle.dumps(None))
        while True:
            pipe.send_bytes(_answer(work, pipe.recv_bytes()))
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # nothing is half-written now, and to raise while ending is noise


def _answer(work: bytes, message: bytes) -> bytes:
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
