"""Random beam tables of nonexistent sensors, and clouds of sensors that do not spin."""

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F32
from viewshed.sensors import LidarModel
from viewshed_lab.sim import Box, Cylinder, Scene
from viewshed_lab.sim.scene import junction


def random_sensor(rng: np.random.Generator) -> LidarModel:
    """Return a spinning sensor of 8 to 128 rings, evenly or unevenly spaced, with its own calibration."""
    rings = int(rng.integers(8, 129))
    low_deg, high_deg = rng.uniform(-45.0, -12.0), rng.uniform(2.0, 35.0)
    spread = {
        "even": np.full(rings - 1, 1.0),
        "dense": 1.0 + 6.0 * np.abs(np.linspace(-1.0, 1.0, rings - 1)) ** 2,
        "random": rng.uniform(0.3, 1.7, rings - 1),
    }[str(rng.choice(["even", "dense", "random"]))]
    # Beams stand at least 0.15 degrees apart; the calibration moves each by up to a quarter of its gap.
    gaps = np.maximum(spread / spread.sum() * (high_deg - low_deg), 0.15)
    elevation = low_deg + np.append(0.0, np.cumsum(gaps))
    elevation[1:-1] += rng.uniform(-0.25, 0.25, rings - 2) * np.minimum(gaps[1:], gaps[:-1])
    columns = int(rng.choice([600, 900, 1024, 1800, 2048]))
    columns = min(columns, max(360, 90_000 // rings))
    return LidarModel(
        "nobody's", np.deg2rad(np.clip(elevation, -80, 80)), columns,
        origin_m=np.full(rings, float(rng.choice([0.0, 0.0, 0.036, -0.05, 0.12]))),
        max_range_m=float(rng.uniform(60, 150)),
    )  # fmt: skip


def random_scene(rng: np.random.Generator) -> Scene:
    """Return a street with houses and cars, a hall, or the junction."""
    kind = rng.choice(["junction", "street", "hall"])
    if kind == "junction":
        return junction()
    if kind == "hall":
        a, b = rng.uniform(5.0, 25.0, 2)
        walls = (Box(a, 0, 0.3, 60, 6), Box(-b, 0, 0.3, 60, 6), Box(0, a + 3, 60, 0.3, 6), Box(0, -b - 2, 60, 0.3, 6))
        return Scene(
            walls, tuple(Cylinder(float(rng.uniform(-12, 12)), float(rng.uniform(-12, 12)), 0.4, 2.5) for _ in range(8))
        )
    boxes = [Box(float(x), side * rng.uniform(9, 16), rng.uniform(6, 20), 8, rng.uniform(4, 14))
             for side in (-1, 1) for x in np.arange(-70, 71, 22)]  # fmt: skip
    boxes += [Box(float(rng.uniform(6, 50)), float(rng.uniform(-6, 6)), 4.2, 1.8, 1.5) for _ in range(6)]
    return Scene(tuple(boxes), ())


def rosette(rng: np.random.Generator, count: int = 24_000) -> F32:
    """Return points of a sensor whose pattern does not repeat: 70 degrees wide, directions that form no rings."""
    t = np.arange(count) * 1e-5
    radius = np.deg2rad(35.0) * np.abs(np.sin(2 * np.pi * 312.7 * t))
    angle = 2 * np.pi * 187.31 * t
    azimuth, elevation = radius * np.cos(angle), radius * np.sin(angle) * 0.7
    range_m = np.where(
        elevation < -0.05, np.minimum(1.8 / np.maximum(np.tan(-elevation), 1e-3), 60.0), rng.uniform(5, 60, count)
    )
    direction = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=1
    )
    return (direction * range_m[:, None]).astype(np.float32)


def right_share(inferred: NDArray[np.int16], truth: NDArray[np.int16]) -> float:
    """Return the share of returns in the right ring; inferred and true rings are matched one to one."""
    together = np.zeros((int(inferred.max()) + 2, int(truth.max()) + 1), np.int64)
    np.add.at(together, (inferred + 1, truth), 1)
    stands_for, stood_by = together[1:].argmax(axis=1), together[1:].argmax(axis=0)
    right = (inferred >= 0) & (stands_for[np.maximum(inferred, 0)] == truth) & (stood_by[truth] == inferred)
    return float(right.mean())
