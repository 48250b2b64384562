"""Sweeps whose returns are known by hand: a sensor of sixteen rings on flat ground, with whatever is put around it."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from viewshed import BevGrid, Sweep
from viewshed.arrays import F64
from viewshed.monitor.evidence import MonitoredSweep
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sensors import LidarModel

HEIGHT_M, FAR_M = 1.8, 40.0
COLUMNS, RINGS = 720, 16
ELEVATION = np.deg2rad(np.linspace(-20.0, 10.0, RINGS))
MODEL = LidarModel("by hand", ELEVATION, COLUMNS, max_range_m=100.0)
GRID = BevGrid(128, 64.0)
GROUND_RINGS = 9
"""The lowest rings meet the ground before the wall that stands 40 m away all around."""


def street() -> F64:
    """Return the ranges (RINGS, COLUMNS) in meters of flat ground with a round wall at 40 m."""
    ground_m = HEIGHT_M / np.maximum(-np.sin(ELEVATION), 1e-9)
    range_m = np.minimum(ground_m, FAR_M / np.cos(ELEVATION))
    return np.repeat(range_m[:, None], COLUMNS, axis=1)


def columns_at(low_deg: float, high_deg: float) -> NDArray[np.bool_]:
    """Return the mask (COLUMNS,) of the columns between two azimuths in degrees; column 0 begins at -180."""
    azimuth = (np.arange(COLUMNS) + 0.5) * 360.0 / COLUMNS - 180.0
    return (azimuth > low_deg) & (azimuth < high_deg)


def wall(range_m: F64, low_deg: float, high_deg: float, distance_m: float, height_m: float = 3.0) -> F64:
    """Return ranges with a round wall put in between two azimuths."""
    at_m = distance_m / np.cos(ELEVATION)
    z = HEIGHT_M + at_m * np.sin(ELEVATION)
    meets = (z > 0.0) & (z < height_m)
    nearer = np.where(meets[:, None] & columns_at(low_deg, high_deg), at_m[:, None], np.inf)
    return np.minimum(range_m, nearer)


def points_at(range_m: F64) -> tuple[NDArray[np.float32], NDArray[np.int16]]:
    """Return points (N, 3) and rings (N,) of ranges (RINGS, COLUMNS), NaN for none, column by column."""
    azimuth = ((np.arange(COLUMNS) + 0.5) * 2 * np.pi / COLUMNS - np.pi)[:, None]
    flat = np.cos(ELEVATION)
    direction = np.stack(
        np.broadcast_arrays(flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(ELEVATION)), axis=-1
    )
    returned = np.isfinite(range_m.T)
    points = (direction * range_m.T[..., None])[returned].astype(np.float32)
    return points, np.broadcast_to(np.arange(RINGS, dtype=np.int16), returned.shape)[returned]


def sweep_of(range_m: F64, more: NDArray[np.floating] | None = None, ring: int = 0) -> Sweep:
    """Return the sweep of ranges (RINGS, COLUMNS), NaN for none, and of more points (K, 3) of one ring."""
    points, rings = points_at(range_m)
    if more is not None:
        points = np.concatenate([points, more.astype(np.float32)])
        rings = np.concatenate([rings, np.full(len(more), ring, np.int16)])
    upright = np.array([1.0, 0.0, 0.0, 0.0])
    return Sweep(points, ring=rings, model=MODEL, attitude=upright, sensor_height_m=HEIGHT_M)


def monitored(sweep: Sweep) -> MonitoredSweep:
    """Return what evidence is handed of a sweep alone."""
    return MonitoredSweep(leveled(sweep))


def leveled(sweep: Sweep) -> LeveledSweep:
    """Return the sweep leveled."""
    return level(sweep, GRID)


def measured(
    measure: Callable[[MonitoredSweep], NDArray[np.float32]], range_m: F64, **more: object
) -> NDArray[np.float32]:
    """Return what evidence measures of the sweep of ranges."""
    return measure(monitored(sweep_of(range_m, **more)))  # type: ignore[arg-type]


def sector_at(degrees: float) -> int:
    """Return the sector of an azimuth in degrees."""
    return int((degrees + 180.0) // 5)
