"""Joint field of view of several agents on one grid of the world, and confirmation of claims by other agents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64, Mask
from viewshed.fov.estimate import THRESHOLD, CellState, FovEstimate, is_visible
from viewshed.fov.union import claimed_at
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid


@dataclass(frozen=True, slots=True, eq=False)
class JointFov:
    """Joint field of view of several agents on one grid of the world."""

    grid: BevGrid  # cells, relative to ``world_from_grid``
    world_from_grid: Rigid  # pose of the grid
    agents: tuple[str, ...]  # names of the agents
    # (cells, cells) probability that a trusted agent sees a target there; below the threshold where none claims to
    visible_prob: NDArray[np.float32]
    seen_by: NDArray[np.uint8]  # (cells, cells) uint8, number of agents that claim to see the cell
    # (cells, cells) int8 index of the agent with the highest probability, -1 where none sees the cell
    surest: NDArray[np.int8]
    # (cells, cells) uint8: the surest agent's SURFACE or FREE; HIDDEN where an agent says so and none sees the cell;
    # else UNKNOWN
    state: NDArray[np.uint8]

    def estimate(self, t_ns: int | None = None) -> FovEstimate:
        """Return it as a single estimate, to plot and save like others."""
        return FovEstimate(
            self.grid, self.visible_prob, self.state, method=f"joint view of {len(self.agents)}",
            world_from_level=self.world_from_grid, t_ns=t_ns, agent=" ".join(self.agents),
        )  # fmt: skip


def joint_fov(
    views: Sequence[FovEstimate], grid: BevGrid, world_from_grid: Rigid, trust: NDArray[np.floating] | None = None
) -> JointFov:
    """Return the joint field of view of views with poses, each weighted by the trust (A,) in its agent.

    A low threshold of an agent's own, or a probability in cells that it calls HIDDEN or UNKNOWN, is no claim.

    Raises:
        ValueError: a view has no pose, or the number of trust values differs.
    """
    weights = np.ones(len(views)) if trust is None else np.asarray(trust, np.float64)
    if len(weights) != len(views):
        raise ValueError(f"trust must be of {len(views)} views, got {len(weights)}")
    missed, seen_by = np.ones(grid.shape), np.zeros(grid.shape, np.uint8)
    max_prob, surest = np.zeros(grid.shape), np.full(grid.shape, -1, np.int8)
    state = np.full(grid.shape, CellState.UNKNOWN, np.uint8)
    for number, (view, weight) in enumerate(zip(views, weights, strict=True)):
        prob, claimed, sees = _seen_at(view, grid, world_from_grid, weight)
        state[(claimed == CellState.HIDDEN) & (surest < 0)] = CellState.HIDDEN
        missed *= 1.0 - prob
        seen_by += sees
        better = sees & (prob > max_prob)
        surest[better], state[better], max_prob[better] = number, claimed[better], prob[better]
    visible = np.where(seen_by > 0, 1.0 - missed, np.minimum(1.0 - missed, np.nextafter(np.float32(THRESHOLD), 0.0)))
    agents = tuple(view.agent for view in views)
    return JointFov(grid, world_from_grid, agents, visible.astype(np.float32), seen_by, surest, state)


def _seen_at(
    view: FovEstimate, grid: BevGrid, world_from_grid: Rigid, weight: float = 1.0
) -> tuple[F64, NDArray[np.uint8], Mask]:
    """Return weighted probability and state (cells, cells) of a view, and the mask of cells that it claims to see."""
    prob, state = claimed_at(view, grid, world_from_grid)
    return weight * prob, state, is_visible(state) & (weight * prob >= max(view.threshold, THRESHOLD))


def confirmed(
    view: FovEstimate, cells: Mask, others: Sequence[FovEstimate], trust: F64, least: float, votes: int = 1
) -> FovEstimate:
    """Return a view whose claims in some cells are UNKNOWN unless enough trusted agents confirm them.

    Args:
        view: with a pose.
        cells: (cells, cells) bool, cells that need confirmation: a wedge that opened, or all.
        others: views of other agents, with poses.
        trust: (O,) in the others.
        least: minimum trust of an agent that confirms.
        votes: minimum number of confirming agents; with two, a single liar confirms nothing.

    Raises:
        ValueError: a view has no pose.
    """
    if view.world_from_level is None:
        raise ValueError(f"the view of {view.agent} must have a pose: without one it cannot be confirmed")
    confirmations = np.zeros(view.grid.shape, np.uint8)
    for other, weight in zip(others, trust, strict=True):
        if weight >= least:
            confirmations += _seen_at(other, view.grid, view.world_from_level)[2]
    doubtful = cells & view.visible() & (confirmations < votes)
    prob = np.where(doubtful, np.minimum(view.visible_prob, np.float32(0.5 * view.threshold)), view.visible_prob)
    return replace(view, visible_prob=prob, state=np.where(doubtful, np.uint8(CellState.UNKNOWN), view.state))
