"""Free points chosen against their victim: the attacker has the victim itself, and asks it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

from viewshed.attacks import BlackBox, Knowledge, OverClaim
from viewshed.bev import polar_of_cells
from viewshed.estimate import FovEstimator
from viewshed.reproduce.protocols import generator
from viewshed.successor.contest import Said, Shot
from viewshed.visible import CAR, Target
from viewshed.vulnerability.subjects import Subject

UNTOUCHED = "untouched"
"""The case without an attack; the others are called by the number of questions that were asked."""
POINTS = 150
"""Points that an attacker may add."""
SECTOR_DEG = 30.0
"""Width of the attacker's wedge."""
_AIM_M = 25.0


def attack_on(victim: FovEstimator, questions: int) -> BlackBox:
    """Return the attacker who wants a victim to claim what it did not claim before, by free points in one wedge.

    The victim's own answers are searched, as its channels count returns and have no gradient: weights and channels are
    known to the attacker, the truth is not. The wedge is aimed at a near obstacle.
    """
    scale = Knowledge(half_extent_m=victim.grid.half_extent_m).scale
    return BlackBox(OverClaim(victim), POINTS, questions, sector_deg=SECTOR_DEG, aim_m=_AIM_M * scale, mode="free_form")


def duels(
    subject: Subject,
    victims: Mapping[str, FovEstimator],
    questions: Mapping[str, Sequence[int]],
    rng_of: tuple[int, int],
    target: Target = CAR,
) -> dict[str, Any]:
    """Return what every victim says of a sweep untouched and with points chosen against it, as plain values.

    Args:
        subject: the sweep, on the victims' grid.
        victims: by name.
        questions: by victim, the numbers of questions with each of which it is attacked.
        rng_of: seed and number of the sweep: every attacker draws from the same start, so that wedges are the same.
        target: what would have to be seen.
    """
    sample, seed, number = subject.sample, *rng_of
    visible, known = sample.truth.visible(target), sample.known
    azimuth = polar_of_cells(sample.truth.grid)[1]
    found: dict[str, dict[str, Said]] = defaultdict(lambda: defaultdict(Said))
    for name, victim in victims.items():
        for asked in questions[name]:
            tampered = attack_on(victim, asked).apply(sample.sweep, generator(seed, "chosen", number))
            wedge = None if tampered.wedge is None else tampered.wedge.holds(azimuth)
            shots = Shot(UNTOUCHED, sample.sweep, wedge), Shot(str(asked), tampered.sweep, wedge)
            for shot in shots if asked == questions[name][0] else shots[1:]:
                found[name][shot.case].add(victim.estimate(shot.sweep), shot, visible, known)
    return {name: {case: said.to_json() for case, said in cases.items()} for name, cases in found.items()}
