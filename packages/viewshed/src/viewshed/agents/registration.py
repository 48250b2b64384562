"""Correct poses within their stated errors, by the surfaces that several agents see.

An honest agent whose heading is off by half a degree contradicts others just as a liar does. Messages carry the
covariance of their pose, so the receiver can search within it for the pose at which the agent's surfaces lie on those
of others: a prior from the covariance, a likelihood from coinciding surfaces, and the posterior mean (correlative scan
matching; Olson, 2009). The remaining pose error is left to the view comparisons.

**Large stated errors buy no freedom.** A pose moves by at most :data:`REACH` standard deviations, and stated ones count
up to :data:`MAX_STD_M` and :data:`MAX_YAW_STD`. Agents that state no errors keep their poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import F64
from viewshed.fov.estimate import FovEstimate
from viewshed.geometry import Rigid, pose_covariance_of
from viewshed.sweep import Sweep

MAX_STD_M, MAX_YAW_STD = 0.25, float(np.radians(0.6))
"""Caps of the standard deviations of a position along each axis, and of a heading in radians."""

MIN_STD_M, MIN_YAW_STD = 0.03, float(np.radians(0.05))
"""A pose is left unchanged if both standard deviations are below these."""

REACH = 2.0
"""Maximum correction along each axis and of the heading, in standard deviations."""

_STEPS = np.linspace(-REACH, REACH, 5)

_NEAR_M = 45.0
"""Maximum range of surfaces."""

_MAX_SURFACES = 250
"""Maximum number of surface cells of the moved agent; more are thinned evenly."""

_MIN_MATCHES = 30
"""Minimum number of these cells that coincide with others' surfaces at some pose."""

_NATS_PER_MATCH = 0.25
"""Log-likelihood of a surface cell that coincides with another agent's."""

_CELL_M, _CELLS = 0.25, 1024
"""Cell size and number of cells of the map of surfaces; it repeats after 256 m, farther than two views overlap."""

_BITS = 32


@dataclass(frozen=True, slots=True)
class PoseStd:
    """Standard deviations that an agent states for its pose.

    Raises:
        ValueError: a number is negative or not finite.
    """

    place_m: float = 0.0  # along each horizontal axis
    yaw: float = 0.0  # of the heading, radians

    def __post_init__(self) -> None:
        if not (0.0 <= self.place_m < np.inf and 0.0 <= self.yaw < np.inf):
            raise ValueError(f"standard deviations must be finite and not negative, got {self.place_m} and {self.yaw}")

    @classmethod
    def of(cls, covariance: NDArray[np.floating[Any]]) -> Self:
        """Return the standard deviations of a covariance (6, 6) of x, y, z, roll, pitch, yaw; the larger of both axes.

        Raises:
            ValueError: it is not a covariance; see :func:`viewshed.geometry.pose_covariance_of`.
        """
        covariance = pose_covariance_of(covariance, "the covariance of a pose")
        place_m2 = float(np.linalg.eigvalsh(covariance[:2, :2])[-1])
        return cls(max(place_m2, 0.0) ** 0.5, max(float(covariance[5, 5]), 0.0) ** 0.5)

    @classmethod
    def stated_by(cls, sweep: Sweep) -> PoseStd:
        """Return the standard deviations that a sweep states for its pose, with defaults for missing ones."""
        if sweep.pose_covariance is None:
            return UNSTATED
        stated = cls.of(sweep.pose_covariance)
        # A table of positions has no heading errors: their variance is 0.
        return cls(stated.place_m, stated.yaw or UNSTATED.yaw)

    @property
    def bounded(self) -> PoseStd:
        """The standard deviations, capped."""
        return PoseStd(min(self.place_m, MAX_STD_M), min(self.yaw, MAX_YAW_STD))

    @property
    def matters(self) -> bool:
        """Whether the errors are large enough to correct the pose."""
        return self.place_m >= MIN_STD_M or self.yaw >= MIN_YAW_STD


EXACT = PoseStd()
"""Standard deviations of a pose without errors."""

UNSTATED = PoseStd(0.1, float(np.radians(0.3)))
"""Default of a pose without stated errors: no localization is exact."""


def registered_poses(views: Sequence[FovEstimate], stds: Sequence[PoseStd]) -> list[Rigid]:
    """Return the poses of views, corrected within their standard deviations; those without stated errors are unchanged.

    Raises:
        ValueError: a view has no pose.
    """
    poses = []
    for view in views:
        if view.world_from_level is None:
            raise ValueError(f"the view of {view.agent} must have a pose: without one it cannot be aligned")
        poses.append(view.world_from_level)
    if len(views) < 2 or not any(std.matters for std in stds):
        return poses
    surfaces = [surface_cells(view, 0.0, _NEAR_M) for view in views]
    # Bit mask per map cell of the agents that see a surface there, so that an agent's own can be left out.
    seen_by = np.zeros((_CELLS, _CELLS), np.uint32)
    for number, (agent_surfaces, pose) in enumerate(zip(surfaces, poses, strict=True)):
        _mark(seen_by, number, agent_surfaces, pose)
    # Correct one after the other, the least certain first, against the poses corrected so far.
    for number in sorted(range(len(views)), key=lambda k: -stds[k].bounded.place_m - 20.0 * stds[k].bounded.yaw):
        if stds[number].matters and len(surfaces[number]) >= _MIN_MATCHES:
            agent_surfaces = surfaces[number]
            corrected = _corrected_pose(
                np.ascontiguousarray(agent_surfaces[:: -(-len(agent_surfaces) // _MAX_SURFACES)]),
                poses[number],
                stds[number],
                seen_by,
                number,
            )
            _mark(seen_by, number, agent_surfaces, poses[number], erase=True)
            _mark(seen_by, number, agent_surfaces, corrected)
            poses[number] = corrected
    return poses


def surface_cells(view: FovEstimate, nearest_m: float, farthest_m: float) -> F64:
    """Return the centers (S, 2) of a view's surface cells between two ranges, in ``level``."""
    return _core.surface_cells(view.state, *view.grid.origin_m, view.grid.cell_m, nearest_m, farthest_m)


def agent_bit(number: int) -> int:
    """Return the bit of an agent in a map of surfaces."""
    return 1 << number % _BITS


def pose_numbers(pose: Rigid) -> F64:
    """Return x, y, z and yaw (4,) of an upright pose."""
    return np.append(pose.translation, pose.yaw)


def _mark(seen_by: NDArray[np.uint32], number: int, xy: F64, pose: Rigid, *, erase: bool = False) -> None:
    """Set or erase an agent's bit at surfaces (S, 2) of ``level``, each half a meter wide."""
    _core.mark_surfaces(seen_by, xy, pose_numbers(pose), _CELL_M, agent_bit(number), wide=True, erase=erase)


def _corrected_pose(xy: F64, pose: Rigid, std: PoseStd, seen_by: NDArray[np.uint32], number: int) -> Rigid:
    """Return the posterior mean pose of an agent, given its surfaces (S, 2) in ``level`` and those of others."""
    turns, shifts = _STEPS * std.bounded.yaw, _STEPS * std.bounded.place_m
    x_m, y_m = pose.translation[0] + shifts, pose.translation[1] + shifts
    matches = _core.count_met(xy, pose.yaw + turns, x_m, y_m, _CELL_M, seen_by, agent_bit(number))
    if matches.max() < _MIN_MATCHES:
        return pose
    prior = -0.5 * _STEPS**2
    logs = _NATS_PER_MATCH * matches + prior[:, None, None] + prior[:, None] + prior
    weight = np.exp(logs - logs.max())
    weight /= weight.sum()
    turn, x_m, y_m = (
        float(weight.sum(axis=axes) @ values) for axes, values in (((1, 2), turns), ((0, 2), shifts), ((0, 1), shifts))
    )
    return Rigid(np.eye(3), np.array([x_m, y_m, 0.0])) @ pose @ Rigid.from_yaw(turn)
