"""Evidence of views against their agents: comparison of views with each other, with their past, and at other poses.

Each comparison is a number that is small between honest views. Two views are compared only where both stand on the same
ground, so that crests, decks and quarries do not count as lies. For agents *i* and *j*:

- *through*: of *j*'s surfaces where *i* claims to see, the share at which *i* claims all free;
- *denied*: of what *j* sees free, with no surface of any agent in front, the share that *i* claims hidden.

For the view of one agent, against its own last view and against all others':

- *opened*, *closed*: by how much more of the area around it appeared than vanished, and by how much more became hidden
  than came out; cells that are unknown now are ignored;
- *misplaced*: the share by which more of its surfaces coincide with others' at another pose near the claimed one.

:class:`Surprises` holds how rare each number is among honest agents. A view that claims too much contradicts all that
see surfaces there, and opens at once. One that claims too little denies and closes. One that is old or misplaced sees
through surfaces, and others see through its own.
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
"""Comparisons of two agents, and comparisons of one agent with its past or with all others."""

NEAREST_M, FARTHEST_M = 2.0, 40.0
"""Range of the compared cells in meters."""

SAME_GROUND_M = 0.4
"""Maximum difference of ground heights where views are compared; elsewhere one looks over a crest, or from a deck."""

MIN_SEEN = 0.25
"""A view that claims less than this share of the near cells denies nothing: its sensor is covered, or beside a truck.
Honest views see at least a third."""

MAX_CELLS = 250
"""Maximum number of surface cells, and of free cells, of a view that are compared; more are thinned evenly."""

_PRIOR_COUNT, _PRIOR_SHARES = 20, np.array([0.03, 0.1])
"""Prior count of cells of each share, and prior shares of ``PAIR``."""

_TURNS, _SHIFTS_M = np.radians([0.0, -2.0, 2.0]), np.arange(-2.0, 3.0)
_CLAIMED = 0, len(_SHIFTS_M) // 2, len(_SHIFTS_M) // 2
"""Offsets from the claimed pose at which surfaces are compared: headings, shifts along each axis, and offset 0."""

_MIN_MATCHES = 30
"""Minimum number of an agent's surfaces that coincide with others' at some pose."""

_MAP_M, _MAP_CELLS = 0.5, 512
"""Cell size and number of cells of the map of surfaces; it repeats after 256 m, farther than two views overlap."""


class _Cells(NamedTuple):
    """Sampled surface and free cells of views (P,), in the world."""

    places_m: F64  # (P, 2)
    ground_m: F64  # (P,)
    owner: NDArray[np.int32]  # (P,) agent number
    is_free: Mask  # (P,)

    @classmethod
    def of(cls, views: Sequence[ComparedView]) -> Self:
        """Return the cells of several views, concatenated."""
        return cls(*(np.concatenate(columns) for columns in zip(*(view.cells for view in views), strict=True)))


class ComparedView:
    """One agent's view, prepared for comparisons in the world."""

    def __init__(self, report: AgentReport, number: int) -> None:
        """Look up the surfaces, free cells and states of an agent's view once."""
        self.report, self.number, grid = report, number, report.estimate.grid
        self.state = report.estimate.state
        self.lattice = _lattice(grid)
        states = self.state.reshape(-1)[_lattice_numbers(grid)]
        self.visible = is_visible(states)
        self.surfaces = surface_cells(report.estimate, NEAREST_M, FARTHEST_M)
        surfaces, free = _thinned(self.surfaces), _thinned(self.lattice[states == CellState.FREE])
        level, is_free = np.concatenate([surfaces, free]), np.arange(len(surfaces) + len(free)) >= len(surfaces)
        owner = np.full(len(level), number, np.int32)
        self.cells = _Cells(self.in_world(level), report.ground_m(level), owner, is_free)

    def in_world(self, level: F64) -> F64:
        """Return points (…, 2) of ``level`` in the world."""
        pose = self.report.world_from_level
        world: F64 = level @ pose.rotation[:2, :2].T + pose.translation[:2]
        return world

    def against(self, others: _Cells, agents: int) -> F64:
        """Return *through* and *denied* (A, 2) of this view against others; NaN where two views do not overlap."""
        report, grid = self.report, self.report.estimate.grid
        ground = HeightMap.flat(grid.half_extent_m) if report.ground is None else report.ground
        # Elevated sensors see over the blockers of lower ones.
        blockers = np.concatenate([self.surfaces, footprint_points(report.detections.boxes, COARSE).reshape(-1, 2)])
        claimed, through, free, denied = _core.compare_view(
            self.state, *grid.origin_m, grid.cell_m, ground.heights_m, ground.half_extent_m,
            pose_numbers(report.world_from_level), others.places_m, others.ground_m, others.owner, others.is_free,
            own=self.number, agents=agents, blockers=blockers,
            from_above=report.elevated, nearest_m=NEAREST_M, farthest_m=min(FARTHEST_M, grid.half_extent_m),
            same_ground_m=SAME_GROUND_M,
        )  # fmt: skip
        if self.visible.sum() < MIN_SEEN * self.visible.size:
            free = np.zeros_like(free)
        return np.column_stack([_shares(through, claimed, 0), _shares(denied, free, 1)])

    def since(self, last: ComparedView) -> tuple[float, float]:
        """Return *opened* and *closed* since an earlier view, as shares of what is seen now or was seen then."""
        last_from_now = last.report.world_from_level.inverse() @ self.report.world_from_level
        grid, then = self.report.estimate.grid, last.report.estimate.grid
        sees, saw, either, hidden, shown = _core.compare_past(
            self.state, *grid.origin_m, grid.cell_m, last.state, *then.origin_m, then.cell_m,
            pose_numbers(last_from_now), self.lattice,
        )  # fmt: skip
        return (sees - saw) / max(either, 1), (hidden - shown) / max(either, 1)

    def misplaced(self, seen_by: NDArray[np.uint32]) -> float:
        """Return the share of matches with others' surfaces that the claimed pose lacks to the best pose nearby."""
        own, pose = _thinned(self.surfaces), self.report.world_from_level
        if len(own) < _MIN_MATCHES:
            return np.nan
        x_m, y_m = pose.translation[0] + _SHIFTS_M, pose.translation[1] + _SHIFTS_M
        matches = _core.count_met(own, pose.yaw + _TURNS, x_m, y_m, _MAP_M, seen_by, agent_bit(self.number))
        return float((matches.max() - matches[_CLAIMED]) / matches.max()) if matches.max() >= _MIN_MATCHES else np.nan


def _thinned(xy: F64) -> F64:
    return np.ascontiguousarray(xy[:: max(-(-len(xy) // MAX_CELLS), 1)])


@lru_cache(maxsize=4)
def _lattice(grid: BevGrid) -> F64:
    """Return the sample points (P, 2), in ``level``, for past comparisons and for free cells."""
    steps = np.arange(-FARTHEST_M, FARTHEST_M, 1.0) + 0.3  # off the edges of cells
    xy = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    range_m = np.hypot(xy[:, 0], xy[:, 1])
    near = (range_m > NEAREST_M) & (range_m < min(FARTHEST_M, grid.half_extent_m))
    lattice: F64 = xy[near & grid.index(xy)[1]]
    return lattice


@lru_cache(maxsize=4)
def _lattice_numbers(grid: BevGrid) -> NDArray[np.intp]:
    """Return the flat cell indices (P,) of the lattice."""
    cells, _ = grid.index(_lattice(grid))
    return np.ravel_multi_index((cells[:, 0], cells[:, 1]), grid.shape)


def _shares(counts: NDArray[np.int32], total: NDArray[np.int32], name: int) -> F64:
    """Return the shares (A,) of counts in totals, shrunk toward the prior; NaN where the total is 0."""
    return np.where(total > 0, (counts + _PRIOR_COUNT * _PRIOR_SHARES[name]) / (total + _PRIOR_COUNT), np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Comparisons:
    """Comparisons of the views of A agents at one time; NaN where nothing is compared."""

    pairs: F64  # (A, A, 2) of each view with each other, by ``PAIR``
    own: F64  # (A, 3) of each view, by ``OWN``


def compare_views(
    reports: Mapping[int, AgentReport], agents: int, last: Mapping[int, ComparedView], compared: Sequence[int]
) -> tuple[Comparisons, dict[int, ComparedView]]:
    """Return the comparisons of views, and the views to compare with next time.

    Args:
        reports: by agent number.
        agents: number of agents.
        last: view of each agent at its last comparison.
        compared: numbers of the agents whose views are compared with all others, both ways.
    """
    pairs, own = np.full((agents, agents, len(PAIR)), np.nan), np.full((agents, len(OWN)), np.nan)
    if not compared:
        return Comparisons(pairs, own), {}
    views = {number: ComparedView(report, number) for number, report in reports.items()}
    # Bit mask per map cell of the agents that see a surface there, so that an agent's own can be left out.
    seen_by = np.zeros((_MAP_CELLS, _MAP_CELLS), np.uint32)
    for number, view in views.items():
        pose = pose_numbers(view.report.world_from_level)
        _core.mark_surfaces(seen_by, view.surfaces, pose, _MAP_M, agent_bit(number), wide=False, erase=False)
    all_cells, compared_cells = _Cells.of(list(views.values())), _Cells.of([views[number] for number in compared])
    for number, view in views.items():
        pairs[number] = view.against(all_cells if number in compared else compared_cells, agents)
        if number in compared:
            since = view.since(last[number]) if number in last else (np.nan, np.nan)
            own[number] = *since, view.misplaced(seen_by)
    return Comparisons(pairs, own), {number: views[number] for number in compared}


@dataclass(frozen=True, slots=True, eq=False)
class Surprises:
    """Quantiles of comparisons among honest agents, to rate how rare a number is."""

    pairs: F64  # (2, 2, 2, Q) quantiles of pairs, by whether the first and the second sensor are elevated
    own: F64  # (2, 3, Q) of one view, by whether its sensor is elevated

    USUAL = 1.2
    """Surprise in nats that is not counted, that of three in ten honest numbers."""

    MAX = 6.0
    """Maximum surprise of one number."""

    LEVELS = np.concatenate([np.linspace(0.0, 0.9, 10), 1.0 - np.geomspace(0.1, 1e-4, 40)[1:]])
    """Levels of the quantiles."""

    @classmethod
    def blank(cls) -> Self:
        """Return surprises for which no number is rare."""
        return cls(np.full((2, 2, len(PAIR), len(cls.LEVELS)), np.inf), np.full((2, len(OWN), len(cls.LEVELS)), np.inf))

    @classmethod
    def fit(cls, compared: Sequence[Comparisons], elevated: Sequence[NDArray[np.bool_]]) -> Self:
        """Return the quantiles over N times of scenes without liars; ``elevated`` (A,) of each time."""
        levels, kinds = cls.LEVELS, (False, True)

        def quantiles(values: list[F64]) -> F64:
            finite = np.concatenate(values)
            finite = finite[np.isfinite(finite)]
            return np.quantile(finite, levels) if len(finite) else np.zeros(len(levels))

        off_diagonal = [~np.eye(len(each), dtype=np.bool_) for each in elevated]
        pairs = [
            [
                [
                    quantiles([
                        each.pairs[..., k][(high[:, None] == first) & (high == second) & others]
                        for each, high, others in zip(compared, elevated, off_diagonal, strict=True)
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
        nats = np.clip(-np.log(np.maximum(above, 1e-9)), self.USUAL, self.MAX) - self.USUAL
        return np.where(np.isfinite(values), nats, np.nan)

    def to_json(self) -> dict[str, Any]:
        """Return the quantiles as plain values."""
        return {name: getattr(self, name).round(5).tolist() for name in self.__slots__}

    @classmethod
    def from_json(cls, table: Mapping[str, Any]) -> Self:
        """Return the surprises from the plain values of :meth:`to_json`."""
        return cls(*(np.array(table[name], np.float64) for name in cls.__slots__))
