"""Evidence against the cells of the last ten seconds: static surfaces that vanish, obstacles that appear from nowhere.

Two sweeps cannot distinguish a vanished object from an edge, a fence or a thin pole, which some beams hit and some
miss. Cells fixed in the world can: a surface counts as gone only if nearly all sweeps of a second saw it, and an
obstacle as new only if no sweep of the last ten seconds saw one there. Sweeps without poses are not remembered.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import F32
from viewshed.geometry import Rigid
from viewshed.monitor.evidence.base import ABSTAINS, SECTORS, MonitoredSweep
from viewshed.monitor.evidence.history import FOLLOWED, USUAL_GAP_S, compare, transform_rows, view_of
from viewshed.preprocess.leveling import LeveledSweep

MIN_SWEEPS = 12
"""Minimum number of remembered sweeps (a second) before the memory is used."""

FAR_M = 2000.0
"""The memory restarts farther than this from its origin, because cell numbers are limited."""


@dataclass(slots=True, eq=False, weakref_slot=True)
class CellMemory:
    """The obstacles of the last ten seconds of a stream, in cells of half a meter fixed in the world.

    Attributes:
        sweeps: number of sweeps added since the memory began.
    """

    sweeps: int = 0
    _cells: _core.CellMemory = field(default_factory=_core.CellMemory, repr=False)
    _origin_m: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3), repr=False)
    _begin_ns: int = 0

    def copy(self) -> CellMemory:
        """Return an independent copy."""
        return CellMemory(self.sweeps, self._cells.copy(), self._origin_m, self._begin_ns)

    def add(self, leveled: LeveledSweep) -> None:
        """Remember the obstacles of a sweep; ignored without a pose or rings."""
        view, pose, now_ns = view_of(leveled), leveled.sweep.world_from_sensor, leveled.sweep.t_ns
        if view is None or pose is None:
            return
        if self.sweeps == 0 or self._is_far(pose):
            self.sweeps, self._cells = 0, _core.CellMemory()
            self._origin_m, self._begin_ns = pose.translation.copy(), now_ns or 0
        self._cells.add(view, self._memory_from(pose), self._from_memory(pose), self._seconds_at(now_ns))
        self.sweeps += 1

    def check(self, monitored: MonitoredSweep) -> tuple[F32, F32] | None:
        """Return gone surfaces and new obstacles (SECTORS,), see ``_core.CellMemory.check``; None if not comparable."""
        now = monitored.leveled
        view, pose, comparison = view_of(now), now.sweep.world_from_sensor, compare(monitored)
        if view is None or pose is None or comparison is None or self.sweeps < MIN_SWEEPS or self._is_far(pose):
            return None
        return self._cells.check(
            view, self._from_memory(pose), self._seconds_at(now.sweep.t_ns), comparison.earlier[:FOLLOWED],
            comparison.to_earlier[:FOLLOWED], comparison.gaps_s[:FOLLOWED], SECTORS,
        )  # fmt: skip

    def _is_far(self, pose: Rigid) -> bool:
        return float(np.abs(pose.translation - self._origin_m).max()) > FAR_M

    def _seconds_at(self, t_ns: int | None) -> float:
        """Return the seconds since the memory began; without times by the number of sweeps."""
        return self.sweeps * USUAL_GAP_S if t_ns is None else (t_ns - self._begin_ns) * 1e-9

    def _memory_from(self, pose: Rigid) -> F32:
        return transform_rows(pose.rotation, pose.translation - self._origin_m)

    def _from_memory(self, pose: Rigid) -> F32:
        back = pose.rotation.T
        return transform_rows(back, back @ (self._origin_m - pose.translation))


def _part(part: int) -> Callable[[MonitoredSweep], F32]:
    """Return the measure of one part of ``CellMemory.check``; it abstains without a memory, poses or rings."""

    def measure(monitored: MonitoredSweep) -> F32:
        if monitored.memory is None:
            return ABSTAINS
        # Cached: both kinds of evidence come from one check.
        key = ("cells", ref(monitored.memory), monitored.memory.sweeps)
        if key not in monitored.leveled.derived:
            monitored.leveled.derived[key] = monitored.memory.check(monitored)
        contradictions: tuple[F32, F32] | None = monitored.leveled.derived[key]
        return ABSTAINS if contradictions is None else contradictions[part]

    return measure


measure_gone, measure_new = map(_part, range(2))
