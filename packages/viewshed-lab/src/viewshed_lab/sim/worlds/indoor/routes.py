"""Routes through a building: free floor on a fine lattice, a road map of straight lines over it, tracks along them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

from viewshed.arrays import F64
from viewshed_lab.sim.world import Track
from viewshed_lab.sim.worlds.layout import Rect

_CELL_M, _BIN_M, _REACH_M = 0.1, 1.8, 3.8


@dataclass(frozen=True, slots=True, eq=False)
class FreeFloor:
    """Floor on which the center of a robot may be."""

    low_m: F64  # (2,) lowest x and y of the lattice
    free: NDArray[np.bool_]  # (nx, ny) whether a cell of 0.1 m is far enough from all obstacles

    def at(self, xy_m: F64) -> NDArray[np.bool_]:
        """Return which points (..., 2) within the lattice are free."""
        cells = ((xy_m - self.low_m) / _CELL_M).astype(np.int32)
        return np.asarray(self.free[cells[..., 0], cells[..., 1]])

    def sees(self, start_m: F64, stop_m: F64) -> NDArray[np.bool_]:
        """Return for which of k pairs of points (k, 2) the straight line between them is free."""
        if not len(start_m):
            return np.zeros(0, np.bool_)
        longest = float(np.abs(stop_m - start_m).max())
        share = np.linspace(0.0, 1.0, int(longest / _CELL_M) + 2)
        line = start_m[:, None, :] + (stop_m - start_m)[:, None, :] * share[None, :, None]
        return np.asarray(self.at(line).all(axis=1))

    def without(self, rects: NDArray[np.float64], reach_m: float) -> FreeFloor:
        """Return the floor that is farther than ``reach_m`` from rectangles (k, 4)."""
        free = self.free.copy()
        size = np.tile(np.array(free.shape), 2)
        grown = rects + reach_m * np.array([-1.0, -1.0, 1.0, 1.0])
        cells = np.clip(np.ceil((grown - np.tile(self.low_m, 2)) / _CELL_M - 0.5).astype(int), 0, size)
        for a, b, c, d in cells.tolist():
            free[a:c, b:d] = False
        return FreeFloor(self.low_m, free)


def open_floor(rect: Rect) -> FreeFloor:
    """Return a floor over ``rect`` with nothing on it."""
    size = np.ceil((np.array(rect[2:]) - np.array(rect[:2])) / _CELL_M).astype(int) + 1
    return FreeFloor(np.array(rect[:2], np.float64), np.ones((int(size[0]), int(size[1])), np.bool_))


@dataclass(frozen=True, slots=True, eq=False)
class RoadMap:
    """Nodes on the free floor, and the straight lines between them."""

    floor: FreeFloor  # what is free
    nodes_m: F64  # (n, 2)
    edges: NDArray[np.intp]  # (k, 2) int rows of ``nodes_m``

    @classmethod
    def over(cls, floor: FreeFloor, rng: np.random.Generator, wanted_m: F64) -> RoadMap:
        """Return a road map with one node per bin of 1.8 m, if a random point in it is free, and the given nodes."""
        size = np.array(floor.free.shape) * _CELL_M
        bins = np.ceil(size / _BIN_M).astype(int)
        corner = np.stack(np.meshgrid(*map(np.arange, bins), indexing="ij"), axis=-1).reshape(-1, 2)
        tries = (corner[None] + rng.random((3, len(corner), 2))) * _BIN_M
        inside = np.minimum(tries, size - 1.5 * _CELL_M) + floor.low_m
        ok = floor.at(inside)
        first = inside[ok.argmax(axis=0), np.arange(len(corner))][ok.any(axis=0)]
        wanted_m = wanted_m[((wanted_m > floor.low_m) & (wanted_m < floor.low_m + size - _CELL_M)).all(axis=1)]
        nodes = np.concatenate([first, wanted_m[floor.at(wanted_m)]])
        distance_m = np.abs(nodes[:, None, :] - nodes[None, :, :])
        i, j = np.nonzero(np.triu((distance_m < _REACH_M).all(axis=2), 1))
        seen = floor.sees(nodes[i], nodes[j])
        return cls(floor, nodes, np.column_stack([i[seen], j[seen]]))

    def off(self, way_m: F64, reach_m: float) -> RoadMap:
        """Return the map without edges within ``reach_m`` of a path (k, 2); the nodes are the same."""
        steps = int(np.abs(np.diff(way_m, axis=0)).max() / (2 * _CELL_M)) + 2
        share = np.linspace(0.0, 1.0, steps)[:, None, None]
        spots = (way_m[None, :-1] * (1 - share) + way_m[None, 1:] * share).reshape(-1, 2)
        floor = self.floor.without(np.hstack([spots, spots]), reach_m)
        ends = self.nodes_m[self.edges]
        low, high = spots.min(axis=0) - reach_m - _CELL_M, spots.max(axis=0) + reach_m + _CELL_M
        far = ((ends.min(axis=1) > high) | (ends.max(axis=1) < low)).any(axis=1)
        near = np.flatnonzero(~far)
        far[near] = floor.sees(ends[near, 0], ends[near, 1])
        return RoadMap(floor, self.nodes_m, self.edges[far])

    def largest(self, rows: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Return the nodes of the largest connected part of the map within ``rows`` (n,)."""
        kept = rows & self.floor.at(self.nodes_m)
        _, part = connected_components(self.matrix(kept), directed=False)
        sizes = np.bincount(part[kept], minlength=1)
        return np.flatnonzero(kept & (part == sizes.argmax()))

    def matrix(self, rows: NDArray[np.bool_]) -> csr_matrix:
        """Return lengths in meters of the edges within ``rows`` (n,) as a sparse (n, n) matrix."""
        i, j = self.edges[rows[self.edges].all(axis=1)].T
        lengths = np.hypot(*(self.nodes_m[i] - self.nodes_m[j]).T)
        return csr_matrix((lengths, (i, j)), shape=(len(rows), len(rows)))


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """The part of a road map that one robot uses."""

    roads: RoadMap
    rows: NDArray[np.bool_]
    lengths: csr_matrix

    @classmethod
    def of(cls, roads: RoadMap, nodes: NDArray[np.intp]) -> Network:
        """Return the network over some nodes."""
        rows = np.zeros(len(roads.nodes_m), np.bool_)
        rows[nodes] = True
        return cls(roads, rows, roads.matrix(rows))

    def path(self, start: int, goal: int) -> F64:
        """Return the corners (k, 2) of a short path between two connected nodes, including both ends."""
        _, predecessors = dijkstra(self.lengths, directed=False, indices=goal, return_predecessors=True)
        path = [start]
        while path[-1] != goal:
            path.append(int(predecessors[path[-1]]))
        return _straightened(self.roads.floor, self.roads.nodes_m[path])


def _straightened(floor: FreeFloor, path: F64) -> F64:
    """Return the path without needless corners: from each corner directly to the farthest one in free line."""
    kept = [0]
    while kept[-1] < len(path) - 1:
        ahead = path[kept[-1] + 1 :]
        seen = np.flatnonzero(floor.sees(np.broadcast_to(path[kept[-1]], ahead.shape), ahead))
        kept.append(kept[-1] + 1 + int(seen[-1] if seen.size else 0))
    return path[kept]


def drive_route(path: F64, speed_mps: float, turn_rate: float, start_s: float, pause_s: ArrayLike = ()) -> Track:
    """Return the track along corners (k, 2): straight at constant speed, turning in place at ``turn_rate``.

    Args:
        path: corners, no two in a row the same.
        speed_mps: meters per second.
        turn_rate: radians per second.
        start_s: departure from the first corner.
        pause_s: seconds to stand at each corner, before turning; empty for no pauses.
    """
    if len(path) < 2:
        return Track(np.array([start_s]), path[:1], np.zeros(1))
    step = np.diff(path, axis=0)
    yaw = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    turn = np.maximum(np.abs(np.diff(yaw)) / turn_rate, 0.02)
    pauses = np.asarray(pause_s, np.float64)
    stand = pauses[1:-1] if pauses.size else np.zeros(len(turn))
    drive = np.hypot(*step.T) / speed_mps
    stages = np.empty(3 * len(drive) - 2)
    stages[0::3], stages[1::3], stages[2::3] = drive, stand + 0.02, turn
    t_s = start_s + np.r_[0.0, np.cumsum(stages)]
    corner = np.r_[0, np.repeat(np.arange(1, len(path) - 1), 3), len(path) - 1]
    turned = np.arange(len(turn))
    heading = np.column_stack([turned, turned, turned + 1]).ravel()
    return Track(t_s, path[corner], yaw[np.r_[0, heading, len(yaw) - 1]])
