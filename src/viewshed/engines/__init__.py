"""Engines: run one function over many jobs, on this machine or on a cluster, with the same results.

A job says all that its work needs (seeds, place, number), so results do not depend on the engine, on the number of
workers or on the order. To add an engine, write a file and add a line to :data:`ENGINES`.
"""

from collections.abc import Callable

from viewshed.engines.local import LocalEngine
from viewshed.engines.ray import RayEngine
from viewshed.engines.role import TRIES, Done, Engine

__all__ = ["ENGINES", "TRIES", "Done", "Engine", "LocalEngine", "RayEngine", "engine_named"]

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
