"""Poses that no vehicle can have: too far from the last one, off the map, or of unknown place."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from viewshed.agents.report import AgentReport

MOST_MPS = 70.0
"""No agent drives faster."""

DEVIATIONS = 3.0
"""Number of standard deviations of its place that are allowed for beside."""

MOST_M = 1e7
"""Coordinates are no larger."""

MOST_STD_M = 1e3
"""Whose place is less certain than this says nothing of any place: a covariance beyond (1 km)²."""

LATE_S, AHEAD_S = 1.0, 0.5
"""Most seconds by which an agent's clock may be before and after the arrival of a report."""

AGREEING = 3
"""Number of refused poses in a row, agreeing with each other, that are a new beginning."""


@dataclass(frozen=True, slots=True, eq=False)
class _Fix:
    """Where an agent was: by its own clock, by that of the receiver, and how certainly."""

    t_s: float
    arrived_s: float
    place_m: NDArray[np.float64]
    std_m: float

    def reach_m(self, other: _Fix) -> float:
        """Return how far from here another pose may be."""
        # Either clock may stand still for a while: messages arrive in bursts, and an agent's clock may be set back.
        seconds = max(other.t_s - self.t_s, other.arrived_s - self.arrived_s, 0.0)
        return MOST_MPS * seconds + DEVIATIONS * float(np.hypot(self.std_m, other.std_m))

    def apart_m(self, other: _Fix) -> float:
        """Return how far from here another pose is."""
        return float(np.linalg.norm(other.place_m - self.place_m))

    def agrees(self, other: _Fix) -> bool:
        """Return whether an agent can have come from here to another pose."""
        return self.apart_m(other) <= self.reach_m(other)


@dataclass(slots=True)
class Kinematics:
    """Follows the poses that one agent reports."""

    refused: int = 0
    """Reports refused so far."""
    _last: _Fix | None = None
    _doubted: list[_Fix] = field(default_factory=list, repr=False)

    def problem_of(self, t_s: float, arrived_s: float, report: AgentReport) -> str | None:
        """Return what is wrong with the pose of the next report, a sentence; None where it is taken.

        Args:
            t_s: its time by the agent's clock.
            arrived_s: when it came, by the receiver's clock.
            report: of the agent, always the same one.
        """
        problem = self._range_problem(report)
        own_s = min(max(t_s, arrived_s - LATE_S), arrived_s + AHEAD_S)
        fix = _Fix(own_s, arrived_s, report.world_from_level.translation, report.pose_std.place_m)
        if problem is None and self._last is not None and not self._last.agrees(fix):
            # Refused poses that follow from each other: the agent is there, and the old place was wrong.
            follows = bool(self._doubted) and self._doubted[-1].agrees(fix)
            self._doubted = [*(self._doubted if follows else ()), fix]
            if len(self._doubted) < AGREEING:
                problem = (
                    f"its pose must be within {self._last.reach_m(fix):.1f} m of its last one ({MOST_MPS:g} m/s and"
                    f" {DEVIATIONS:g} standard deviations), got {self._last.apart_m(fix):.1f} m; check its localization"
                )
        elif problem is not None:
            self._doubted = []
        if problem is not None:
            self.refused += 1
            return problem
        self._last, self._doubted = fix, []
        return None

    @staticmethod
    def _range_problem(report: AgentReport) -> str | None:
        """Return which number of a report no vehicle can have."""
        places = (report.world_from_level.translation, report.detections.boxes[:, :6])
        farthest_m = max(float(np.abs(place).max(initial=0.0)) for place in places)
        if not farthest_m <= MOST_M:
            return f"coordinates must be at most {MOST_M:g} m, got {farthest_m:g} m; check its localization"
        if not report.pose_std.place_m <= MOST_STD_M:
            return (
                f"the standard deviation of its place must be at most {MOST_STD_M:g} m, got"
                f" {report.pose_std.place_m:g} m; wait for its localization"
            )
        return None
