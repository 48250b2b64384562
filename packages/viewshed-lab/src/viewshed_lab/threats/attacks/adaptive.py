"""Adaptive attacks: black-box search with queries to the victim's estimator (family 16).

An objective gives each attacked sweep a value. The attacker searches for the plan of highest value (which beams to
spoof and at which ranges, or where to put free points), by random draws and then an evolution strategy from the best.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed.fov.estimate import THRESHOLD, FovEstimator
from viewshed.sweep import Sweep
from viewshed_lab._config import Azimuth, Between, Budget, Checked, Range, Sector
from viewshed_lab.threats.attacks.base import NOTHING, Attack, AttackFactory, Knowledge, Tampered, Wedge
from viewshed_lab.threats.attacks.beam_lattice import Rays, lattice_of, rays_in, within
from viewshed_lab.threats.attacks.ghosts import FarWall
from viewshed_lab.threats.attacks.points import HEIGHTS_M, Mode, check_free_budget
from viewshed_lab.threats.attacks.spoofer import (
    LEAVE,
    MEASURED_SPOOFER,
    NO_RETURN,
    Spoofer,
    add_points,
    is_obstacle,
    limits_m,
    scene_of,
    street_depth_m,
    to_sensor,
    untouched,
)
from viewshed_lab.threats.attacks.wedge_attack import Placement

RANDOM_SHARE = 0.3
"""Share of an evolution's queries that is used for random draws."""

OFFSPRING = 6  # λ of the evolution strategy

_GROWS, _SHRINKS = 1.6, 0.88
"""Factors of the step size after a success and after a failure."""

_STEPS = (0.03, 2.0)
"""Minimum and maximum step size of the evolution."""

_MARGIN_M = 2.0
"""Margin between planned ranges and the sensor's limits, so that noise rarely loses a return."""

_NEAR_M = 25.0
"""Obstacles nearer than this are a feature of their own."""

_FREE_M = (1.0, 90.0)
"""Minimum and maximum range of free points."""

_F = 10
"""Number of features per beam."""

_GONE, _SHARP, _STREET, _WALL = 2 * _F, 3 * _F + 1, 3 * _F + 2, 3 * _F + 3
"""Indices into a candidate: the constant weight of removal, and three of the common parameters."""

_MIDDLE, _OBSTACLE, _SPREAD, _CROWD, _NEAR = 2, 4, 6, 8, 9
"""Columns of the features, see ``_features``."""

_GUESSES: tuple[dict[int, float], ...] = (
    {_SPREAD: 0.5, _SHARP: 2.0, _STREET: -1.0, _WALL: 4.0},
    {_NEAR: 9.0, _MIDDLE: -3.0, _STREET: 1.0, _WALL: 0.3},
    {_NEAR: 9.0, _SPREAD: 3.0, _STREET: 1.0, _WALL: 0.3},
    {_NEAR: 9.0, _MIDDLE: -3.0, _GONE: 5.0},
    {_NEAR: 9.0, _CROWD: -6.0, _SPREAD: 0.1, _STREET: 1.0, _WALL: 0.3},
    {_OBSTACLE: 9.0, _CROWD: -6.0, _SPREAD: 0.1, _STREET: 1.0, _WALL: 4.0},
    {_NEAR: 9.0, _CROWD: -6.0, _SPREAD: 0.1, _GONE: 5.0},
    {_OBSTACLE: 9.0, _MIDDLE: -3.0, _GONE: 5.0},
    {_MIDDLE: -3.0, _STREET: -1.0, _WALL: -2.5},
    {_SPREAD: 3.0, _STREET: -1.0, _WALL: -2.5},
)
"""The first plans: a fan of far returns; a far wall in the center and one spread over columns; removal in the center;
far walls and removal in the columns with the fewest obstacles first; near walls."""


class SearchSpace(Protocol):
    """A set of plans to search; a plan is a vector."""

    def draw(self, number: int, rng: np.random.Generator) -> F64:
        """Return random plan ``number``; the first few may be good guesses."""
        ...

    def mutated(self, parent: F64, step: float, rng: np.random.Generator) -> F64:
        """Return a plan near ``parent``."""
        ...


class Attempts:
    """The evaluated plans: the best one, its value, and the values of all in order.

    A later plan of equal value replaces the best, so that the search can cross a plateau.
    """

    def __init__(self, value_of: Callable[[F64], float]) -> None:
        self._value_of = value_of
        self.candidate: F64 | None = None
        self.value = -np.inf
        self.history: list[float] = []

    def attempt(self, candidate: F64) -> bool:
        """Evaluate a plan; return whether it is better than all before."""
        value = self._value_of(candidate)
        self.history.append(value)
        better = value > self.value
        if value >= self.value:
            self.candidate, self.value = candidate, value
        return better


def evolution(space: SearchSpace, value_of: Callable[[F64], float], limit: int, rng: np.random.Generator) -> Attempts:
    """Evaluate ``limit`` plans: random draws, then a (1 + λ) evolution strategy with λ = 6 from the best of them.

    The step grows after a success and shrinks otherwise (Rechenberg 1973).
    """
    attempts, step = Attempts(value_of), 0.6
    for number in range(int(np.ceil(RANDOM_SHARE * limit))):
        attempts.attempt(space.draw(number, rng))
    while (left := limit - len(attempts.history)) > 0 and attempts.candidate is not None:
        parent = attempts.candidate
        children = [space.mutated(parent, step, rng) for _ in range(min(OFFSPRING, left))]
        improved = [attempts.attempt(child) for child in children]
        step = float(np.clip(step * (_GROWS if any(improved) else _SHRINKS), *_STEPS))
    return attempts


@dataclass(frozen=True, slots=True, eq=False)
class BeamSearchSpace:
    """Plans on the beams of a wedge: priorities and target depths from common parameters and residuals per beam.

    A candidate is a vector: weights of the features for priority, depth and removal (3 F); preferred elevation, its
    weight, a switch to an empty street's depths and the range of its wall (4); residuals of priority and depth (2 K).
    """

    sweep: Sweep  # attacked sweep
    wedge: Wedge  # attacked wedge
    budget: int | None  # maximum number of beams, None for all
    spoofer: Spoofer  # success rate and range noise
    rays: Rays  # (K,) beams of the wedge
    # (K, F) features: constant, azimuth and its distance from the center, elevation, obstacle, depth, values spread
    # evenly over columns and over rings, number of obstacles in the column, and near obstacle
    features: F64
    obstacle: NDArray[np.bool_]  # (K,) bool, beams with obstacle returns

    @classmethod
    def of(cls, sweep: Sweep, wedge: Wedge, budget: int | None, spoofer: Spoofer) -> BeamSearchSpace:
        """Return the plans for a wedge of a sweep; if its beams are unknown, without the empty ones."""
        rays = rays_in(sweep, wedge, empty=lattice_of(sweep) is not None)
        obstacle = is_obstacle(sweep, rays) if len(rays) else np.zeros(0, np.bool_)
        return cls(sweep, wedge, budget, spoofer, rays, _features(rays, wedge, obstacle), obstacle)

    def draw(self, number: int, rng: np.random.Generator) -> F64:
        """Return a random plan; the first few are guesses, see ``_GUESSES``."""
        f, k = _F, len(self.rays)
        candidate = np.concatenate([rng.normal(0.0, 1.0, 3 * f + 4), rng.normal(0.0, 0.3, 2 * k)])
        candidate[_GONE] -= 2.5  # makes removal rare
        candidate[_SHARP] += rng.exponential(3.0) - 1.0
        candidate[3 * f + 4 :][:k] += rng.exponential(1.0) * self._by_column(rng)
        if number < len(_GUESSES):
            candidate[:] = 0.0
            candidate[list(_GUESSES[number])] = list(_GUESSES[number].values())
        return candidate

    def _by_column(self, rng: np.random.Generator) -> F64:
        """Return normal numbers (K,), equal within a column."""
        _, number = np.unique(self.features[:, _SPREAD], return_inverse=True)
        return np.asarray(rng.normal(0.0, 1.0, int(number.max(initial=-1)) + 1)[number])

    def mutated(self, parent: F64, step: float, rng: np.random.Generator) -> F64:
        """Return a plan with some common parameters changed, or the residuals of some beams, or both."""
        child, head = parent.copy(), 3 * _F + 4
        which = rng.random()
        if which < 0.7:
            chosen = rng.random(head) < 0.25
            child[:head][chosen] += step * rng.normal(0.0, 1.0, int(chosen.sum()))
        if which > 0.4:
            center, width = rng.uniform(-1.0, 1.0), rng.uniform(0.05, 0.6)
            near = np.tile(np.abs(self.features[:, 1] - center) < width, 2)
            child[head:][near] += step * rng.normal(0.0, 1.0, int(near.sum())) + step * rng.normal()
            child[head : head + len(self.rays)] += step * self._by_column(rng) * (rng.random() < 0.5)
        return child

    def tampered(self, candidate: F64, rng: np.random.Generator) -> Tampered:
        """Return the sweep after a plan, with the spoofer's random losses and noise."""
        return self.spoofer.spoof(self.sweep, self.rays, self.target_m(candidate), self.wedge, rng)

    def target_m(self, candidate: F64) -> F64:
        """Return a plan's target depths (K,) in meters, ``LEAVE`` or ``NO_RETURN``."""
        f, k = _F, len(self.rays)
        priority, depth, gone = (self.features @ candidate[: 3 * f].reshape(3, f).T).T
        height, sharp, street, wall = candidate[3 * f : 3 * f + 4]
        residual = candidate[3 * f + 4 :]
        priority = priority + residual[:k] - max(sharp, 0.0) * np.abs(self.features[:, 3] - height)
        min_m, max_m = limits_m(self.sweep)
        low_m, high_m = min(min_m + _MARGIN_M, max_m), max(max_m - _MARGIN_M, min_m)
        if street > 0.0:
            wall_m = low_m + (high_m - low_m) * float(_sigmoid(wall))
            depth_m = street_depth_m(self.sweep, self.rays, wall_m)
            priority = np.where(depth_m > self.rays.depth_m + _MARGIN_M, priority, -np.inf)
            depth_m = np.clip(depth_m, low_m, high_m)
        else:
            depth_m = low_m + (high_m - low_m) * _sigmoid(depth + wall + residual[k:])
        depth_m = np.where((gone > 0.0) & (self.rays.row >= 0), NO_RETURN, depth_m)
        limit = k if self.budget is None else min(self.budget, k)
        target_m = np.full(k, LEAVE)
        chosen = np.argsort(-priority, kind="stable")[:limit]
        chosen = chosen[np.isfinite(priority[chosen])]
        target_m[chosen] = depth_m[chosen]
        return target_m


@dataclass(frozen=True, slots=True, eq=False)
class PointSearchSpace:
    """Plans of free points in a wedge: five common parameters, then residuals of azimuth, range, height of each."""

    sweep: Sweep  # attacked sweep
    wedge: Wedge  # attacked wedge
    budget: int  # number of points

    def draw(self, number: int, rng: np.random.Generator) -> F64:
        """Return a random plan; the first is an even fan of far points."""
        candidate = np.concatenate([rng.normal(0.0, 1.0, 5), rng.normal(0.0, 0.5, 3 * self.budget)])
        if number == 0:
            candidate[:5] = 0.0, 1.0, 3.0, 0.0, 0.0
            candidate[5:] = 0.0
        return candidate

    def mutated(self, parent: F64, step: float, rng: np.random.Generator) -> F64:
        """Return a plan with the common parameters changed, or the residuals of some points, or both."""
        child, which = parent.copy(), rng.random()
        if which < 0.7:
            child[:5] += step * rng.normal(0.0, 1.0, 5)
        if which > 0.4:
            chosen = np.tile(rng.random(self.budget) < 0.2, 3)
            child[5:][chosen] += step * rng.normal(0.0, 1.0, int(chosen.sum()))
        return child

    def tampered(self, candidate: F64, rng: np.random.Generator) -> Tampered:
        """Return the sweep with a plan's points; those that leveling moves out of the wedge are left out."""
        points = self.points(candidate)
        tampered = add_points(self.sweep, points[within(points.astype(np.float32), self.wedge)], rng)
        return replace(tampered, wedge=self.wedge)

    def points(self, candidate: F64) -> F64:
        """Return the points (budget, 3) of a plan, meters, sensor frame."""
        center, spread, far, slope, high = candidate[:5]
        aside, near, up = candidate[5:].reshape(3, self.budget)
        even = (np.arange(self.budget) + 0.5) * (2.0 / max(self.budget, 1)) - 1.0  # evenly spaced in (-1, 1)
        azimuth = self.wedge.azimuth + 0.499 * self.wedge.width * np.clip(center + spread * even + 0.1 * aside, -1, 1)
        range_m = _FREE_M[0] + (_FREE_M[1] - _FREE_M[0]) * _sigmoid(far + slope * even + near)
        to_level = scene_of(self.sweep).level_from_sensor.rotation
        ahead = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)], axis=1) @ to_level.T
        xy = range_m[:, None] * ahead[:, :2]
        low_m, high_m = HEIGHTS_M
        z = scene_of(self.sweep).ground.at(xy) + low_m + (high_m - low_m) * _sigmoid(high + up)
        return to_sensor(self.sweep, np.column_stack([xy, z]))


def _features(rays: Rays, wedge: Wedge, obstacle: NDArray[np.bool_]) -> F64:
    """Return features (K, 10) of beams, each scaled to a spread of about 1."""
    azimuth = np.arctan2(rays.direction[:, 1], rays.direction[:, 0]) - wedge.azimuth
    azimuth = ((azimuth + np.pi) % (2 * np.pi) - np.pi) / (wedge.width / 2)
    elevation = np.rad2deg(np.arcsin(np.clip(rays.direction[:, 2], -1.0, 1.0))) / 5.0
    depth = np.log1p(np.where(np.isfinite(rays.depth_m), rays.depth_m, 200.0)) - 3.0
    column = rays.column if (rays.column >= 0).all() else np.rint(azimuth * 500.0).astype(np.intp)
    ring = np.where(rays.ring >= 0, rays.ring, np.rint(elevation * 20.0).astype(np.intp))
    one, stands = np.ones(len(rays)), obstacle.astype(float)
    _, column_number = np.unique(column, return_inverse=True)  # columns of the wedge, from 0 on
    crowd = np.bincount(column_number, stands, minlength=1)[column_number] / 10.0
    near = stands * (rays.depth_m < _NEAR_M)
    columns = one, azimuth, np.abs(azimuth), elevation, stands, depth, _spread(column), _spread(ring), crowd, near
    return np.stack(columns, axis=1)


def _spread(number: NDArray[np.intp]) -> F64:
    """Return multiples of the golden ratio modulo 1: consecutive numbers are spread evenly over [0, 1)."""
    return np.asarray((number * 0.6180339887498949) % 1.0)


def _sigmoid(value: F64 | float) -> F64:
    squashed: F64 = 0.5 + 0.5 * np.tanh(0.5 * np.asarray(value))
    return squashed


Value = Callable[[Sweep], float]
"""Maps an attacked sweep to its value for the attacker."""


class Objective(Protocol):
    """A quantity that the attacker maximizes."""

    def on(self, clean: Sweep, wedge: Wedge) -> Value:
        """Return the value function of attacks on the sweep ``clean`` in ``wedge``."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class OverClaim:
    """Area in the wedge, in m², that the victim claims under attack and did not claim before.

    The attacker has no truth and compares with the victim's own clean estimate.
    """

    estimator: FovEstimator  # the victim's estimator
    threshold: float = THRESHOLD  # minimum probability of a claimed cell

    claimed: ClassVar[bool] = True
    """True counts newly claimed cells, False cells that are no longer claimed."""

    def on(self, clean: Sweep, wedge: Wedge) -> Value:
        """Return the value function; this queries the victim once."""
        grid = self.estimator.grid

        def claims(sweep: Sweep) -> NDArray[np.bool_]:
            return np.asarray(self.estimator.estimate(sweep).visible(self.threshold) == self.claimed)

        x, y = np.moveaxis(grid.centers @ scene_of(clean).level_from_sensor.rotation[:2, :2], -1, 0)
        candidates = ~claims(clean) & wedge.holds(np.arctan2(y, x))
        return lambda sweep: float((candidates & claims(sweep)).sum()) * grid.cell_area_m2


@dataclass(frozen=True, slots=True, eq=False)
class UnderClaim(OverClaim):
    """Area in the wedge, in m², that the victim claimed before and no longer claims under attack.

    Its attributes are those of :class:`OverClaim`.
    """

    claimed = False


@dataclass(frozen=True, slots=True, eq=False)
class Evade(Checked):
    """Another objective minus a penalty for a monitor's score above a limit."""

    aim: Objective  # the attacker's objective
    score: Value  # maps a sweep to a monitor's score, or to 1 for an alarm and 0 for none
    limit: float = 0.0  # maximum score that goes unnoticed
    # penalty per unit of score above the limit, in units of the aim
    penalty: Annotated[float, Between(0.0, 1e12)] = 1e6

    def on(self, clean: Sweep, wedge: Wedge) -> Value:
        """Return the value function: the aim minus the penalty."""
        aim = self.aim.on(clean, wedge)
        return lambda sweep: aim(sweep) - self.penalty * max(0.0, float(self.score(sweep)) - self.limit)


@dataclass(frozen=True, slots=True, eq=False)
class SearchResult:
    """Result of an attacker's search."""

    tampered: Tampered  # the attacked sweep, with other noise than in the search, and the record of its changes
    value: float  # value of the plan in the search
    history: NDArray[np.float64]  # (P,) value of each evaluated plan; the first plan is no attack
    queries: int  # number of queries to the victim


@dataclass(frozen=True, slots=True, eq=False)
class BlackBox(Checked):
    """Searches for the plan of highest value by querying the victim with attacked sweeps.

    In the search, all plans meet the same random sample of the spoofer's noise and losses; the attack itself meets
    another. A plan that is not better than no attack is not carried out.
    """

    objective: Objective  # quantity that the attacker maximizes
    budget: Budget = 150  # maximum number of returns; None for every beam of the wedge
    queries: Annotated[int, Between(2, 10_000_000)] = 200  # maximum number of queries; two are of the clean sweep
    sector_deg: Sector = 30.0  # width of the wedge
    # center of the wedge in the sensor's frame; None aims at an obstacle, as a far wall does
    azimuth: Azimuth = None
    aim_m: Range = 25.0  # obstacles nearer than this are aimed at
    placement: Placement = "random"  # choice of the obstacle, see :class:`WedgeAttack`
    mode: Mode = "beam_constrained"  # ``beam_constrained`` or ``free_form``
    spoofer: Spoofer = MEASURED_SPOOFER  # success rate and range noise

    def __post_init__(self) -> None:
        Checked.__post_init__(self)
        check_free_budget(self.mode, self.budget)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and the record of its changes."""
        return self.search(sweep, rng).tampered

    def search(self, sweep: Sweep, rng: np.random.Generator) -> SearchResult:
        """Return the attacked sweep with the value of the plan and the number of queries."""
        aimed = FarWall(self.budget, self.sector_deg, self.azimuth, self.placement, near_m=self.aim_m)
        wedge = aimed.aim(sweep, rng)
        value_of = self.objective.on(sweep, wedge)
        nothing, seed = value_of(sweep), int(rng.integers(2**62))
        space: BeamSearchSpace | PointSearchSpace
        if self.mode == "free_form":
            space = PointSearchSpace(sweep, wedge, self.budget or 0)
        else:
            space = BeamSearchSpace.of(sweep, wedge, self.budget, self.spoofer)

        def evaluate(candidate: F64) -> float:
            """Return the value of a plan, with the same noise for every plan."""
            noise = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, 0])))
            return float(value_of(space.tampered(candidate, noise).sweep))

        best = evolution(space, evaluate, max(0, self.queries - 2), rng)
        history = np.append(nothing, best.history)
        queries = 2 + len(best.history)
        if best.candidate is None or best.value <= nothing:
            return SearchResult(untouched(sweep, wedge), nothing, history, queries)
        return SearchResult(space.tampered(best.candidate, rng), best.value, history, queries)


def _black_box(
    aim: Callable[[FovEstimator], Objective], mode: Mode, budget: int | None = None, knowledge: Knowledge = NOTHING
) -> Attack:
    if knowledge.estimator is None:
        raise ValueError("an attacker who adapts needs a victim, got none; give Knowledge(estimator=…)")
    return BlackBox(
        aim(knowledge.estimator), 150 if budget is None else budget, aim_m=25.0 * knowledge.scale, mode=mode
    )


ADAPTIVE: dict[str, AttackFactory] = {
    "adaptive_over_claim": partial(_black_box, OverClaim, "beam_constrained"),
    "adaptive_under_claim": partial(_black_box, UnderClaim, "beam_constrained"),
    "adaptive_over_claim_free": partial(_black_box, OverClaim, "free_form"),
    "adaptive_under_claim_free": partial(_black_box, UnderClaim, "free_form"),
}
"""Attacks of family 16 by name, like ``ATTACKS``; they need ``Knowledge(estimator=…)``: 200 queries per sweep."""
