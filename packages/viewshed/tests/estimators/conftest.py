"""Small scenes with known geometry: a ray caster of ten lines, and level sweeps on flat ground."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed.fov.height_map import HeightMap
from viewshed.geometry import Rigid
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.sweep import Sweep

Box = tuple[float, float, float, float, float]
"""x low, x high, y low, y high, height: a box on flat ground."""
SENSOR_M = 1.8
CastScene = Callable[..., Sweep]
MakeLevel = Callable[..., LeveledSweep]


def _cast(boxes: Sequence[Box] = (), sensor_m: float = SENSOR_M, columns: int = 720, reach_m: float = 60.0) -> Sweep:
    """Return a sweep of the nearest hits of 40 rings by ``columns`` beams, by the slab method."""
    elevation = np.deg2rad(np.linspace(-30.0, 3.0, 40))
    azimuth = (np.arange(columns) + 0.37) * 2 * np.pi / columns - np.pi
    ring, azimuth = np.repeat(np.arange(40), columns), np.tile(azimuth, 40)
    slope = np.tan(elevation)[ring]
    way = np.stack([np.cos(azimuth), np.sin(azimuth), slope], axis=1)
    depth = np.where(slope < 0, -sensor_m / np.minimum(slope, -1e-9), np.inf)
    for x0, x1, y0, y1, top in boxes:
        with np.errstate(divide="ignore"):
            ends = np.stack([(np.array([x0, y0, -sensor_m]) / way), (np.array([x1, y1, top - sensor_m]) / way)])
        enter, leave = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
        depth = np.where((enter > 0) & (enter <= leave), np.minimum(depth, enter), depth)
    hit = depth < reach_m
    points = (way * np.where(hit, depth, 0.0)[:, None])[hit]
    return Sweep(
        points.astype(np.float32), ring=ring[hit].astype(np.int16), sensor_height_m=sensor_m, t_ns=5, agent="a"
    )


def _level(
    points: NDArray[np.float32], azimuth: NDArray[np.float32] | None = None, sensor_m: float = SENSOR_M
) -> LeveledSweep:
    """Return a leveled sweep on flat ground from points in the level frame (z = 0 on the ground)."""
    points = np.ascontiguousarray(points, np.float32).reshape(-1, 3)
    range_m = np.hypot(points[:, 0].astype(np.float64), points[:, 1])
    azimuth = np.arctan2(points[:, 1], points[:, 0]) if azimuth is None else azimuth
    return LeveledSweep(
        Sweep(points - np.array([0, 0, sensor_m], np.float32), sensor_height_m=sensor_m),
        points,
        range_m.astype(np.float32),
        np.asarray(azimuth, np.float32),
        points[:, 2].copy(),
        np.arange(len(points), dtype=np.int32),
        Rigid(np.eye(3), np.array([0.0, 0.0, sensor_m])),
        HeightMap.flat(100.0),
    )


@pytest.fixture(scope="session")
def cast() -> CastScene:
    """Return the function that casts a sweep of boxes on flat ground."""
    return _cast


@pytest.fixture(scope="session")
def make_level() -> MakeLevel:
    """Return the function that makes a leveled sweep from points."""
    return _level


@pytest.fixture(scope="session")
def street() -> Sweep:
    """An asymmetric scene: a wall ahead, a car left of it, a pole behind to the right."""
    return _cast([(10.0, 10.5, -2.0, 6.0, 4.0), (3.0, 5.0, 6.5, 8.5, 1.5), (-7.0, -6.5, -3.5, -3.0, 3.0)])
