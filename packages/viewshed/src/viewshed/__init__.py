"""viewshed: what can this LiDAR see, how sure are we, and is someone lying about it?

>>> import numpy as np, viewshed
>>> sweep = viewshed.Sweep(points=np.zeros((0, 3), np.float32))
>>> viewshed.estimate(sweep, method="shadow_map").visible().any()
np.False_
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from viewshed import _core, _moved, _outputs
from viewshed._extras import needed_for, plugin, plugins

if TYPE_CHECKING:
    from viewshed.estimators import ESTIMATORS, estimate, load_estimator
    from viewshed.fov.estimate import CellState, FovEstimate, FovEstimator
    from viewshed.fov.score import score
    from viewshed.fov.truth import Truth
    from viewshed.fov.visibility import CAR, PEDESTRIAN, Target
    from viewshed.geometry import Rigid
    from viewshed.grid import GRIDS, BevGrid
    from viewshed.io import read_sweep, write_sweep
    from viewshed.recordings.recording import open_recording
    from viewshed.sensors import LidarModel, lidar_model
    from viewshed.sweep import Sweep

__version__ = "0.4.0"

if __version__ != _core.VERSION:
    raise ImportError(
        f"viewshed's native core must be of version {__version__}, got {_core.VERSION};"
        " reinstall viewshed (in a checkout: pip install packages/viewshed)"
    )

_HOMES = {
    # what most users need, in data-flow order
    "read_sweep": "io", "open_recording": "recordings.recording", "Sweep": "sweep",
    "estimate": "estimators", "load_estimator": "estimators",
    "FovEstimate": "fov.estimate", "CellState": "fov.estimate",
    "Truth": "fov.truth", "score": "fov.score",
    # values and tables behind them
    "BevGrid": "grid", "GRIDS": "grid", "Target": "fov.visibility", "CAR": "fov.visibility",
    "PEDESTRIAN": "fov.visibility", "LidarModel": "sensors", "lidar_model": "sensors", "Rigid": "geometry",
    "ESTIMATORS": "estimators", "FovEstimator": "fov.estimate", "write_sweep": "io",
}  # fmt: skip

_LAB_NAMES = ("Archive", "Sample", "WORLDS", "attacks")

__all__ = [
    "CAR", "ESTIMATORS", "GRIDS", "PEDESTRIAN", "BevGrid", "CellState", "FovEstimate", "FovEstimator", "LidarModel",
    "Rigid", "Sweep", "Target", "Truth", "estimate", "lidar_model", "load_estimator", "open_recording", "read_sweep",
    "score", "write_sweep",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import a public name on first use, to keep ``import viewshed`` fast."""
    if name in _LAB_NAMES:
        with needed_for(f"viewshed.{name}"):
            return plugin("names", name, f"viewshed.{name}")
    if name not in _HOMES:
        raise AttributeError(f"module 'viewshed' has no attribute {name!r}")
    with needed_for(f"viewshed.{name}"):
        return getattr(import_module(f"viewshed.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*__all__, *plugins("names"), "__version__"])


def _lazy(module: str, name: str) -> Any:
    """Return a function that imports ``viewshed.MODULE.NAME`` when called, and calls it."""

    def call(*arguments: Any) -> Any:
        return getattr(import_module(f"viewshed.{module}"), name)(*arguments)

    return call


_outputs.save, _outputs.draw = _lazy("io.export", "save_estimate"), _lazy("show.plot", "draw_estimate")

_moved.install()
