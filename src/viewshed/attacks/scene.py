"""What an attacker knows of the scene: level frame, ground and obstacles, as the victim's own sweep tells them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.attacks.rays import Rays
from viewshed.bev import GRIDS
from viewshed.level import OBSTACLE_HEIGHTS_M, LevelSweep, level_sweep
from viewshed.sweep import Sweep

Floats = NDArray[np.float64]
_NEAR_M, _NEAR_SHARE = 25.0, 0.01
_ROUNDS = 4


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """A box on the ground, in the level frame.

    Attributes:
        center: (x, y) of its middle, metres.
        heading: yaw of its length, radians.
        size_m: length, width, height.
        ground_m: z of its lower side.
    """

    center: tuple[float, float]
    heading: float
    size_m: tuple[float, float, float]
    ground_m: float


@lru_cache(maxsize=2)
def scene_of(sweep: Sweep) -> LevelSweep:
    """Return ``sweep`` levelled over the extent that it fills: indoors where hardly anything lies beyond 25 m."""
    x, y, _ = sweep.points.T
    far = np.count_nonzero(x * x + y * y > _NEAR_M**2)
    return level_sweep(sweep, GRIDS["road" if far > _NEAR_SHARE * len(sweep) else "indoor"])


def heights_m(sweep: Sweep) -> NDArray[np.float32]:
    """Return the height (N,) in metres of each return above local ground; NaN for ego and null returns."""
    level = scene_of(sweep)
    heights = np.full(len(sweep), np.nan, np.float32)
    heights[level.rows] = level.height_m
    return heights


def is_obstacle(sweep: Sweep, rays: Rays) -> NDArray[np.bool_]:
    """Return which rays (K,) returned from more than 0.3 m above local ground."""
    heights = np.append(heights_m(sweep), np.float32(np.nan))[rays.row]
    found: NDArray[np.bool_] = heights > OBSTACLE_HEIGHTS_M[0]
    return found


def azimuth_of_obstacle(sweep: Sweep, near_m: float, far_m: float, rng: np.random.Generator) -> float | None:
    """Return the azimuth, in the sensor's frame, of a return of an obstacle drawn at random; None without any."""
    level = scene_of(sweep)
    low, high = OBSTACLE_HEIGHTS_M
    fits = (level.height_m > low) & (level.height_m < high) & (level.range_m > near_m) & (level.range_m < far_m)
    rows = level.rows[fits]
    if len(rows) == 0:
        return None
    x, y, _ = sweep.points[rows[rng.integers(len(rows))]].astype(np.float64)
    return float(np.arctan2(y, x))


def drawn_azimuth(azimuth: float | None, rng: np.random.Generator) -> float:
    """Return ``azimuth``, or one drawn at random where it is None."""
    return float(rng.uniform(-np.pi, np.pi)) if azimuth is None else azimuth


def open_azimuth(sweep: Sweep, range_m: float, rng: np.random.Generator) -> float:
    """Return the azimuth of a return drawn among those beyond ``range_m``, where a ghost can be seen; else any."""
    level = scene_of(sweep)
    rows = level.rows[level.range_m > range_m]
    if len(rows) == 0:
        return drawn_azimuth(None, rng)
    x, y, _ = sweep.points[rows[rng.integers(len(rows))]].astype(np.float64)
    return float(np.arctan2(y, x))


def level_rays(sweep: Sweep, rays: Rays) -> tuple[Floats, Floats]:
    """Return starts (K, 3) in metres and directions (K, 3) in the level frame, the ground below the sensor at z = 0."""
    to_level = scene_of(sweep).level_from_sensor
    return to_level @ rays.start_m, rays.direction @ to_level.rotation.T


def ahead(sweep: Sweep, azimuth: float, range_m: float) -> tuple[float, float, float]:
    """Return the place (x, y) in the level frame at an azimuth of the sensor and a range, and its level azimuth."""
    rotation = scene_of(sweep).level_from_sensor.rotation
    x, y, _ = rotation @ np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    level_azimuth = float(np.arctan2(y, x))
    return range_m * np.cos(level_azimuth), range_m * np.sin(level_azimuth), level_azimuth


def ground_at(sweep: Sweep, x_m: float, y_m: float) -> float:
    """Return z of the ground at a place in the level frame, in metres."""
    return float(scene_of(sweep).ground.at(np.array([[x_m, y_m]]))[0])


def to_sensor(sweep: Sweep, points: NDArray[Any]) -> Floats:
    """Return points (A, 3) of the level frame in the sensor's frame."""
    return scene_of(sweep).level_from_sensor.inverse() @ points


def street_depth_m(sweep: Sweep, rays: Rays, wall_m: float) -> Floats:
    """Return how far the rays (K,) would go on an empty street with a wall at range ``wall_m`` at its end.

    To the ground, found by iteration on its height, or to the wall, whichever is nearer.
    """
    ground = scene_of(sweep).ground
    start, way = level_rays(sweep, rays)
    flat = np.maximum(np.hypot(way[:, 0], way[:, 1]), 1e-6)
    wall = wall_m / flat
    down = way[:, 2] < -1e-4
    depth = wall.copy()
    for _ in range(_ROUNDS):
        below = ground.at(start[:, :2] + depth[:, None] * way[:, :2]).astype(np.float64)
        depth = np.where(down, np.clip((below - start[:, 2]) / np.minimum(way[:, 2], -1e-4), 0.0, wall), wall)
    return depth


def chord_m(start: Floats, way: Floats, box: Box) -> tuple[Floats, Floats]:
    """Return the depths (K,) in metres at which rays (K, 3) enter and leave a box; +inf and -inf where they miss it.

    By slabs (Kay and Kajiya 1986).
    """
    c, s = np.cos(box.heading), np.sin(box.heading)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    middle = np.array([*box.center, box.ground_m + box.size_m[2] / 2])
    start, way = (start - middle) @ turn.T, way @ turn.T
    way = np.where(np.abs(way) < 1e-12, 1e-12, way)
    half = np.array(box.size_m) / 2
    first, second = (-half - start) / way, (half - start) / way
    enter, leave = np.minimum(first, second).max(axis=1), np.maximum(first, second).min(axis=1)
    hit = (enter > 0.0) & (enter <= leave)
    return np.where(hit, enter, np.inf), np.where(hit, leave, -np.inf)
