"""What earlier sweeps of a moving sensor tell of the one now: the obstacles that they saw, seen from where it is now.

A single sweep cannot tell a far return that somebody spoofed from a true one. But what stood there a moment ago and did
not move still stands there, whatever the beams say now; and what an earlier sweep has seen as well rests on two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed._numba import atan2
from viewshed.fov.visibility import Beams, Target, returns_by_kind
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.preprocess.leveling import OBSTACLE_HEIGHTS_M, LeveledSweep, level
from viewshed.preprocess.no_return import measured_and_inferred_beams
from viewshed.sweep import Sweep

HISTORY_SWEEPS = 5
"""Earlier sweeps that are looked at."""

COLUMNS = 720
"""Azimuth columns in which obstacles are remembered."""

SLOPES = (-0.75, 0.35)
"""Least and greatest rise over range at which obstacles are remembered, ..."""

ROWS = 160
"""... in so many steps of 0.4°."""

GAP_ROWS, GAP_COLUMNS = 20, 4
"""What lies at like depths at most so many rows or columns (8° or 2°) apart is one obstacle."""

PLACE_M = 0.5
"""Side of the places in which obstacles of several sweeps meet: one stands where two saw it in places side by side."""

PLACES = 512
"""Places along a side of the square around the sensor in which obstacles are remembered."""

_ALIKE = 1.25

_NEAREST_M = 1.0

Floats = NDArray[np.float32]

Mask = NDArray[np.bool_]

_SEEN: WeakKeyDictionary[LeveledSweep, dict[tuple[BevGrid, Target], Mask]] = WeakKeyDictionary()


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """What earlier sweeps saw, seen from the sensor now.

    Attributes:
        sensor_height_m: of the sensor now.
        earlier: the sweeps.
        now_from_earlier: where the ``level`` frame of each lies in that of now.
    """

    sensor_height_m: float
    earlier: tuple[LeveledSweep, ...]
    now_from_earlier: tuple[Rigid, ...]
    _supports: dict[tuple[BevGrid, Target], NDArray[np.uint8]] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, leveled: LeveledSweep, earlier: Sequence[LeveledSweep]) -> History | None:
        """Return what ``earlier`` sweeps tell of one, leveled on the same grid; None where there are none.

        Raises:
            ValueError: one of them has no pose.
        """
        if not earlier:
            return None
        now_from_world = _pose(leveled).inverse()
        return cls(leveled.sensor_height_m, tuple(earlier), tuple(now_from_world @ _pose(each) for each in earlier))

    def obstacles(self) -> Floats:
        """Return the horizontal range of the nearest obstacle by slope and azimuth (ROWS, COLUMNS); +inf for none.

        An obstacle is what at least two earlier sweeps saw in one place of the map (or the only sweep): what moved was
        seen there once.
        """
        found = [_on_obstacles(*pair) for pair in zip(self.earlier, self.now_from_earlier, strict=True)]
        seen_by = np.zeros((PLACES, PLACES), np.uint32)
        for number, points in enumerate(found):
            _mark(points, np.uint32(1 << number % 32), seen_by)
        image = np.full((ROWS, COLUMNS), np.inf, np.float32)
        for number, points in enumerate(found):
            own = np.uint32(1 << number % 32 if len(found) > 1 else 0)
            _remember(points, np.float32(self.sensor_height_m), seen_by, own, image)
        _fill(image, GAP_ROWS, np.float32(_ALIKE))
        _fill(image.T, GAP_COLUMNS, np.float32(_ALIKE))
        return image

    def within(self, beams: Beams) -> Beams:
        """Return the beams, none deeper than the obstacle remembered in its direction."""
        depth_m = np.minimum(beams.depth_m, _depths(self.obstacles(), beams.azimuth, beams.slope))
        return Beams(beams.azimuth, beams.slope, depth_m)

    def support(self, grid: BevGrid, target: Target) -> NDArray[np.uint8]:
        """Return how many of the earlier sweeps would have seen a target in each cell (cells, cells), by their beams.

        It is computed once, however often it is asked for, and so is what a sweep sees.
        """
        if (grid, target) in self._supports:
            return self._supports[grid, target]
        total = np.zeros(grid.shape, np.uint8)
        lattice = np.array([*grid.origin_m, grid.cell_m], np.float32)
        for before, now_from_before in zip(self.earlier, self.now_from_earlier, strict=True):
            before_from_now = now_from_before.inverse().as_matrix()[:2, [0, 1, 3]].astype(np.float32)
            _support(_seen(before, grid, target), lattice, before_from_now, total)
        total.setflags(write=False)
        self._supports[grid, target] = total
        return total


def history_of(leveled: LeveledSweep, earlier: Sequence[Sweep], grid: BevGrid) -> History | None:
    """Return what ``earlier`` sweeps tell of one that was leveled on ``grid``; None where there are none.

    Raises:
        ValueError: one of them has no pose.
    """
    return History.of(leveled, [level(sweep, grid) for sweep in earlier if len(sweep)])


def _pose(leveled: LeveledSweep) -> Rigid:
    pose = leveled.world_from_level
    if pose is None:
        raise ValueError("sweeps must have poses to be seen together, got one without; give world_from_sensor")
    return pose


@njit(cache=True, nogil=True, error_model="numpy")
def _fill(image: Any, gap: Any, ratio: Any) -> None:  # pragma: no cover - compiled
    """Fill gaps of at most so many rows between pixels of a column with like depths, as those between rings are."""
    last = np.full(image.shape[1], -1, np.int32)
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            depth = image[row, column]
            if depth == np.inf:
                continue
            before = last[column]
            if before >= 0 and 1 < row - before <= gap:
                other = image[before, column]
                if depth < other * ratio and other < depth * ratio:
                    for between in range(before + 1, row):
                        image[between, column] = max(depth, other)
            last[column] = row


def _on_obstacles(before: LeveledSweep, now_from_before: Rigid) -> Floats:
    """Return the points (M, 3) of an earlier sweep on obstacles, in the ``level`` frame now."""
    transform = now_from_before.as_matrix()[:3].astype(np.float32)
    high = before.points[before.height_m > np.float32(OBSTACLE_HEIGHTS_M[0])]
    points: Floats = high @ transform[:, :3].T + transform[:, 3]
    return points


def _seen(leveled: LeveledSweep, grid: BevGrid, target: Target) -> Mask:
    """Return where a sweep would have seen a target, by itself, on the grid around it (cells, cells)."""
    kept = _SEEN.setdefault(leveled, {})
    if (grid, target) not in kept:
        beams = measured_and_inferred_beams(leveled, target.height_m)
        returns = returns_by_kind([beams], leveled.sensor_height_m, leveled.ground, grid, target)[0]
        kept[grid, target] = returns >= target.min_returns
    return kept[grid, target]


@njit(cache=True, nogil=True, error_model="numpy")
def _support(seen: Any, lattice: Any, transform: Any, total: Any) -> None:  # pragma: no cover - compiled
    """Add a mask (cells, cells) of another frame to the total, each cell by where its middle lies there."""
    x0, y0, cell_m = lattice
    cells, per_m = seen.shape[0], np.float32(1.0) / cell_m
    for i in range(cells):
        x = x0 + (np.float32(i) + np.float32(0.5)) * cell_m
        for j in range(cells):
            y = y0 + (np.float32(j) + np.float32(0.5)) * cell_m
            u = (transform[0, 0] * x + transform[0, 1] * y + transform[0, 2] - x0) * per_m
            v = (transform[1, 0] * x + transform[1, 1] * y + transform[1, 2] - y0) * per_m
            if u >= 0.0 and v >= 0.0 and u < cells and v < cells:
                total[i, j] += seen[int(u), int(v)]


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _place(x: Any, y: Any) -> Any:  # pragma: no cover - compiled
    """Return the place of a point, at least one from the edge; -1 outside."""
    i = int(np.floor(x * np.float32(1.0 / PLACE_M))) + PLACES // 2
    j = int(np.floor(y * np.float32(1.0 / PLACE_M))) + PLACES // 2
    inside = (i >= 1) & (j >= 1) & (i < PLACES - 1) & (j < PLACES - 1)
    return (i if inside else -1), j


@njit(cache=True, nogil=True, error_model="numpy")
def _mark(points: Any, bit: Any, seen_by: Any) -> None:  # pragma: no cover - compiled
    """Set the bit of a sweep in the places (PLACES, PLACES) of its obstacles."""
    for n in range(points.shape[0]):
        i, j = _place(points[n, 0], points[n, 1])
        if i >= 0:
            seen_by[i, j] |= bit


@njit(cache=True, nogil=True, error_model="numpy")
def _remember(points: Any, sensor_m: Any, seen_by: Any, own: Any, image: Any) -> None:  # pragma: no cover - compiled
    """Put a sweep's obstacles (M, 3) that others saw as well into an image; ``own`` is its bit, 0 takes them all."""
    for n in range(points.shape[0]):
        x, y = points[n, 0], points[n, 1]
        range_m = np.sqrt(x * x + y * y)
        i, j = _place(x, y)
        if i < 0 or range_m < _NEAREST_M:
            continue
        seen = np.uint32(0)
        for u in range(i - 1, i + 2):
            seen |= seen_by[u, j - 1] | seen_by[u, j] | seen_by[u, j + 1]
        if seen == own:
            continue
        row, column = _pixel(atan2(y, x), (points[n, 2] - sensor_m) / range_m)
        if row >= 0:
            image[row, column] = min(image[row, column], range_m)


@njit(cache=True, nogil=True, error_model="numpy")
def _depths(image: Any, azimuth: Any, slope: Any) -> Any:  # pragma: no cover - compiled
    depth = np.full(azimuth.shape[0], np.inf, np.float32)
    for n in range(azimuth.shape[0]):
        row, column = _pixel(azimuth[n], slope[n])
        if row >= 0:
            depth[n] = image[row, column]
    return depth


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _pixel(azimuth: Any, slope: Any) -> Any:  # pragma: no cover - compiled
    """Return row and column of a direction; row -1 outside."""
    row = (slope - np.float32(SLOPES[0])) * np.float32(ROWS / (SLOPES[1] - SLOPES[0]))
    column = int((azimuth + np.float32(np.pi)) * np.float32(COLUMNS / (2 * np.pi)))
    inside = (row >= np.float32(0.0)) & (row < np.float32(ROWS))
    return (int(row) if inside else -1), min(max(column, 0), COLUMNS - 1)
