"""Views that lie: what an agent claims to see, held against itself and against others.

A view that claims too much convicts others, or hides a removal; one that claims too little escapes contradiction. Each
check makes one number of a claimed view, larger where it is more suspicious, NaN where it has nothing to look at. What
is large is not decided here: honest views err as well, and :class:`ViewScale` knows how much.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from viewshed.arrays import F64, Mask
from viewshed.detections import Detections
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.geometry import Rigid
from viewshed.monitor.score import SurpriseScale
from viewshed.objects.cells import SeenCells

AZIMUTHS, NEAREST_M, FARTHEST_M, STEP_M = 180, 2.0, 40.0, 0.5
"""Where views are compared: on rays from the sensor."""

MARGIN_M = 1.5
"""A surface has some depth of its own: what lies within this distance behind it is not yet behind it."""

SHIFT_M, TURNS = 2.0, np.radians(np.arange(-3.0, 3.1, 1.0))
"""Poses so far around the claimed one at which surfaces are compared with those of others."""

_TURNED = [Rigid.from_yaw(float(turn)).rotation[:2, :2] for turn in TURNS]

FEWEST_SURFACES = 30
"""Surface cells that two agents must share for their poses to be compared."""

MOST_SURFACES = 400
"""Of more surface cells every second, third, ... one is compared."""

ELEVATED_M = 4.0
"""Sensors higher than this look over cars: their views are compared with those of their kind."""

TALL_M = 10.0
"""Masts of the honest scenes are 4 to 8 m and 20 m high; those from here on err in their own way."""

HEIGHTS = 3
"""Where sensors are: among the traffic, above it, on tall masts."""

TALLEST_M = 22.0
"""What is usual for a sensor that is higher than all masts of the honest scenes is not known: it is not checked."""

SEEN_OVER_M, LOOKED_AT_M = 2.0, 1.2
"""An elevated sensor sees over surfaces of this height to targets of that height."""

MOST_OTHERS = 4
"""Most other agents, the nearest ones, with whose views one view is compared."""

LOOKS = 2
"""Number of an agent's last checks whose mean counts."""

USUAL, MOST = 0.5, 4.0
"""Surprise up to which a check says nothing, as suspicious as three honest views in ten, and the most that one says."""


@dataclass(frozen=True, eq=False)
class ClaimedView:
    """What one agent claims at one time, and what others claim at about that time.

    Attributes:
        estimate: its field of view, with a pose.
        detections: its objects, in ``level``.
        others: fields of view of other agents, with poses.

    Raises:
        ValueError: a view has no pose.
    """

    estimate: FovEstimate
    detections: Detections
    others: tuple[FovEstimate, ...] = ()

    def __post_init__(self) -> None:
        for view in (self.estimate, *self.others):
            if view.world_from_level is None:
                raise ValueError(f"the view of {view.agent} must have a pose; views without one cannot be compared")

    @property
    def elevated(self) -> bool:
        """Whether the sensor looks over cars."""
        return height_of(self.estimate) > 0

    @cached_property
    def _samples(self) -> tuple[F64, F64]:
        """Places (A, R, 2) on rays from the sensor, in ``level``, and their ranges (R,)."""
        azimuth = (np.arange(AZIMUTHS) + 0.5) * (2 * np.pi / AZIMUTHS) - np.pi
        range_m = np.arange(NEAREST_M, FARTHEST_M, STEP_M)
        rays = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
        return rays[:, None] * range_m[:, None], range_m

    @cached_property
    def _cells(self) -> SeenCells:
        """What the agent itself claims, looked up in ``level``."""
        return SeenCells(self.estimate.grid, self.estimate.state, Rigid.identity())

    @cached_property
    def _others(self) -> list[SeenCells]:
        """What the others claim, looked up in ``level`` of the agent."""
        return [SeenCells(other.grid, other.state, between(self.estimate, other)) for other in self.others]

    @cached_property
    def _own(self) -> NDArray[np.uint8]:
        """What the agent itself claims at the places, (A, R)."""
        return self._cells.states_at(self._samples[0])

    @cached_property
    def _theirs(self) -> NDArray[np.uint8]:
        """What the others claim at the places, (O, A, R)."""
        xy = self._samples[0]
        states = [other.states_at(xy) for other in self._others]
        return np.stack(states) if states else np.zeros((0, *xy.shape[:2]), np.uint8)

    def _behind(self, surfaces: Mask) -> Mask:
        """Return which places (A, R) lie behind one of the surfaces (A, R)."""
        range_m = self._samples[1]
        steps = round(MARGIN_M / STEP_M)
        first_m = np.where(surfaces, range_m, np.inf)
        # An elevated sensor sees the next target over a surface; from low ones everything behind it is hidden.
        height_m = self.estimate.basis.sensor_height_m if self.estimate.basis is not None else 0.0
        reach = (height_m - LOOKED_AT_M) / (height_m - SEEN_OVER_M) if self.elevated else np.inf
        hidden_to_m = np.maximum.accumulate(np.where(surfaces, range_m * reach, 0.0), axis=1)
        nearest_m = np.minimum.accumulate(first_m, axis=1)
        behind = np.zeros_like(surfaces)
        behind[:, steps:] = (nearest_m[:, :-steps] < np.inf) & (range_m[steps:] < hidden_to_m[:, :-steps])
        return behind

    def _share(self, part: Mask, whole: Mask) -> float:
        """Return the share of an area (A, R) that belongs to a part of it; NaN of nothing."""
        area = np.broadcast_to(self._samples[1], whole.shape)
        total = float(area[whole].sum())
        return float(area[part & whole].sum()) / total if total > 0 else np.nan


def between(to: FovEstimate, of: FovEstimate) -> Rigid:
    """Return the pose of one view's ``level`` frame in that of another, both with poses."""
    assert to.world_from_level is not None
    assert of.world_from_level is not None
    return to.world_from_level.inverse() @ of.world_from_level


def height_of(estimate: FovEstimate) -> int:
    """Return where the sensor of a view is, one of ``HEIGHTS``: 0 among the traffic, 1 above it, 2 on a tall mast."""
    basis = estimate.basis
    return 0 if basis is None else int(np.searchsorted((ELEVATED_M, TALL_M), basis.sensor_height_m))


def _is_too_tall(estimate: FovEstimate) -> bool:
    return estimate.basis is not None and estimate.basis.sensor_height_m > TALLEST_M


def _apart_m(one: FovEstimate, other: FovEstimate) -> float:
    assert one.world_from_level is not None
    assert other.world_from_level is not None
    return float(np.linalg.norm(one.world_from_level.translation - other.world_from_level.translation))


def _is_visible(state: NDArray[np.uint8]) -> Mask:
    visible: Mask = (state == CellState.FREE) | (state == CellState.SURFACE)
    return visible


def hidden_detections(view: ClaimedView) -> float:
    """Return the share of the agent's own objects that stand where it claims to see nothing."""
    boxes = view.detections.boxes
    range_m = np.hypot(boxes[:, 0], boxes[:, 1])
    near = (range_m > NEAREST_M) & (range_m < FARTHEST_M)
    if not near.any():
        return np.nan
    # An object hides its own center: any of its middle and its near side may be what is seen.
    scale = 1.0 - np.array([0.0, 0.5, 1.0, 1.3])[:, None] * boxes[near, 4] / 2 / range_m[near]
    states = view._cells.states_at(scale[..., None] * boxes[near, :2])
    return float(1.0 - _is_visible(states).any(axis=0).mean())


def claims_in_shadows(view: ClaimedView) -> float:
    """Return the share of the places close behind the agent's own objects that it claims to see."""
    boxes = view.detections.boxes
    range_m = np.hypot(boxes[:, 0], boxes[:, 1])
    casts = (range_m > NEAREST_M) & (range_m < FARTHEST_M) & (boxes[:, 3:5].min(axis=1) > 1.0)
    if not casts.any():
        return np.nan
    far_m = range_m[casts] + boxes[casts, 3:5].max(axis=1) / 2
    behind = (far_m[:, None] + np.array([0.5, 1.0, 1.5, 2.0])) / range_m[casts, None]
    return float(_is_visible(view._cells.states_at(behind[..., None] * boxes[casts, None, :2])).mean())


def claims_behind_walls(view: ClaimedView) -> float:
    """Return the share of what is claimed visible that lies behind surfaces which hide what is behind them for others.

    How tall a surface is no view says; that others see nothing behind one does.
    """
    xy, walls = view._samples[0], np.zeros(view._own.shape, np.bool_)
    for other, theirs in zip(view._others, view._theirs, strict=True):
        surfaces, place = theirs == CellState.SURFACE, other.frame_from_level.translation[:2]
        away = xy[surfaces] - place
        unit = away / np.maximum(np.hypot(*away.T), 1e-9)[:, None]
        behind = [other.states_at(xy[surfaces] + step_m * unit) == CellState.HIDDEN for step_m in (1.5, 2.5)]
        walls[surfaces] |= behind[0] & behind[1]
    return view._share(view._behind(walls), _is_visible(view._own)) if view.others else np.nan


def open_but_denied(view: ClaimedView) -> float:
    """Return the share of what nobody's surface hides from the agent that it claims not to see."""
    surfaces = (view._own == CellState.SURFACE) | (view._theirs == CellState.SURFACE).any(axis=0)
    known = _is_visible(view._own) | _is_visible(view._theirs).any(axis=0)
    return view._share(~_is_visible(view._own), ~view._behind(surfaces) & known)


def surfaces_claimed_free(view: ClaimedView) -> float:
    """Return the share of the surfaces that others see, in the agent's view, where it sees none and claims all free."""
    surfaces = (view._theirs == CellState.SURFACE).any(axis=0) & ~(view._theirs == CellState.FREE).any(axis=0)
    surfaces &= _is_visible(view._own)
    # Surfaces are seen from different sides, and lie a cell or two apart.
    about = np.stack(np.meshgrid(*[np.array([-1.0, -0.5, 0.0, 0.5, 1.0])] * 2), axis=-1).reshape(-1, 2)
    near = view._cells.states_at(view._samples[0][surfaces][:, None] + about)
    free = np.zeros_like(surfaces)
    free[surfaces] = (near == CellState.FREE).all(axis=1)
    return view._share(free, surfaces)


def surfaces_seen_free(view: ClaimedView) -> float:
    """Return the share of the agent's surfaces that others see free and nobody sees as surfaces."""
    free = (view._theirs == CellState.FREE).any(axis=0) & ~(view._theirs == CellState.SURFACE).any(axis=0)
    return view._share(free, (view._own == CellState.SURFACE) & _is_visible(view._theirs).any(axis=0))


def misplaced(view: ClaimedView) -> float:
    """Return how many more of the agent's surfaces lie on others' at another pose near the claimed one, as a share."""
    own = np.argwhere(view.estimate.state == CellState.SURFACE)
    if not view.others or len(own) < FEWEST_SURFACES:
        return np.nan
    own = own[:: -(-len(own) // MOST_SURFACES)]
    at = (own + 0.5) * view.estimate.grid.cell_m + view.estimate.grid.origin_m
    best = claimed = total = 0.0
    for other in view.others:
        pose, cell_m = between(other, view.estimate), other.grid.cell_m
        # Shifts are whole cells of the other's grid, and a border of them makes room: for each cell (x, y) of the view,
        # a window (X, X) of what lies about it.
        most = round(SHIFT_M / cell_m)
        surfaces = np.pad((other.state == CellState.SURFACE).astype(np.float32), most)
        about = sliding_window_view(surfaces, (2 * most + 1,) * 2)
        onto = np.empty((len(TURNS), (2 * most + 1) ** 2))
        for row, turn in zip(onto, _TURNED, strict=True):
            cells, inside = other.grid.index(at @ (pose.rotation[:2, :2] @ turn).T + pose.translation[:2])
            x, y = cells[inside].T
            row[:] = about[x, y].sum(axis=0).ravel()
        if onto.max() >= FEWEST_SURFACES:
            at_claim = onto[len(TURNS) // 2, onto.shape[1] // 2]
            best, claimed, total = best + onto.max(), claimed + at_claim, total + onto.max()
    return (best - claimed) / total if total else np.nan


def certainty(view: ClaimedView) -> float:
    """Return the share of the view within reach that is claimed as good as surely, seen or not."""
    prob = view.estimate.at(view._samples[0])
    sure = (prob > 0.99) | (prob < 0.01)
    return view._share(sure, _is_visible(view._own))


VIEW_CHECKS: dict[str, Callable[[ClaimedView], float]] = {
    "hidden_detections": hidden_detections,
    "claims_in_shadows": claims_in_shadows,
    "claims_behind_walls": claims_behind_walls,
    "open_but_denied": open_but_denied,
    "surfaces_claimed_free": surfaces_claimed_free,
    "surfaces_seen_free": surfaces_seen_free,
    "misplaced": misplaced,
    "certainty": certainty,
}
"""Every check by name."""


def check_view(view: ClaimedView, checks: Mapping[str, Callable[[ClaimedView], float]] = VIEW_CHECKS) -> F64:
    """Return what every check says of a view (C,), in the order of ``checks``; NaN where it abstains."""
    return np.array([check(view) for check in checks.values()])


@dataclass(frozen=True, slots=True, eq=False)
class ViewScale:
    """How rare numbers of checks are among honest views, of sensors among the traffic and of elevated ones.

    Attributes:
        low: of sensors among the traffic.
        elevated: of sensors that look over it.
    """

    low: SurpriseScale
    elevated: SurpriseScale

    @classmethod
    def fit(cls, low: NDArray[np.floating[Any]], elevated: NDArray[np.floating[Any]]) -> Self:
        """Return the scale of checks of honest views (N, C) and (M, C).

        Raises:
            ValueError: the checks differ.
        """
        if low.ndim != 2 or elevated.ndim != 2 or low.shape[1] != elevated.shape[1]:
            raise ValueError(f"checks must be (N, C) and (M, C) alike, got {low.shape} and {elevated.shape}")
        return cls(SurpriseScale.fit(low[..., None]), SurpriseScale.fit(elevated[..., None]))

    def to_json(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {
            name: [[[float(f"{one:.6g}") for one in row] for row in part] for part in (scale.values, scale.surprises)]
            for name, scale in (("low", self.low), ("elevated", self.elevated))
        }

    @classmethod
    def from_json(cls, table: Mapping[str, Any]) -> Self:
        """Return the scale in plain values."""
        return cls(*(SurpriseScale(*(np.array(part, np.float32) for part in table[name])) for name in cls.__slots__))

    def __call__(self, numbers: NDArray[np.floating[Any]], *, elevated: bool) -> F64:
        """Return the surprise (…, C) of numbers (…, C): -log10 of the share of honest views that are as suspicious.

        A check that abstains is no surprise.
        """
        rows = np.asarray(numbers, np.float64).reshape(-1, np.shape(numbers)[-1], 1)
        surprises = (self.elevated if elevated else self.low)(rows)[..., 0]
        return np.nan_to_num(surprises.astype(np.float64), nan=0.0).reshape(np.shape(numbers))


@dataclass(slots=True)
class CheckedViews:
    """Checks the views of agents in turn, one at a time, so that a round costs a bounded amount of work.

    Args:
        agents: how many there are.
    """

    agents: int
    _found: dict[int, tuple[F64, ...]] = field(default_factory=dict, repr=False)
    _last: list[int] = field(init=False, repr=False)
    _times: int = 0

    def __post_init__(self) -> None:
        self._last = [-1] * self.agents

    def regroup(self, kept: Sequence[int]) -> None:
        """Check the views of other agents: who stays keeps its last checks; ``kept`` are numbers so far, -1 for new."""
        self.agents = len(kept)
        self._found = {number: self._found[old] for number, old in enumerate(kept) if old in self._found}
        self._last = [-1 if old < 0 else self._last[old] for old in kept]

    def add(self, views: Mapping[int, tuple[FovEstimate, Detections]]) -> F64:
        """Return the mean of the last checks of each agent (A, C); NaN before there are ``LOOKS`` of them.

        Args:
            views: views and detections of one time, by the number of the agent.
        """
        self._times += 1
        known = [number for number, (estimate, _) in views.items() if not _is_too_tall(estimate)]
        if known:
            number = min(known, key=lambda one: (self._last[one], one))
            estimate, detections = views[number]
            # Others are the nearest ones: they see most of what the agent claims.
            others = sorted(
                (other for one, (other, _) in views.items() if one != number),
                key=lambda other: _apart_m(estimate, other),
            )
            view = ClaimedView(estimate, detections, tuple(others[:MOST_OTHERS]))
            self._found[number] = (*self._found.get(number, ()), check_view(view))[-LOOKS:]
            self._last[number] = self._times
        out = np.full((self.agents, len(VIEW_CHECKS)), np.nan)
        for number, rows in self._found.items():
            if len(rows) == LOOKS:
                spoke = np.isfinite(rows)
                some = spoke.any(axis=0)
                out[number, some] = np.where(spoke, rows, 0.0).sum(axis=0)[some] / spoke.sum(axis=0)[some]
        return out


def view_doubt(surprises: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return one number of the surprises (…, C) of several checks: what each is beyond the usual, added up.

    One check alone says no more than ``MOST``: an honest view may be odd in one way.

    >>> view_doubt(np.array([[0.3, 0.2, 0.4], [2.5, 0.1, 1.5]])).tolist()
    [0.0, 3.0]
    """
    beyond = np.clip(np.asarray(surprises, np.float64), USUAL, MOST) - USUAL
    return np.asarray(beyond.sum(axis=-1))
