"""Sweeps to attack: simulated scenes, and one computed by hand on flat ground."""

from collections.abc import Callable

import numpy as np
import pytest
from tests.threats.attacks.oracle import Scene, scenes

from viewshed import LidarModel, Sweep
from viewshed.geometry import Rigid

SENSOR_M = 1.8
MODEL = LidarModel("by hand", np.deg2rad(np.linspace(-24.0, 3.0, 28)), 720, max_range_m=80.0)
FlatScene = Callable[..., Sweep]


def flat(wall_x_m: float = np.inf, pose: Rigid | None = None, wall_y_m: tuple[float, float] = (-4.0, 6.0)) -> Sweep:
    """Return a sweep of flat ground 1.8 m below the sensor and a 2.5 m wall at ``wall_x_m``, y from -4 to 6 m."""
    azimuth = -np.pi + (np.repeat(np.arange(720), 28) + 0.5) * MODEL.azimuth_step
    ring = np.tile(np.arange(28), 720)
    slope = np.tan(MODEL.elevation)[ring]
    way = np.stack([np.cos(azimuth), np.sin(azimuth), slope], axis=1)
    range_m = np.where(slope < 0, -SENSOR_M / np.minimum(slope, -1e-9), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        at_wall = wall_x_m / way[:, 0]
        y, z = at_wall * way[:, 1], at_wall * way[:, 2]
        hit = (at_wall > 0) & (at_wall < range_m) & (y > wall_y_m[0]) & (y < wall_y_m[1]) & (z < 2.5 - SENSOR_M)
    range_m = np.where(hit, at_wall, range_m)
    seen = range_m < 60.0
    points = (way[seen] * range_m[seen, None]).astype(np.float32)
    intensity = np.random.default_rng(0).integers(1, 200, len(points)).astype(np.float32)
    return Sweep(
        points, intensity=intensity, ring=ring[seen].astype(np.int16), sensor_height_m=SENSOR_M, model=MODEL,
        world_from_sensor=Rigid(np.eye(3), np.array([0.0, 0.0, SENSOR_M])) if pose is None else pose, t_ns=0,
    )  # fmt: skip


@pytest.fixture(scope="session")
def flat_scene() -> FlatScene:
    """Return the function that makes a sweep of flat ground, with or without a wall ahead."""
    return flat


@pytest.fixture(scope="session")
def simulated() -> list[Scene]:
    """Ten small simulated scenes: sensors on vehicles, robots and masts, at rest and in motion."""
    return scenes()


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator with a fixed seed."""
    return np.random.Generator(np.random.PCG64(5))
