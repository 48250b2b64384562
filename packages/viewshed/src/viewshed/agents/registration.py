"""Poses put right within what agents say of their errors, by the surfaces that several of them see.

An honest agent that is half a degree off contradicts others as a dishonest one does. Messages carry the covariance of
their pose, so that the receiver may look, within it, for the pose at which the agent's surfaces lie on those of others:
a prior from the covariance, a likelihood from the surfaces that meet, and the mean of both (correlative scan matching;
Olson, 2009). What is left of a pose that is off is for the checks of views to find.

**Nobody buys freedom by stating large errors.** No pose moves by more than :data:`REACH` standard deviations, and
those that are stated count up to :data:`MOST_M` and :data:`MOST_TURN`. Agents that state that they have none stay where
they are.
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

MOST_M, MOST_TURN = 0.25, float(np.radians(0.6))
"""Larger standard deviations of a place, along each axis, and of a heading count as these."""

LEAST_M, LEAST_TURN = 0.03, float(np.radians(0.05))
"""Where both are smaller, a pose is left as it is."""

REACH = 2.0
"""Most standard deviations by which a pose is moved along each axis, or turned."""

_STEPS = np.linspace(-REACH, REACH, 5)

_NEAR_M = 45.0
"""Surfaces up to this range count."""

_MOST_SURFACES = 250
"""Of more surface cells of the agent that is moved every second, third, ... one counts."""

_FEWEST_MET = 30
"""Least number of them that must meet surfaces of others at some pose."""

_NATS_EACH = 0.25
"""Log-likelihood of a surface that meets one of another agent."""

_CELL_M, _CELLS = 0.25, 1024
"""Places in the world are kept in cells that repeat after 256 m, farther than two views overlap."""

_BITS = 32


@dataclass(frozen=True, slots=True)
class PoseStd:
    """What an agent says of the errors of its pose: standard deviations.

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
        """Return those of a covariance (6, 6) of x, y, z, roll, pitch and yaw: the larger one of both axes.

        Raises:
            ValueError: it is no covariance; see :func:`viewshed.geometry.pose_covariance_of`.
        """
        covariance = pose_covariance_of(covariance, "the covariance of a pose")
        place_m2 = float(np.linalg.eigvalsh(covariance[:2, :2])[-1])
        return cls(max(place_m2, 0.0) ** 0.5, max(float(covariance[5, 5]), 0.0) ** 0.5)

    @classmethod
    def stated_by(cls, sweep: Sweep) -> PoseStd:
        """Return those that a sweep states of its pose; the usual ones of what it leaves out."""
        if sweep.pose_covariance is None:
            return UNSTATED
        stated = cls.of(sweep.pose_covariance)
        # A table of places leaves out the turn, with a variance of 0.
        return cls(stated.place_m, stated.yaw or UNSTATED.yaw)

    @property
    def bounded(self) -> PoseStd:
        """What of it counts."""
        return PoseStd(min(self.place_m, MOST_M), min(self.yaw, MOST_TURN))

    @property
    def matters(self) -> bool:
        """Whether the pose may be put right."""
        return self.place_m >= LEAST_M or self.yaw >= LEAST_TURN


EXACT = PoseStd()
"""Of a pose without errors."""

UNSTATED = PoseStd(0.1, float(np.radians(0.3)))
"""Of a pose of which nobody states how certain it is: no localization is exact."""


def registered_poses(views: Sequence[FovEstimate], stds: Sequence[PoseStd]) -> list[Rigid]:
    """Return the poses of views, put right within their standard deviations; those that state none unchanged.

    Raises:
        ValueError: a view has no pose.
    """
    poses = []
    for view in views:
        if view.world_from_level is None:
            raise ValueError(f"the view of {view.agent} must have a pose: without one it cannot be put right")
        poses.append(view.world_from_level)
    if len(views) < 2 or not any(std.matters for std in stds):
        return poses
    surfaces = [surface_cells(view, 0.0, _NEAR_M) for view in views]
    # Who sees a surface where: a bit for each agent, so that its own can be left out.
    seen_by = np.zeros((_CELLS, _CELLS), np.uint32)
    for number, (own, pose) in enumerate(zip(surfaces, poses, strict=True)):
        _mark(seen_by, number, own, pose)
    # One after the other, the least certain first: each meets those before it where they were put.
    for number in sorted(range(len(views)), key=lambda k: -stds[k].bounded.place_m - 20.0 * stds[k].bounded.yaw):
        if stds[number].matters and len(surfaces[number]) >= _FEWEST_MET:
            own = surfaces[number]
            moved = _put_right(
                np.ascontiguousarray(own[:: -(-len(own) // _MOST_SURFACES)]),
                poses[number],
                stds[number],
                seen_by,
                number,
            )
            _mark(seen_by, number, own, poses[number], erase=True)
            _mark(seen_by, number, own, moved)
            poses[number] = moved
    return poses


def surface_cells(view: FovEstimate, nearest_m: float, farthest_m: float) -> F64:
    """Return the centers (S, 2) of the surface cells of a view between two ranges, in ``level``."""
    return _core.surface_cells(view.state, *view.grid.origin_m, view.grid.cell_m, nearest_m, farthest_m)


def agent_bit(number: int) -> int:
    """Return what stands for an agent in a map of who sees what."""
    return 1 << number % _BITS


def pose_numbers(pose: Rigid) -> F64:
    """Return x, y, z and yaw (4,) of an upright pose."""
    return np.append(pose.translation, pose.yaw)


def _mark(seen_by: NDArray[np.uint32], number: int, xy: F64, pose: Rigid, *, erase: bool = False) -> None:
    """Note that an agent sees surfaces half a meter wide at places (S, 2) of ``level``, or take that back."""
    _core.mark_surfaces(seen_by, xy, pose_numbers(pose), _CELL_M, agent_bit(number), wide=True, erase=erase)


def _put_right(xy: F64, pose: Rigid, std: PoseStd, seen_by: NDArray[np.uint32], number: int) -> Rigid:
    """Return the mean pose of an agent, given its surfaces (S, 2) in ``level`` and those that others see."""
    turns, shifts = _STEPS * std.bounded.yaw, _STEPS * std.bounded.place_m
    x_m, y_m = pose.translation[0] + shifts, pose.translation[1] + shifts
    met = _core.count_met(xy, pose.yaw + turns, x_m, y_m, _CELL_M, seen_by, agent_bit(number))
    if met.max() < _FEWEST_MET:
        return pose
    prior = -0.5 * _STEPS**2
    logs = _NATS_EACH * met + prior[:, None, None] + prior[:, None] + prior
    weight = np.exp(logs - logs.max())
    weight /= weight.sum()
    turn, x_m, y_m = (
        float(weight.sum(axis=axes) @ values) for axes, values in (((1, 2), turns), ((0, 2), shifts), ((0, 1), shifts))
    )
    return Rigid(np.eye(3), np.array([x_m, y_m, 0.0])) @ pose @ Rigid.from_yaw(turn)
