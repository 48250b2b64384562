"""Union of the fields of view of several LiDARs of one vehicle, on the grid of the first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid

SPREAD_S = 0.5
"""Maximum time between the sweeps of one union; moving objects are elsewhere after a longer time."""

TILT_DEG = 10.0
"""Maximum angle between the ground planes of two sensors; beyond it a mounting is wrong or lacks roll and pitch."""

_STATES_BY_RANK = np.array([CellState.UNKNOWN, CellState.HIDDEN, CellState.FREE, CellState.SURFACE], np.uint8)
"""States in ascending order of information; the state of highest rank wins."""


def union_of_views(views: Sequence[FovEstimate]) -> FovEstimate:
    """Return the union of the views of one vehicle's sensors, on the grid and in the level frame of the first.

    The probability of a cell is the maximum over the sensors: two uncertain sensors do not make a certain one, and
    returns of two sensors are not added up to reach the target's minimum. The state is the one of highest rank:
    SURFACE, FREE, HIDDEN, UNKNOWN.

    Raises:
        ValueError: there is no view, one has no pose, or their targets, thresholds, times or ground planes differ.
    """
    if not views:
        raise ValueError("views must be one or more, got none")
    first = views[0]
    for number, view in enumerate(views):
        if view.world_from_level is None:
            raise ValueError(
                f"each sweep of one vehicle must have its mounting, number {number} has none; give it as"
                " world_from_sensor, in one frame for all"
            )
        if (view.target, view.threshold) != (first.target, first.threshold):
            raise ValueError("views of one vehicle must be of one target and one threshold")
    times_ns = [view.t_ns for view in views if view.t_ns is not None]
    if times_ns and max(times_ns) - min(times_ns) > SPREAD_S * 1e9:
        raise ValueError(
            f"sweeps of one vehicle must be of one time, within {SPREAD_S:g} s, got"
            f" {1e-9 * (max(times_ns) - min(times_ns)):.1f} s; history takes earlier sweeps of one sensor"
        )
    poses = [view.world_from_level for view in views if view.world_from_level is not None]
    for number, pose in enumerate(poses):
        tilt_deg = np.degrees(np.arccos(np.clip(pose.rotation[:, 2] @ poses[0].rotation[:, 2], -1.0, 1.0)))
        if tilt_deg > TILT_DEG:
            raise ValueError(
                f"mountings must agree with the ground that the sweeps show: between sweeps 0 and {number} it differs"
                f" by {tilt_deg:.0f}°; give roll and pitch as well"
            )
    prob, rank = np.zeros(first.grid.shape), np.zeros(first.grid.shape, np.uint8)
    rank_of = np.argsort(_STATES_BY_RANK).astype(np.uint8)
    for view in views:
        own_prob, state = claimed_at(view, first.grid, poses[0])
        prob, rank = np.maximum(prob, own_prob), np.maximum(rank, rank_of[state])
    return replace(
        first, visible_prob=prob.astype(np.float32), state=_STATES_BY_RANK[rank], std=None, basis=None,
        agent=" ".join(dict.fromkeys(view.agent for view in views)),
    )  # fmt: skip


def claimed_at(view: FovEstimate, grid: BevGrid, world_from_grid: Rigid) -> tuple[F64, NDArray[np.uint8]]:
    """Return the probability float64 and state uint8 (cells, cells) of a view, resampled to another grid.

    Cells outside the view's own grid are 0 and UNKNOWN.

    Raises:
        ValueError: the view has no pose.
    """
    if view.world_from_level is None:
        raise ValueError(f"the view of {view.agent} must have a pose: without one it cannot be placed")
    pose = view.world_from_level.inverse() @ world_from_grid
    centers = grid.centers @ pose.rotation[:2, :2].T + pose.translation[:2]
    cells, inside = view.grid.index(centers)
    state = np.where(inside, view.state[cells[..., 0], cells[..., 1]], np.uint8(CellState.UNKNOWN))
    return np.nan_to_num(view.at(centers).astype(np.float64), nan=0.0), state
