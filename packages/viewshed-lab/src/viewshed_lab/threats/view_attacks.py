"""Lies about a field of view: an agent claims to see more or less, from another place, or at another time.

Each lie takes the honest views and returns the claimed one. States and probabilities stay consistent, so that only the
content of the message can expose it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.geometry import Rigid
from viewshed.grid import polar_of_cells
from viewshed.objects.matching import corners_of

CLAIMED_PROB = np.float32(0.98)
"""Probability of a falsely claimed cell; a falsely denied cell has 1 minus this."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewLie:
    """Parameters of one agent's lie, constant during a scene."""

    azimuth: float  # direction of the lie, radians in ``level``
    amount: float  # size of the lie: share of the visible area, meters, degrees or seconds; see each lie


def over_claim(views: Sequence[FovEstimate], lie: ViewLie) -> FovEstimate:
    """Claim hidden and unknown cells free, in a wedge that makes the visible area larger by the share ``amount``."""
    now = views[-1]
    range_m, azimuth = polar_of_cells(now.grid)
    visible = now.visible()
    reach_m = 0.9 * float(range_m[visible].max(initial=0.0))
    denied = ~visible & (range_m < min(reach_m, 45.0))
    return _with_state(now, _wedge(denied, azimuth, lie, int(lie.amount * visible.sum())), CellState.FREE)


def under_claim(views: Sequence[FovEstimate], lie: ViewLie) -> FovEstimate:
    """Claim visible cells hidden, in a wedge that makes the visible area smaller by the share ``amount``."""
    now = views[-1]
    _, azimuth = polar_of_cells(now.grid)
    visible = now.visible()
    return _with_state(now, _wedge(visible, azimuth, lie, int(lie.amount * visible.sum())), CellState.HIDDEN)


def shifted_pose(views: Sequence[FovEstimate], lie: ViewLie) -> FovEstimate:
    """Claim a pose ``amount`` meters away, toward the azimuth."""
    now = views[-1]
    step = Rigid(np.eye(3), lie.amount * np.array([np.cos(lie.azimuth), np.sin(lie.azimuth), 0.0]))
    return replace(now, world_from_level=_pose(now) @ step)


def turned_pose(views: Sequence[FovEstimate], lie: ViewLie) -> FovEstimate:
    """Claim a yaw that is wrong by ``amount`` degrees, with the sign of the azimuth."""
    now = views[-1]
    return replace(now, world_from_level=_pose(now) @ Rigid.from_yaw(np.radians(np.copysign(lie.amount, lie.azimuth))))


def stale(views: Sequence[FovEstimate], lie: ViewLie) -> FovEstimate:
    """Claim the cells of the view ``amount`` seconds ago, at the current pose."""
    now = views[-1]
    if now.t_ns is None:
        raise ValueError("views must have times to be replayed, got none")
    target_ns = now.t_ns - round(1e9 * lie.amount)
    old = min(views, key=lambda view: abs((view.t_ns or 0) - target_ns))
    return replace(now, visible_prob=old.visible_prob, state=old.state)


def inflated_certainty(views: Sequence[FovEstimate], lie: ViewLie) -> FovEstimate:
    """Claim full certainty: probability 1 in visible cells and 0 elsewhere; ``amount`` is not used."""
    now = views[-1]
    return replace(now, visible_prob=np.where(now.visible(), np.float32(1.0), np.float32(0.0)))


def behind_own(views: Sequence[FovEstimate], lie: ViewLie) -> FovEstimate:
    """Claim random hidden patches free, in all directions; their area is the share ``amount`` of the visible area."""
    now = views[-1]
    hidden = now.state == CellState.HIDDEN
    rng = np.random.default_rng(int(1e6 * abs(lie.azimuth)))
    order = np.flatnonzero(hidden)
    # Take patches of 8 × 8 cells (4 m on roads) in random order.
    patch = rng.random((now.grid.cells // 8 + 1,) * 2)
    cells = np.unravel_index(order, now.grid.shape)
    rank = np.argsort(patch[cells[0] // 8, cells[1] // 8], kind="stable")
    chosen = np.zeros(now.grid.cells**2, np.bool_)
    chosen[order[rank[: int(lie.amount * now.visible().sum())]]] = True
    return _with_state(now, chosen.reshape(now.grid.shape), CellState.FREE)


def with_objects(view: FovEstimate, boxes: NDArray[np.float64]) -> FovEstimate:
    """Return the view with fake objects in boxes (K, 7) of ``level``: surfaces in them, hidden cells behind.

    An agent that fabricates objects, or whose LiDAR is spoofed, thus makes its view consistent with them.
    """
    range_m, azimuth = polar_of_cells(view.grid)
    for box in boxes:
        inside = _in_box(view, box)
        off = (azimuth - np.arctan2(box[1], box[0]) + np.pi) % (2 * np.pi) - np.pi
        corners = corners_of(box[None])[0]
        across = (np.arctan2(corners[:, 1], corners[:, 0]) - np.arctan2(box[1], box[0]) + np.pi) % (2 * np.pi) - np.pi
        near_m = range_m[inside].min(initial=np.inf)
        shadow = (off > across.min()) & (off < across.max()) & (range_m > near_m)
        # Returns come from the near side of the object.
        view = _with_state(view, shadow | inside, CellState.HIDDEN)
        view = _with_state(view, inside & (range_m < near_m + _DEPTH_M), CellState.SURFACE)
    return view


def without_objects(view: FovEstimate, boxes: NDArray[np.float64]) -> FovEstimate:
    """Return the view with free cells in boxes (K, 7) of ``level``; cells behind them stay hidden."""
    for box in boxes:
        view = _with_state(view, _in_box(view, box), CellState.FREE)
    return view


_DEPTH_M = 1.0
"""Depth of the near side of a claimed object."""

_MARGIN_M = 0.4
"""Margin of boxes on each side, as a surface covers whole cells."""


def _in_box(view: FovEstimate, box: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the mask (cells, cells) of cells with centers in a box (7,), with a margin."""
    offset = view.grid.centers - box[:2]
    cos, sin = np.cos(box[6]), np.sin(box[6])
    ahead, left = cos * offset[..., 0] + sin * offset[..., 1], cos * offset[..., 1] - sin * offset[..., 0]
    return np.asarray((np.abs(ahead) < box[3] / 2 + _MARGIN_M) & (np.abs(left) < box[4] / 2 + _MARGIN_M))


VIEW_LIES: dict[str, tuple[Callable[[Sequence[FovEstimate], ViewLie], FovEstimate], float]] = {
    lie.__name__: (lie, amount)
    for lie, amount in (
        (over_claim, 0.2),
        (behind_own, 0.2),
        (under_claim, 0.3),
        (shifted_pose, 1.0),
        (turned_pose, 2.0),
        (stale, 2.0),
        (inflated_certainty, 1.0),
    )
}
"""Lies by name, with their default amounts. A lie takes the agent's honest views, the one to forge last."""


def _wedge(cells: NDArray[np.bool_], azimuth: NDArray[np.float32], lie: ViewLie, count: int) -> NDArray[np.bool_]:
    """Return the mask (cells, cells) of the ``count`` of ``cells`` that are nearest in azimuth to the lie's."""
    off = np.abs((azimuth - lie.azimuth + np.pi) % (2 * np.pi) - np.pi)
    order = np.argsort(np.where(cells, off, np.inf), axis=None, kind="stable")
    out = np.zeros(cells.size, np.bool_)
    out[order[: min(count, int(cells.sum()))]] = True
    return out.reshape(cells.shape)


def _with_state(view: FovEstimate, cells: NDArray[np.bool_], state: CellState) -> FovEstimate:
    prob = 1 - CLAIMED_PROB if state == CellState.HIDDEN else CLAIMED_PROB
    return replace(
        view, visible_prob=np.where(cells, prob, view.visible_prob), state=np.where(cells, np.uint8(state), view.state)
    )


def _pose(view: FovEstimate) -> Rigid:
    if view.world_from_level is None:
        raise ValueError(f"the view of {view.agent} must have a pose to lie about it, got none")
    return view.world_from_level
