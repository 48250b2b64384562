"""From a sweep to what every geometric estimator starts from: level points, their heights above local ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed import level_kernels as kernels
from viewshed.bev import BevGrid
from viewshed.geometry import Rigid, rotation_from_quaternion
from viewshed.ground import NODES, Ground, estimate_ground
from viewshed.inference import NOTHING_TOLD, Told, told_rings
from viewshed.level_kernels import EGO_BOX_M, EGO_HEIGHTS_M
from viewshed.lone import Placed, placed_by_rings
from viewshed.planes import free_plane
from viewshed.sweep import Sweep
from viewshed.visible import Beams

OBSTACLE_HEIGHTS_M = (0.3, 3.0)
"""Returns between these heights above local ground are obstacles."""
NULL_RANGE_M = 0.5
"""Returns nearer than this are null returns or the sensor's own housing, whatever the sensor."""
MAX_RANGE_M = 250.0
"""Returns farther than this are not used where the sensor is not known."""
TILT_SUPPORT = 0.35
"""Share of the near ground (or of the area seen) that must lie on a plane before it is believed about the tilt."""
LEVEL_TILT = np.deg2rad(6.0)
"""A ground plane steeper than this is taken as the sensor's tilt where the attitude is not known."""
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class LevelSweep:
    """A sweep in its ``level`` frame, without ego returns, null returns and clutter; M ≤ N rows, in the sweep's order.

    Attributes:
        sweep: the sweep that it came from.
        points: (M, 3) float32 metres in ``level`` (the sensor is at (0, 0, sensor_height_m)).
        range_m: (M,) float32 horizontal range from the sensor.
        azimuth: (M,) float32 radians in [-π, π), counter-clockwise from forward.
        height_m: (M,) float32 height above local ground.
        rows: (M,) row of each point in the sweep.
        level_from_sensor: the transform used.
        ground: the local ground.
        told: the sweep's rings and sensor, its own or told by its points.
        placed: the sweep's returns on its range image, or None where nothing tells its rings.
    """

    sweep: Sweep
    points: NDArray[np.float32]
    range_m: NDArray[np.float32]
    azimuth: NDArray[np.float32]
    height_m: NDArray[np.float32]
    rows: NDArray[np.intp]
    level_from_sensor: Rigid
    ground: Ground
    told: Told = NOTHING_TOLD
    placed: Placed | None = None

    @property
    def sensor_height_m(self) -> float:
        """Height of the sensor above the ground below it, in metres."""
        return float(self.level_from_sensor.translation[2])

    @property
    def world_from_level(self) -> Rigid | None:
        """Pose of the ``level`` frame in the map, or None where the sweep has none."""
        pose = self.sweep.world_from_sensor
        return None if pose is None else pose @ self.level_from_sensor.inverse()

    def beams(self, straight_up: Mask | None = None) -> Beams:
        """Return the beams that returned: straight lines from the sensor to each point.

        Those of rows of the sweep in ``straight_up`` (N,) point there and meet nothing: to leave them out costs copies.
        """
        rows = np.zeros(0, np.bool_) if straight_up is None else straight_up
        slope = kernels.slopes(self.points, self.range_m, np.float32(self.sensor_height_m), rows, self.rows)
        return Beams(self.azimuth, slope, self.range_m)

    def obstacle_cells(self, grid: BevGrid) -> NDArray[np.bool_]:
        """Return the mask (cells, cells) of cells that hold an obstacle return, 0.3 to 3 m above local ground."""
        mask = np.zeros(grid.shape, np.bool_)
        lattice = np.array([*grid.origin_m, 1.0 / grid.cell_m, *OBSTACLE_HEIGHTS_M], np.float32)
        kernels.obstacles(self.points, self.height_m, lattice, mask)
        return mask


def level_sweep(sweep: Sweep, grid: BevGrid) -> LevelSweep:
    """Return ``sweep`` levelled, its ground estimated over the extent of ``grid``.

    The attitude is the sweep's own, else its pose's, else the sensor's z axis is taken as vertical unless the
    ground plane is steeper than 6°, which then is taken as the sensor's tilt. The height is the sweep's own, else
    the ground's below the sensor. Returns nearer than 0.5 m, farther than the sensor can see, or inside the box of
    a vehicle below the sensor (heights of 1.2 to 3 m) are left out, and so is clutter (:mod:`viewshed.lone`) where the
    rings are known or can be told. Lone returns say nothing of the ground.
    """
    told = told_rings(sweep)
    placed = placed_by_rings(sweep.points, told, range_limits(sweep))
    lone = np.zeros(len(sweep), np.bool_) if placed is None else placed.lone
    rotation, ground = _attitude_and_ground(sweep, grid, lone)
    height = sweep.sensor_height_m or max(-float(ground.at(np.zeros((1, 2)))[0]), 0.05)
    ground = ground.raised(height)
    transform = Rigid(rotation, np.array([0.0, 0.0, height]))
    ego = EGO_BOX_M if EGO_HEIGHTS_M[0] <= height <= EGO_HEIGHTS_M[1] else (0.0, 0.0)
    clutter = None if placed is None else placed.clutter
    columns = kernels.level(
        sweep.points,
        np.zeros(0, np.bool_) if clutter is None else clutter,
        transform.as_matrix()[:3].astype(np.float32),
        np.array([*range_limits(sweep), *ego], np.float32),
        ground.heights_m,
        np.float32(ground.half_extent_m),
    )
    for column in columns:
        column.setflags(write=False)
    points, range_m, azimuth, height_m, rows = columns
    return LevelSweep(sweep, points, range_m, azimuth, height_m, rows, transform, ground, told, placed)


def range_limits(sweep: Sweep) -> tuple[float, float]:
    """Return the nearest and the farthest range in metres at which returns of the sweep are used."""
    if sweep.model is None:
        return NULL_RANGE_M, MAX_RANGE_M
    return max(NULL_RANGE_M, sweep.model.min_range_m), max(MAX_RANGE_M, sweep.model.max_range_m)


def _attitude_and_ground(sweep: Sweep, grid: BevGrid, lone: Mask) -> tuple[NDArray[np.float64], Ground]:
    attitude = sweep.known_attitude
    rotation = np.eye(3) if attitude is None else rotation_from_quaternion(attitude)
    ground = _ground(sweep, grid, rotation, lone)
    if attitude is not None:
        return rotation, ground
    normal = _tilted_normal(sweep, ground)
    if normal is None:
        return rotation, ground
    rotation = _upright(normal)
    return rotation, _ground(sweep, grid, rotation, lone)


def _ground(sweep: Sweep, grid: BevGrid, rotation: NDArray[np.float64], lone: Mask) -> Ground:
    half = grid.half_extent_m + max(abs(offset) for offset in grid.offset_m)
    limits = np.array(range_limits(sweep), np.float32)
    lows, rise = kernels.lows((sweep.points, lone), rotation.astype(np.float32), limits, np.float32(half), NODES)
    return estimate_ground(lows, rise, half, sweep.sensor_height_m)


def _tilted_normal(sweep: Sweep, ground: Ground) -> NDArray[np.float64] | None:
    """Return the ground's normal (3,) in the sensor frame where the sensor is clearly tilted, else None."""
    normal = np.array([-ground.plane[0], -ground.plane[1], 1.0])
    if ground.support < TILT_SUPPORT:
        stride = max(len(sweep) // 2500, 1)
        found, support = free_plane(np.ascontiguousarray(sweep.points[::stride]))
        if support < TILT_SUPPORT:
            return None
        normal = found.astype(np.float64)
    normal /= np.linalg.norm(normal)
    return normal if np.arccos(min(normal[2], 1.0)) > LEVEL_TILT else None


def _upright(normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation (3, 3) that takes ``normal`` to z and keeps the heading of x."""
    forward = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    forward /= np.linalg.norm(forward)
    return np.stack([forward, np.cross(normal, forward), normal])
