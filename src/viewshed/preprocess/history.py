"""History: what earlier sweeps of a moving sensor saw, seen from where the sensor is now.

A single sweep cannot tell a far return that somebody spoofed from a true one. But what stood there a moment ago and did
not move still stands there, whatever the beams say now; and a cell that an earlier sweep saw as well rests on two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed._numba import atan2
from viewshed.fov.visibility import Beams, Target, returns_by_kind
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.preprocess.evidence import beam_evidence
from viewshed.preprocess.held_ground import hold_over, pose_of
from viewshed.preprocess.leveling import OBSTACLE_HEIGHTS_M, LeveledSweep, leveled_on
from viewshed.sweep import Sweep

HISTORY_SWEEPS = 5
"""Earlier sweeps that are used."""

COLUMNS = 720
"""Azimuth columns of the image of remembered obstacles."""

SLOPES = (-0.75, 0.35)
"""Least and greatest rise over range at which obstacles are remembered, ..."""

ROWS = 160
"""... in so many rows of 0.4°."""

SIGHT_STEP = 2
"""Lines of sight are looked along in every so many rows and columns."""

GAP_ROWS, GAP_COLUMNS = 20, 4
"""Obstacle pixels of similar depth at most so many rows or columns (8° or 2°) apart belong to one obstacle."""

SEEN_THROUGH_M = 1.0
"""Such a gap is closed where something farther was seen in it if it is narrower than this: seen from elsewhere."""

MAP_CELL_M = 0.5
"""Side of a cell of the map of obstacles: one stands where two sweeps saw it in the same or in neighboring cells."""

MAP_CELLS = 512
"""Cells along a side of the map of obstacles, a square about the sensor."""

LEAST_VIEW = 0.15
"""A line of sight is open if more than this share of a target is in view past what is remembered."""

_SIMILAR = 1.25

_NEAREST_M = 1.0
"""Obstacles nearer than this are not remembered: too near for a direction, and often the vehicle itself."""

_NOBODY, _SEVERAL = 0, -1
"""In the map of obstacles: no sweep, and more than one; a single sweep stands by its number, from 1."""

Floats = NDArray[np.float32]

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class History:
    """What earlier sweeps saw, seen from the sensor now.

    Attributes:
        now: the sweep now, with the ground, height and reach that earlier ones hold; what is to be estimated.
        earlier: the sweeps, any number of them, each with what those before it hold.
        now_from_earlier: pose of the ``level`` frame of each in that of the sweep now.
    """

    now: LeveledSweep
    earlier: tuple[LeveledSweep, ...]
    now_from_earlier: tuple[Rigid, ...]
    _confirmations: dict[tuple[BevGrid, Target], NDArray[np.int32]] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, leveled: LeveledSweep, earlier: Sequence[LeveledSweep]) -> History | None:
        """Return the history of a sweep from ``earlier`` ones, leveled on the same grid; None where there are none.

        Raises:
            ValueError: one of them has no pose.
        """
        if not earlier:
            return None
        *before, now = hold_over([*earlier, leveled])
        now_from_world = pose_of(now).inverse()
        poses = tuple(now_from_world @ pose_of(sweep) for sweep in before)
        return cls(now, tuple(before), poses)

    @property
    def sensor_height_m(self) -> float:
        """Height of the sensor now."""
        return self.now.sensor_height_m

    def obstacles(self) -> Floats:
        """Return the horizontal range of the nearest obstacle by slope and azimuth (ROWS, COLUMNS); +inf for none.

        An obstacle is what at least two earlier sweeps saw in one place of the map (or the only sweep): what moved was
        seen there once.
        """
        points = [_obstacle_points(*pair) for pair in zip(self.earlier, self.now_from_earlier, strict=True)]
        # Which sweeps saw an obstacle in each cell of the map?
        seen_by = np.zeros((MAP_CELLS, MAP_CELLS), np.int32)
        for number, xyz in enumerate(points, start=1):
            _mark_cells(xyz, np.int32(number), seen_by)
        # Put what another sweep saw there as well into the image; of a single sweep everything.
        image = np.full((ROWS, COLUMNS), np.inf, np.float32)
        for number, xyz in enumerate(points, start=1):
            own = np.int32(number if len(points) > 1 else _NOBODY)
            _draw_obstacles(xyz, np.float32(self.sensor_height_m), seen_by, own, image)
        _close_gaps(image)
        return image

    def _obstacles_of(self, before: LeveledSweep, now_from_before: Rigid) -> Floats:
        """Return the image (ROWS, COLUMNS) of all obstacles that one earlier sweep saw."""
        xyz = _obstacle_points(before, now_from_before)
        seen_by, image = np.zeros((MAP_CELLS, MAP_CELLS), np.int32), np.full((ROWS, COLUMNS), np.inf, np.float32)
        _mark_cells(xyz, np.int32(1), seen_by)
        _draw_obstacles(xyz, np.float32(self.sensor_height_m), seen_by, np.int32(_NOBODY), image)
        _close_gaps(image)
        return image

    def within(self, beams: Beams) -> Beams:
        """Return the beams, none deeper than the obstacle remembered in its direction."""
        depth_m = np.minimum(beams.depth_m, _obstacle_ranges(self.obstacles(), beams.azimuth, beams.slope))
        return Beams(beams.azimuth, beams.slope, depth_m)

    def confirmations(self, grid: BevGrid, target: Target) -> NDArray[np.int32]:
        """Return how many of the earlier sweeps confirm that a target in each cell (cells, cells) would be seen.

        A sweep confirms a cell that it would have seen itself, if the line of sight from here was open as well: past
        the obstacles that it saw, those that several sweeps saw and those of the last sweep, whether they move or not.
        Computed once for a grid and a target; read-only.
        """
        if (grid, target) in self._confirmations:
            return self._confirmations[grid, target]
        total, there = np.zeros(grid.shape, np.int32), np.empty(grid.shape, np.bool_)
        x0_m, y0_m = np.array(grid.origin_m, np.float32)
        lines, where = _sight_lines(), (self.sensor_height_m, self.now.ground, grid, target)
        [whole] = returns_by_kind([lines], *where)
        # A sweep alone leaves gaps where it looked from afar or along a face, and the way seems open there.
        images = [self._obstacles_of(*pair) for pair in zip(self.earlier, self.now_from_earlier, strict=True)]
        remembered = np.minimum.reduce([self.obstacles(), *images[-1:]])
        for before, now_from_before, image in zip(self.earlier, self.now_from_earlier, images, strict=True):
            # Did it see the cell from where it was?
            before_from_now = now_from_before.inverse().as_matrix()[:2, [0, 1, 3]].astype(np.float32)
            seen = beam_evidence(before, grid, target).supports_claim()
            _look_up_mask(seen, x0_m, y0_m, np.float32(grid.cell_m), before_from_now, there)
            # Is the way from here to the cell open?
            depth_m = _obstacle_ranges(np.minimum(image, remembered), lines.azimuth, lines.slope)
            [open_] = returns_by_kind([Beams(lines.azimuth, lines.slope, depth_m)], *where)
            total += there & (open_ > np.float32(LEAST_VIEW) * whole)
        total.setflags(write=False)
        self._confirmations[grid, target] = total
        return total


def history_of(leveled: LeveledSweep, earlier: Sequence[Sweep | LeveledSweep], grid: BevGrid) -> History | None:
    """Return the history of a sweep, leveled on ``grid``, from ``earlier`` ones; None where there are none.

    Raises:
        ValueError: one of them has no pose.
    """
    before = [leveled_on(sweep, grid) for sweep in earlier]
    return History.of(leveled, [sweep for sweep in before if len(sweep.sweep)])


def _obstacle_points(before: LeveledSweep, now_from_before: Rigid) -> Floats:
    """Return the points (M, 3) of an earlier sweep on obstacles, in the ``level`` frame now."""
    transform = now_from_before.as_matrix()[:3].astype(np.float32)
    high = before.points[before.height_m > np.float32(OBSTACLE_HEIGHTS_M[0])]
    points: Floats = high @ transform[:, :3].T + transform[:, 3]
    return points


def _close_gaps(image: Floats) -> None:
    """Close the gaps between the rings and between the columns of one obstacle in an image (ROWS, COLUMNS)."""
    row_step, column_step = (SLOPES[1] - SLOPES[0]) / ROWS, 2 * np.pi / COLUMNS
    _fill_gaps(image, GAP_ROWS, np.float32(_SIMILAR), np.float32(SEEN_THROUGH_M / row_step))
    _fill_gaps(image.T, GAP_COLUMNS, np.float32(_SIMILAR), np.float32(SEEN_THROUGH_M / column_step))


@lru_cache(maxsize=1)
def _sight_lines() -> Beams:
    """Return lines of sight in every other row and column of the image of obstacles."""
    row, column = np.mgrid[:ROWS:SIGHT_STEP, :COLUMNS:SIGHT_STEP]
    azimuth = (column.ravel() + 0.5) * (2 * np.pi / COLUMNS) - np.pi
    slope = SLOPES[0] + (row.ravel() + 0.5) * ((SLOPES[1] - SLOPES[0]) / ROWS)
    return Beams(azimuth.astype(np.float32), slope.astype(np.float32), np.full(row.size, np.inf, np.float32))


@njit(cache=True, nogil=True, error_model="numpy")
def _look_up_mask(
    mask: Any, x0_m: Any, y0_m: Any, cell_m: Any, transform: Any, out: Any
) -> None:  # pragma: no cover - compiled
    """Write what a mask (cells, cells) of an earlier frame says where the center of each cell lies there."""
    cells, per_m = mask.shape[0], np.float32(1.0) / cell_m
    for i in range(cells):
        x = x0_m + (np.float32(i) + np.float32(0.5)) * cell_m
        for j in range(cells):
            y = y0_m + (np.float32(j) + np.float32(0.5)) * cell_m
            u = (transform[0, 0] * x + transform[0, 1] * y + transform[0, 2] - x0_m) * per_m
            v = (transform[1, 0] * x + transform[1, 1] * y + transform[1, 2] - y0_m) * per_m
            inside = u >= 0.0 and v >= 0.0 and u < cells and v < cells
            out[i, j] = inside and mask[int(u), int(v)]


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _map_cell(x: Any, y: Any) -> Any:  # pragma: no cover - compiled
    """Return the cell (i, j) of a point in the map of obstacles, at least one from the edge; i is -1 outside."""
    i = int(np.floor(x * np.float32(1.0 / MAP_CELL_M))) + MAP_CELLS // 2
    j = int(np.floor(y * np.float32(1.0 / MAP_CELL_M))) + MAP_CELLS // 2
    inside = (i >= 1) & (j >= 1) & (i < MAP_CELLS - 1) & (j < MAP_CELLS - 1)
    return (i if inside else -1), j


@njit(cache=True, nogil=True, error_model="numpy")
def _mark_cells(points: Any, number: Any, seen_by: Any) -> None:  # pragma: no cover - compiled
    """Enter a sweep's number in the cells (MAP_CELLS, MAP_CELLS) of its obstacles; ``_SEVERAL`` where another's is."""
    for n in range(points.shape[0]):
        i, j = _map_cell(points[n, 0], points[n, 1])
        if i >= 0:
            free = seen_by[i, j] == _NOBODY or seen_by[i, j] == number
            seen_by[i, j] = number if free else np.int32(_SEVERAL)


@njit(cache=True, nogil=True, error_model="numpy")
def _draw_obstacles(
    points: Any, sensor_height_m: Any, seen_by: Any, own: Any, image: Any
) -> None:  # pragma: no cover - compiled
    """Lower the image (ROWS, COLUMNS) to a sweep's obstacles (M, 3) that another one saw as well.

    ``own`` is the sweep's number; ``_NOBODY`` lets its own marks count and so takes them all.
    """
    for n in range(points.shape[0]):
        x, y = points[n, 0], points[n, 1]
        range_m = np.sqrt(x * x + y * y)
        i, j = _map_cell(x, y)
        if i < 0 or range_m < _NEAREST_M:
            continue
        # Is there a mark of another sweep in the cell or in one of its eight neighbors?
        confirmed = False
        for u in range(i - 1, i + 2):
            for v in range(j - 1, j + 2):
                confirmed |= (seen_by[u, v] != _NOBODY) & (seen_by[u, v] != own)
        if not confirmed:
            continue
        row, column = _pixel(atan2(y, x), (points[n, 2] - sensor_height_m) / range_m)
        if row >= 0:
            image[row, column] = min(image[row, column], range_m)


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_gaps(image: Any, gap: Any, ratio: Any, narrow: Any) -> None:  # pragma: no cover - compiled
    """Fill gaps of at most so many rows between pixels of a column with similar depths, as those between rings are.

    Pixels of something farther in a gap were seen from elsewhere. They are filled as well where the gap is narrow: of
    fewer than ``narrow`` rows at a meter.
    """
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            depth = image[row, column]
            if depth == np.inf:
                continue
            # Back to the nearest pixel that is no farther: of the same obstacle, or the gap is none of its own.
            before, seen_through = row - 1, False
            while before >= 0 and row - before <= gap and image[before, column] >= depth * ratio:
                seen_through |= image[before, column] < np.inf
                before -= 1
            if before < 0 or not 1 < row - before <= gap or depth >= image[before, column] * ratio:
                continue
            fill = max(depth, image[before, column])
            if not seen_through or (row - before) * fill < narrow:
                for between in range(before + 1, row):
                    image[between, column] = fill


@njit(cache=True, nogil=True, error_model="numpy")
def _obstacle_ranges(image: Any, azimuth: Any, slope: Any) -> Any:  # pragma: no cover - compiled
    """Return the remembered range (M,) in each direction; +inf for none."""
    range_m = np.full(azimuth.shape[0], np.inf, np.float32)
    for n in range(azimuth.shape[0]):
        row, column = _pixel(azimuth[n], slope[n])
        if row >= 0:
            range_m[n] = image[row, column]
    return range_m


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _pixel(azimuth: Any, slope: Any) -> Any:  # pragma: no cover - compiled
    """Return row and column of a direction in the image of obstacles; row -1 outside."""
    row = (slope - np.float32(SLOPES[0])) * np.float32(ROWS / (SLOPES[1] - SLOPES[0]))
    column = int((azimuth + np.float32(np.pi)) * np.float32(COLUMNS / (2 * np.pi)))
    inside = (row >= np.float32(0.0)) & (row < np.float32(ROWS))
    return (int(row) if inside else -1), min(max(column, 0), COLUMNS - 1)
