"""Sweeps under every attack and as bare clouds, with what the sensor measured before: honest, or attacked as well.

Free points chosen against their victim: the attacker has the victim itself, and queries it.

Parts of a view: cells clear of the threshold, bands of range, and whose sensor it was.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from math import inf

import numpy as np

from viewshed.estimators import Estimator
from viewshed.estimators.base import EarlierSweeps
from viewshed.estimators.classical import ClassicalEstimator, checked_history
from viewshed.estimators.temporal import where_confirmed
from viewshed.fov.estimate import THRESHOLD, FovEstimate
from viewshed.fov.visibility import CAR, Target
from viewshed.grid import BevGrid
from viewshed.preprocess.history import HISTORY_SWEEPS, History
from viewshed.preprocess.leveling import LeveledSweep, level, leveled_on
from viewshed.sweep import Sweep, unorganized_no_sensor
from viewshed_lab.data.simulated import simulate_frame
from viewshed_lab.studies.cases import BARE, DEFAULT, TOUCHING, attack_of, generator
from viewshed_lab.studies.evaluate import Evaluation, Reference
from viewshed_lab.studies.records import BENIGN, Case, Row, pool
from viewshed_lab.studies.samples import StudySample, parts_of
from viewshed_lab.studies.suite import EstimatorSuite
from viewshed_lab.threats.attacks import BlackBox, Knowledge, OverClaim
from viewshed_lab.threats.attacks.base import Wedge
from viewshed_lab.training.samples import AttackedSweep

MARGIN = 2
"""Returns that cells must be apart from the threshold to be clear of it."""

BANDS = (0.0, 0.3125, 0.625, 1.0, inf)
"""Edges of the bands of range as shares of half the grid's side: 20, 40, 64 m on the road, and the corners beyond."""

ALONE, HONEST, ATTACKED = "alone", "past", "attacked past"
"""What stands behind the name of a method that is given earlier sweeps, or is not, on sweeps that have some."""

CONFIRMED = "confirmed, "
"""Stands before them where only what an earlier sweep has seen as well is claimed."""

ATTACKS = tuple(Case("attack", name, DEFAULT) for name in TOUCHING)
"""Attacks that touch returns, each with its default budget."""

CASES = (BENIGN, BARE, *ATTACKS)


@dataclass(frozen=True, slots=True, eq=False)
class PriorSweeps:
    """What a sensor measured before a sweep."""

    sweeps: tuple[Sweep, ...]  # the last ones, the oldest first, as measured
    levels: tuple[LeveledSweep, ...]  # the same, leveled
    grid: BevGrid  # on which

    @classmethod
    def of(cls, sample: StudySample) -> PriorSweeps:
        """Return the five sweeps before a sample, or as many as its scene has; a recorded one's own."""
        grid, sweeps = sample.truth.grid, sample.earlier
        if sample.frame is not None:
            scene, frame = sample.frame
            step = scene.preset.agents
            numbers = range(frame % step, frame, step)[-HISTORY_SWEEPS:]
            sweeps = tuple(simulate_frame(scene, number).sweep for number in numbers)
        return cls(sweeps, tuple(level(sweep, grid) for sweep in sweeps), grid)

    @property
    def complete(self) -> bool:
        """Whether there are as many as an estimator may look at."""
        return len(self.sweeps) == HISTORY_SWEEPS

    def histories(
        self, leveled: LeveledSweep, attacked: AttackedSweep | None, rng: np.random.Generator
    ) -> dict[str, History | None]:
        """Return the histories of a sweep: none, honest, and where it was attacked also as if the attack had lasted.

        Args:
            leveled: the sweep.
            attacked: the attack on it; None where its rings were taken, then earlier sweeps have none either.
            rng: for the attacks on the earlier sweeps.
        """
        if attacked is None:
            bare = [level(unorganized_no_sensor(sweep), self.grid) for sweep in self.sweeps]
            return {ALONE: None, HONEST: History.of(leveled, bare)}
        honest = {ALONE: None, HONEST: History.of(leveled, self.levels)}
        if attacked.attack is None:
            return honest
        before = attacked.attack_history(self.sweeps, rng)
        return honest | {ATTACKED: History.of(leveled, [level(sweep, self.grid) for sweep in before])}


def with_histories(
    estimators: Mapping[str, Estimator], leveled: LeveledSweep, histories: Mapping[str, History | None]
) -> Iterator[tuple[str, FovEstimate]]:
    """Yield what those of the estimators that earlier sweeps help say with each history, confirmed or not, by name."""
    for name, estimator in estimators.items():
        if estimator.uses_history:
            for kind, history in histories.items():
                estimate = estimator.estimate(leveled, history)
                yield f"{name}, {kind}", estimate
                if history is not None:
                    yield f"{name}, {CONFIRMED}{kind}", where_confirmed(estimate, history)


def evaluation_of(
    sample: StudySample, estimators: Mapping[str, Estimator], setting: str, number: int, seed: int, target: Target
) -> Evaluation:
    """Return a sample with those who are tried on it, against exact truth of a target."""
    suite = EstimatorSuite(sample.truth.grid, THRESHOLD, estimators)

    def rng_of(case: Case) -> np.random.Generator:
        return generator(seed, "ablation", str(number), case.name)

    return Evaluation(sample, suite, Reference.exact(sample, target), setting, number, rng_of)


def evaluate(
    samples: Mapping[int, StudySample],
    estimators: Mapping[str, Estimator],
    setting: str,
    seed: int,
    target: Target = CAR,
    with_history: Sequence[str] = (),
) -> list[Row]:
    """Return what every estimator says of the samples in every case, all samples together.

    Args:
        samples: by their number, all on the estimators' grid.
        estimators: by name.
        setting: domain of the rows.
        seed: of the attacks.
        target: what would have to be seen.
        with_history: names of estimators that are also given earlier sweeps, as methods of their own; on sweeps with
            five before them.
    """
    helped = {name: estimators[name] for name in with_history if name in estimators}
    every = (
        evaluate_sample(evaluation_of(sample, estimators, setting, number, seed, target), target, seed, helped)
        for number, sample in samples.items()
    )
    return pool(chain.from_iterable(every))


def evaluate_sample(
    evaluation: Evaluation, target: Target, seed: int, helped: Mapping[str, Estimator]
) -> Iterator[Row]:
    """Yield the scores of one sample in every case; attacks that its sweep does not allow are left out."""
    sample, grid = evaluation.sample, evaluation.suite.grid
    parts = parts_of(sample.sample, target, BANDS, MARGIN)
    earlier = PriorSweeps.of(sample) if helped else None
    for case in CASES:
        try:
            tampered = evaluation.tampered(case)
        except ValueError:
            continue
        leveled, histories = level(tampered.sweep, grid), dict[str, History | None]()
        if earlier is not None and earlier.complete:
            attacked = None if case == BARE else _attacked(evaluation, case, tampered.sweep, tampered.wedge)
            rng = generator(seed, "past", str(evaluation.number), case.name)
            histories = earlier.histories(leveled, attacked, rng)
        alone = evaluation.suite.estimates(leveled).items()
        for name, estimate in chain(alone, with_histories(helped, leveled, histories)):
            yield from evaluation.score(name, case, estimate, tampered.wedge)
            if case == BENIGN:
                prob = evaluation.reference.prob_of(estimate)
                for part, mask in parts.items():
                    counts = evaluation.reference.counts(prob, THRESHOLD, sample.known & mask)
                    yield evaluation.row(name, case, part, counts)


def _attacked(evaluation: Evaluation, case: Case, sweep: Sweep, wedge: Wedge | None) -> AttackedSweep:
    """Return the attack on a sweep, by which earlier sweeps can be attacked as well."""
    if case == BENIGN:
        return AttackedSweep(sweep)
    return AttackedSweep(sweep, attack_of(case, evaluation.sample, evaluation.suite.grid.half_extent_m), wedge)


@dataclass(frozen=True, slots=True)
class Enveloped(ClassicalEstimator):
    """An estimator that claims nothing behind the nearest obstacle: no point that somebody adds can widen its claim."""

    inner: Estimator  # whose probability is kept where the other claims
    bound: Estimator  # the first blocker, not limited by the farthest return
    name: str = "enveloped"

    @property
    def grid(self) -> BevGrid:  # type: ignore[override]
        """Grid of both."""
        return self.inner.grid

    @property
    def target(self) -> Target:  # type: ignore[override]
        """What would have to be seen."""
        return self.inner.target

    def estimate(self, sweep: Sweep | LeveledSweep, history: EarlierSweeps = None) -> FovEstimate:
        """Return the inner estimate within the bound."""
        leveled = leveled_on(sweep, self.grid)
        checked_history(self, leveled, history)
        inner, bound = self.inner.estimate(leveled), self.bound.estimate(leveled)
        prob = np.where(bound.visible(), inner.visible_prob, np.float32(0.0))
        return replace(
            inner,
            visible_prob=prob,
            state=np.where(bound.visible(), inner.state, bound.state),
            std=None,
            method=self.name,
        )


UNTOUCHED = Case("adaptive", "over_claim_free", "0")
"""The case without an attack; those with one are distinguished by the number of queries that were made."""

POINTS = 150
"""Points that an attacker may add."""

SECTOR_DEG = 30.0
"""Width of the attacker's wedge."""

_AIM_M = 25.0


def queried(queries: int) -> Case:
    """Return the case of an attacker who makes this number of queries."""
    return replace(UNTOUCHED, level=str(queries))


def attack_on(victim: Estimator, queries: int) -> BlackBox:
    """Return the attacker who wants a victim to claim what it did not claim before, by free points in one wedge.

    The victim's own answers are searched, as its channels count returns and have no gradient: weights and channels are
    known to the attacker, the truth is not. The wedge is aimed at a near obstacle.
    """
    scale = Knowledge(half_extent_m=victim.grid.half_extent_m).scale
    return BlackBox(OverClaim(victim), POINTS, queries, sector_deg=SECTOR_DEG, aim_m=_AIM_M * scale, mode="free_form")


def evaluate_chosen(evaluation: Evaluation, queries: Mapping[str, Sequence[int]], seed: int) -> Iterator[Row]:
    """Yield what every victim says of a sweep untouched and with points chosen against it.

    Args:
        evaluation: the sweep and the victims.
        queries: by victim, the numbers of queries with each of which it is attacked.
        seed: every attacker draws from the same start, so that wedges are the same.
    """
    sample, rng_of = evaluation.sample, partial(generator, seed, "chosen", str(evaluation.number))
    for name, victim in evaluation.suite.estimators.items():
        for number in queries[name]:
            tampered = attack_on(victim, number).apply(sample.sweep, rng_of())
            sweeps = {UNTOUCHED: sample.sweep} if number == queries[name][0] else {}
            for case, sweep in (sweeps | {queried(number): tampered.sweep}).items():
                yield from evaluation.score(name, case, victim.estimate(sweep), tampered.wedge)
