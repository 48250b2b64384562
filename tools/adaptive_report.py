"""Report what attackers who adapt achieve and cost, beside a far wall that does not, as a table in the docs.

Usage: python -m tools.adaptive_report [OUT.md] [SCENES]
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from viewshed import CAR, Sweep
from viewshed._page import facts, page, table
from viewshed.datasets.presets import preset_named
from viewshed.datasets.simulated import ScenePlan, simulate_frame
from viewshed.estimators import ESTIMATORS
from viewshed.fov.estimate import FovEstimate, FovEstimator
from viewshed.grid import BevGrid
from viewshed.threats.attacks import Attack, Tampered, Wedge
from viewshed.threats.attacks._gradient import WhiteBox
from viewshed.threats.attacks.adaptive import BlackBox, Evade, Objective, OverClaim, UnderClaim, cells_in
from viewshed.threats.attacks.ghosts import FarWall, RemovalAndFarWall
from viewshed.threats.defenses import DEFENSES

BUDGET, QUERIES, SECTOR_DEG, STEPS = 150, 200, 30.0, 80
VICTIMS = ("continuous", "first_blocker", "shadow_map")
DEFENDED = ("radius", "one_return")
WAYS = ("far wall", "removal and far wall", "random search", "evolution", "evolution, free points")
_INTRODUCTION = """\
{scenes} simulated road scenes (HDL-32E, clear), one sweep each. The wedge of {sector:g}° is aimed at an obstacle nearer
than 25 m, the same for all ways; the budget is {budget} returns with the noise and the losses measured on commercial
sensors, {queries} queries for each search. Areas are means over the scenes, in m², in the wedge, for a car:

- **newly claimed**: claimed under attack and not before, what the attacker can measure;
- **of which false**: what exact truth does not show.

A plan is made with other noise than it meets, so *planned* and *newly claimed* differ."""
_COST = """\
A query costs one estimate and one application of a plan; a search costs its queries. A white box pays for each of its
steps one gradient, which is the network's; here it is that of an analytic objective."""


@dataclass(frozen=True, slots=True)
class Scene:
    """A sweep with its truth."""

    sweep: Sweep
    visible: NDArray[np.bool_]
    known: NDArray[np.bool_]
    grid: BevGrid


@dataclass(frozen=True, slots=True)
class Defended:
    """A victim that cleans its sweeps first; the attacker knows."""

    victim: FovEstimator
    defense: str

    @property
    def grid(self) -> BevGrid:
        """The victim's."""
        return self.victim.grid

    def estimate(self, sweep: Sweep) -> FovEstimate:
        """Estimate from what is left."""
        return self.victim.estimate(DEFENSES[self.defense]().apply(sweep).sweep)


@dataclass(slots=True)
class Sums:
    """What came of one way against one victim, summed over scenes."""

    claimed_m2: list[float] = field(default_factory=list)
    false_m2: list[float] = field(default_factory=list)
    planned_m2: list[float] = field(default_factory=list)
    seconds: float = 0.0
    queries: int = 0


def scenes_of(count: int) -> list[Scene]:
    """Return simulated sweeps of different scenes."""
    preset = replace(preset_named("nuscenes"), conditions=("clear",), condition_weights=(1.0,), seed=77)
    found = []
    for number in range(count):
        frame = simulate_frame(ScenePlan(preset, 0, number), 11)
        found.append(Scene(frame.sweep, frame.truth.visible(CAR), frame.known, frame.truth.grid))
    return found


def _way(name: str, victim: FovEstimator, azimuth: float) -> Attack:
    aim = OverClaim(victim)
    ways: dict[str, Attack] = {
        "far wall": FarWall(BUDGET, SECTOR_DEG, azimuth=azimuth),
        "removal and far wall": RemovalAndFarWall(BUDGET, SECTOR_DEG, azimuth=azimuth),
        "random search": BlackBox(aim, BUDGET, QUERIES, SECTOR_DEG, azimuth, method="random"),
        "evolution": BlackBox(aim, BUDGET, QUERIES, SECTOR_DEG, azimuth),
        "evolution, free points": BlackBox(aim, BUDGET, QUERIES, SECTOR_DEG, azimuth, mode="free_form"),
    }
    return ways[name]


def measured(name: str, victim: FovEstimator, scenes: list[Scene]) -> Sums:
    """Return what one way achieves against one victim."""
    sums = Sums()
    for number, scene in enumerate(scenes):
        wedge = FarWall(sector_deg=SECTOR_DEG).aim(scene.sweep, _rng(number, 0))
        attack = _way(name, victim, wedge.azimuth)
        start = time.perf_counter()
        if isinstance(attack, BlackBox):
            found = attack.search(scene.sweep, _rng(number, 1))
            sums.planned_m2.append(found.value)
            sums.queries += found.queries
            tampered = found.tampered
        else:
            tampered = attack.apply(scene.sweep, _rng(number, 1))
        sums.seconds += time.perf_counter() - start
        _score(sums, scene, victim, tampered, wedge)
    return sums


def _score(sums: Sums, scene: Scene, victim: FovEstimator, tampered: Tampered, wedge: Wedge) -> None:
    before, after = victim.estimate(scene.sweep).visible(), victim.estimate(tampered.sweep).visible()
    new = after & ~before & cells_in(scene.grid, scene.sweep, wedge)
    sums.claimed_m2.append(float(new.sum()) * scene.grid.cell_area_m2)
    sums.false_m2.append(float((new & scene.known & ~scene.visible).sum()) * scene.grid.cell_area_m2)


def _rng(*seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))


def _row(victim: str, way: str, sums: Sums, base: Sums) -> list[str]:
    wins = sum(mine > far for mine, far in zip(sums.claimed_m2, base.claimed_m2, strict=True))
    planned = f"{np.mean(sums.planned_m2):.0f}" if sums.planned_m2 else "–"
    cost = f"{1e3 * sums.seconds / len(sums.claimed_m2):.0f}"
    each = f"{1e3 * sums.seconds / sums.queries:.1f}" if sums.queries else "–"
    more = "–" if sums is base else f"{wins} of {len(sums.claimed_m2)}"
    claimed, false = np.mean(sums.claimed_m2), np.mean(sums.false_m2)
    return [victim, way, planned, f"{claimed:.0f}", f"{false:.0f}", more, cost, each]


def _gradient_ms(scenes: list[Scene]) -> float:
    """Return milliseconds of one step of a white box, without the network's own."""

    def far(points: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        range_m = np.linalg.norm(points, axis=1)
        return float(range_m.sum()), points / np.maximum(range_m, 1e-9)[:, None]

    start = time.perf_counter()
    for number, scene in enumerate(scenes):
        WhiteBox(far, BUDGET, STEPS, sector_deg=SECTOR_DEG).search(scene.sweep, _rng(number))
    return 1e3 * (time.perf_counter() - start) / len(scenes) / STEPS


def _evading(scenes: list[Scene]) -> list[list[str]]:
    """Return rows of searches that hide from a defense's score, and one that takes away."""
    radius = DEFENSES["radius"]()
    rows = []
    for aim_name in ("over-claim", "over-claim, unnoticed by radius", "under-claim"):
        values, scores = [], []
        for number, scene in enumerate(scenes[:4]):
            victim = ESTIMATORS["shadow_map"](scene.grid)
            limit = radius.apply(scene.sweep).score
            aims: dict[str, Objective] = {
                "over-claim": OverClaim(victim),
                "over-claim, unnoticed by radius": Evade(OverClaim(victim), lambda s: radius.apply(s).score, limit),
                "under-claim": UnderClaim(victim),
            }
            wedge = FarWall(sector_deg=SECTOR_DEG).aim(scene.sweep, _rng(number, 0))
            found = BlackBox(aims[aim_name], BUDGET, QUERIES, azimuth=wedge.azimuth).search(scene.sweep, _rng(number))
            values.append(found.value)
            scores.append(radius.apply(found.tampered.sweep).score / limit)
        rows.append([aim_name, f"{np.mean(values):.0f}", f"{np.mean(scores):.3f}"])
    return rows


def report(scenes: list[Scene]) -> str:
    """Return the page."""
    victims: dict[str, FovEstimator] = {name: ESTIMATORS[name](scenes[0].grid) for name in VICTIMS}
    victims |= {f"shadow_map after {name}": Defended(victims["shadow_map"], name) for name in DEFENDED}
    rows = []
    for victim, estimator in victims.items():
        ways = WAYS if victim in VICTIMS else ("far wall", "evolution")
        found = {way: measured(way, estimator, scenes) for way in ways}
        rows += [_row(victim, way, sums, found["far wall"]) for way, sums in found.items()]
    head = ["victim", "attacker", "planned", "newly claimed", "of which false", "more than the far wall", "ms a sweep",
            "ms a query"]  # fmt: skip
    intro = _INTRODUCTION.format(scenes=len(scenes), sector=SECTOR_DEG, budget=BUDGET, queries=QUERIES)
    other = table(["objective against `shadow_map`", "planned, m²", "score of `radius`, clean = 1"], _evading(scenes))
    step = f"A step of a white box costs {_gradient_ms(scenes):.1f} ms beside the gradient."
    return page(
        "Attackers who adapt: what they achieve", facts(cores="1"), intro, table(head, rows), _COST, step, other
    )


def main() -> None:
    """Measure, write."""
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    text = report(scenes_of(int(sys.argv[2]) if len(sys.argv) > 2 else 8))
    if out is None:
        print(text)
    else:
        out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
