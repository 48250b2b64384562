"""viewshed: what can this LiDAR see, how sure are we, and is someone lying about it?

>>> import numpy as np, viewshed
>>> sweep = viewshed.Sweep(points=np.zeros((0, 3), np.float32))
>>> viewshed.BevGrid().shape
(256, 256)
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from viewshed.datasets import Archive, Sample
    from viewshed.estimators import ESTIMATORS
    from viewshed.fov.estimate import CellState, FovEstimate, FovEstimator
    from viewshed.fov.truth import Truth
    from viewshed.fov.visibility import CAR, PEDESTRIAN, Target
    from viewshed.geometry import Rigid
    from viewshed.grid import GRIDS, BevGrid
    from viewshed.io import read_sweep, write_sweep
    from viewshed.sensors import LidarModel, lidar_model
    from viewshed.sim.worlds import WORLDS
    from viewshed.sweep import Sweep


__version__ = "0.3.0"

_HOMES = {
    "Rigid": "geometry", "LidarModel": "sensors", "lidar_model": "sensors",
    "read_sweep": "io", "write_sweep": "io", "Sweep": "sweep",
    "BevGrid": "grid", "GRIDS": "grid",
    "Target": "fov.visibility", "CAR": "fov.visibility", "PEDESTRIAN": "fov.visibility",
    "FovEstimate": "fov.estimate", "CellState": "fov.estimate", "FovEstimator": "fov.estimate",
    "ESTIMATORS": "estimators",
    "WORLDS": "sim.worlds", "Truth": "fov.truth", "Sample": "datasets", "Archive": "datasets",
}  # fmt: skip

__all__ = [
    "CAR", "ESTIMATORS", "GRIDS", "PEDESTRIAN", "WORLDS", "Archive", "BevGrid", "CellState", "FovEstimate",
    "FovEstimator", "LidarModel", "Rigid", "Sample", "Sweep", "Target", "Truth", "lidar_model", "read_sweep",
    "write_sweep",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that ``import viewshed`` stays light."""
    if name not in _HOMES:
        raise AttributeError(f"module 'viewshed' has no attribute {name!r}")
    return getattr(import_module(f"viewshed.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
