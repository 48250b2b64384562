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

from viewshed import _core
from viewshed.agents.registration import agent_bit, pose_numbers, surface_cells
from viewshed.agents.report import AgentReport
from viewshed.arrays import F64, Mask
from viewshed.fov.estimate import CellState, is_visible
from viewshed.fov.height_map import HeightMap
from viewshed.grid import BevGrid
from viewshed.objects.cells import COARSE, footprint_points

PAIR, OWN = ("through", "denied"), ("opened", "closed", "misplaced")
"""Comparisons of two agents, and of one agent alone or with all others."""

NEAREST_M, FARTHEST_M = 2.0, 40.0
"""Ranges at which views are compared."""

SAME_GROUND_M = 0.4
"""Views are compared where their grounds differ by less: elsewhere one looks over a crest, or from a deck."""

LEAST_SEEN = 0.25
"""A view that claims less than this share of what is near denies nothing: its sensor is covered, or beside a truck.
Honest views see a third at least."""

MOST_CELLS = 250
"""Of more surface or free cells of a view every second, third, ... one is compared."""

_FEW, _USUAL = 20, np.array([0.03, 0.1])
"""Shares of pairs count as if they had this many cells more, with the usual share."""

_TURNS, _SHIFTS_M = np.radians([0.0, -2.0, 2.0]), np.arange(-2.0, 3.0)
_CLAIMED = 0, len(_SHIFTS_M) // 2, len(_SHIFTS_M) // 2
"""Poses about the claimed one at which surfaces are compared: turns, shifts along each axis, the claimed one."""

_FEWEST_MET = 30
"""Surfaces of an agent and of others that must meet at some pose."""

_MAP_M, _MAP_CELLS = 0.5, 512
"""Surfaces in the world are kept in cells that repeat after 256 m, farther than two views overlap."""


class _Cells(NamedTuple):
    """Some surface and free cells of views (P,): where they are in the world, their ground, whose they are."""

    places_m: F64  # (P, 2)
    ground_m: F64  # (P,)
    owner: NDArray[np.int32]  # (P,)
    is_free: Mask  # (P,)

    @classmethod
    def of(cls, views: Sequence[ComparedView]) -> Self:
        """Return the cells of several views."""
        return cls(*(np.concatenate(columns) for columns in zip(*(view.cells for view in views), strict=True)))


class ComparedView:
    """One agent's view, looked up at places of the world."""

    def __init__(self, report: AgentReport, number: int) -> None:
        """Look up surfaces, free cells and states about the agent of a number once."""
        self.report, self.number, grid = report, number, report.estimate.grid
        self.state = report.estimate.state
        self.lattice = _lattice(grid)
        states = self.state.reshape(-1)[_lattice_numbers(grid)]
        self.visible = is_visible(states)
        self.surfaces = surface_cells(report.estimate, NEAREST_M, FARTHEST_M)
        surfaces, free = _some(self.surfaces), _some(self.lattice[states == CellState.FREE])
        level, is_free = np.concatenate([surfaces, free]), np.arange(len(surfaces) + len(free)) >= len(surfaces)
        owner = np.full(len(level), number, np.int32)
        self.cells = _Cells(self.in_world(level), report.ground_m(level), owner, is_free)

    def in_world(self, level: F64) -> F64:
        """Return places (…, 2) of ``level`` in the world."""
        pose = self.report.world_from_level
        world: F64 = level @ pose.rotation[:2, :2].T + pose.translation[:2]
        return world

    def against(self, others: _Cells, agents: int) -> F64:
        """Return *through* and *denied* (A, 2) of this view and others; NaN where two have nothing in common."""
        report, grid = self.report, self.report.estimate.grid
        ground = HeightMap.flat(grid.half_extent_m) if report.ground is None else report.ground
        # Elevated sensors see over what stands in the way of others.
        blockers = np.concatenate([self.surfaces, footprint_points(report.detections.boxes, COARSE).reshape(-1, 2)])
        claimed, through, free, denied = _core.compare_view(
            self.state, *grid.origin_m, grid.cell_m, ground.heights_m, ground.half_extent_m,
            pose_numbers(report.world_from_level), others.places_m, others.ground_m, others.owner, others.is_free,
            own=self.number, agents=agents, blockers=blockers,
            from_above=report.elevated, nearest_m=NEAREST_M, farthest_m=min(FARTHEST_M, grid.half_extent_m),
            same_ground_m=SAME_GROUND_M,
        )  # fmt: skip
        if self.visible.sum() < LEAST_SEEN * self.visible.size:
            free = np.zeros_like(free)
        return np.column_stack([_shares(through, claimed, 0), _shares(denied, free, 1)])

    def since(self, last: ComparedView) -> tuple[float, float]:
        """Return *opened* and *closed*, as shares of what is seen now or then."""
        last_from_now = last.report.world_from_level.inverse() @ self.report.world_from_level
        grid, then = self.report.estimate.grid, last.report.estimate.grid
        sees, saw, either, hidden, shown = _core.compare_past(
            self.state, *grid.origin_m, grid.cell_m, last.state, *then.origin_m, then.cell_m,
            pose_numbers(last_from_now), self.lattice,
        )  # fmt: skip
        return (sees - saw) / max(either, 1), (hidden - shown) / max(either, 1)

    def misplaced(self, seen_by: NDArray[np.uint32]) -> float:
        """Return how many more surfaces lie on others', on their map, at another pose than the claimed one, a share."""
        own, pose = _some(self.surfaces), self.report.world_from_level
        if len(own) < _FEWEST_MET:
            return np.nan
        x_m, y_m = pose.translation[0] + _SHIFTS_M, pose.translation[1] + _SHIFTS_M
        met = _core.count_met(own, pose.yaw + _TURNS, x_m, y_m, _MAP_M, seen_by, agent_bit(self.number))
        return float((met.max() - met[_CLAIMED]) / met.max()) if met.max() >= _FEWEST_MET else np.nan


def _some(xy: F64) -> F64:
    return np.ascontiguousarray(xy[:: max(-(-len(xy) // MOST_CELLS), 1)])


@lru_cache(maxsize=4)
def _lattice(grid: BevGrid) -> F64:
    """Return where a view is compared with its past (P, 2), in ``level``, and whose free cells others are asked of."""
    steps = np.arange(-FARTHEST_M, FARTHEST_M, 1.0) + 0.3  # off the edges of cells
    xy = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    range_m = np.hypot(xy[:, 0], xy[:, 1])
    near = (range_m > NEAREST_M) & (range_m < min(FARTHEST_M, grid.half_extent_m))
    lattice: F64 = xy[near & grid.index(xy)[1]]
    return lattice


@lru_cache(maxsize=4)
def _lattice_numbers(grid: BevGrid) -> NDArray[np.intp]:
    """Return the flat numbers (P,) of the cells of the lattice."""
    cells, _ = grid.index(_lattice(grid))
    return np.ravel_multi_index((cells[:, 0], cells[:, 1]), grid.shape)


def _shares(some: NDArray[np.int32], total: NDArray[np.int32], name: int) -> F64:
    """Return the share (A,) of some of each other's cells, of few ones near the usual; NaN of none."""
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
    if not asked:
        return Comparisons(pairs, own), {}
    views = {number: ComparedView(report, number) for number, report in reports.items()}
    # Who sees a surface in each cell of the map: a bit for each agent, so that its own can be left out.
    seen_by = np.zeros((_MAP_CELLS, _MAP_CELLS), np.uint32)
    for number, view in views.items():
        pose = pose_numbers(view.report.world_from_level)
        _core.mark_surfaces(seen_by, view.surfaces, pose, _MAP_M, agent_bit(number), wide=False, erase=False)
    everybody, of_asked = _Cells.of(list(views.values())), _Cells.of([views[number] for number in asked])
    for number, view in views.items():
        pairs[number] = view.against(everybody if number in asked else of_asked, agents)
        if number in asked:
            since = view.since(last[number]) if number in last else (np.nan, np.nan)
            own[number] = *since, view.misplaced(seen_by)
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
