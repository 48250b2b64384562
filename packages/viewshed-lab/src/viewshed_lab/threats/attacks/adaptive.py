"""Attackers who adapt to what the victim runs, by asking it (family 16) or by its gradient (family 15).

What they want is a number for each sweep that the victim might read. They search among plans (which beams to take and
which ranges to give them, or where to put free points) by random draws, and by an evolution from the best of them.
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

DRAWN_SHARE = 0.3
"""Share of the queries of an evolution that its random draws may use."""

OFFSPRING = 6

_GROWS, _SHRINKS = 1.6, 0.88
"""Factors of the step after a success and after a failure."""

_STEPS = (0.03, 2.0)
"""Smallest and largest step of the evolution."""

_MARGIN_M = 2.0
"""Planned ranges keep this far from the sensor's limits, so that noise rarely takes a return away."""

_NEAR_M = 25.0
"""Obstacles nearer than this are a feature of their own."""

_FREE_M = (1.0, 90.0)
"""Nearest and farthest range of free points."""

_F = 10
"""Features of a beam."""

_GONE, _SHARP, _STREET, _WALL = 2 * _F, 3 * _F + 1, 3 * _F + 2, 3 * _F + 3
"""Places in a candidate: the constant weight of removal, and numbers of the head."""

_MIDDLE, _OBSTACLE, _SPREAD, _CROWD, _NEAR = 2, 4, 6, 8, 9
"""Features by column, see ``_features``."""

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
"""The first plans: a fan of far returns; a far wall in the middle and one spread over columns; removal in the middle;
far walls and removal that take the columns with the fewest obstacles first; near walls."""


class SearchSpace(Protocol):
    """What can be searched."""

    def draw(self, number: int, rng: np.random.Generator) -> F64:
        """Return a random plan; the first few may be good guesses, by their number."""
        ...

    def mutated(self, parent: F64, step: float, rng: np.random.Generator) -> F64:
        """Return a plan near another."""
        ...


class Attempts:
    """The plans that were tried: the best, what it is worth, and what each was worth, in order.

    Of equals the later is the best, so that a plateau is crossed.
    """

    def __init__(self, value_of: Callable[[F64], float]) -> None:
        self._value_of = value_of
        self.candidate: F64 | None = None
        self.value = -np.inf
        self.history: list[float] = []

    def attempt(self, candidate: F64) -> bool:
        """Return whether a plan is better than all before."""
        value = self._value_of(candidate)
        self.history.append(value)
        better = value > self.value
        if value >= self.value:
            self.candidate, self.value = candidate, value
        return better


def evolution(space: SearchSpace, value_of: Callable[[F64], float], limit: int, rng: np.random.Generator) -> Attempts:
    """Try ``limit`` plans: a share drawn at random, then a (1 + λ) evolution strategy with λ = 6 from the best.

    The step grows after a success and shrinks otherwise (Rechenberg 1973). Never worse than the best of its draws.
    """
    tried, step = Attempts(value_of), 0.6
    for number in range(int(np.ceil(DRAWN_SHARE * limit))):
        tried.attempt(space.draw(number, rng))
    while (left := limit - len(tried.history)) > 0 and tried.candidate is not None:
        parent = tried.candidate
        children = [space.mutated(parent, step, rng) for _ in range(min(OFFSPRING, left))]
        won = [tried.attempt(child) for child in children]
        step = float(np.clip(step * (_GROWS if any(won) else _SHRINKS), *_STEPS))
    return tried


@dataclass(frozen=True, slots=True, eq=False)
class BeamSearchSpace:
    """Plans on the beams of a wedge: a priority and a wanted depth for each, from a few weights and a residual each.

    A candidate is: weights of the features for the priority, for the depth and for removal; which elevation to prefer
    and how much; whether depths are an empty street's and how far its wall is; then residuals of priority and depth.
    """

    sweep: Sweep  # that is attacked
    wedge: Wedge  # that the attacker reaches
    budget: int | None  # most beams, None for all
    spoofer: Spoofer  # what the attacker achieves
    rays: Rays  # (K,) beams of the wedge
    # (K, F) of the beams: constant, azimuth and its distance from the middle, elevation, obstacle, depth, numbers that
    # spread evenly over columns and over rings, how crowded with obstacles the column is, and obstacles that are near
    features: F64
    obstacle: NDArray[np.bool_]  # (K,) bool, beams that returned from above the ground

    @classmethod
    def of(cls, sweep: Sweep, wedge: Wedge, budget: int | None, spoofer: Spoofer) -> BeamSearchSpace:
        """Return the plans for a wedge of a sweep; where its beams are not known, only returns can be moved."""
        rays = rays_in(sweep, wedge, empty=lattice_of(sweep) is not None)
        obstacle = is_obstacle(sweep, rays) if len(rays) else np.zeros(0, np.bool_)
        return cls(sweep, wedge, budget, spoofer, rays, _features(rays, wedge, obstacle), obstacle)

    def draw(self, number: int, rng: np.random.Generator) -> F64:
        """Return a random plan; the first few are guesses: a fan of far returns, far walls, removal, near walls."""
        f, k = _F, len(self.rays)
        candidate = np.concatenate([rng.normal(0.0, 1.0, 3 * f + 4), rng.normal(0.0, 0.3, 2 * k)])
        candidate[_GONE] -= 2.5  # removal is the exception
        candidate[_SHARP] += rng.exponential(3.0) - 1.0
        candidate[3 * f + 4 :][:k] += rng.exponential(1.0) * self._by_column(rng)
        if number < len(_GUESSES):
            candidate[:] = 0.0
            candidate[list(_GUESSES[number])] = list(_GUESSES[number].values())
        return candidate

    def _by_column(self, rng: np.random.Generator) -> F64:
        """Return one normal number (K,) for each beam, the same for all of a column."""
        _, number = np.unique(self.features[:, _SPREAD], return_inverse=True)
        return np.asarray(rng.normal(0.0, 1.0, int(number.max(initial=-1)) + 1)[number])

    def mutated(self, parent: F64, step: float, rng: np.random.Generator) -> F64:
        """Return a plan with some weights changed, or the residuals of some beams, or both."""
        child, head = parent.copy(), 3 * _F + 4
        which = rng.random()
        if which < 0.7:
            chosen = rng.random(head) < 0.25
            child[:head][chosen] += step * rng.normal(0.0, 1.0, int(chosen.sum()))
        if which > 0.4:
            middle, width = rng.uniform(-1.0, 1.0), rng.uniform(0.05, 0.6)
            near = np.tile(np.abs(self.features[:, 1] - middle) < width, 2)
            child[head:][near] += step * rng.normal(0.0, 1.0, int(near.sum())) + step * rng.normal()
            child[head : head + len(self.rays)] += step * self._by_column(rng) * (rng.random() < 0.5)
        return child

    def tampered(self, candidate: F64, rng: np.random.Generator) -> Tampered:
        """Return the sweep after a plan, as far as the spoofer wins and keeps to it."""
        return self.spoofer.spoof(self.sweep, self.rays, self.wanted_m(candidate), self.wedge, rng)

    def wanted_m(self, candidate: F64) -> F64:
        """Return the depth (K,) in meters that a plan wants of each beam, ``LEAVE`` or ``NO_RETURN``."""
        f, k = _F, len(self.rays)
        priority, depth, gone = (self.features @ candidate[: 3 * f].reshape(3, f).T).T
        height, sharp, street, wall = candidate[3 * f : 3 * f + 4]
        residual = candidate[3 * f + 4 :]
        priority = priority + residual[:k] - max(sharp, 0.0) * np.abs(self.features[:, 3] - height)
        least_m, most_m = limits_m(self.sweep)
        low_m, high_m = min(least_m + _MARGIN_M, most_m), max(most_m - _MARGIN_M, least_m)
        if street > 0.0:
            wall_m = low_m + (high_m - low_m) * float(_sigmoid(wall))
            wanted = street_depth_m(self.sweep, self.rays, wall_m)
            priority = np.where(wanted > self.rays.depth_m + _MARGIN_M, priority, -np.inf)
            wanted = np.clip(wanted, low_m, high_m)
        else:
            wanted = low_m + (high_m - low_m) * _sigmoid(depth + wall + residual[k:])
        wanted = np.where((gone > 0.0) & (self.rays.row >= 0), NO_RETURN, wanted)
        limit = k if self.budget is None else min(self.budget, k)
        out = np.full(k, LEAVE)
        chosen = np.argsort(-priority, kind="stable")[:limit]
        chosen = chosen[np.isfinite(priority[chosen])]
        out[chosen] = wanted[chosen]
        return out


@dataclass(frozen=True, slots=True, eq=False)
class PointSearchSpace:
    """Plans of free points in a wedge: azimuth, range and height of each, from a few numbers and residuals."""

    sweep: Sweep  # that is attacked
    wedge: Wedge  # that the attacker reaches
    budget: int  # number of points

    def draw(self, number: int, rng: np.random.Generator) -> F64:
        """Return a random plan; the first is an even fan of far points."""
        candidate = np.concatenate([rng.normal(0.0, 1.0, 5), rng.normal(0.0, 0.5, 3 * self.budget)])
        if number == 0:
            candidate[:5] = 0.0, 1.0, 3.0, 0.0, 0.0
            candidate[5:] = 0.0
        return candidate

    def mutated(self, parent: F64, step: float, rng: np.random.Generator) -> F64:
        """Return a plan with the common numbers changed, or some points, or both."""
        child, which = parent.copy(), rng.random()
        if which < 0.7:
            child[:5] += step * rng.normal(0.0, 1.0, 5)
        if which > 0.4:
            some = np.tile(rng.random(self.budget) < 0.2, 3)
            child[5:][some] += step * rng.normal(0.0, 1.0, int(some.sum()))
        return child

    def tampered(self, candidate: F64, rng: np.random.Generator) -> Tampered:
        """Return the sweep with the points of a plan; points that the attitude puts beside the wedge are left out."""
        points = self.points(candidate)
        tampered = add_points(self.sweep, points[within(points.astype(np.float32), self.wedge)], rng)
        return replace(tampered, wedge=self.wedge)

    def points(self, candidate: F64) -> F64:
        """Return the points (budget, 3) of a plan, meters, sensor frame."""
        middle, spread, far, slope, high = candidate[:5]
        aside, near, up = candidate[5:].reshape(3, self.budget)
        even = (np.arange(self.budget) + 0.5) * (2.0 / max(self.budget, 1)) - 1.0
        azimuth = self.wedge.azimuth + 0.499 * self.wedge.width * np.clip(middle + spread * even + 0.1 * aside, -1, 1)
        range_m = _FREE_M[0] + (_FREE_M[1] - _FREE_M[0]) * _sigmoid(far + slope * even + near)
        to_level = scene_of(self.sweep).level_from_sensor.rotation
        ahead = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)], axis=1) @ to_level.T
        xy = range_m[:, None] * ahead[:, :2]
        low_m, high_m = HEIGHTS_M
        z = scene_of(self.sweep).ground.at(xy) + low_m + (high_m - low_m) * _sigmoid(high + up)
        return to_sensor(self.sweep, np.column_stack([xy, z]))


def _features(rays: Rays, wedge: Wedge, obstacle: NDArray[np.bool_]) -> F64:
    """Return features (K, 10) of beams, each about one wide."""
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
    """Return multiples of the golden ratio in [0, 1): the first few of any run of numbers are spread evenly."""
    return np.asarray((number * 0.6180339887498949) % 1.0)


def _sigmoid(value: F64 | float) -> F64:
    squashed: F64 = 0.5 + 0.5 * np.tanh(0.5 * np.asarray(value))
    return squashed


Value = Callable[[Sweep], float]
"""From an attacked sweep to what it is worth to the attacker."""


class Objective(Protocol):
    """Anything that an attacker wants more of."""

    def on(self, clean: Sweep, wedge: Wedge) -> Value:
        """Return what sweeps made from ``clean`` are worth, where the attacker reaches ``wedge``."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class OverClaim:
    """Area in the wedge, in m², that the victim claims under attack and did not claim before.

    The attacker has no truth: the victim's own clean estimate stands for it.
    """

    estimator: FovEstimator  # what the victim runs
    threshold: float = THRESHOLD  # probability from which a cell is claimed

    claimed: ClassVar[bool] = True
    """Whether cells are to be claimed that were not, or the other way round."""

    def on(self, clean: Sweep, wedge: Wedge) -> Value:
        """Return the objective; the victim is queried once."""
        grid = self.estimator.grid

        def claims(sweep: Sweep) -> NDArray[np.bool_]:
            return np.asarray(self.estimator.estimate(sweep).visible(self.threshold) == self.claimed)

        x, y = np.moveaxis(grid.centers @ scene_of(clean).level_from_sensor.rotation[:2, :2], -1, 0)
        others = ~claims(clean) & wedge.holds(np.arctan2(y, x))
        return lambda sweep: float((others & claims(sweep)).sum()) * grid.cell_area_m2


@dataclass(frozen=True, slots=True, eq=False)
class UnderClaim(OverClaim):
    """Area in the wedge, in m², that the victim claimed before and no longer claims under attack.

    Its attributes are those of :class:`OverClaim`.
    """

    claimed = False


@dataclass(frozen=True, slots=True, eq=False)
class Evade(Checked):
    """Another objective, worth nothing like as much where a monitor's score is above a limit."""

    aim: Objective  # what the attacker wants
    score: Value  # from a sweep to the doubt of a monitor, or 1 for an alarm and 0 for none
    limit: float = 0.0  # the highest score that goes unnoticed
    # what one unit of score above the limit costs, in units of the aim
    penalty: Annotated[float, Between(0.0, 1e12)] = 1e6

    def on(self, clean: Sweep, wedge: Wedge) -> Value:
        """Return the aim less the penalty."""
        aim = self.aim.on(clean, wedge)
        return lambda sweep: aim(sweep) - self.penalty * max(0.0, float(self.score(sweep)) - self.limit)


@dataclass(frozen=True, slots=True, eq=False)
class SearchResult:
    """What an attacker found."""

    tampered: Tampered  # the attacked sweep, with noise that the attacker could not know, and what was done to it
    value: float  # what the plan was worth to the attacker while planning
    history: NDArray[np.float64]  # (P,) what each plan that was tried was worth, the first is doing nothing
    queries: int  # how often the victim was queried


@dataclass(frozen=True, slots=True, eq=False)
class BlackBox(Checked):
    """Searches for the plan that is worth most, by asking the victim what it makes of attacked sweeps.

    Plans are tried with range noise and lost beams as the spoofer has them, drawn once; the attack itself meets other
    noise. A plan that is worth no more than doing nothing is not carried out.
    """

    objective: Objective  # what the attacker wants
    budget: Budget = 150  # most returns; None for every beam of the wedge
    queries: Annotated[int, Between(2, 10_000_000)] = 200  # most questions to the victim; two are of the clean sweep
    sector_deg: Sector = 30.0  # width of the wedge
    # middle of the wedge in the sensor's frame; None aims at an obstacle as a far wall is aimed
    azimuth: Azimuth = None
    aim_m: Range = 25.0  # obstacles nearer than this are aimed at
    placement: Placement = "random"  # how that is aimed, see :class:`WedgeAttack`
    mode: Mode = "beam_constrained"  # ``beam_constrained`` or ``free_form``
    spoofer: Spoofer = MEASURED_SPOOFER  # how well the beams are won

    def __post_init__(self) -> None:
        Checked.__post_init__(self)
        check_free_budget(self.mode, self.budget)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        return self.search(sweep, rng).tampered

    def search(self, sweep: Sweep, rng: np.random.Generator) -> SearchResult:
        """Return the attacked sweep with what it is worth and what it cost to find."""
        aimed = FarWall(self.budget, self.sector_deg, self.azimuth, self.placement, near_m=self.aim_m)
        wedge = aimed.aim(sweep, rng)
        value_of = self.objective.on(sweep, wedge)
        nothing, seed = value_of(sweep), int(rng.integers(2**62))
        space: BeamSearchSpace | PointSearchSpace
        if self.mode == "free_form":
            space = PointSearchSpace(sweep, wedge, self.budget or 0)
        else:
            space = BeamSearchSpace.of(sweep, wedge, self.budget, self.spoofer)

        def worth(candidate: F64) -> float:
            """Return what a plan is worth under noise that is the same for every plan."""
            noise = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, 0])))
            return float(value_of(space.tampered(candidate, noise).sweep))

        best = evolution(space, worth, max(0, self.queries - 2), rng)
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
"""Attackers of family 16 by name, as ``ATTACKS``; they need ``Knowledge(estimator=…)`` and ask it 200 times a sweep."""
