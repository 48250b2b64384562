"""History: obstacles and views of earlier sweeps of a moving sensor, transformed to its current pose.

A single sweep cannot distinguish a spoofed far return from a true one. But a static obstacle of the last seconds is
still there, whatever the current beams say; and a cell that an earlier sweep saw too is confirmed by two sweeps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import F32
from viewshed.fov.visibility import Beams, Target, expected_returns
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.preprocess.evidence import beam_evidence
from viewshed.preprocess.held_ground import hold_over, pose_of
from viewshed.preprocess.leveling import OBSTACLE_HEIGHTS_M, LeveledSweep, leveled_on
from viewshed.sweep import Sweep

HISTORY_SWEEPS = 5
"""Default number of earlier sweeps."""


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class History:
    """Earlier sweeps and their poses relative to the current sweep."""

    # the current sweep, to be estimated, with ground and height carried over from earlier ones
    now: LeveledSweep
    earlier: tuple[LeveledSweep, ...]  # earlier sweeps, oldest first, each with ground and height carried over
    now_from_earlier: tuple[Rigid, ...]  # pose of each one's ``level`` frame in the current ``level`` frame
    _obstacles: list[F32] = field(default_factory=list, repr=False)
    _confirmations: dict[tuple[BevGrid, Target], NDArray[np.int32]] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, leveled: LeveledSweep, earlier: Sequence[LeveledSweep]) -> History | None:
        """Return the history of a sweep from ``earlier`` ones, leveled on the same grid; None if there are none.

        Raises:
            ValueError: a sweep has no pose.
        """
        if not earlier:
            return None
        *before, now = hold_over([*earlier, leveled])
        now_from_world = pose_of(now).inverse()
        poses = tuple(now_from_world @ pose_of(sweep) for sweep in before)
        return cls(now, tuple(before), poses)

    @property
    def sensor_height_m(self) -> float:
        """Height of the sensor above the ground in the current sweep, in meters."""
        return self.now.sensor_height_m

    def obstacles(self) -> F32:
        """Return the image (rows, columns) of the horizontal range of the nearest obstacle, +inf for none; cached.

        Rows are slopes, columns azimuths. At least two earlier sweeps (or the only one) must have seen an obstacle at
        the same place of the map; this excludes moving objects. Edges of obstacles are left out, because beams may pass
        beside them. The image is read-only.
        """
        if not self._obstacles:
            self._obstacles.append(self._obstacles_of(range(len(self.earlier))))
            self._obstacles[0].setflags(write=False)
        return self._obstacles[0]

    def _obstacles_of(self, numbers: Sequence[int]) -> F32:
        """Return the image (rows, columns) of the obstacles in the earlier sweeps with these indices."""
        clouds = []
        for number in numbers:
            before, transform = self.earlier[number], self.now_from_earlier[number].as_matrix()[:3]
            clouds.append((before.points, before.height_m, transform.astype(np.float32, order="C")))
        return _core.obstacle_image(clouds, OBSTACLE_HEIGHTS_M[0], self.sensor_height_m)

    def within(self, beams: Beams) -> Beams:
        """Return the beams with depths limited to the obstacle in their direction."""
        return _limited(beams, self.obstacles())

    def confirmations(self, grid: BevGrid, target: Target) -> NDArray[np.int32]:
        """Return (cells, cells) int32: the number of earlier sweeps that confirm that a target in each cell is visible.

        A sweep confirms a cell if it saw the cell, and if the line of sight from the current pose to the cell is free
        of the obstacles of that sweep, of several sweeps (:meth:`obstacles`) and of the last sweep, moving or not.
        Cached per grid and target; read-only.
        """
        if (grid, target) in self._confirmations:
            return self._confirmations[grid, target]
        total = np.zeros(grid.shape, np.int32)
        lines, scene = _sight_lines(), (self.sensor_height_m, self.now.ground, grid, target)
        all_lines, _ = expected_returns(lines, *scene)
        # The image of one sweep has gaps (far obstacles, grazing surfaces) through which lines of sight would pass.
        images = [self._obstacles_of([number]) for number in range(len(self.earlier))]
        static_and_last = np.minimum.reduce([self.obstacles(), *images[-1:]])
        for before, now_from_before, image in zip(self.earlier, self.now_from_earlier, images, strict=True):
            # Cells that the earlier sweep saw, and lines of sight from the current pose that are free.
            before_from_now = now_from_before.inverse().as_matrix()[:2, [0, 1, 3]].astype(np.float32, order="C")
            seen = beam_evidence(before, grid, target).supports_claim()
            free_lines, _ = expected_returns(_limited(lines, np.minimum(image, static_and_last)), *scene)
            total += _core.confirmed_cells(seen, before_from_now, *grid.origin_m, grid.cell_m, free_lines, all_lines)
        total.setflags(write=False)
        self._confirmations[grid, target] = total
        return total


def history_of(leveled: LeveledSweep, earlier: Sequence[Sweep | LeveledSweep], grid: BevGrid) -> History | None:
    """Return the history of a sweep, leveled on ``grid``, from ``earlier`` ones; None if all are empty or none given.

    Raises:
        ValueError: a sweep has no pose.
    """
    before = [leveled_on(sweep, grid) for sweep in earlier]
    return History.of(leveled, [sweep for sweep in before if len(sweep.sweep)])


def _limited(beams: Beams, image: F32) -> Beams:
    """Return the beams with depths limited to the obstacle in their direction of an obstacle image."""
    return Beams(beams.azimuth, beams.slope, _core.end_at_obstacles(image, *beams.arrays))


@lru_cache(maxsize=1)
def _sight_lines() -> Beams:
    """Return lines of sight in every fourth row and column of the obstacle image."""
    azimuth, slope = _core.sight_lines()
    return Beams(azimuth, slope, np.full(len(slope), np.inf, np.float32))
