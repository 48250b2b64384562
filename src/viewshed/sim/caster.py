"""Exact nearest hits of a sensor's beams: every solid is convex, so a beam is inside it between two depths."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from viewshed.geometry import rotation_from_quaternion
from viewshed.sensors import LidarModel
from viewshed.sim.scene import Box, Cylinder, Scene
from viewshed.sweep import Sweep

Array = NDArray[np.float64]
NOISE_M = 0.015
"""Standard deviation of a measured range, typical of a mechanical sensor."""


class _Rays(NamedTuple):
    origins: tuple[Array, Array, Array]
    directions: tuple[Array, Array, Array]


def depth_image(
    model: LidarModel, scene: Scene, sensor_height_m: float, attitude: ArrayLike = (1.0, 0.0, 0.0, 0.0)
) -> Array:
    """Return (rings, azimuth_columns) metres from each beam's origin to its first hit; inf where it hits nothing.

    Column c fires at azimuth -π + c · ``model.azimuth_step``. ``attitude`` is ``level_from_sensor`` (w, x, y, z).

    >>> model = LidarModel("one", np.deg2rad([-30.0]), azimuth_columns=4)
    >>> depth_image(model, Scene(), sensor_height_m=2.0).round(6).tolist()
    [[4.0, 4.0, 4.0, 4.0]]
    """
    rotation = rotation_from_quaternion(attitude)
    starts, directions = _beams(model)
    level_starts = starts @ rotation.T + [0.0, 0.0, sensor_height_m]
    level_directions = directions @ rotation.T
    rays = _Rays(_split(np.broadcast_to(level_starts, directions.shape)), _split(level_directions))
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = _ground_depth(rays, scene)
        solids: tuple[Box | Cylinder, ...] = (*scene.boxes, *scene.cylinders)
        for solid in solids:
            np.minimum(depth, _solid_depth(rays, solid, scene.ground_m(solid.x_m, solid.y_m)), out=depth)
    return depth


def cast(
    model: LidarModel,
    scene: Scene,
    sensor_height_m: float,
    attitude: ArrayLike = (1.0, 0.0, 0.0, 0.0),
    rng: np.random.Generator | None = None,
) -> Sweep:
    """Return the sweep that ``model`` would measure, with ring and firing azimuth; beams without a return are left out.

    With ``rng`` the ranges have normal noise of :data:`NOISE_M`; without it they are exact.
    """
    depth = depth_image(model, scene, sensor_height_m, attitude)
    returned = (depth >= model.min_range_m) & (depth <= model.max_range_m)
    ring, column = np.nonzero(returned)
    measured = depth[returned] + (0.0 if rng is None else rng.normal(0.0, NOISE_M, len(ring)))
    starts, directions = _beams(model)
    return Sweep(
        points=(starts[ring, 0] + directions[ring, column] * measured[:, None]).astype(np.float32),
        ring=ring.astype(np.int16),
        azimuth=_firing_azimuth(model)[column].astype(np.float32),
        attitude=np.asarray(attitude, dtype=np.float64),
        sensor_height_m=sensor_height_m,
        model=model,
    )


def _firing_azimuth(model: LidarModel) -> Array:
    return np.linspace(-np.pi, np.pi, model.azimuth_columns, endpoint=False)


def _beams(model: LidarModel) -> tuple[Array, Array]:
    """Origins (rings, 1, 3) and unit directions (rings, columns, 3) of the beams in the sensor's frame."""
    azimuth = _firing_azimuth(model) + np.asarray(model.azimuth_offset)[:, None]
    elevation = np.broadcast_to(model.elevation[:, None], azimuth.shape)
    flat = np.cos(elevation)
    directions = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)
    origins = np.zeros((model.rings, 1, 3))
    origins[:, 0, 2] = model.origin_m
    return origins, directions


def _split(vectors: Array) -> tuple[Array, Array, Array]:
    return vectors[..., 0], vectors[..., 1], vectors[..., 2]


def _ground_depth(rays: _Rays, scene: Scene) -> Array:
    (x, y, z), (dx, dy, dz) = rays
    a, b = scene.slope
    depth = (a * x + b * y - z) / (dz - a * dx - b * dy)
    return np.where(depth > 0, depth, np.inf)


def _solid_depth(rays: _Rays, solid: Box | Cylinder, ground_m: float) -> Array:
    near, far = _box_interval(rays, solid) if isinstance(solid, Box) else _cylinder_interval(rays, solid)
    low, high = _slab(rays.origins[2], rays.directions[2], ground_m + solid.bottom_m, ground_m + solid.top_m)
    enter, leave = np.maximum(near, low), np.minimum(far, high)
    return np.where((enter <= leave) & (enter > 0), enter, np.inf)


def _slab(start: Array, direction: Array, low_m: float, high_m: float) -> tuple[Array, Array]:
    """Depths at which a beam enters and leaves low ≤ coordinate ≤ high."""
    first, second = (low_m - start) / direction, (high_m - start) / direction
    return np.fmin(first, second), np.fmax(first, second)


def _box_interval(rays: _Rays, box: Box) -> tuple[Array, Array]:
    (x, y, _), (dx, dy, _) = rays
    c, s = np.cos(box.yaw), np.sin(box.yaw)
    x, y = x - box.x_m, y - box.y_m
    near_u, far_u = _slab(c * x + s * y, c * dx + s * dy, -box.length_m / 2, box.length_m / 2)
    near_v, far_v = _slab(c * y - s * x, c * dy - s * dx, -box.width_m / 2, box.width_m / 2)
    return np.maximum(near_u, near_v), np.minimum(far_u, far_v)


def _cylinder_interval(rays: _Rays, cylinder: Cylinder) -> tuple[Array, Array]:
    """Roots of |o + t d|² = r² in the plane; none gives an empty interval."""
    (x, y, _), (dx, dy, _) = rays
    x, y = x - cylinder.x_m, y - cylinder.y_m
    a, half_b = dx * dx + dy * dy, x * dx + y * dy
    root = np.sqrt(half_b**2 - a * (x * x + y * y - cylinder.radius_m**2))
    return np.nan_to_num((-half_b - root) / a, nan=np.inf), np.nan_to_num((-half_b + root) / a, nan=-np.inf)
