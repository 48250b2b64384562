"""Sweeps under every attack and as bare clouds, and what each contestant says of them: cells counted by probability."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.attacks import ATTACKS, Knowledge
from viewshed.bev import BevGrid, polar_of_cells
from viewshed.estimate import FovEstimate, FovEstimator
from viewshed.evaluation import unorganised_no_sensor
from viewshed.level import level_sweep
from viewshed.metrics import Scores
from viewshed.reproduce.protocols import generator
from viewshed.successor.parts import parts_of
from viewshed.successor.remembered import Remembered, estimates
from viewshed.sweep import Sweep
from viewshed.training.attacking import Struck
from viewshed.visible import CAR, Target
from viewshed.vulnerability.contestants import estimate_of
from viewshed.vulnerability.scoring import counts
from viewshed.vulnerability.subjects import Subject

BENIGN, BARE = "benign", "no rings"
"""The sweep as measured, and without rings and sensor."""
TOUCHING = tuple(name for name in ATTACKS if name != "pose_spoof")
"""Attacks that touch returns, each with its default budget."""
CASES = (BENIGN, BARE, *TOUCHING)
Mask = NDArray[np.bool_]
_ROW = 5


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A sweep as it is shown to the contestants.

    Attributes:
        case: of ``CASES``.
        sweep: what they see.
        wedge: (cells, cells) bool, cells whose azimuth the attacker reaches, or None if it is everywhere.
        struck: the attack, by which earlier sweeps can be attacked as well; None where the rings were taken.
    """

    case: str
    sweep: Sweep
    wedge: Mask | None = None
    struck: Struck | None = None


def shots_of(subject: Subject, seed: int, number: int) -> Iterator[Shot]:
    """Yield a subject in every case; attacks that its sweep does not allow are left out."""
    sweep, grid = subject.sample.sweep, subject.sample.truth.grid
    yield Shot(BENIGN, sweep, struck=Struck(sweep))
    yield Shot(BARE, unorganised_no_sensor(sweep))
    knowledge = Knowledge(subject.earlier[:1], half_extent_m=grid.half_extent_m)
    for name in TOUCHING:
        attack = ATTACKS[name](None, knowledge)
        try:
            found = attack.apply(sweep, generator(seed, "ablation", number, name))
        except ValueError:
            continue
        wedge = None if found.wedge is None else found.wedge.holds(polar_of_cells(grid)[1])
        yield Shot(name, found.sweep, wedge, Struck(found.sweep, attack, found.wedge))


@dataclass(slots=True, eq=False)
class Said:
    """What one contestant said of one case.

    Attributes:
        view: all cells whose truth is known.
        wedge: those of them that the attacker reaches.
        sweeps: (sweeps, 4) cells of each sweep: both, only claimed, only true, neither.
        parts: by part of the view: sweeps that have it, and its cells as in ``sweeps``.
    """

    view: Scores = field(default_factory=Scores)
    wedge: Scores = field(default_factory=Scores)
    sweeps: list[list[int]] = field(default_factory=list)
    parts: dict[str, list[int]] = field(default_factory=dict)

    def add(self, estimate: FovEstimate, shot: Shot, visible: Mask, known: Mask) -> None:
        """Count one sweep."""
        prob, std = estimate.visible_prob, estimate.std
        doubt = None if std is None or np.isnan(std[0, 0]) else std
        self.view.add(prob[known], visible[known], None if doubt is None else doubt[known])
        if shot.wedge is not None:
            among = known & shot.wedge
            self.wedge.add(prob[among], visible[among], None if doubt is None else doubt[among])
        self.sweeps.append(list(counts(estimate.visible()[known], visible[known])))

    def add_parts(self, estimate: FovEstimate, visible: Mask, known: Mask, parts: Mapping[str, Mask]) -> None:
        """Count the parts of one sweep, masks (cells, cells) by name."""
        for name, part in parts.items():
            among = known & part
            self.parts[name] = _sum(self.parts.get(name), [1, *counts(estimate.visible()[among], visible[among])])

    def __add__(self, other: Said) -> Said:
        """Return both together."""
        parts = {name: _sum(self.parts.get(name), other.parts.get(name)) for name in {**self.parts, **other.parts}}
        return Said(self.view + other.view, self.wedge + other.wedge, self.sweeps + other.sweeps, parts)

    def to_json(self) -> dict[str, Any]:
        """Return it as plain values."""
        scores = {"view": self.view.to_json(), "wedge": self.wedge.to_json()}
        return scores | {"sweeps": self.sweeps, "parts": self.parts}

    @classmethod
    def from_json(cls, told: Mapping[str, Any]) -> Said:
        """Return what :meth:`to_json` told.

        Raises:
            ValueError: it is damaged or of another version.
        """
        return cls(Scores.from_json(told["view"]), Scores.from_json(told["wedge"]), told["sweeps"], told["parts"])


def _sum(one: list[int] | None, other: list[int] | None) -> list[int]:
    """Return two rows of counts together; None is a row of zeros."""
    return [a + b for a, b in zip(one or [0] * _ROW, other or [0] * _ROW, strict=True)]


def score(
    subjects: Mapping[int, Subject],
    estimators: Mapping[str, FovEstimator],
    seed: int,
    target: Target = CAR,
    remembering: tuple[str, ...] = (),
) -> dict[str, Any]:
    """Return what every estimator says of the subjects in every case, as plain values.

    Args:
        subjects: by their number, all on the estimators' grid.
        estimators: by name.
        seed: of the attacks.
        target: what would have to be seen.
        remembering: names of estimators that are also told of the past, as contestants of their own; on sweeps with
            five before them.
    """
    found: dict[str, dict[str, Said]] = defaultdict(lambda: defaultdict(Said))
    for number, subject in subjects.items():
        visible, known = subject.sample.truth.visible(target), subject.sample.known
        parts, memory = dict(parts_of(subject, target)), Remembered.of(subject) if remembering else None
        memory = memory if memory is not None and memory.whole else None
        for shot in shots_of(subject, seed, number):
            level = level_sweep(shot.sweep, subject.sample.truth.grid)
            pasts = {} if memory is None else memory.pasts(level, shot.struck, (seed, number, shot.case))
            alone = ((name, estimate_of(each, level, shot.sweep)) for name, each in estimators.items())
            for name, estimate in chain(alone, estimates(estimators, remembering, level, pasts)):
                found[name][shot.case].add(estimate, shot, visible, known)
                if shot.case == BENIGN:
                    found[name][shot.case].add_parts(estimate, visible, known, parts)
    return {name: {case: said.to_json() for case, said in cases.items()} for name, cases in found.items()}


@dataclass(frozen=True, slots=True)
class Enveloped:
    """An estimator that claims nothing behind the nearest obstacle: no point that somebody adds can widen its claim.

    Attributes:
        inner: whose probability is kept where the other claims.
        bound: the first blocker, not limited by the farthest return.
    """

    inner: FovEstimator
    bound: FovEstimator

    @property
    def grid(self) -> BevGrid:
        """Grid of both."""
        return self.inner.grid

    def estimate(self, sweep: Sweep) -> FovEstimate:
        """Return the inner estimate within the bound."""
        inner, bound = self.inner.estimate(sweep), self.bound.estimate(sweep)
        prob = np.where(bound.visible(), inner.visible_prob, np.float32(0.0))
        return FovEstimate(self.grid, prob, np.where(bound.visible(), inner.state, bound.state), method="enveloped")
