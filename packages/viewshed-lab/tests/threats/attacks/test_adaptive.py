"""Attackers who adapt: optima that are known, rules of the beam model, their cost; and that they beat a far wall."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from tests.threats.attacks.drawn import generator, same
from tests.threats.attacks.oracle import Scene, broken_by_any, broken_on_beams

from viewshed import BevGrid, FovEstimate, Sweep
from viewshed.arrays import F64
from viewshed.estimators import ESTIMATORS
from viewshed_lab.threats.attacks import Spoofer, Wedge
from viewshed_lab.threats.attacks._gradient import Expectation, WhiteBox
from viewshed_lab.threats.attacks.adaptive import BlackBox, Evade, OverClaim, SearchResult, UnderClaim, evolution
from viewshed_lab.threats.attacks.ghosts import FarWall

pytestmark = pytest.mark.slow

EXACT = Spoofer(1.0, 0.0, 0.0)
WIDE = BevGrid(64, 100.0)


@dataclass(frozen=True)
class Reach:
    """A victim that claims the disc up to the farthest return, and counts how often it is asked."""

    asked: list[int]
    grid: BevGrid = WIDE

    def estimate(self, sweep: Sweep) -> FovEstimate:
        self.asked.append(len(sweep))
        far_m = float(np.hypot(sweep.points[:, 0], sweep.points[:, 1]).max(initial=0.0))
        seen = np.hypot(*np.moveaxis(self.grid.centers, -1, 0)) < far_m
        return FovEstimate(self.grid, seen.astype(np.float32), seen.astype(np.uint8))


@dataclass(frozen=True)
class Bowl:
    """Plans (3,) whose best is known."""

    best: tuple[float, float, float] = (1.5, -0.7, 0.2)

    def draw(self, number: int, rng: np.random.Generator) -> F64:
        return rng.normal(0.0, 2.0, 3)

    def mutated(self, parent: F64, step: float, rng: np.random.Generator) -> F64:
        return parent + step * rng.normal(0.0, 1.0, 3)

    def value(self, candidate: F64) -> float:
        return -float(((candidate - np.array(self.best)) ** 2).sum())


def test_evolution_finds_the_top_of_a_bowl() -> None:
    found = evolution(Bowl(), Bowl().value, 400, generator(1))
    assert np.abs(found.candidate - Bowl().best).max() < 0.05
    assert len(found.history) == 400


def test_the_farthest_claim_is_the_whole_wedge(flat_scene: Any) -> None:
    sweep, wedge = flat_scene(12.0), Wedge(0.2, np.deg2rad(30.0))
    victim = Reach([])
    attack = BlackBox(OverClaim(victim), 1, 40, azimuth=0.2, spoofer=EXACT)
    found = attack.search(sweep, generator(3))
    x, y = np.moveaxis(victim.grid.centers, -1, 0)
    range_m, before_m = np.hypot(x, y), np.hypot(*sweep.points[:, :2].T).max()
    reach = wedge.holds(np.arctan2(y, x)) & (range_m >= before_m) & (range_m < 77.9)
    most_m2 = reach.sum() * victim.grid.cell_area_m2
    assert 0.96 * most_m2 < found.value <= most_m2
    assert found.tampered.added.sum() == 1
    assert found.queries == len(victim.asked) == 40
    assert len(found.history) == 39
    assert found.history[0] == 0.0


@pytest.mark.parametrize("mode", ["beam_constrained", "free_form"])
def test_black_boxes_keep_the_rules(simulated: list[Scene], mode: Any) -> None:
    effective = 0
    for number, scene in enumerate(simulated):
        budget, half = (1, 20, 150, 700)[number % 4], scene.half_extent_m
        victim = ESTIMATORS["continuous"](BevGrid(48, half))
        aim = OverClaim(victim) if number % 2 else UnderClaim(victim)
        attack = BlackBox(aim, budget, 25, azimuth=0.7 * number, mode=mode)
        before = scene.sweep.points.tobytes()
        found = attack.search(scene.sweep, generator(number))
        assert before == scene.sweep.points.tobytes()
        assert same(found.tampered, attack.apply(scene.again(), generator(number)))
        rules = broken_on_beams(scene, found.tampered, budget) if mode == "beam_constrained" else []
        assert rules + broken_by_any(scene.sweep, found.tampered, budget) == [], scene.name
        assert found.queries <= 25
        assert found.value == found.history.max()
        wedge, new = found.tampered.wedge, found.tampered.sweep.points[found.tampered.added]
        assert wedge.holds(np.arctan2(new[:, 1], new[:, 0])).all()
        effective += bool(found.tampered.added.any() or found.tampered.removed.any())
    assert effective >= 5


@pytest.mark.parametrize(("name", "times"), [("continuous", 4.0), ("first_blocker", 1.0), ("shadow_map", 2.0)])
def test_who_adapts_over_claims_more_than_a_far_wall(simulated: list[Scene], name: str, times: float) -> None:
    adaptive = fixed = 0.0
    for number, scene in enumerate(simulated[:8:2]):
        aim = OverClaim(ESTIMATORS[name](BevGrid(128, 64.0)))
        azimuth = FarWall().apply(scene.sweep, generator(number)).wedge
        worth = aim.on(scene.sweep, azimuth)
        found = BlackBox(aim, 60, 60, azimuth=azimuth.azimuth).search(scene.sweep, generator(number, 1))
        adaptive += worth(found.tampered.sweep)
        fixed += worth(FarWall(60, azimuth=azimuth.azimuth).apply(scene.sweep, generator(number, 2)).sweep)
    assert adaptive > times * fixed


def test_evading_keeps_the_monitor_quiet(flat_scene: Any) -> None:
    sweep, victim = flat_scene(12.0), Reach([])
    clean_m = float(np.hypot(*sweep.points[:, :2].T).max())

    def score(seen: Sweep) -> float:
        return float(np.hypot(*seen.points[:, :2].T).max()) - clean_m

    evade = BlackBox(Evade(OverClaim(victim), score, 9.0), 20, 120, azimuth=0.0, spoofer=EXACT).search(
        sweep, generator(1)
    )
    assert 0.0 < score(evade.tampered.sweep) <= 9.0
    assert evade.value > 0.0


@dataclass(frozen=True)
class Wells:
    """-Σ wᵢ (rᵢ - tᵢ)² over the returns: the best range of each is known."""

    weight: np.ndarray
    target_m: np.ndarray

    def __call__(self, points: np.ndarray) -> tuple[float, np.ndarray]:
        range_m = np.linalg.norm(points, axis=1)
        off_m = range_m - self.target_m
        return -float((self.weight * off_m**2).sum()), (-2 * self.weight * off_m / range_m)[:, None] * points


def _wells(sweep: Sweep) -> Wells:
    rng = np.random.default_rng(6)
    range_m = np.linalg.norm(sweep.points, axis=1)
    return Wells(rng.uniform(0.1, 3.0, len(sweep)), np.clip(range_m + rng.uniform(-12, 25, len(sweep)), 3.0, 75.0))


def test_the_gradient_finds_the_best_beams_and_their_best_ranges(flat_scene: Any) -> None:
    sweep = flat_scene(14.0)
    wells, range_m = _wells(sweep), np.linalg.norm(sweep.points, axis=1)
    attack = WhiteBox(wells, 40, 160, azimuth=0.1, spoofer=EXACT)
    found = attack.search(sweep, generator(1))
    inside = Wedge(0.1, np.deg2rad(29.999)).holds(np.arctan2(sweep.points[:, 1], sweep.points[:, 0]))
    gain = np.where(inside, wells.weight * (range_m - wells.target_m) ** 2, 0.0)
    best = np.argsort(-gain)[:40]
    assert set(np.flatnonzero(found.tampered.removed)) == set(best)
    assert found.value - found.history[0] == pytest.approx(gain[best].sum(), rel=1e-3)
    new_m = np.linalg.norm(found.tampered.sweep.points[found.tampered.added], axis=1)
    assert np.abs(np.sort(new_m) - np.sort(wells.target_m[best])).max() < 0.1
    assert len(found.history) == 162 == found.queries


def test_ranges_stay_where_the_sensor_reports_them(flat_scene: Any) -> None:
    sweep = flat_scene(14.0)
    wells = Wells(np.ones(len(sweep)), np.full(len(sweep), 500.0))
    found = WhiteBox(wells, None, 400, azimuth=0.1, sector_deg=6.0, spoofer=EXACT).search(sweep, generator(1))
    new_m = np.linalg.norm(found.tampered.sweep.points[found.tampered.added], axis=1)
    assert len(new_m) > 100
    assert np.abs(new_m - 79.5).max() < 0.1


def test_expectation_over_noise_is_unbiased_and_costs_its_samples(flat_scene: Any) -> None:
    sweep = flat_scene(14.0)
    wells = _wells(sweep)
    noisy = WhiteBox(wells, 40, 80, azimuth=0.1, expectation=Expectation(6, 0.3, 0.1, 0.02, 0.1), spoofer=EXACT)
    found = noisy.search(sweep, generator(1))
    plain = WhiteBox(wells, 40, 80, azimuth=0.1, spoofer=EXACT).search(sweep, generator(1))
    assert found.queries == 6 * plain.queries == 6 * 82
    value = wells(sweep.points.astype(np.float64))[0]
    assert found.value > value
    gained = [wells(_met(sweep, one))[0] - value for one in (plain, found)]
    assert 0.8 * gained[0] < gained[1] < gained[0]


def _met(sweep: Sweep, found: SearchResult) -> np.ndarray:
    """Return the points after an attack in the rows that they had: each return replaced keeps its place."""
    assert found.tampered.added.sum() == found.tampered.removed.sum()
    return found.tampered.sweep.points.astype(np.float64)


def test_white_boxes_keep_the_rules(simulated: list[Scene]) -> None:
    for number, scene in enumerate(simulated):
        target_m = np.random.default_rng(number).uniform(0.0, 150.0, len(scene.sweep))
        attack = WhiteBox(Wells(np.ones(len(scene.sweep)), target_m), (5, 150, None)[number % 3], 20, azimuth=number)
        found = attack.search(scene.sweep, generator(number))
        assert broken_on_beams(scene, found.tampered, attack.budget) == [], scene.name
        assert same(found.tampered, attack.apply(scene.again(), generator(number)))
        assert found.value >= found.history[0]


def test_a_slope_that_leads_down_is_not_followed(flat_scene: Any) -> None:
    sweep = flat_scene(14.0)
    range_m = np.linalg.norm(sweep.points, axis=1)
    found = WhiteBox(Wells(np.ones(len(sweep)), range_m), 40, 20, azimuth=0.1).search(sweep, generator(1))
    assert found.tampered.sweep.points.tobytes() == sweep.points.tobytes()
