"""Level a sweep: identify its sensor, find isolated returns, estimate attitude and ground, turn its points level."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed import _core
from viewshed._numba import BLOCK, split
from viewshed.fov.height_map import HeightMap
from viewshed.fov.visibility import Beams
from viewshed.geometry import Rigid, rotation_from_quaternion
from viewshed.grid import BevGrid
from viewshed.preprocess.ego_vehicle import EGO_BOX_M, EGO_HEIGHTS_M, vehicle_heading
from viewshed.preprocess.ground import estimate_ground, lattice_nodes
from viewshed.preprocess.ground_plane import free_plane
from viewshed.preprocess.range_image import RangeImage, range_image_by_sensor
from viewshed.preprocess.sensor_identification import UNIDENTIFIED, SensorId, identify_sensor
from viewshed.sweep import Sweep

OBSTACLE_HEIGHTS_M = (0.3, 3.0)
"""Returns between these heights above local ground are obstacles."""

NULL_RANGE_M = 0.5
"""Returns nearer than this are null returns or the sensor's own housing, whatever the sensor."""

MAX_RANGE_M = 250.0
"""Returns farther than this are not used where the sensor is not known."""

TILT_SUPPORT = 0.35
"""Share of the near ground (or of the area seen) that must lie on a plane before it is believed about the tilt, ..."""

TILT_RETURNS = 0.5
"""... or this share of the returns: far walls outweigh the ground below a sensor that looks down beside them."""

_ON_PLANE_M = 0.2

LEVEL_TILT = np.deg2rad(6.0)
"""A ground plane steeper than this is taken as the sensor's tilt where the attitude is not known."""

LEAST_HEIGHT_M = 0.05
"""Least height of a sensor above the ground that was estimated."""

Mask = NDArray[np.bool_]

Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Held:
    """What a sweep takes from earlier ones of its stream beside their ground; numbers alone, no sweep.

    Attributes:
        heights_m: the sensor's heights above the ground that the last sweeps estimated, this one's last.
        reach_m: the greatest reach that a sweep of the stream showed.
        is_height_held: whether this sweep's own height was set aside for the median of ``heights_m``.
    """

    heights_m: tuple[float, ...]
    reach_m: float
    is_height_held: bool = False


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class LeveledSweep:
    """A sweep in its ``level`` frame, without ego returns, null returns and clutter; M ≤ N rows, in the sweep's order.

    Attributes:
        sweep: the sweep that it came from.
        points: (M, 3) float32 meters in ``level`` (the sensor is at (0, 0, sensor_height_m)).
        range_m: (M,) float32 horizontal range from the sensor.
        azimuth: (M,) float32 radians in [-π, π), counter-clockwise from forward.
        height_m: (M,) float32 height above local ground.
        rows: (M,) int32 row of each point in the sweep.
        level_from_sensor: the transform used.
        ground: the local ground.
        sensor_id: the rings and the sensor, the sweep's own or identified by its points.
        range_image: the sweep's N returns on its range image, or None where the rings are not known.
        held: what it takes from earlier sweeps beside their ground (:mod:`viewshed.preprocess.held_ground`); None for a
            sweep by itself.
    """

    sweep: Sweep
    points: NDArray[np.float32]
    range_m: NDArray[np.float32]
    azimuth: NDArray[np.float32]
    height_m: NDArray[np.float32]
    rows: NDArray[np.int32]
    level_from_sensor: Rigid
    ground: HeightMap
    sensor_id: SensorId = UNIDENTIFIED
    range_image: RangeImage | None = None
    held: Held | None = None

    @property
    def sensor_height_m(self) -> float:
        """Height of the sensor above the ground below it, in meters."""
        return float(self.level_from_sensor.translation[2])

    @property
    def world_from_level(self) -> Rigid | None:
        """Pose of the ``level`` frame in the map, or None where the sweep has none."""
        pose = self.sweep.world_from_sensor
        return None if pose is None else pose @ self.level_from_sensor.inverse()

    def beams(self, left_out: Mask | None = None) -> Beams:
        """Return the beams that returned: straight lines from the sensor to each point.

        Those of rows of the sweep in ``left_out`` (N,) point straight up and meet nothing: removing them costs copies.
        """
        slope = _core.beam_slopes(self.points, self.range_m, self.sensor_height_m, left_out, self.rows)
        return Beams(self.azimuth, slope, self.range_m)

    def obstacle_cells(self, grid: BevGrid) -> NDArray[np.bool_]:
        """Return the mask (cells, cells) of cells that hold an obstacle return, 0.3 to 3 m above local ground."""
        return _core.obstacle_cells(
            self.points, self.height_m, *grid.origin_m, 1.0 / grid.cell_m, *OBSTACLE_HEIGHTS_M, grid.cells
        )


def level(sweep: Sweep, grid: BevGrid) -> LeveledSweep:
    """Return ``sweep`` leveled, its ground estimated over the extent of ``grid``.

    The attitude is the sweep's own, else its pose's, else the sensor's z axis is taken as vertical unless the
    ground plane is steeper than 6°, which then is taken as the sensor's tilt. The height is the sweep's own, else
    the ground's below the sensor. Returns nearer than 0.5 m, farther than the sensor can see, or inside the box of
    a vehicle below the sensor (heights of 1.2 to 3 m) are left out, and so is clutter
    (:mod:`viewshed.preprocess.range_image`) where the rings are known or can be identified.
    """
    # 1. Identify the sensor: its beam table, and the ring of each return.
    sensor_id = identify_sensor(sweep)
    # 2. Range image: isolated returns say nothing of the ground, clutter is left out altogether.
    image = range_image_by_sensor(sweep.points, sensor_id, range_limits(sweep))
    isolated = np.zeros(len(sweep), np.bool_) if image is None else image.isolated
    isolated.setflags(write=False)
    # 3. Attitude and ground, in the sensor's frame; then raise both until the ground below the sensor is at z = 0.
    rotation, ground = _attitude_and_ground(sweep, grid, isolated)
    height_m = sweep.sensor_height_m or max(-float(ground.at(np.zeros((1, 2)))[0]), LEAST_HEIGHT_M)
    ground = ground.raised(height_m)
    level_from_sensor = Rigid(rotation, np.array([0.0, 0.0, height_m]))
    # 4. Level points, with their range, azimuth and height above the ground.
    clutter = None if image is None else image.clutter
    points, range_m, azimuth, heights_m, rows = _level_points(sweep, clutter, level_from_sensor, ground)
    return LeveledSweep(
        sweep, points, range_m, azimuth, heights_m, rows, level_from_sensor, ground, sensor_id, image
    )  # fmt: skip


def leveled_on(sweep: Sweep | LeveledSweep, grid: BevGrid) -> LeveledSweep:
    """Return ``sweep`` leveled for ``grid``; one that is leveled already is taken as it is.

    Raises:
        TypeError: ``sweep`` is neither.
        ValueError: it was leveled for a smaller grid.
    """
    if isinstance(sweep, Sweep):
        return level(sweep, grid)
    if not isinstance(sweep, LeveledSweep):
        raise TypeError(
            f"sweep must be a Sweep or a LeveledSweep, got {type(sweep).__name__}; make one with viewshed.Sweep(points)"
        )
    extent_m = grid.half_extent_m + max(abs(offset) for offset in grid.offset_m)
    if sweep.ground.half_extent_m < extent_m:
        raise ValueError(
            f"a leveled sweep must have ground out to {extent_m:g} m for this grid, got"
            f" {sweep.ground.half_extent_m:g} m; level it on the estimator's grid"
        )
    return sweep


def range_limits(sweep: Sweep) -> tuple[float, float]:
    """Return the nearest and the farthest range in meters at which returns of the sweep are used."""
    if sweep.model is None:
        return NULL_RANGE_M, MAX_RANGE_M
    return max(NULL_RANGE_M, sweep.model.min_range_m), sweep.model.max_range_m


def _attitude_and_ground(sweep: Sweep, grid: BevGrid, isolated: Mask) -> tuple[NDArray[np.float64], HeightMap]:
    """Return the rotation (3, 3) from sensor to level, and the ground with the sensor at z = 0."""
    attitude = sweep.known_attitude
    rotation = np.eye(3) if attitude is None else rotation_from_quaternion(attitude)
    ground = _ground(sweep, grid, rotation, isolated)
    if attitude is not None:
        return rotation, ground
    # Nothing says how the sensor is tilted: a steep ground plane does. The ground is then found again, upright.
    normal = _tilted_normal(sweep, ground)
    if normal is None:
        return rotation, ground
    rotation = _upright(normal)
    return rotation, _ground(sweep, grid, rotation, isolated)


def _ground(sweep: Sweep, grid: BevGrid, rotation: NDArray[np.float64], isolated: Mask) -> HeightMap:
    """Return the ground over the extent of ``grid``, after a rotation (3, 3)."""
    half_m = grid.half_extent_m + max(abs(offset) for offset in grid.offset_m)
    near_m, far_m = np.array(range_limits(sweep), np.float32)
    lows_m, rise_m = lowest_returns(
        sweep.points, isolated, rotation.astype(np.float32), near_m, far_m, np.float32(half_m), lattice_nodes(half_m),
        _vehicle_axis(sweep, rotation),
    )  # fmt: skip
    return estimate_ground(lows_m, rise_m, half_m, sweep.sensor_height_m)


def _tilted_normal(sweep: Sweep, ground: HeightMap) -> NDArray[np.float64] | None:
    """Return the ground's normal (3,) in the sensor frame where the sensor is clearly tilted, else None."""
    normal = np.array([-ground.plane[0], -ground.plane[1], 1.0])
    if ground.support < TILT_SUPPORT:
        # Too few near nodes lie on that plane: look for a steeper one, up to 60°, through some of the returns.
        returns = np.ascontiguousarray(sweep.points[:: max(len(sweep) // 2500, 1)])
        steep, support = free_plane(returns)
        if support < TILT_SUPPORT and _share_at_one_height(returns @ steep) < TILT_RETURNS:
            return None
        normal = steep.astype(np.float64)
    normal /= np.linalg.norm(normal)
    return normal if np.arccos(min(normal[2], 1.0)) > LEVEL_TILT else None


def _share_at_one_height(height_m: NDArray[np.float32]) -> float:
    """Return the share of heights (n,) below the sensor that lie within ``_ON_PLANE_M`` of each other."""
    low = np.sort(height_m[height_m < -LEAST_HEIGHT_M])
    together = np.searchsorted(low, low + np.float32(_ON_PLANE_M)) - np.arange(len(low))
    return float(together.max(initial=0)) / max(len(height_m), 1)


def _upright(normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation (3, 3) that takes ``normal`` to z and keeps the heading of x."""
    forward = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    forward /= np.linalg.norm(forward)
    return np.stack([forward, np.cross(normal, forward), normal])


def _vehicle_axis(sweep: Sweep, rotation: NDArray[np.float64]) -> Floats:
    """Return the axis (2,) of the own vehicle in the level frame: cosine and sine of its heading."""
    heading = vehicle_heading(sweep.points, rotation, sweep.vehicle_yaw)
    return np.array([np.cos(heading), np.sin(heading)], np.float32)


def _level_points(
    sweep: Sweep, clutter: Mask | None, level_from_sensor: Rigid, ground: HeightMap
) -> tuple[Floats, Floats, Floats, Floats, NDArray[np.int32]]:
    """Return points (M, 3), range, azimuth, height above the ground and row in the sweep (M,) of returns that count."""
    columns = _core.level_points(
        sweep.points,
        clutter,
        level_from_sensor.as_matrix()[:3].astype(np.float32),
        *range_limits(sweep),
        vehicle_heading(sweep.points, level_from_sensor.rotation, sweep.vehicle_yaw),
        ground.heights_m,
        ground.half_extent_m,
    )
    for column in columns:
        column.setflags(write=False)
    return columns


@njit(cache=True, nogil=True, error_model="numpy")
def lowest_returns(
    points: Any, isolated: Any, rotation: Any, near_m: Any, far_m: Any, half_m: Any, side: int, axis: Any
) -> Any:  # pragma: no cover - compiled
    """Return each node's second-lowest point (side, side, 3), and the height from it up to the highest (side, side).

    The lowest one where it is alone; +inf where a node has none. Points are turned first; isolated ones do not count.
    """
    # Of each node the two lowest heights and the points that they are of, and the greatest height.
    lowest, origin = np.full((side * side, 2), np.inf, np.float32), np.zeros((side * side, 2), np.int32)
    highest = np.full(side * side, -np.inf, np.float32)
    x, y, z = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    nodes, heights = np.empty(BLOCK, np.int32), np.empty(BLOCK, np.float32)
    for start in range(0, points.shape[0], BLOCK):
        count = split(points, start, x, y, z)
        _nodes(x[:count], y[:count], z[:count], rotation, near_m, far_m, half_m, np.float32(side), axis, nodes, heights)
        for n in range(count):
            k = start + n
            if nodes[n] < 0 or isolated[k]:
                continue
            node, low = np.uint32(nodes[n]), heights[n]
            highest[node] = max(highest[node], low)
            # Insert into the two lowest. Most points are higher than both.
            if low <= lowest[node, 1] and _before(points, k, low, origin[node, 1], lowest[node, 1]):
                rank = 1
                if _before(points, k, low, origin[node, 0], lowest[node, 0]):
                    lowest[node, 1], origin[node, 1] = lowest[node, 0], origin[node, 0]
                    rank = 0
                lowest[node, rank], origin[node, rank] = low, k
    return _low_points(points, rotation, lowest, origin, highest)


@njit(cache=True, nogil=True, error_model="numpy")
def _low_points(
    points: Any, rotation: Any, lowest: Any, origin: Any, highest: Any
) -> Any:  # pragma: no cover - compiled
    """Return the turned low point (side, side, 3) of each node, and the rise (side, side) from it to the highest."""
    side = int(np.sqrt(highest.shape[0]))
    lows, rise = np.full((side, side, 3), np.inf, np.float32), np.zeros((side, side), np.float32)
    for node in range(highest.shape[0]):
        rank = 1 if np.isfinite(lowest[node, 1]) else 0
        if np.isfinite(lowest[node, rank]):
            i, j, k = node // side, node % side, origin[node, rank]
            px, py, pz = points[k, 0], points[k, 1], points[k, 2]
            lows[i, j, 0] = rotation[0, 0] * px + rotation[0, 1] * py + rotation[0, 2] * pz
            lows[i, j, 1] = rotation[1, 0] * px + rotation[1, 1] * py + rotation[1, 2] * pz
            lows[i, j, 2] = lowest[node, rank]
            rise[i, j] = highest[node] - lowest[node, rank]
    return lows, rise


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _before(points: Any, k: Any, z: Any, other: Any, low: Any) -> Any:  # pragma: no cover - compiled
    """Whether ``z`` is lower; among equals x and y decide, so that the order of the points does not."""
    if z != low:
        return z < low
    if points[k, 0] != points[other, 0]:
        return points[k, 0] < points[other, 0]
    return points[k, 1] < points[other, 1]


@njit(cache=True, nogil=True, error_model="numpy")
def _nodes(
    xs: Any,
    ys: Any,
    zs: Any,
    rotation: Any,
    near_m: Any,
    far_m: Any,
    half_m: Any,
    last: Any,
    axis: Any,
    nodes: Any,
    heights: Any,
) -> None:  # pragma: no cover - compiled
    """Find the node (-1 where it is no candidate for ground) and the z of each point of a block.

    No candidates: points outside or out of range, and those that may be the hood or roof of the vehicle below the
    sensor. Without branches, so that it vectorizes.
    """
    nodes_per_m, side = last / (np.float32(2.0) * half_m), np.int32(last)
    near2, far2 = near_m * near_m, far_m * far_m
    xx, xy, xz = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    yx, yy, yz = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    zx, zy, zz = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    cos, sin = axis[0], axis[1]
    hood_x, hood_y, hood_z = np.float32(EGO_BOX_M[0]), np.float32(EGO_BOX_M[1]), np.float32(-EGO_HEIGHTS_M[0])
    for k in range(xs.shape[0]):
        px, py, pz = xs[k], ys[k], zs[k]
        d2 = px * px + py * py + pz * pz
        x, y = xx * px + xy * py + xz * pz, yx * px + yy * py + yz * pz
        z = zx * px + zy * py + zz * pz
        u, v = (x + half_m) * nodes_per_m, (y + half_m) * nodes_per_m
        hood = (abs(cos * x + sin * y) < hood_x) & (abs(cos * y - sin * x) < hood_y) & (z > hood_z)
        inside = (d2 >= near2) & (d2 <= far2) & (u >= 0) & (v >= 0) & (u < last) & (v < last) & (not hood)
        i, j = np.int32(u if inside else np.float32(0)), np.int32(v if inside else np.float32(0))
        nodes[k] = i * side + j if inside else np.int32(-1)
        heights[k] = z
