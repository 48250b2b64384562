"""What several views see together: those of the LiDARs of one vehicle on the grid of the first."""

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
"""Sweeps farther apart in time than this are not of one moment: what moves is somewhere else by then."""

TILT_DEG = 10.0
"""Mountings by which the ground of two sensors differs by more than this are wrong, or have no roll and pitch."""

_SAID_MOST = np.array([CellState.UNKNOWN, CellState.HIDDEN, CellState.FREE, CellState.SURFACE], np.uint8)
"""States from the one that says least: of several sensors, the one that says most of a cell decides."""


def union_of_views(views: Sequence[FovEstimate]) -> FovEstimate:
    """Return what the sensors of one vehicle see together, on the grid and in the level frame of the first.

    Each sensor has its own beams and its own view. A cell has the highest probability that a sensor gives it, so that
    nothing is claimed that no sensor claims: two sensors that doubt do not make one that is sure. SURFACE goes before
    FREE, FREE before HIDDEN, HIDDEN before UNKNOWN. Five returns of one sensor are needed, never those of two together.

    Raises:
        ValueError: there is no view, one has no pose, or their targets, thresholds or times differ.
    """
    if not views:
        raise ValueError("views must be one or more, got none")
    first = views[0]
    for number, view in enumerate(views):
        if view.world_from_level is None:
            raise ValueError(
                f"each sweep of one vehicle must have its mounting, number {number} has none; say it as"
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
                f"mountings must fit the ground that the sweeps show: by those of sweep 0 and {number} it differs by"
                f" {tilt_deg:.0f}°; state roll and pitch as well"
            )
    prob, rank = np.zeros(first.grid.shape), np.zeros(first.grid.shape, np.uint8)
    rank_of = np.argsort(_SAID_MOST).astype(np.uint8)
    for view in views:
        own_prob, state = claimed_at(view, first.grid, poses[0])
        prob, rank = np.maximum(prob, own_prob), np.maximum(rank, rank_of[state])
    return replace(
        first, visible_prob=prob.astype(np.float32), state=_SAID_MOST[rank], std=None, basis=None,
        agent=" ".join(dict.fromkeys(view.agent for view in views)),
    )  # fmt: skip


def claimed_at(view: FovEstimate, grid: BevGrid, world_from_grid: Rigid) -> tuple[F64, NDArray[np.uint8]]:
    """Return the probability and the state (cells, cells) that a view claims in the cells of another grid.

    Outside its own they are 0 and UNKNOWN.

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
