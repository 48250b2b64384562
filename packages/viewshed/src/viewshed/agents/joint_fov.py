"""What several agents see together, on one grid of the world; and claims that only others may confirm."""

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
    """What several agents see together, on one grid of the world."""

    grid: BevGrid  # where the cells are, about ``world_from_grid``
    world_from_grid: Rigid  # pose of the grid
    agents: tuple[str, ...]  # names
    # (cells, cells) probability that any trusted agent sees a target there; below the threshold where nobody claims so
    visible_prob: NDArray[np.float32]
    seen_by: NDArray[np.uint8]  # (cells, cells) uint8, how many agents claim to see it
    # (cells, cells) int8 number of the agent that sees it most surely, -1 where nobody sees it
    surest: NDArray[np.int8]
    # (cells, cells) uint8: SURFACE or FREE as the surest agent says, HIDDEN where somebody says so and nobody sees it,
    # UNKNOWN elsewhere
    state: NDArray[np.uint8]

    def estimate(self, t_ns: int | None = None) -> FovEstimate:
        """Return it as one estimate, to be drawn and saved as others are."""
        return FovEstimate(
            self.grid, self.visible_prob, self.state, method=f"joint view of {len(self.agents)}",
            world_from_level=self.world_from_grid, t_ns=t_ns, agent=" ".join(self.agents),
        )  # fmt: skip


def joint_fov(
    views: Sequence[FovEstimate], grid: BevGrid, world_from_grid: Rigid, trust: NDArray[np.floating] | None = None
) -> JointFov:
    """Return what views with poses see together; an agent's claims count by how far it is trusted (A,).

    Neither a low threshold of an agent's own nor a probability in cells that it calls HIDDEN or UNKNOWN is a claim.

    Raises:
        ValueError: a view has no pose, or there is another number of trusts.
    """
    weights = np.ones(len(views)) if trust is None else np.asarray(trust, np.float64)
    if len(weights) != len(views):
        raise ValueError(f"trust must be of {len(views)} views, got {len(weights)}")
    missed, seen_by = np.ones(grid.shape), np.zeros(grid.shape, np.uint8)
    most, surest = np.zeros(grid.shape), np.full(grid.shape, -1, np.int8)
    state = np.full(grid.shape, CellState.UNKNOWN, np.uint8)
    for number, (view, weight) in enumerate(zip(views, weights, strict=True)):
        prob, claimed, sees = _seen_at(view, grid, world_from_grid, weight)
        state[(claimed == CellState.HIDDEN) & (surest < 0)] = CellState.HIDDEN
        missed *= 1.0 - prob
        seen_by += sees
        better = sees & (prob > most)
        surest[better], state[better], most[better] = number, claimed[better], prob[better]
    visible = np.where(seen_by > 0, 1.0 - missed, np.minimum(1.0 - missed, np.nextafter(np.float32(THRESHOLD), 0.0)))
    agents = tuple(view.agent for view in views)
    return JointFov(grid, world_from_grid, agents, visible.astype(np.float32), seen_by, surest, state)


def _seen_at(
    view: FovEstimate, grid: BevGrid, world_from_grid: Rigid, weight: float = 1.0
) -> tuple[F64, NDArray[np.uint8], Mask]:
    """Return weighted probability and state (cells, cells) that a view claims, and where it claims to see."""
    prob, state = claimed_at(view, grid, world_from_grid)
    return weight * prob, state, is_visible(state) & (weight * prob >= max(view.threshold, THRESHOLD))


def confirmed(
    view: FovEstimate, cells: Mask, others: Sequence[FovEstimate], trust: F64, least: float, votes: int = 1
) -> FovEstimate:
    """Return a view that claims some cells only where trusted agents claim them as well; UNKNOWN elsewhere.

    Args:
        view: with a pose.
        cells: (cells, cells) bool, those in doubt: a wedge that opened, or all.
        others: views of other agents, with poses.
        trust: (O,) in the others.
        least: trust from which an agent may confirm.
        votes: least number of agents that must; with two, one liar alone confirms nothing.

    Raises:
        ValueError: a view has no pose.
    """
    if view.world_from_level is None:
        raise ValueError(f"the view of {view.agent} must have a pose: without one it cannot be confirmed")
    agreed = np.zeros(view.grid.shape, np.uint8)
    for other, one in zip(others, trust, strict=True):
        if one >= least:
            agreed += _seen_at(other, view.grid, view.world_from_level)[2]
    doubtful = cells & view.visible() & (agreed < votes)
    prob = np.where(doubtful, np.minimum(view.visible_prob, np.float32(0.5 * view.threshold)), view.visible_prob)
    return replace(view, visible_prob=prob, state=np.where(doubtful, np.uint8(CellState.UNKNOWN), view.state))
