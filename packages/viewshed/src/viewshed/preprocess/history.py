"""History: what earlier sweeps of a moving sensor saw, seen from where the sensor is now.

A single sweep cannot tell a far return that somebody spoofed from a true one. But what stood there a moment ago and did
not move still stands there, whatever the beams say now; and a cell that an earlier sweep saw as well rests on two.
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
"""Earlier sweeps that are used."""


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class History:
    """What earlier sweeps saw, seen from the sensor now."""

    # the sweep now, with the ground and height that earlier ones hold; what is to be estimated
    now: LeveledSweep
    earlier: tuple[LeveledSweep, ...]  # the sweeps, any number of them, each with what those before it hold
    now_from_earlier: tuple[Rigid, ...]  # pose of the ``level`` frame of each in that of the sweep now
    _obstacles: list[F32] = field(default_factory=list, repr=False)
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

    def obstacles(self) -> F32:
        """Return the horizontal range of the nearest obstacle by slope and azimuth (rows, columns); +inf for none.

        An obstacle is what at least two earlier sweeps saw in one place of the map (or the only sweep): what moved was
        seen there once. Its edges are left out: a beam may pass beside them. Computed once; read-only.
        """
        if not self._obstacles:
            self._obstacles.append(self._obstacles_of(range(len(self.earlier))))
            self._obstacles[0].setflags(write=False)
        return self._obstacles[0]

    def _obstacles_of(self, numbers: Sequence[int]) -> F32:
        """Return the image (rows, columns) of the obstacles that some of the earlier sweeps saw."""
        clouds = []
        for number in numbers:
            before, transform = self.earlier[number], self.now_from_earlier[number].as_matrix()[:3]
            clouds.append((before.points, before.height_m, transform.astype(np.float32, order="C")))
        return _core.obstacle_image(clouds, OBSTACLE_HEIGHTS_M[0], self.sensor_height_m)

    def within(self, beams: Beams) -> Beams:
        """Return the beams, none deeper than the obstacle remembered in its direction."""
        return _ended(beams, self.obstacles())

    def confirmations(self, grid: BevGrid, target: Target) -> NDArray[np.int32]:
        """Return how many of the earlier sweeps confirm that a target in each cell (cells, cells) would be seen.

        A sweep confirms a cell that it would have seen itself, if the line of sight from here was open as well: past
        the obstacles that it saw, those that several sweeps saw and those of the last sweep, whether they move or not.
        Computed once for a grid and a target; read-only.
        """
        if (grid, target) in self._confirmations:
            return self._confirmations[grid, target]
        total = np.zeros(grid.shape, np.int32)
        lines, where = _sight_lines(), (self.sensor_height_m, self.now.ground, grid, target)
        whole, _ = expected_returns(lines, *where)
        # A sweep alone leaves gaps where it looked from afar or along a face, and the way seems open there.
        images = [self._obstacles_of([number]) for number in range(len(self.earlier))]
        remembered = np.minimum.reduce([self.obstacles(), *images[-1:]])
        for before, now_from_before, image in zip(self.earlier, self.now_from_earlier, images, strict=True):
            # Did it see the cell from where it was, and is the way from here to the cell open?
            before_from_now = now_from_before.inverse().as_matrix()[:2, [0, 1, 3]].astype(np.float32, order="C")
            seen = beam_evidence(before, grid, target).supports_claim()
            open_, _ = expected_returns(_ended(lines, np.minimum(image, remembered)), *where)
            total += _core.confirmed_cells(seen, before_from_now, *grid.origin_m, grid.cell_m, open_, whole)
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


def _ended(beams: Beams, image: F32) -> Beams:
    """Return the beams, none deeper than the obstacle of an image in its direction."""
    return Beams(beams.azimuth, beams.slope, _core.end_at_obstacles(image, *beams.arrays))


@lru_cache(maxsize=1)
def _sight_lines() -> Beams:
    """Return lines of sight in every fourth row and column of the image of obstacles."""
    azimuth, slope = _core.sight_lines()
    return Beams(azimuth, slope, np.full(len(slope), np.inf, np.float32))
