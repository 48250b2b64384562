"""White-box attack: projected gradient ascent on the ranges of the attacker's beams."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed.sweep import Sweep
from viewshed_lab._config import Azimuth, Between, Budget, Checked, Range, Sector, Share
from viewshed_lab.threats.attacks.adaptive import SearchResult
from viewshed_lab.threats.attacks.base import Tampered
from viewshed_lab.threats.attacks.beam_lattice import Rays, rays_in
from viewshed_lab.threats.attacks.ghosts import FarWall
from viewshed_lab.threats.attacks.spoofer import LEAVE, MEASURED_SPOOFER, Spoofer, limits_m, untouched
from viewshed_lab.threats.attacks.wedge_attack import Placement

ValueAndGradient = Callable[[NDArray[np.float64]], tuple[float, NDArray[Any]]]
"""Maps points (N, 3) in the sensor's frame to the attacker's objective and its gradient (N, 3)."""

_MARGIN_M = 0.5  # distance of planned ranges from the sensor's limits

_REFINES = 0.25
"""The second half of the steps starts with this share of the initial step."""


@dataclass(frozen=True, slots=True)
class Expectation(Checked):
    """Random disturbances over which the objective is averaged, so that a plan is robust (Athalye et al. 2018)."""

    samples: Annotated[int, Between(1, 10_000)] = 8  # per gradient
    # standard deviation of the ranges of the attacker's returns
    noise_m: Annotated[float, Between(0.0, 10.0)] = 0.10
    lost_share: Share = 0.015  # of the attacker's beams; a lost one keeps its clean return
    yaw: Annotated[float, Between(0.0, np.pi)] = 0.0  # standard deviation of a rotation of the cloud, radians
    # standard deviation of a shift of the cloud, along each level axis
    shift_m: Annotated[float, Between(0.0, 100.0)] = 0.0


NO_EXPECTATION = Expectation(1, 0.0, 0.0)
"""No disturbances: the plan is carried out exactly."""


@dataclass(frozen=True, slots=True, eq=False)
class WhiteBox(Checked):
    """Gradient ascent in the ranges of the beams that returned, within the range limits of the sensor.

    First all beams of the wedge move; the gain of a beam is its slope integrated along its motion, by trapezoids. The
    beams with the largest gains, up to the budget, are kept and refined; the others go back. The step size is the same
    for all beams (Goodfellow et al. 2015; Madry et al. 2018) and shrinks to zero in each half.
    """

    objective: ValueAndGradient  # value and gradient of the points; rows are those of the sweep
    budget: Budget = 150  # maximum number of beams; None for all of the wedge
    # half before, half after the choice of beams; each half computes the gradient once more
    steps: Annotated[int, Between(2, 100_000)] = 80
    # initial step, meters; a beam moves at most about ``step_m * steps / 4`` before the choice
    step_m: Annotated[float, Between(1e-6, 1000.0)] = 2.0
    sector_deg: Sector = 30.0  # width of the wedge
    # center of the wedge in the sensor's frame; None aims at an obstacle, as a far wall does
    azimuth: Azimuth = None
    aim_m: Range = 25.0  # obstacles nearer than this are aimed at
    placement: Placement = "random"  # choice of the obstacle, see :class:`WedgeAttack`
    expectation: Expectation = NO_EXPECTATION  # disturbances over which the objective is averaged
    spoofer: Spoofer = MEASURED_SPOOFER  # success rate and range noise

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and the record of its changes."""
        return self.search(sweep, rng).tampered

    def search(self, sweep: Sweep, rng: np.random.Generator) -> SearchResult:
        """Return the attacked sweep with the value of the plan and the number of queries.

        Raises:
            ValueError: the objective's gradient does not have the shape of the points, or is not finite.
        """
        aimed = FarWall(self.budget, self.sector_deg, self.azimuth, self.placement, near_m=self.aim_m)
        wedge = aimed.aim(sweep, rng)
        rays = rays_in(sweep, wedge)
        climb = _Climb(sweep, rays, self.objective, self.expectation, int(rng.integers(2**62)))
        all_rays, first = np.ones(len(rays), np.bool_), self.steps // 2
        _, gain = climb.ascend(rays.depth_m, all_rays, first, self.step_m)
        chosen = _best_beams(gain, self.budget)
        start_m = np.where(chosen, climb.depth_m, rays.depth_m)
        best_m, _ = climb.ascend(start_m, chosen, self.steps - first, _REFINES * self.step_m, best=True)
        history, queries = np.array(climb.history), len(climb.history) * self.expectation.samples
        if not chosen.any() or climb.value <= history[0]:
            return SearchResult(untouched(sweep, wedge), float(history[0]), history, queries)
        tampered = self.spoofer.spoof(sweep, rays, np.where(chosen, best_m, LEAVE), wedge, rng)
        return SearchResult(tampered, climb.value, history, queries)


class _Climb:
    """Gradient ascent on the depths of some rays; keeps the last depths, the best value and the history of values."""

    def __init__(
        self, sweep: Sweep, rays: Rays, objective: ValueAndGradient, expectation: Expectation, seed: int
    ) -> None:
        self._points, self._rays, self._objective = sweep.points.astype(np.float64), rays, objective
        self._expectation, self._seed = expectation, seed
        low_m, high_m = limits_m(sweep)
        self._low_m = np.minimum(low_m + _MARGIN_M, rays.depth_m)
        self._high_m = np.maximum(high_m - _MARGIN_M, rays.depth_m)
        self.depth_m = rays.depth_m
        self.value = -np.inf
        self.history: list[float] = []

    def ascend(
        self, start_m: F64, moves: NDArray[np.bool_], steps: int, step_m: float, *, best: bool = False
    ) -> tuple[F64, F64]:
        """Return the best (or the last) depths (K,) in meters, and the gain (K,) of each beam."""
        depth_m, best_m, gain = start_m, start_m, np.zeros(len(start_m))
        value, slope = self._slope(depth_m, moves)
        for number in range(steps):
            if best and value > self.value:
                self.value, best_m = value, depth_m
            ahead = depth_m + step_m * (1.0 - number / steps) * np.sign(slope)
            moved_m = np.where(moves, np.clip(ahead, self._low_m, self._high_m), depth_m)
            value, after = self._slope(moved_m, moves)
            gain += 0.5 * (slope + after) * (moved_m - depth_m)
            depth_m, slope = moved_m, after
        if best and value > self.value:
            self.value, best_m = value, depth_m
        self.depth_m = depth_m
        return (best_m if best else depth_m), gain

    def _slope(self, depth_m: F64, moves: NDArray[np.bool_]) -> tuple[float, F64]:
        """Return the mean value over the disturbances, and its derivative (K,) by the depths."""
        values, slope = [], np.zeros(len(depth_m))
        for sample in range(self._expectation.samples):
            rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence([self._seed, sample])))
            value, along = self._sample(depth_m, moves, rng)
            values.append(value)
            slope += along
        self.history.append(float(np.mean(values)))
        return self.history[-1], slope / self._expectation.samples

    def _sample(self, depth_m: F64, moves: NDArray[np.bool_], rng: np.random.Generator) -> tuple[float, F64]:
        """Return the value and its derivative (K,) under one random disturbance."""
        spread, rays = self._expectation, self._rays
        noise_m = spread.noise_m * rng.normal(size=len(rays))
        kept = moves & (rng.random(len(rays)) >= spread.lost_share)
        angle, shift_m = spread.yaw * rng.normal(), spread.shift_m * rng.normal(size=2)
        points, rows = self._points.copy(), rays.row[kept]
        points[rows] = rays.start_m[kept] + (depth_m + noise_m)[kept, None] * rays.direction[kept]
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        value, gradient = self._objective(points @ turn.T + np.append(shift_m, 0.0))
        gradient = np.asarray(gradient, np.float64)
        if gradient.shape != points.shape or not np.isfinite(gradient).all():
            raise ValueError(f"the gradient must be finite with shape {points.shape}, got {gradient.shape}")
        slope = np.zeros(len(rays))
        slope[kept] = ((gradient @ turn)[rows] * rays.direction[kept]).sum(axis=1)
        return float(value), slope


def _best_beams(gain: F64, budget: int | None) -> NDArray[np.bool_]:
    """Return the mask (K,) of the ``budget`` beams with the largest positive gains."""
    chosen = np.zeros(len(gain), np.bool_)
    order = np.argsort(-gain, kind="stable")[: len(gain) if budget is None else budget]
    chosen[order[gain[order] > 0.0]] = True
    return chosen
