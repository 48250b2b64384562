"""A toy sensor over a small grid, random walls in front of it, and attacks on its measurements."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.visibility import CAR
from viewshed.grid import BevGrid
from viewshed.guarantees.envelope import Envelope, Given
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep

GRID = BevGrid(24, 12.0)
TOY = LidarModel("toy", np.deg2rad([-24.0, -17.0, -12.0, -8.5, -6.0, -4.0, -2.0, 1.0]), 90)
HEIGHT_M = 1.7


def directions(model: LidarModel = TOY) -> NDArray[Any]:
    """Return unit directions (columns, rings, 3) of the beams, in the middle of their columns."""
    azimuth = (np.arange(model.azimuth_columns) + 0.5) / model.azimuth_columns * 2 * np.pi - np.pi
    a, e = np.meshgrid(azimuth, model.elevation, indexing="ij")
    return np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1)


def scene(rng: np.random.Generator, model: LidarModel = TOY) -> NDArray[Any]:
    """Return ranges (columns, rings) along the beams over flat ground with walls of random height; +inf for none."""
    d = directions(model)
    ground = np.where(d[..., 2] < 0, -HEIGHT_M / np.minimum(d[..., 2], -1e-9), np.inf)
    depth = np.where(ground < 30.0, ground, np.inf)
    azimuth = np.arctan2(d[:, 0, 1], d[:, 0, 0])
    for _ in range(rng.integers(1, 5)):
        middle, half = rng.uniform(-np.pi, np.pi), rng.uniform(0.05, 0.6)
        range_m, top_m = rng.uniform(2.0, 11.0), rng.uniform(0.4, 2.5)
        inside = np.abs((azimuth - middle + np.pi) % (2 * np.pi) - np.pi) < half
        along = range_m / np.hypot(d[..., 0], d[..., 1])
        stops = inside[:, None] & (HEIGHT_M + along * d[..., 2] < top_m) & (along < depth)
        depth = np.where(stops, along, depth)
    return np.where(rng.random(depth.shape) < rng.uniform(0.0, 0.3), np.inf, depth)


def sweep_of(depth: NDArray[Any], added: NDArray[Any] | None = None, **more: Any) -> Sweep:
    """Return the sweep of ranges (columns, rings), with ``added`` points."""
    hit = np.isfinite(depth)
    points = (directions(more.get("model") or TOY) * np.where(hit, depth, 0.0)[..., None])[hit]
    points = points if added is None else np.concatenate([points, added])
    known: dict[str, Any] = {"model": TOY, "sensor_height_m": HEIGHT_M, "attitude": np.array([1.0, 0.0, 0.0, 0.0])}
    return Sweep(points.astype(np.float32), **(known | more))


def leveled(sweep: Sweep) -> LeveledSweep:
    return level(sweep, GRID)


def envelope(sweep: Sweep, grade: float = 0.0) -> Envelope:
    """Return the envelope for a car, on flat ground unless a slope is allowed."""
    one = leveled(sweep)
    return Envelope.of(one, Given.of(one, grade=grade), GRID, CAR)


def attacked(rng: np.random.Generator, depth: NDArray[Any], beams: NDArray[Any]) -> Sweep:
    """Return the sweep with new or lost returns at the ``beams`` (K, 2: column, ring), and random added points."""
    depth = depth.copy()
    depth[beams[:, 0], beams[:, 1]] = np.where(rng.random(len(beams)) < 0.5, np.inf, rng.uniform(0.6, 80.0, len(beams)))
    added = rng.normal(0.0, 6.0, (rng.integers(0, 40), 3)) if rng.random() < 0.7 else None
    return sweep_of(depth, added)
