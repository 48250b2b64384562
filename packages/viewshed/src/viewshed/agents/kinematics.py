"""Refuse poses that no vehicle can have: too far from the last one, out of range, or too uncertain."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from viewshed.agents.report import AgentReport

MAX_MPS = 70.0
"""Maximum speed of an agent."""

DEVIATIONS = 3.0
"""Standard deviations of the position that are allowed in addition."""

MAX_COORDINATE_M = 1e7
"""Maximum absolute coordinate."""

MAX_STD_M = 1e3
"""Maximum standard deviation of a position; beyond it (a covariance over (1 km)²) a position tells nothing."""

LATE_S, AHEAD_S = 1.0, 0.5
"""Maximum lag and lead in seconds of a time stamp against the arrival of its report; larger ones are clipped."""

AGREEING = 3
"""Number of consecutive refused poses, consistent with each other, after which they are accepted as a new start."""


@dataclass(frozen=True, slots=True, eq=False)
class _Fix:
    """Position of an agent with its two time stamps and its standard deviation."""

    t_s: float
    arrived_s: float
    place_m: NDArray[np.float64]
    std_m: float

    def reach_m(self, other: _Fix) -> float:
        """Return the maximum plausible distance to another fix."""
        # Use the larger time difference: messages may arrive in bursts, and the agent's clock may be set back.
        seconds = max(other.t_s - self.t_s, other.arrived_s - self.arrived_s, 0.0)
        return MAX_MPS * seconds + DEVIATIONS * float(np.hypot(self.std_m, other.std_m))

    def apart_m(self, other: _Fix) -> float:
        """Return the distance to another fix."""
        return float(np.linalg.norm(other.place_m - self.place_m))

    def agrees(self, other: _Fix) -> bool:
        """Return whether an agent can have moved from here to another fix."""
        return self.apart_m(other) <= self.reach_m(other)


@dataclass(slots=True)
class Kinematics:
    """Checks the successive poses of one agent."""

    refused: int = 0
    """Number of reports refused so far."""
    _last: _Fix | None = None
    _refused_fixes: list[_Fix] = field(default_factory=list, repr=False)

    def problem_of(self, t_s: float, arrived_s: float, report: AgentReport) -> str | None:
        """Return a sentence on what is wrong with the pose of the next report, or None if it is accepted.

        Args:
            t_s: time of the report by the agent's clock.
            arrived_s: arrival time by the receiver's clock.
            report: of the same agent in all calls.
        """
        problem = self._range_problem(report)
        clipped_s = min(max(t_s, arrived_s - LATE_S), arrived_s + AHEAD_S)
        fix = _Fix(clipped_s, arrived_s, report.world_from_level.translation, report.pose_std.place_m)
        if problem is None and self._last is not None and not self._last.agrees(fix):
            # Refused poses that are consistent with each other: the agent is there, and the old position was wrong.
            is_consistent = bool(self._refused_fixes) and self._refused_fixes[-1].agrees(fix)
            self._refused_fixes = [*(self._refused_fixes if is_consistent else ()), fix]
            if len(self._refused_fixes) < AGREEING:
                problem = (
                    f"its pose must be within {self._last.reach_m(fix):.1f} m of its last one ({MAX_MPS:g} m/s and"
                    f" {DEVIATIONS:g} standard deviations), got {self._last.apart_m(fix):.1f} m; check its localization"
                )
        elif problem is not None:
            self._refused_fixes = []
        if problem is not None:
            self.refused += 1
            return problem
        self._last, self._refused_fixes = fix, []
        return None

    @staticmethod
    def _range_problem(report: AgentReport) -> str | None:
        """Return a sentence on a number of a report that is out of range, or None."""
        places = (report.world_from_level.translation, report.detections.boxes[:, :6])
        farthest_m = max(float(np.abs(place).max(initial=0.0)) for place in places)
        if not farthest_m <= MAX_COORDINATE_M:
            return f"coordinates must be at most {MAX_COORDINATE_M:g} m, got {farthest_m:g} m; check its localization"
        if not report.pose_std.place_m <= MAX_STD_M:
            return (
                f"the standard deviation of its place must be at most {MAX_STD_M:g} m, got"
                f" {report.pose_std.place_m:g} m; wait for its localization"
            )
        return None
