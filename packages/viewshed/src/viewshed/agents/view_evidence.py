"""What claimed views say against their agents, compared with each other over their own ground, and with their past.

Each comparison is a number that is small between honest views. Two views are compared where both stand on the same
ground, so that crests, decks and quarries are no lies: of *i* and *j*,

- *through*: the share of *j*'s surfaces, where *i* claims to see, about which *i* claims all free;
- *denied*: the share of what *j* sees free, with no surface of anybody before it, that *i* claims hidden;

and one agent's view with its own last one, and with all others':

- *opened*, *closed*: by how much more of the area around it appeared than vanished, and by how much more was hidden
  than came out; what is unknown now says nothing;
- *misplaced*: how many more of its surfaces lie on others' at another pose near the claimed one.

:class:`Surprises` holds how rare each number is where nobody lies. A view that claims too much speaks against all that
see surfaces there, and opens at once; one that claims too little denies and closes; one that is old or elsewhere sees
through surfaces, and others through its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from viewshed.agents.report import AgentReport
from viewshed.arrays import F64, Mask
from viewshed.fov.estimate import CellState
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.objects.cells import COARSE, footprint_points

PAIR, OWN = ("through", "denied"), ("opened", "closed", "misplaced")
"""Comparisons of two agents, and of one agent alone or with all others."""

NEAREST_M, FARTHEST_M = 2.0, 40.0
"""Ranges at which views are compared."""

SAME_GROUND_M = 0.75
"""Views are compared where their grounds differ by less: elsewhere one looks over a crest, or from a deck."""

LEAST_SEEN = 0.25
"""A view that claims less than this share of what is near denies nothing: its sensor is covered, or beside a truck.
Honest views see a third at least."""

MOST_CELLS = 250
"""Of more surface or free cells of a view every second, third, ... one is compared."""

_FEW, _USUAL = 20, np.array([0.03, 0.1])
"""Shares of pairs count as if they were of so many cells more, with the usual share."""

_ABOUT_M = np.stack(np.meshgrid(*[np.array([-1.0, 0.0, 1.0])] * 2), axis=-1).reshape(-1, 2)
"""Surfaces are seen from different sides, and lie a cell or two apart: all about one must be free to deny it."""

_SECTORS, _WIDEST = 180, 6
"""Sectors of a view, and to how many on each side a near surface reaches."""

_TURNS = [Rigid.from_yaw(float(turn)).rotation[:2, :2].T for turn in np.radians([0.0, -2.0, 2.0])]
_SHIFTS = np.stack(np.meshgrid(*[np.arange(-4, 5, 2)] * 2), axis=-1).reshape(-1, 2)
_CLAIMED = len(_SHIFTS) // 2
"""Poses about the claimed one at which surfaces are compared: turns, shifts in cells of the map, the claimed one."""

_FEWEST_MET = 30
"""Surfaces of an agent and of others that must meet at some pose."""

_MAP_M, _MAP_CELLS = 0.5, 512
"""Surfaces in the world are kept in cells that repeat after 256 m, farther than two views overlap."""


class _Cells(NamedTuple):
    """Some cells of views: where they are in the world (S, 2), and their ground (S,)."""

    world: F64
    ground_m: F64


class ComparedView:
    """One agent's view, looked up at places of the world."""

    def __init__(self, report: AgentReport) -> None:
        """Look up surfaces, free cells and states about the agent once."""
        self.report, self.grid = report, report.estimate.grid
        self._states = report.estimate.state.reshape(-1)
        self.lattice = _lattice(self.grid)
        states = self._states[_lattice_numbers(self.grid)]
        self.visible, self.hidden = _is_visible(states), states == CellState.HIDDEN
        xy = self.grid.centers[report.estimate.state == CellState.SURFACE]
        range_m = np.hypot(xy[:, 0], xy[:, 1])
        self.surface_xy = xy[(range_m > NEAREST_M) & (range_m < FARTHEST_M)]
        self.surfaces = self._placed(_some(self.surface_xy))
        self.free = self._placed(_some(self.lattice[states == CellState.FREE]))

    def _placed(self, xy: F64) -> _Cells:
        return _Cells(self.in_world(xy), self.report.ground_m(xy))

    def in_world(self, level: F64) -> F64:
        """Return places (…, 2) of ``level`` in the world."""
        pose = self.report.world_from_level
        world: F64 = level @ pose.rotation[:2, :2].T + pose.translation[:2]
        return world

    def states_at(self, level: F64) -> NDArray[np.uint8]:
        """Return the states (…,) at places (…, 2) of ``level``, within the grid."""
        return self._states[_numbers(self.grid, level)]

    def _nearby(self, cells: Sequence[_Cells]) -> tuple[F64, NDArray[np.intp]]:
        """Return those of other views' cells that are near and on the same ground: (N, 2) in ``level``, whose (N,)."""
        whose = np.repeat(np.arange(len(cells)), [len(each.world) for each in cells])
        level = self.report.in_level(np.concatenate([each.world for each in cells]))
        range_m = np.hypot(level[:, 0], level[:, 1])
        near = np.flatnonzero((range_m > NEAREST_M) & (range_m < min(FARTHEST_M, self.grid.half_extent_m)))
        level, ground_m = level[near], np.concatenate([each.ground_m for each in cells])[near]
        same = np.abs(self.report.ground_m(level) - ground_m) < SAME_GROUND_M
        return level[same], whose[near[same]]

    def against(self, others: Sequence[ComparedView]) -> F64:
        """Return *through* and *denied* (K, 2) of this view and others; NaN where two have nothing in common."""
        # Surfaces of others: does this view claim to see there, and free cells alone about them?
        surfaces, whose = self._nearby([other.surfaces for other in others])
        about = self.states_at(surfaces[:, None] + _ABOUT_M)
        claimed = _is_visible(about[:, len(_ABOUT_M) // 2])
        through = (about[claimed] == CellState.FREE).all(axis=1)
        out = [_shares(through, whose[claimed], len(others), 0)]
        # Free ground of others that no surface and no object of its own hides from this agent; elevated ones see over
        # most.
        free, of = self._nearby([other.free for other in others])
        if not self.report.elevated:
            objects = footprint_points(self.report.detections.boxes, COARSE).reshape(-1, 2)
            first_m = _first_m(np.concatenate([self.surface_xy, surfaces, objects]), self.grid.cell_m)
            is_open = np.hypot(free[:, 0], free[:, 1]) < first_m[_sectors(free)] - 0.5
            free, of = free[is_open], of[is_open]
        denied = _shares(self.states_at(free) == CellState.HIDDEN, of, len(others), 1)
        out.append(denied if self.visible.mean() >= LEAST_SEEN else np.full(len(others), np.nan))
        return np.column_stack(out)

    def since(self, last: ComparedView) -> tuple[float, float]:
        """Return *opened* and *closed*, as shares of what is seen now or then."""
        before = last.report.in_level(self.in_world(self.lattice))
        known = np.abs(before).max(axis=1) < last.grid.half_extent_m
        now, states = self.visible[known], last.states_at(before[known])
        then = _is_visible(states)
        seen = max(int((now | then).sum()), 1)
        hidden = int((then & self.hidden[known]).sum()) - int((now & (states == CellState.HIDDEN)).sum())
        return (int(now.sum()) - int(then.sum())) / seen, hidden / seen

    def misplaced(self, surfaces: Mask) -> float:
        """Return how many more surfaces lie on others', on their map, at another pose than the claimed one, a share."""
        own = _some(self.surface_xy)
        if len(own) < _FEWEST_MET:
            return np.nan
        cells = np.floor(self.in_world(np.stack([own @ turn for turn in _TURNS])) / _MAP_M).astype(np.int32)
        met = surfaces[_map_numbers(cells[:, None] + _SHIFTS[:, None])].sum(axis=-1).ravel()
        return float((met.max() - met[_CLAIMED]) / met.max()) if met.max() >= _FEWEST_MET else np.nan


def _some(xy: F64) -> F64:
    return xy[:: max(-(-len(xy) // MOST_CELLS), 1)]


@lru_cache(maxsize=4)
def _lattice(grid: BevGrid) -> F64:
    """Return where a view is compared with its past (P, 2), in ``level``, and whose free cells others are asked of."""
    steps = np.arange(-FARTHEST_M, FARTHEST_M, 1.0) + 0.3  # off the edges of cells
    xy = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    range_m = np.hypot(xy[:, 0], xy[:, 1])
    lattice: F64 = xy[(range_m > NEAREST_M) & (range_m < min(FARTHEST_M, grid.half_extent_m))]
    return lattice


@lru_cache(maxsize=4)
def _lattice_numbers(grid: BevGrid) -> NDArray[np.intp]:
    return _numbers(grid, _lattice(grid))


def _numbers(grid: BevGrid, level: F64) -> NDArray[np.intp]:
    """Return the flat numbers (…,) of the cells at places (…, 2) of ``level``, the nearest ones beyond the edge."""
    cells = ((level - grid.origin_m) / grid.cell_m).astype(np.int32)
    cells = np.clip(cells, 0, grid.cells - 1)
    numbers: NDArray[np.intp] = cells[..., 0] * grid.cells + cells[..., 1]
    return numbers


def _map_numbers(cells: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the flat numbers (…,) on the map of surfaces of cells (…, 2) of the world."""
    cells = cells & (_MAP_CELLS - 1)
    numbers: NDArray[np.int32] = cells[..., 0] * _MAP_CELLS + cells[..., 1]
    return numbers


def _first_m(level: F64, cell_m: float) -> F64:
    """Return the range (sectors,) from which surfaces (S, 2), cells of some width, hide what is behind them."""
    range_m, sectors = np.hypot(level[:, 0], level[:, 1]), _sectors(level)
    first_m = np.full(_SECTORS, np.inf)
    np.minimum.at(first_m, sectors, range_m)
    # A near cell is several sectors wide: so many to both sides as its half width spans, one at least.
    wide = first_m.copy()
    for step in range(1, _WIDEST + 1):
        reaches = (step == 1) | (first_m * step * (2 * np.pi / _SECTORS) <= cell_m)
        near = np.where(reaches, first_m, np.inf)
        wide = np.minimum(wide, np.minimum(np.roll(near, step), np.roll(near, -step)))
    return wide


def _is_visible(states: NDArray[np.uint8]) -> Mask:
    visible: Mask = (states == CellState.FREE) | (states == CellState.SURFACE)
    return visible


def _sectors(level: F64) -> NDArray[np.intp]:
    turn = (np.arctan2(level[:, 1], level[:, 0]) + np.pi) / (2 * np.pi)
    sectors: NDArray[np.intp] = (turn * _SECTORS).astype(np.intp) % _SECTORS
    return sectors


def _shares(part: Mask, whose: NDArray[np.intp], count: int, name: int) -> F64:
    """Return the share (K,) of each other's cells (N,), of few ones near the usual; NaN of none."""
    total, some = np.bincount(whose, minlength=count), np.bincount(whose, part, minlength=count)
    return np.where(total > 0, (some + _FEW * _USUAL[name]) / (total + _FEW), np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Comparisons:
    """What views of A agents say of each other at one time; NaN where nothing is compared."""

    pairs: F64  # (A, A, 2) of each view with each other, by ``PAIR``
    own: F64  # (A, 3) of each view, by ``OWN``


def compare_views(
    reports: Mapping[int, AgentReport], agents: int, last: Mapping[int, ComparedView], asked: Sequence[int]
) -> tuple[Comparisons, dict[int, ComparedView]]:
    """Return what views say of each other, and those to be compared with the next time.

    Args:
        reports: by the number of the agent.
        agents: how many there are.
        last: the view of each agent when it was asked last.
        asked: numbers of the agents whose views are compared with all others, both ways.
    """
    pairs, own = np.full((agents, agents, len(PAIR)), np.nan), np.full((agents, len(OWN)), np.nan)
    views = {number: ComparedView(report) for number, report in reports.items()} if asked else {}
    # Who sees a surface in each cell of the map: a bit for each agent, so that its own can be left out.
    seen_by = np.zeros(_MAP_CELLS**2, np.uint32)
    for number, view in views.items():
        cells = np.floor(view.in_world(view.surface_xy) / _MAP_M).astype(np.int32)
        seen_by[np.unique(_map_numbers(cells))] |= np.uint32(1 << number % 32)
    for number in asked:
        view = views[number]
        others = [other for other in views if other != number]
        since = view.since(last[number]) if number in last else (np.nan, np.nan)
        misplaced = view.misplaced((seen_by & ~np.uint32(1 << number % 32)) != 0)
        own[number] = *since, misplaced
        if others:
            pairs[number, others] = view.against([views[other] for other in others])
    for number in views.keys() - set(asked):
        if asked:
            pairs[number, list(asked)] = views[number].against([views[other] for other in asked])
    return Comparisons(pairs, own), {number: views[number] for number in asked}


@dataclass(frozen=True, slots=True, eq=False)
class Surprises:
    """How rare numbers of comparisons are where nobody lies."""

    pairs: F64  # (2, 2, 2, Q) quantiles of pairs, by whether the first and the second sensor are elevated
    own: F64  # (2, 3, Q) of one view, by whether its sensor is elevated

    USUAL = 1.2
    """Surprise in nats that says nothing, as of three honest numbers in ten."""

    MOST = 6.0
    """Most that one number says."""

    LEVELS = np.concatenate([np.linspace(0.0, 0.9, 10), 1.0 - np.geomspace(0.1, 1e-4, 40)[1:]])
    """Shares of honest numbers below each quantile."""

    @classmethod
    def blank(cls) -> Self:
        """Return surprises of which no number is one."""
        return cls(np.full((2, 2, len(PAIR), len(cls.LEVELS)), np.inf), np.full((2, len(OWN), len(cls.LEVELS)), np.inf))

    @classmethod
    def fit(cls, compared: Sequence[Comparisons], elevated: Sequence[NDArray[np.bool_]]) -> Self:
        """Return the quantiles of N times of scenes in which nobody lies; ``elevated`` (A,) of each."""
        levels, kinds = cls.LEVELS, (False, True)

        def quantiles(values: list[F64]) -> F64:
            known = np.concatenate(values)
            known = known[np.isfinite(known)]
            return np.quantile(known, levels) if len(known) else np.zeros(len(levels))

        off = [~np.eye(len(each), dtype=np.bool_) for each in elevated]
        pairs = [
            [
                [
                    quantiles([
                        each.pairs[..., k][(high[:, None] == first) & (high == second) & others]
                        for each, high, others in zip(compared, elevated, off, strict=True)
                    ])
                    for k in range(len(PAIR))
                ]
                for second in kinds
            ]
            for first in kinds
        ]  # fmt: skip
        own = [
            [quantiles([each.own[high == kind, k] for each, high in zip(compared, elevated, strict=True)])
             for k in range(len(OWN))]
            for kind in kinds
        ]  # fmt: skip
        return cls(np.array(pairs), np.array(own))

    def __call__(self, compared: Comparisons, elevated: NDArray[np.bool_]) -> tuple[F64, F64]:
        """Return surprises (A, A, 2) and (A, 3) in nats beyond the usual; NaN where nothing is compared."""
        kind = elevated.astype(np.intp)
        return (
            self._of(compared.pairs, self.pairs[kind[:, None], kind[None]]),
            self._of(compared.own, self.own[kind]),
        )  # fmt: skip

    def _of(self, values: F64, quantiles: F64) -> F64:
        above = 1.0 - np.append(0.0, self.LEVELS)[(values[..., None] > quantiles).sum(axis=-1)]
        nats = np.clip(-np.log(np.maximum(above, 1e-9)), self.USUAL, self.MOST) - self.USUAL
        return np.where(np.isfinite(values), nats, np.nan)

    def to_json(self) -> dict[str, Any]:
        """Return them as plain values."""
        return {name: getattr(self, name).round(5).tolist() for name in self.__slots__}

    @classmethod
    def from_json(cls, table: Mapping[str, Any]) -> Self:
        """Return the surprises in plain values."""
        return cls(*(np.array(table[name], np.float64) for name in cls.__slots__))
