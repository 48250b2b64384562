"""Sweeps under every attack and as bare clouds, and what each contestant says of them: cells counted by probability.

The same sweeps with what the sensor measured before: honest, or attacked as well.

Free points chosen against their victim: the attacker has the victim itself, and asks it.

Parts of a view that are told apart: cells clear of the threshold, bands of range, and whose sensor it was.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.datasets.simulated import simulate_frame
from viewshed.estimators import Estimator
from viewshed.estimators.base import ClassicalEstimator
from viewshed.estimators.temporal import where_confirmed
from viewshed.fov.estimate import FovEstimate
from viewshed.fov.visibility import CAR, Target
from viewshed.grid import BevGrid, polar_of_cells
from viewshed.metrics import Scores
from viewshed.preprocess.history import HISTORY_SWEEPS, History
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.studies.paper.protocols import generator
from viewshed.studies.statistics import counts
from viewshed.studies.suite import Subject, estimate_of
from viewshed.sweep import Sweep, unorganized_no_sensor
from viewshed.threats.attacks import ATTACKS, ROAD_EXTENT_M, BlackBox, Knowledge, OverClaim
from viewshed.training.samples import AttackedSweep

CLEAR = "clear of the threshold"
"""Cells whose true number of returns is more than ``MARGIN`` from that from which on a target is visible."""

MARGIN = 2

EDGES_M = (0.0, 20.0, 40.0, 64.0)
"""Between bands of range, on a grid of ``ROAD_EXTENT_M``; in proportion on others. Beyond the last are the corners."""

SENSOR = "sensor "
"""Begins the name of a part that is all of a sensor's sweeps."""

Mask = NDArray[np.bool_]


def parts_of(subject: Subject, target: Target) -> Iterator[tuple[str, Mask]]:
    """Yield the parts that a subject has, by name: masks (cells, cells) of the truth's grid."""
    truth, model = subject.sample.truth, subject.sample.sweep.model
    returns = truth.expected_returns[target.name].astype(np.int64)
    yield CLEAR, np.abs(returns - target.min_returns) > MARGIN
    range_m, _ = polar_of_cells(truth.grid)
    edges_m = [edge * truth.grid.half_extent_m / ROAD_EXTENT_M for edge in EDGES_M]
    for low_m, high_m in pairwise(edges_m):
        yield f"{low_m:g} to {high_m:g} m", (range_m >= low_m) & (range_m < high_m)
    yield f"from {edges_m[-1]:g} m on", range_m >= edges_m[-1]
    if model is not None:
        yield SENSOR + model.name, np.ones(truth.grid.shape, np.bool_)


ALONE, HONEST, ATTACKED = "alone", "past", "attacked past"
"""What stands behind the name of a contestant that is told of the past, or is not, on sweeps that have one."""

WARY = "wary, "
"""Stands before them where only what an earlier sweep has seen as well is claimed."""


@dataclass(frozen=True, slots=True, eq=False)
class Remembered:
    """What a sensor measured before a sweep.

    Attributes:
        sweeps: the last ones, the oldest first, as measured.
        levels: the same, leveled.
        grid: on which.
    """

    sweeps: tuple[Sweep, ...]
    levels: tuple[LeveledSweep, ...]
    grid: BevGrid

    @classmethod
    def of(cls, subject: Subject) -> Remembered:
        """Return the five sweeps before a subject's, or as many as its scene has; a recorded one's own."""
        grid = subject.sample.truth.grid
        sweeps = subject.earlier if subject.frame is None else _simulated(subject)
        return cls(sweeps, tuple(level(sweep, grid) for sweep in sweeps), grid)

    @property
    def whole(self) -> bool:
        """Whether there are as many as an estimator may look at."""
        return len(self.sweeps) == HISTORY_SWEEPS

    def pasts(
        self, leveled: LeveledSweep, struck: AttackedSweep | None, rng_of: tuple[int, int, str]
    ) -> dict[str, History | None]:
        """Return the pasts of a sweep: none, honest, and where it was attacked also as if the attack had lasted.

        Args:
            leveled: the sweep.
            struck: the attack on it, None where its rings were taken; then the past has none either.
            rng_of: seed, number of the subject and case, for the attacks on the past.
        """
        if struck is None:
            bare = [level(unorganized_no_sensor(sweep), self.grid) for sweep in self.sweeps]
            return {ALONE: None, HONEST: History.of(leveled, bare)}
        honest = {ALONE: None, HONEST: History.of(leveled, self.levels)}
        if struck.attack is None:
            return honest
        seed, number, case = rng_of
        before = struck.attack_history(self.sweeps, generator(seed, "past", number, case))
        return honest | {ATTACKED: History.of(leveled, [level(sweep, self.grid) for sweep in before])}


def _simulated(subject: Subject) -> tuple[Sweep, ...]:
    assert subject.frame is not None
    scene, frame = subject.frame
    step = scene.preset.agents
    return tuple(simulate_frame(scene, at).sweep for at in range(frame % step, frame, step)[-HISTORY_SWEEPS:])


def estimates(
    estimators: Mapping[str, Estimator],
    names: tuple[str, ...],
    leveled: LeveledSweep,
    pasts: Mapping[str, History | None],
) -> Iterator[tuple[str, FovEstimate]]:
    """Yield what those of the estimators that the past helps say with each past, wary or not, each with its name."""
    for name in names:
        estimator = estimators.get(name)
        if estimator is not None and estimator.uses_history:
            for kind, past in pasts.items():
                found = estimator.estimate(leveled, past)
                yield f"{name}, {kind}", found
                if past is not None:
                    yield f"{name}, {WARY}{kind}", where_confirmed(found, past)


BENIGN, BARE = "benign", "no rings"
"""The sweep as measured, and without rings and sensor."""

TOUCHING = tuple(name for name in ATTACKS if name != "pose_spoof")
"""Attacks that touch returns, each with its default budget."""

CASES = (BENIGN, BARE, *TOUCHING)

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
    struck: AttackedSweep | None = None


def shots_of(subject: Subject, seed: int, number: int) -> Iterator[Shot]:
    """Yield a subject in every case; attacks that its sweep does not allow are left out."""
    sweep, grid = subject.sample.sweep, subject.sample.truth.grid
    yield Shot(BENIGN, sweep, struck=AttackedSweep(sweep))
    yield Shot(BARE, unorganized_no_sensor(sweep))
    knowledge = Knowledge(subject.earlier[:1], half_extent_m=grid.half_extent_m)
    for name in TOUCHING:
        attack = ATTACKS[name](None, knowledge)
        try:
            found = attack.apply(sweep, generator(seed, "ablation", number, name))
        except ValueError:
            continue
        wedge = None if found.wedge is None else found.wedge.holds(polar_of_cells(grid)[1])
        yield Shot(name, found.sweep, wedge, AttackedSweep(found.sweep, attack, found.wedge))


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
    estimators: Mapping[str, Estimator],
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
            leveled = level(shot.sweep, subject.sample.truth.grid)
            pasts = {} if memory is None else memory.pasts(leveled, shot.struck, (seed, number, shot.case))
            alone = ((name, estimate_of(each, leveled, shot.sweep)) for name, each in estimators.items())
            for name, estimate in chain(alone, estimates(estimators, remembering, leveled, pasts)):
                found[name][shot.case].add(estimate, shot, visible, known)
                if shot.case == BENIGN:
                    found[name][shot.case].add_parts(estimate, visible, known, parts)
    return {name: {case: said.to_json() for case, said in cases.items()} for name, cases in found.items()}


@dataclass(frozen=True, slots=True)
class Enveloped(ClassicalEstimator):
    """An estimator that claims nothing behind the nearest obstacle: no point that somebody adds can widen its claim.

    Attributes:
        inner: whose probability is kept where the other claims.
        bound: the first blocker, not limited by the farthest return.
    """

    inner: Estimator
    bound: Estimator
    name: str = "enveloped"

    @property
    def grid(self) -> BevGrid:  # type: ignore[override]
        """Grid of both."""
        return self.inner.grid

    @property
    def target(self) -> Target:  # type: ignore[override]
        """What would have to be seen."""
        return self.inner.target

    def _estimate(self, leveled: LeveledSweep, history: History | None) -> FovEstimate:
        """Return the inner estimate within the bound."""
        inner, bound = self.inner.estimate(leveled), self.bound.estimate(leveled)
        prob = np.where(bound.visible(), inner.visible_prob, np.float32(0.0))
        return replace(
            inner,
            visible_prob=prob,
            state=np.where(bound.visible(), inner.state, bound.state),
            std=None,
            method=self.name,
        )


UNTOUCHED = "untouched"
"""The case without an attack; the others are called by the number of questions that were asked."""

POINTS = 150
"""Points that an attacker may add."""

SECTOR_DEG = 30.0
"""Width of the attacker's wedge."""

_AIM_M = 25.0


def attack_on(victim: Estimator, questions: int) -> BlackBox:
    """Return the attacker who wants a victim to claim what it did not claim before, by free points in one wedge.

    The victim's own answers are searched, as its channels count returns and have no gradient: weights and channels are
    known to the attacker, the truth is not. The wedge is aimed at a near obstacle.
    """
    scale = Knowledge(half_extent_m=victim.grid.half_extent_m).scale
    return BlackBox(OverClaim(victim), POINTS, questions, sector_deg=SECTOR_DEG, aim_m=_AIM_M * scale, mode="free_form")


def duels(
    subject: Subject,
    victims: Mapping[str, Estimator],
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
