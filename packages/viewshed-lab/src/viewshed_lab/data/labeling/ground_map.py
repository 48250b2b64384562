"""Estimate the ground from several sweeps: ground that is far away in one sweep is close in another.

Every sweep contributes its two lowest returns per node of a lattice that is fixed to the world. The lows of the sweeps
around one are merged, and the core finds the ground among them as in a single sweep. It is interpolated where none of
them saw it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.interpolate import griddata

from viewshed import _core
from viewshed.fov.height_map import HeightMap
from viewshed.geometry import Rigid
from viewshed.preprocess.leveling import LeveledSweep

NODES_PER_HALF = 64
"""Lattice nodes per half side of the grid: 1 m on roads, twice as fine as for a single sweep."""

REACH = 1.42
"""Half side of the ground patch around a sweep, in half sides of the grid: covers the grid's corners at any yaw."""


@dataclass(frozen=True, slots=True, eq=False)
class Lows:
    """The two lowest returns of a sweep in each occupied node of the world's lattice."""

    node: NDArray[np.int32]  # (K, 2) int32 node along x and y
    points: NDArray[np.float64]  # (K, 2, 3) float64 world coordinates, the lowest first; NaN where there is no second
    top_m: NDArray[np.float64]  # (K,) float64 z of the highest return, NaN where there is only one


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """Ground around a sensor, on a lattice with the axes of the world."""

    ground: HeightMap  # z from the sensor, over x and y from ``center_m``
    center_m: NDArray[np.float64]  # (2,) center of the patch from the sensor, meters in world axes
    yaw: float  # heading of the sensor in the world

    def at(self, xy: NDArray[Any]) -> NDArray[np.float32]:
        """Return ground z from the sensor (N,) below points (N, 2) in the axes of ``level``."""
        return self.ground.at(self._place(xy))

    def seen(self, xy: NDArray[Any]) -> NDArray[np.bool_]:
        """Return whether the ground below points (N, 2) in the axes of ``level`` was measured by returns."""
        ground, count = self.ground, len(self.ground.seen)
        node = np.floor((self._place(xy) / ground.half_extent_m + 1) * count / 2).astype(np.intp).clip(0, count - 1)
        measured: NDArray[np.bool_] = ground.seen[node[:, 0], node[:, 1]]
        return measured

    def _place(self, xy: NDArray[Any]) -> NDArray[np.float32]:
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        turned = np.stack([c * xy[:, 0] - s * xy[:, 1], s * xy[:, 0] + c * xy[:, 1]], axis=-1)
        return np.asarray(turned - self.center_m, np.float32)


def lows_of(points: NDArray[np.float32], world_from_points: Rigid, node_m: float, reach_m: float) -> Lows:
    """Return the lowest points per node of the world, of points (N, 3) within ``reach_m`` of their origin.

    >>> lows_of(np.array([[0.2, 1.2, 5.0], [0.3, 1.3, 4.0]], np.float32), Rigid.identity(), 1.0, 9.0).points[0, :, 2]
    array([4., 5.])
    """
    center = np.floor(world_from_points.translation[:2] / node_m).astype(np.int64)
    count = 2 * int(np.ceil(reach_m / node_m)) + 1
    corner = center - count // 2
    rows = np.full((count * count, 3), -1, np.int32)
    world = np.empty((len(points), 3))
    _lowest(points, world_from_points.as_matrix()[:3], corner, np.float32(reach_m), node_m, count, world, rows)
    used = np.flatnonzero(rows[:, 0] >= 0)
    lowest_m = np.full((len(used), 3, 3), np.nan)
    present = rows[used] >= 0
    lowest_m[present] = world[rows[used][present]]
    node = np.stack([used // count, used % count], axis=-1) + corner
    return Lows(node.astype(np.int32), lowest_m[:, :2], lowest_m[:, 2, 2])


def patch_of(leveled: LeveledSweep, around: Iterable[Lows], half_extent_m: float, node_m: float) -> Patch:
    """Return the ground around a sweep, from the lows of the sweeps ``around`` it in the same world.

    Args:
        leveled: the sweep; without a pose, its ``level`` frame is the world.
        around: lows, including those of the sweep itself.
        half_extent_m: half the side of the grid.
        node_m: side of a node, the same as of the lows.
    """
    pose = leveled.sweep.world_from_sensor
    sensor = np.array([0.0, 0.0, leveled.sensor_height_m]) if pose is None else pose.translation
    count = 4 * int(np.ceil(REACH * half_extent_m / node_m / 2))
    corner = np.round(sensor[:2] / node_m).astype(np.int64) - count // 2
    lows, rise = np.full((count, count, 2, 3), np.inf, np.float32), np.full((count, count), np.inf, np.float32)
    sweeps = list(around)
    for sweep in sweeps:
        _merge_lows(sweep.node, sweep.points, corner, sensor, lows)
    for sweep in sweeps:
        _merge_rise(sweep.node, sweep.top_m - sensor[2], corner, lows, rise)
    rise[~np.isfinite(rise)] = 0.0
    second = np.isfinite(lows[:, :, 1, 2])[..., None]
    lowest = np.where(second, lows[:, :, 1], lows[:, :, 0])
    center = (corner + count // 2) * node_m - sensor[:2]
    lowest[np.isfinite(lowest[..., 2]), :2] -= center.astype(np.float32)
    ground = _ground_of(lowest, rise, count * node_m / 2, leveled.sensor_height_m)
    return Patch(ground, center, 0.0 if pose is None else pose.yaw)


def _ground_of(
    lows_m: NDArray[np.float32], rise_m: NDArray[np.float32], half_extent_m: float, sensor_height_m: float
) -> HeightMap:
    """Return the ground of a low point of each node (n, n, 3), and of the rise (n, n) to the node's highest point."""
    heights_m, seen, plane, support, level_m = _core.ground_of_lows(lows_m, rise_m, half_extent_m, sensor_height_m)
    if np.isfinite(level_m):  # no ground is seen
        return HeightMap.flat(half_extent_m, level_m)
    # Heights above the plane are linear between the seen nodes, and between these and the corners, which lie on it.
    middle_m = ((np.arange(len(seen)) + 0.5) * 2 / len(seen) - 1) * half_extent_m
    base_m = plane[0] * middle_m[:, None] + plane[1] * middle_m + plane[2]
    known = seen.copy()
    known[:: len(seen) - 1, :: len(seen) - 1] = True
    above_m = np.where(seen, heights_m - base_m, 0.0)
    filled = griddata(np.argwhere(known), above_m[known], tuple(np.indices(seen.shape)), "linear")
    heights_m = (base_m + filled).astype(np.float32)
    return HeightMap(heights_m, half_extent_m, seen, plane, support)


@njit(cache=True, nogil=True, error_model="numpy")
def _merge_lows(node: Any, points: Any, corner: Any, sensor: Any, lows: Any) -> None:
    """Merge a sweep's lows, from the sensor, into ``lows`` (count, count, 2, 3); keep the two lowest per node."""
    count = lows.shape[0]
    for k in range(node.shape[0]):
        i, j = node[k, 0] - corner[0], node[k, 1] - corner[1]
        if i < 0 or j < 0 or i >= count or j >= count:
            continue
        for rank in range(2):
            z = np.float32(points[k, rank, 2] - sensor[2])
            if z < lows[i, j, 0, 2]:
                lows[i, j, 1] = lows[i, j, 0]
                for axis in range(3):
                    lows[i, j, 0, axis] = points[k, rank, axis] - sensor[axis]
            elif z < lows[i, j, 1, 2]:
                for axis in range(3):
                    lows[i, j, 1, axis] = points[k, rank, axis] - sensor[axis]


@njit(cache=True, nogil=True, error_model="numpy")
def _lowest(
    points: Any, transform: Any, corner: Any, reach: Any, node_m: Any, count: Any, world: Any, rows: Any
) -> None:
    """Fill ``rows`` (count², 3) with the rows of the lowest, the second-lowest and the highest point of each node.

    Points (N, 3) beyond ``reach`` are ignored; ``transform`` (3, 4) maps the others to ``world`` (N, 3), where nodes of
    side ``node_m`` are indexed from ``corner`` (2,).
    """
    for k in range(points.shape[0]):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        if x * x + y * y >= reach * reach:
            continue
        for axis in range(3):
            row = transform[axis]
            world[k, axis] = row[0] * x + row[1] * y + row[2] * z + row[3]
        i, j = int(np.floor(world[k, 0] / node_m)) - corner[0], int(np.floor(world[k, 1] / node_m)) - corner[1]
        if i >= 0 and j >= 0 and i < count and j < count:
            _update_node(rows[i * count + j], k, world)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _update_node(node: Any, k: Any, world: Any) -> None:
    """Add point ``k`` to the rows of a node (3,); the highest is -1 while there is only one point."""
    first, second, z = node[0], node[1], world[k, 2]
    if first >= 0 and (node[2] < 0 or z > world[node[2], 2]):
        node[2] = k if z > world[first, 2] or node[2] >= 0 else first
    if first < 0 or z < world[first, 2]:
        node[0], node[1] = k, first
    elif second < 0 or z < world[second, 2]:
        node[1] = k


@njit(cache=True, nogil=True, error_model="numpy")
def _merge_rise(node: Any, top: Any, corner: Any, lows: Any, rise: Any) -> None:
    """Keep the minimum over sweeps of the highest return above the lowest: things that only passed by are removed."""
    count = rise.shape[0]
    for k in range(node.shape[0]):
        i, j = node[k, 0] - corner[0], node[k, 1] - corner[1]
        if i >= 0 and j >= 0 and i < count and j < count and np.isfinite(top[k]):
            low = lows[i, j, 1, 2] if np.isfinite(lows[i, j, 1, 2]) else lows[i, j, 0, 2]
            rise[i, j] = min(rise[i, j], np.float32(top[k]) - low)
