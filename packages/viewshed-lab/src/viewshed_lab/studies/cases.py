"""The cases of the studies: attacks and corruptions of a sweep, with their seeds.

Corruptions that remove beams also change the truth: a sensor with fewer beams sees less, which is not an error.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from viewshed.arrays import Mask
from viewshed.fov.visibility import CAR
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep
from viewshed_lab.data.simulated import ScenePlan, scan_frame, world_of
from viewshed_lab.sim.raycast.scan import ExactScan
from viewshed_lab.sim.truth.exact import exact_truth
from viewshed_lab.studies.records import Case
from viewshed_lab.studies.samples import StudySample
from viewshed_lab.threats.attacks import (
    ATTACKS,
    BUDGETS,
    FULL_WEDGE,
    PAPER_ATTACK,
    PAPER_INDOOR_ATTACK,
    Knowledge,
    at_severity,
)
from viewshed_lab.threats.attacks import SEVERITIES as STRENGTHS
from viewshed_lab.threats.attacks.base import Attack, Tampered
from viewshed_lab.threats.attacks.points import PaperAttack
from viewshed_lab.threats.corruptions import CORRUPTIONS, Corruption

KINDS = ("benign", "attack", "strength", "corruption", "paper", "adaptive", "unaware")
"""No attack; an attack with a budget; one with a sector, share or offset; a corruption with a severity; the paper's
attacks with a number of points; an attacker that queries the victim, behind its defense if it has one; and one that
queries the victim without its defense. The last two attack each victim separately, see ``evaluate``."""

FULL = "full"
"""The budget of every beam in the wedge."""

DEFAULT = "default"
"""The default budget of an attack."""

MIXTURE = Case("paper", "mixture")
"""The paper's attacks, drawn anew for each sweep."""

TOUCHING = tuple(name for name in ATTACKS if name != "pose_spoof")
"""Attacks that change returns; a spoofed pose only moves the estimate in the map."""

ROOM_M = 20.0
"""Grids with a smaller half extent are indoors: the paper's indoor settings apply."""


def generator(seed: int, *words: str | int) -> np.random.Generator:
    """Return a random generator seeded by a seed, words and numbers."""
    numbers = [word if isinstance(word, int) else zlib.crc32(word.encode()) for word in words]
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *numbers])))


def case_generator(seed: int, domain: str, number: int, case: Case) -> np.random.Generator:
    """Return the generator of a case on one sweep; all levels and defenses share it, for comparison."""
    return generator(seed, number, domain, case.kind.replace("strength", "attack"), case.name)


def budgets_of(name: str, budgets: tuple[str, ...]) -> list[str]:
    """Return those of the budgets that an attack supports, in ascending order.

    >>> budgets_of("uniform", ("full", "150")), budgets_of("ghost_wall", ("full", "150"))
    (['150'], ['150', 'full'])
    """
    known = {FULL if budget == FULL_WEDGE else str(budget): budget for budget in BUDGETS[name]}
    return sorted({budget for budget in budgets if budget in known}, key=lambda budget: known[budget])


def strongest_case(name: str, budgets: tuple[str, ...]) -> Case:
    """Return an attack with the largest supported budget, or without one with its largest strength."""
    levels = [level for level in budgets_of(name, budgets) if level != "0"]
    if levels or name not in STRENGTHS:
        return Case("attack", name, levels[-1] if levels else str(max(BUDGETS[name])))
    attribute = STRENGTHS[name][0][0]
    return Case("strength", name, f"{attribute} {max(v for a, v in STRENGTHS[name] if a == attribute):g}")


def budget_cases(name: str, budgets: tuple[str, ...]) -> list[Case]:
    """Return the cases of an attack with each supported budget."""
    return [Case("attack", name, level) for level in budgets_of(name, budgets)]


def strength_cases(name: str, attribute: str = "") -> list[Case]:
    """Return the cases of an attack with each of its sectors, shares and offsets, or those of one attribute."""
    values = [(a, value) for a, value in STRENGTHS.get(name, ()) if attribute in ("", a)]
    return [Case("strength", name, f"{a} {value:g}") for a, value in values]


def corruption_cases(names: Sequence[str], severities: Sequence[int]) -> list[Case]:
    """Return the cases of corruptions, each with each severity."""
    return [Case("corruption", name, str(severity)) for name in names for severity in severities]


def behind(cases: Sequence[Case], defenses: Sequence[str]) -> Iterator[Case]:
    """Yield each case behind each defense."""
    for case in cases:
        yield from (replace(case, defense=defense) for defense in defenses)


def apply(case: Case, sample: StudySample, rng: np.random.Generator) -> Tampered:
    """Return the sweep after a case's attack or corruption (which is not recorded), without its defense.

    Raises:
        ValueError: the attack or corruption is impossible on this sweep; the message says why.
    """
    sweep = sample.sweep
    if case.kind == "benign":
        return untouched(sweep)
    if case.kind == "corruption":
        return untouched(CORRUPTIONS[case.name](int(case.level)).apply(sweep, rng))
    return attack_of(case, sample).apply(sweep, rng)


def untouched(sweep: Sweep) -> Tampered:
    """Return the record of a sweep without an attack."""
    none = np.zeros(len(sweep), np.bool_)
    return Tampered(sweep, none, none)


def attack_of(case: Case, sample: StudySample) -> Attack:
    """Return the attack of a case, scaled to the grid of the truth.

    Raises:
        ValueError: the attack needs an earlier sweep and there is none, or the kind is not an attack.
    """
    half_extent_m = sample.truth.grid.half_extent_m
    knowledge = Knowledge(sample.earlier[:1], half_extent_m=half_extent_m)
    if case.kind == "attack":
        budget = FULL_WEDGE if case.level == FULL else None if case.level == DEFAULT else int(case.level)
        return ATTACKS[case.name](budget, knowledge)
    if case.kind == "strength":
        attribute, value = case.level.split()
        return at_severity(case.name, attribute, int(value) if value.isdecimal() else float(value), knowledge)
    if case.kind == "paper":
        return _paper_attack(case, PAPER_INDOOR_ATTACK if half_extent_m < ROOM_M else PAPER_ATTACK)
    raise ValueError(f"kind must be an attack, got {case.kind!r}")


def _paper_attack(case: Case, mixture: PaperAttack) -> PaperAttack:
    if case == MIXTURE:
        return mixture
    points = (int(case.level), int(case.level))
    uniform = float(case.name == "uniform")
    return replace(
        mixture, uniform_share=uniform, cluster_share=1.0 - uniform, uniform_points=points, cluster_points=points
    )


OTHER_SENSORS = ("fewer_beams", "dead_rings")
"""Corruptions after which the sensor has fewer beams: the truth counts only the remaining ones."""

_PROBE_M = 10.0


def visible_with(case: Case, sample: StudySample, rng: np.random.Generator) -> Mask | None:
    """Return the true visibility (cells, cells) with the beams that a case leaves, or None if the sensor is unchanged.

    None also for a recorded sample, which has no scene to simulate again. ``rng`` must be in the same state as for the
    corruption.
    """
    if case.kind != "corruption" or case.name not in OTHER_SENSORS or sample.frame is None:
        return None
    scene, number = sample.frame
    world, scan = world_of(scene), _scan(scene, number)
    kept = kept_rings(CORRUPTIONS[case.name](int(case.level)), scan.model, rng)
    agent = world.agents[number % scene.preset.agents]
    return exact_truth(with_rings(scan, kept), world, sample.truth.grid, (CAR,), agent)[0].visible(CAR)


@lru_cache(maxsize=1)
def _scan(scene: ScenePlan, number: int) -> ExactScan:
    """Return the exact scan of a frame, cached as cases of one sample follow each other."""
    return scan_frame(scene, number)[0]


def kept_rings(corruption: Corruption, model: LidarModel, rng: np.random.Generator) -> Mask:
    """Return the mask (rings,) of rings that a corruption keeps, found with a sweep of one return per ring."""
    direction = np.stack([np.cos(model.elevation), np.zeros(model.rings), np.sin(model.elevation)], axis=1)
    probe = Sweep(
        (_PROBE_M * direction).astype(np.float32), ring=np.arange(model.rings, dtype=np.int16), model=model
    )  # fmt: skip
    rings = corruption.apply(probe, rng).ring
    return np.isin(np.arange(model.rings), np.arange(model.rings) if rings is None else rings)


def with_rings(scan: ExactScan, kept: Mask) -> ExactScan:
    """Return the scan of a sensor with only the rings of a mask (R,)."""
    model = scan.model
    fewer = replace(
        model, elevation=model.elevation[kept], azimuth_offset=model.azimuth_offset[kept], origin_m=model.origin_m[kept]
    )
    of_rings = ("origin_m", "direction", "depth_m", "thing", "material", "cos_incidence")
    columns: dict[str, Any] = {name: np.compress(kept, getattr(scan, name), axis=1) for name in of_rings}
    return replace(scan, model=fewer, **columns)
