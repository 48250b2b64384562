"""What earlier sweeps of a moving sensor tell of the one now: the obstacles that they saw, seen from where it is now.

A single sweep cannot tell a far return that somebody spoofed from a true one. But what stood there a moment ago and did
not move still stands there, whatever the beams say now.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.angles import atan2
from viewshed.bev import BevGrid
from viewshed.estimate import FovEstimate
from viewshed.geometry import Rigid
from viewshed.level import OBSTACLE_HEIGHTS_M, LevelSweep, level_sweep
from viewshed.sweep import Sweep
from viewshed.visible import Beams

PAST_SWEEPS = 5
"""Earlier sweeps that are looked at."""
COLUMNS = 720
"""Azimuth columns in which obstacles are remembered."""
SLOPES = (-0.75, 0.35)
"""Least and greatest rise over range at which obstacles are remembered, ..."""
ROWS = 160
"""... in so many steps of 0.4°."""
GAP_ROWS, GAP_COLUMNS = 20, 4
"""What lies at like depths at most so many rows or columns (8° or 2°) apart is one obstacle."""
_ALIKE = 1.25
_NEAREST_M = 1.0
Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Past:
    """What earlier sweeps saw, seen from the sensor now.

    Attributes:
        depth_m: (ROWS, COLUMNS) float32 horizontal range of the nearest obstacle by slope and azimuth that at least two
            earlier sweeps saw there (or the only one); +inf where they saw none. What moved was seen there once.
        points: (P, 2) float32 x and y of their returns in the ``level`` frame now.
    """

    depth_m: Floats
    points: Floats

    @classmethod
    def of(cls, level: LevelSweep, earlier: Sequence[LevelSweep]) -> Past | None:
        """Return what ``earlier`` sweeps tell of one, levelled on the same grid; None where there are none.

        Raises:
            ValueError: one of them has no pose.
        """
        if not earlier:
            return None
        now_from_world = _pose(level).inverse()
        images = np.full((len(earlier), ROWS, COLUMNS), np.inf, np.float32)
        points = []
        for image, before in zip(images, earlier, strict=True):
            transform = (now_from_world @ _pose(before)).as_matrix()[:3].astype(np.float32)
            obstacle = np.float32(OBSTACLE_HEIGHTS_M[0]), np.float32(level.sensor_height_m)
            points.append(_remember(before.points, before.height_m, transform, obstacle, image))
            _fill(image, GAP_ROWS, np.float32(_ALIKE))
            _fill(image.T, GAP_COLUMNS, np.float32(_ALIKE))
        return cls(_often(images), np.concatenate(points))

    def within(self, beams: Beams) -> Beams:
        """Return the beams, none deeper than the obstacle remembered in its direction."""
        depth_m = np.minimum(beams.depth_m, _depths(self.depth_m, beams.azimuth, beams.slope))
        return Beams(beams.azimuth, beams.slope, depth_m)

    def counts(self, grid: BevGrid) -> NDArray[np.int32]:
        """Return how many returns of the earlier sweeps lie in each cell (cells, cells)."""
        points = np.zeros((len(self.points), 3), np.float32)
        points[:, :2] = self.points
        return grid.count(points, Rigid(np.eye(3), np.zeros(3)))


@dataclass(slots=True)
class Memory:
    """The last sweeps of each agent of a stream, as many and as far apart as a :class:`Past` is made of.

    Attributes:
        sweeps: how many are kept of an agent.
        every_s: least time in seconds between two of them.
        forget_s: those from longer before are not used any more.
    """

    sweeps: int = PAST_SWEEPS
    every_s: float = 1.0
    forget_s: float = 10.0
    _kept: dict[str, deque[LevelSweep]] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        if self.sweeps < 1 or not (self.every_s >= 0.0 and self.forget_s > 0.0):
            raise ValueError(
                "sweeps must be at least 1, every_s at least 0 and forget_s above 0, got "
                f"{self.sweeps}, {self.every_s} and {self.forget_s}"
            )

    def past(self, level: LevelSweep) -> Past | None:
        """Return what is kept of a sweep's agent, seen from there; None for nothing, or without its pose or time."""
        now_ns, kept = level.sweep.t_ns, self._kept.get(level.sweep.agent, ())
        if now_ns is None or level.world_from_level is None:
            return None
        return Past.of(level, [each for each in kept if 0 < now_ns - (each.sweep.t_ns or 0) <= self.forget_s * 1e9])

    def add(self, level: LevelSweep) -> None:
        """Keep a sweep, if it has a pose and a time at least ``every_s`` after the last one that was kept.

        One from before it begins a new stream.
        """
        t_ns, kept = level.sweep.t_ns, self._kept.setdefault(level.sweep.agent, deque(maxlen=self.sweeps))
        if t_ns is None or level.world_from_level is None:
            return
        if kept and t_ns < (kept[-1].sweep.t_ns or 0):
            kept.clear()
        if not kept or t_ns - (kept[-1].sweep.t_ns or 0) >= self.every_s * 1e9:
            kept.append(level)


class PastEstimator(Protocol):
    """An estimator that earlier sweeps help."""

    @property
    def grid(self) -> BevGrid:
        """The grid of every estimate that comes back."""
        ...

    def estimate_level(self, level: LevelSweep, past: Past | None = None) -> FovEstimate:
        """Return the estimate for a sweep that is already levelled, and what earlier ones tell of it."""
        ...


@dataclass(frozen=True, slots=True)
class Remembering:
    """An estimator for a stream: each estimate uses what the agent's earlier sweeps saw.

    Sweeps without a pose or a time are estimated by themselves.

    Attributes:
        inner: what estimates.
        memory: what it is told of the past.
    """

    inner: PastEstimator
    memory: Memory = field(default_factory=Memory)

    @property
    def grid(self) -> BevGrid:
        """Grid of the estimates."""
        return self.inner.grid

    def estimate(self, sweep: Sweep) -> FovEstimate:
        """Return the estimate for the next sweep of the stream, and remember the sweep."""
        level = level_sweep(sweep, self.grid)
        found = self.inner.estimate_level(level, self.memory.past(level))
        self.memory.add(level)
        return found


def past_of(level: LevelSweep, earlier: Sequence[Sweep], grid: BevGrid) -> Past | None:
    """Return what ``earlier`` sweeps tell of one that was levelled on ``grid``; None where there are none.

    Raises:
        ValueError: one of them has no pose.
    """
    return Past.of(level, [level_sweep(sweep, grid) for sweep in earlier if len(sweep)])


def _pose(level: LevelSweep) -> Rigid:
    pose = level.world_from_level
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


@njit(cache=True, nogil=True, error_model="numpy")
def _often(images: Any) -> Any:  # pragma: no cover - compiled
    """Return (ROWS, COLUMNS) the second smallest of the images (sweeps, ROWS, COLUMNS), or the only one."""
    nearest, second = images[0].copy(), np.full_like(images[0], np.inf)
    for n in range(1, images.shape[0]):
        for row in range(nearest.shape[0]):
            for column in range(nearest.shape[1]):
                a, b = nearest[row, column], images[n, row, column]
                second[row, column] = min(second[row, column], max(a, b))
                nearest[row, column] = min(a, b)
    return second if images.shape[0] > 1 else nearest


@njit(cache=True, nogil=True, error_model="numpy")
def _remember(
    points: Any, height: Any, transform: Any, obstacle: Any, image: Any
) -> Any:  # pragma: no cover - compiled
    """Put the obstacles among points (M, 3) of another frame into an image; return x and y of all in this one."""
    least_m, sensor_m = obstacle
    flat = np.empty((points.shape[0], 2), np.float32)
    for n in range(points.shape[0]):
        px, py, pz = points[n, 0], points[n, 1], points[n, 2]
        x = transform[0, 0] * px + transform[0, 1] * py + transform[0, 2] * pz + transform[0, 3]
        y = transform[1, 0] * px + transform[1, 1] * py + transform[1, 2] * pz + transform[1, 3]
        flat[n, 0], flat[n, 1] = x, y
        range_m = np.sqrt(x * x + y * y)
        if height[n] <= least_m or range_m < _NEAREST_M:
            continue
        z = transform[2, 0] * px + transform[2, 1] * py + transform[2, 2] * pz + transform[2, 3]
        row, column = _pixel(atan2(y, x), (z - sensor_m) / range_m)
        if row >= 0:
            image[row, column] = min(image[row, column], range_m)
    return flat


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
