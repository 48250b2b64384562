"""Machines of a Ray cluster."""

from __future__ import annotations

import contextlib
import importlib.util
import logging
import os
import socket
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from viewshed.engines.role import TRIES, Done, J, R, attempt, check_workers, reason

if TYPE_CHECKING:
    import ray

_CONNECT_S = 10.0
_QUIET = {
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
        check_workers(self.workers)
        if importlib.util.find_spec("ray") is None:
            raise ImportError("engine ray needs Ray, which is not installed; pip install 'viewshed[ray]'")

    def run(self, work: Callable[[J], R], jobs: Sequence[J]) -> Generator[Done[R], None, None]:
        """Yield one ``Done`` for every job as they finish; see :class:`viewshed.engines.Engine`.

        Raises:
            OSError: the cluster cannot be reached or started.
        """
        with _cluster():
            yield from _Tasks(work, jobs).run(self.workers)


class _Tasks:
    """The tasks of one run: which are under way and what is left to do."""

    def __init__(self, work: Callable[[J], R], jobs: Sequence[J]) -> None:
        import ray

        self._ray = ray
        self._jobs = jobs
        self._work = ray.put(work)
        # We begin lost tasks again ourselves: Ray would do so without end for those that run out of memory.
        self._task: Any = ray.remote(num_cpus=1, max_retries=0, scheduling_strategy="SPREAD")(attempt)
        self._under_way: dict[ray.ObjectRef[Any], tuple[int, int]] = {}

    def run(self, workers: int | None) -> Generator[Done[R], None, None]:
        indices = iter(range(len(self._jobs)))
        try:
            while True:
                while len(self._under_way) < (workers or self._cores()) and (index := next(indices, None)) is not None:
                    yield from self._begin(index, 1)
                if not self._under_way:
                    return
                finished, _ = self._ray.wait(list(self._under_way), num_returns=1)
                yield from self._finish(finished[0])
        finally:
            for task in self._under_way:
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
        self._under_way[task] = index, tries

    def _finish(self, task: ray.ObjectRef[Any]) -> Iterator[Done[R]]:
        index, tries = self._under_way.pop(task)
        try:
            yield self._ray.get(task)
        except self._ray.exceptions.RayTaskError as error:
            yield Done(index, None, f"job {index} cannot travel between processes: {reason(error.cause or error)}")
        except self._ray.exceptions.RayError as error:
            if tries < TRIES:
                yield from self._begin(index, tries + 1)
            else:
                lost = f"{type(error).__name__}: {reason(error)}"[:300]
                yield Done(index, None, f"the worker died {TRIES} times over this job, at last with {lost}")


@contextlib.contextmanager
def _cluster() -> Iterator[None]:
    """Join a cluster or start one, quietly; leave what we joined."""
    with _environment(_QUIET):
        import ray
    if ray.is_initialized():
        yield
        return
    address = os.environ.get("RAY_ADDRESS", "")
    try:
        _reach(address)
        with _environment(_QUIET):
            ray.init(include_dashboard=False, log_to_driver=False, logging_level=logging.ERROR)
    except (ray.exceptions.RayError, OSError, RuntimeError, ValueError) as error:
        told = f"RAY_ADDRESS must name a running Ray cluster, got {address}" if address else "Ray cannot start here"
        raise OSError(f"{told} ({reason(error)}); start one with ray start --head, or unset RAY_ADDRESS") from error
    try:
        yield
    finally:
        ray.shutdown()


def _reach(address: str) -> None:
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
