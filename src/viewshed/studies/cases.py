"""The cases of a study: what is done to a sweep, in which order, and with which seed.

The truth of a sensor that a corruption made another one: fewer beams see less, and that is not an error.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from viewshed.datasets.simulated import ScenePlan, observe_frame, world_of
from viewshed.fov.visibility import CAR
from viewshed.sensors import LidarModel
from viewshed.sim.raycast.scan import ExactScan
from viewshed.sim.truth.exact import exact_truth
from viewshed.studies.robustness.plan import FULL, Study
from viewshed.studies.suite import ROOM_M, Subject
from viewshed.sweep import Sweep
from viewshed.threats.attacks import (
    ATTACKS,
    BUDGETS,
    FULL_WEDGE,
    PAPER_ATTACK,
    PAPER_INDOOR_ATTACK,
    Knowledge,
    at_severity,
)
from viewshed.threats.attacks import SEVERITIES as STRENGTHS
from viewshed.threats.attacks.base import Attack, Wedge
from viewshed.threats.attacks.points import PaperAttack
from viewshed.threats.corruptions import CORRUPTIONS, Corruption

KINDS = ("benign", "attack", "strength", "corruption", "paper", "adaptive", "unaware")
"""Nothing; an attack with a budget; with a sector, share or offset; a corruption with a severity; the paper's attacks
with a number of points; an attacker who asks the victim, and with it the defense if there is one; and one who asked the
victim without knowing of the defense. The last two differ from victim to victim: see ``duels``."""


@dataclass(frozen=True, slots=True, order=True)
class Case:
    """What is done to a sweep before it is estimated.

    Attributes:
        kind: of ``KINDS``.
        name: of the attack or corruption.
        level: budget, severity or ``attribute value``.
        defense: that the result goes through; empty for none.
    """

    kind: str
    name: str = ""
    level: str = ""
    defense: str = ""


BENIGN = Case("benign")


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A sweep as a case leaves it.

    Attributes:
        sweep: what is estimated from.
        added: (N,) bool, rows that an attacker made, or None where there was none.
        wedge: where the attacker works, or None if anywhere.
    """

    sweep: Sweep
    added: NDArray[np.bool_] | None = None
    wedge: Wedge | None = None


def cases_of(study: Study, part: str) -> list[Case]:
    """Return the cases of one of ``PARTS``, each once."""
    makers = {
        "attacks": _attacks, "corruptions": _corruptions, "defenses": _defenses, "paper": _paper, "adaptive": _adaptive,
    }  # fmt: skip
    return list(dict.fromkeys(makers[part](study)))


def budgets_of(name: str, budgets: tuple[str, ...]) -> list[str]:
    """Return those of the budgets that an attack is tried with, from the smallest.

    >>> budgets_of("uniform", ("full", "150")), budgets_of("ghost_wall", ("full", "150"))
    (['150'], ['150', 'full'])
    """
    known = {FULL if budget == FULL_WEDGE else str(budget): budget for budget in BUDGETS[name]}
    return sorted({budget for budget in budgets if budget in known}, key=lambda budget: known[budget])


def strongest_case(study: Study, name: str) -> Case:
    """Return the attack with the largest budget of the study that fits it, or where none does the largest strength."""
    levels = [level for level in budgets_of(name, study.budgets) if level != "0"]
    if levels or name not in STRENGTHS:
        return Case("attack", name, levels[-1] if levels else str(max(BUDGETS[name])))
    attribute = STRENGTHS[name][0][0]
    return Case("strength", name, f"{attribute} {max(v for a, v in STRENGTHS[name] if a == attribute):g}")


def _attacks(study: Study) -> Iterator[Case]:
    yield BENIGN
    for name in study.attacks:
        yield from (Case("attack", name, level) for level in budgets_of(name, study.budgets))
        yield from _strengths(name) if study.strengths else []
        yield strongest_case(study, name)


def _strengths(name: str) -> Iterator[Case]:
    for attribute, value in STRENGTHS.get(name, ()):
        yield Case("strength", name, f"{attribute} {value:g}")


def _corruptions(study: Study) -> Iterator[Case]:
    for name in study.corruptions:
        yield from (Case("corruption", name, str(severity)) for severity in study.severities)


def _defenses(study: Study) -> Iterator[Case]:
    faced = [BENIGN]
    for name in study.attacks:
        faced += [Case("attack", name, level) for level in budgets_of(name, study.defended_budgets) if level != "0"]
        faced.append(strongest_case(study, name))
    faced += [Case("corruption", name, str(study.defended_severity)) for name in study.corruptions]
    for case in faced:
        yield from (replace(case, defense=defense) for defense in study.defenses)


def _paper(study: Study) -> Iterator[Case]:
    yield BENIGN
    yield Case("paper", "mixture")
    for name in ("uniform", "cluster"):
        yield from (Case("paper", name, str(points)) for points in study.paper_points)


def _adaptive(study: Study) -> Iterator[Case]:
    budget = str(study.adaptive_budget)
    for name in study.adaptive:
        yield from (Case("adaptive", name, level) for level in ("0", budget))
    for name in study.adaptive_against_defenses:
        for defense in study.defenses:
            yield Case("adaptive", name, "0", defense)
            yield from (Case(kind, name, budget, defense) for kind in ("unaware", "adaptive"))


def apply(case: Case, subject: Subject, rng: np.random.Generator) -> Trial:
    """Return the subject's sweep as the case leaves it, without its defense.

    Raises:
        ValueError: the attack or corruption cannot work on this sweep; the message says why.
    """
    sweep = subject.sample.sweep
    if case.kind == "benign":
        return Trial(sweep)
    if case.kind == "corruption":
        return Trial(CORRUPTIONS[case.name](int(case.level)).apply(sweep, rng))
    tampered = attack_of(case, subject).apply(sweep, rng)
    return Trial(tampered.sweep, tampered.added, tampered.wedge)


def attack_of(case: Case, subject: Subject) -> Attack:
    """Return the attack of a case, scaled to the subject's grid.

    Raises:
        ValueError: it needs an earlier sweep and there is none, or there is no attack of this kind.
    """
    half_extent_m = subject.sample.truth.grid.half_extent_m
    knowledge = Knowledge(subject.earlier[:1], half_extent_m=half_extent_m)
    if case.kind == "attack":
        return ATTACKS[case.name](FULL_WEDGE if case.level == FULL else int(case.level), knowledge)
    if case.kind == "strength":
        attribute, value = case.level.split()
        return at_severity(case.name, attribute, int(value) if value.isdecimal() else float(value), knowledge)
    if case.kind == "paper":
        return _papers(case, PAPER_INDOOR_ATTACK if half_extent_m < ROOM_M else PAPER_ATTACK)
    raise ValueError(f"kind must be one that attacks, got {case.kind!r}")


def _papers(case: Case, mixture: PaperAttack) -> PaperAttack:
    if case.name == "mixture":
        return mixture
    points = (int(case.level), int(case.level))
    uniform = float(case.name == "uniform")
    return replace(
        mixture, uniform_share=uniform, cluster_share=1.0 - uniform, uniform_points=points, cluster_points=points
    )


def generator(seed: int, domain: str, number: int, case: Case) -> np.random.Generator:
    """Return the generator of a case on one sample: the same for all its levels and defenses, so that they compare."""
    words = [zlib.crc32(word.encode()) for word in (domain, case.kind.replace("strength", "attack"), case.name)]
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, number, *words])))


OTHER_SENSORS = ("fewer_beams", "dead_rings")
"""Corruptions after which the sensor has fewer beams: the truth counts only those that are left."""

_PROBE_M = 10.0

Mask = NDArray[np.bool_]


def visible_with(case: Case, subject: Subject, rng: np.random.Generator) -> Mask | None:
    """Return what the sensor that a case leaves could have seen (cells, cells), or None where it is the same sensor.

    Args:
        case: what is done to the sweep.
        subject: that it is done to. A recorded one has no scene to look at again: None.
        rng: in the state in which the corruption finds it.
    """
    if case.kind != "corruption" or case.name not in OTHER_SENSORS or subject.frame is None:
        return None
    scene, number = subject.frame
    world, scan = world_of(scene), _scan(scene, number)
    kept = kept_rings(CORRUPTIONS[case.name](int(case.level)), scan.model, rng)
    agent = world.agents[number % scene.preset.agents]
    return exact_truth(with_rings(scan, kept), world, subject.sample.truth.grid, (CAR,), agent)[0].visible(CAR)


@lru_cache(maxsize=1)
def _scan(scene: ScenePlan, number: int) -> ExactScan:
    """Return what every beam met in a frame; a sample is looked at several times in a row."""
    return observe_frame(scene, number).scan


def kept_rings(corruption: Corruption, model: LidarModel, rng: np.random.Generator) -> Mask:
    """Return which rings of a sensor (rings,) a corruption leaves, seen on a sweep with one return a ring."""
    direction = np.stack([np.cos(model.elevation), np.zeros(model.rings), np.sin(model.elevation)], axis=1)
    probe = Sweep(
        (_PROBE_M * direction).astype(np.float32), ring=np.arange(model.rings, dtype=np.int16), model=model
    )  # fmt: skip
    left = corruption.apply(probe, rng).ring
    return np.isin(np.arange(model.rings), np.arange(model.rings) if left is None else left)


def with_rings(scan: ExactScan, kept: Mask) -> ExactScan:
    """Return a scan of a sensor that has only some of its rings (R,), from the lowest up."""
    model = scan.model
    fewer = replace(
        model,
        elevation=model.elevation[kept],
        azimuth_offset=model.azimuth_offset[kept],
        origin_m=model.origin_m[kept],
    )
    return replace(
        scan,
        model=fewer,
        origin_m=np.compress(kept, scan.origin_m, axis=1),
        direction=np.compress(kept, scan.direction, axis=1),
        depth_m=np.compress(kept, scan.depth_m, axis=1),
        thing=np.compress(kept, scan.thing, axis=1),
        material=np.compress(kept, scan.material, axis=1),
        cos_incidence=np.compress(kept, scan.cos_incidence, axis=1),
    )
