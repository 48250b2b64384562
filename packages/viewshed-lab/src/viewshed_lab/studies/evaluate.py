"""Evaluates one sample: counts of each estimator in each case against the truth, in the view and in the wedge.

Adaptive attackers query their victim: each estimator, bare or behind a defense, is attacked separately.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import Mask
from viewshed.estimators import PAPER_THRESHOLD, paper_estimators_on
from viewshed.fov.estimate import FovEstimate, FovEstimator
from viewshed.fov.visibility import CAR
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid, polar_of_cells
from viewshed.metrics import ConfusionCounts, Scores, average_precision
from viewshed.preprocess.leveling import level
from viewshed.sweep import Sweep
from viewshed_lab.studies.cases import apply, visible_with
from viewshed_lab.studies.records import STRICT, UNTOUCHED, VIEW, WEDGE, Case, Row, Series, row_of
from viewshed_lab.studies.samples import StudySample
from viewshed_lab.studies.suite import LABEL, Changed, EstimatorSuite
from viewshed_lab.threats.attacks import ATTACKS, Knowledge
from viewshed_lab.threats.attacks.adaptive import ADAPTIVE, BlackBox, Evade
from viewshed_lab.threats.attacks.base import Tampered, Wedge
from viewshed_lab.threats.defenses import DEFENSES, Defended, Defense, TemporalConsistency

AIMED_AS = Case("attack", "far_wall", "0")
"""The attack without queries whose wedge adaptive attackers use as well, so that both can be compared."""


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """The truth that estimates of a sample are compared with."""

    grid: BevGrid  # of the masks
    visible: Mask  # (cells, cells) bool, truth
    known: Mask  # (cells, cells) bool, cells that count
    pose: Rigid | None = None  # pose of the clean sweep's ``level`` frame in the map, or None

    @classmethod
    def of(cls, sample: StudySample, visible: Mask, known: Mask, grid: BevGrid) -> Reference:
        """Return the reference of a sample on a grid."""
        return cls(grid, visible, known, level(sample.sweep, grid).world_from_level)

    @classmethod
    def exact(cls, sample: StudySample) -> Reference:
        """Return the exact truth, by the definition ``probe``."""
        return cls.of(sample, sample.truth.visible(CAR), sample.known, sample.truth.grid)

    @classmethod
    def label(cls, sample: StudySample, grid: BevGrid) -> Reference:
        """Return the paper's label of the clean sweep on one of its grids."""
        label = paper_estimators_on(grid)[LABEL](grid).estimate(sample.sweep)
        return cls.of(sample, label.visible(PAPER_THRESHOLD), np.ones(grid.shape, np.bool_), grid)

    def inside(self, wedge: Wedge) -> Mask:
        """Return the mask (cells, cells) of cells that count and lie in a wedge."""
        return self.known & wedge.holds(polar_of_cells(self.grid)[1])

    def prob_of(self, estimate: FovEstimate) -> NDArray[np.float32]:
        """Return the probability of visible (cells, cells) at the cells of the clean sweep.

        If the pose was attacked, the estimate is elsewhere in the map than the truth: look up each cell of the truth
        in the estimate by its place in the map. A cell outside the estimate gets 0.
        """
        pose = estimate.world_from_level
        if self.pose is None or pose is None or not _moved(self.pose, pose):
            return estimate.visible_prob
        centers = np.concatenate([self.grid.centers, np.zeros((*self.grid.shape, 1))], axis=-1).reshape(-1, 3)
        places = (pose.inverse() @ self.pose) @ centers
        return np.nan_to_num(estimate.at(places[:, :2]).reshape(self.grid.shape), nan=0.0)

    def counts(self, prob: NDArray[np.float32], threshold: float, mask: Mask) -> ConfusionCounts:
        """Return the counts of probabilities (cells, cells) over the cells of a mask."""
        return ConfusionCounts.of(prob >= np.float32(threshold), self.visible, mask, self.grid.cell_area_m2)

    def scores(self, estimate: FovEstimate, mask: Mask) -> Scores:
        """Return the cells of a mask by the probability and deviation of an estimate."""
        scores, std = Scores(), estimate.std
        has_std = std is not None and not np.isnan(std[0, 0])
        prob = self.prob_of(estimate)
        scores.add(prob[mask], self.visible[mask], std[mask] if has_std and std is not None else None)
        return scores


def _moved(one: Rigid, other: Rigid) -> bool:
    """Return whether two poses differ in heading or position; a tilt alone does not move cells."""
    difference = one.inverse() @ other
    return bool(abs(difference.yaw) > 1e-9 or np.hypot(*difference.translation[:2]) > 1e-6)


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """One sample with estimators, truth and defenses."""

    sample: StudySample  # the sweep and earlier sweeps
    suite: EstimatorSuite  # the estimators
    reference: Reference  # the truth
    domain: str  # of the sample
    number: int  # of the sample in its domain
    rng_of: Callable[[Case], np.random.Generator]  # returns a new generator of a case on this sample
    protocol: str = STRICT  # ``STRICT`` or ``PAPER``
    defenses: Mapping[str, Defense] = field(default_factory=dict)  # by name
    _tampered: dict[Case, Tampered] = field(init=False, repr=False, default_factory=dict)
    _references: dict[tuple[str, str], Reference] = field(init=False, repr=False, default_factory=dict)

    def rows(self, cases: Iterable[Case], *, untouched: bool = False) -> Iterator[Row]:
        """Yield the rows of every estimator in each case, or a row that says why the case is impossible.

        Args:
            cases: attacks, corruptions and defenses.
            untouched: whether the attacker's wedge is also counted on the clean sweep.
        """
        for case in cases:
            try:
                tampered = self.tampered(case)
                defended = self.defenses[case.defense].apply(tampered.sweep) if case.defense else None
            except ValueError as error:
                yield self.refusal(case, error)
                continue
            if defended is not None:
                yield self.row("", case, **_defense_counts(defended, tampered))
            sweep = tampered.sweep if defended is None else defended.sweep
            for name, estimate in self.suite.estimates(level(sweep, self.suite.grid)).items():
                yield from self.compare(name, case, estimate, tampered.wedge)
                if untouched and tampered.wedge is not None:
                    yield self._untouched(name, case, tampered.wedge)

    def compare(self, method: str, case: Case, estimate: FovEstimate, wedge: Wedge | None) -> Iterator[Row]:
        """Yield the rows of an estimate: in the whole view, and in the attacker's wedge if there is one."""
        reference = self.reference_of(case)
        prob, threshold = reference.prob_of(estimate), self.suite.threshold
        area = average_precision(prob[reference.known], reference.visible[reference.known])
        numbers: dict[str, Any] = {} if np.isnan(area) else {"auprc": round(area, 6)}
        yield self.row(method, case, VIEW, reference.counts(prob, threshold, reference.known), **numbers)
        if wedge is not None:
            yield self.row(method, case, WEDGE, reference.counts(prob, threshold, reference.inside(wedge)))

    def _untouched(self, method: str, case: Case, wedge: Wedge) -> Row:
        clean = self.suite.estimates(level(self.sample.sweep, self.suite.grid))[method]
        prob, inside = self.reference.prob_of(clean), self.reference.inside(wedge)
        return self.row(method, case, UNTOUCHED, self.reference.counts(prob, self.suite.threshold, inside))

    def row(
        self,
        method: str,
        case: Case,
        region: str = VIEW,
        counts: ConfusionCounts | None = None,
        scores: Scores | None = None,
        **other: Any,
    ) -> Row:
        """Return a row of this sample; ``other`` as of :func:`row_of`."""
        series = Series(self.domain, method, case, region, self.protocol)
        return row_of(series, self.sample.sample.scene, self.number, counts, scores, **other)

    def refusal(self, case: Case, error: ValueError) -> Row:
        """Return the row of a case that is impossible."""
        return self.row("", case, refused=" ".join(str(error).split()))

    def tampered(self, case: Case) -> Tampered:
        """Return the sweep after a case, without its defense; the last one is cached for the next defense."""
        bare = replace(case, defense="")
        if bare not in self._tampered:
            self._tampered.clear()
            self._tampered[bare] = apply(bare, self.sample, self.rng_of(bare))
        return self._tampered[bare]

    def reference_of(self, case: Case) -> Reference:
        """Return the truth of a case: the same for all cases except those that change the sensor."""
        key = case.name, case.level
        if key not in self._references:
            visible = visible_with(case, self.sample, self.rng_of(case))
            self._references[key] = self.reference if visible is None else replace(self.reference, visible=visible)
        return self._references[key]


def defense_of(name: str, sample: StudySample) -> Defense:
    """Return a defense; the temporal one knows the previous, clean sweep."""
    defense = DEFENSES[name]()
    return replace(defense, earlier=sample.earlier[-1:]) if isinstance(defense, TemporalConsistency) else defense


def _defense_counts(defended: Defended, tampered: Tampered) -> dict[str, Any]:
    """Return the numbers of forged and other returns, those of each that a defense drops, and its alarm."""
    added, dropped = tampered.added, defended.dropped
    numbers: dict[str, Any] = {"caught": int((dropped & added).sum()), "added": int(added.sum()),
               "lost": int((dropped & ~added).sum()), "others": int((~added).sum())}  # fmt: skip
    return numbers if defended.alarm is None else numbers | {"alarm": int(defended.alarm)}


@dataclass(frozen=True, slots=True, eq=False)
class AdaptiveEvaluation:
    """One sample with adaptive attackers. Attacks on bare victims are cached."""

    evaluation: Evaluation  # the sample, the victims, the truth and the defenses
    queries: int  # queries of an attacker
    defended: Sequence[str]  # victims that are also tried behind the defenses
    _attacked: dict[tuple[str, str], Sweep] = field(init=False, repr=False, default_factory=dict)

    def rows(self, cases: Iterable[Case]) -> Iterator[Row]:
        """Yield the rows of every victim under its own attack, case by case."""
        suite, defenses = self.evaluation.suite, self.evaluation.defenses
        for case in cases:
            try:
                rows: list[Row] = []
                for victim in self.defended if case.defense else suite.estimators:
                    sweep = self._sweep(case, victim)
                    if case.defense:
                        sweep = defenses[case.defense].apply(sweep).sweep
                    estimate = suite.only(victim).estimates(level(sweep, suite.grid))[victim]
                    rows += self.evaluation.compare(victim, case, estimate, self.wedge)
                yield from rows
            except ValueError as error:
                yield self.evaluation.refusal(case, error)

    @property
    def wedge(self) -> Wedge:
        """The wedge of all adaptive attackers: that of the far wall."""
        attack = ATTACKS[AIMED_AS.name](0, Knowledge(half_extent_m=self.evaluation.suite.grid.half_extent_m))
        wedge = attack.apply(self.evaluation.sample.sweep, self.evaluation.rng_of(AIMED_AS)).wedge
        if wedge is None:
            raise ValueError(f"{AIMED_AS.name} must have a wedge, got none")
        return wedge

    def _sweep(self, case: Case, victim: str) -> Sweep:
        """Return the sweep after the attack of a case, before any defense."""
        clean = self.evaluation.sample.sweep
        if case.level == "0":
            return clean
        if case.kind == "adaptive" and case.defense:
            attack = self.attack(case, victim, self.evaluation.defenses[case.defense])
            return attack.apply(clean, self.evaluation.rng_of(case)).sweep
        key = case.name, victim
        if key not in self._attacked:
            bare = replace(case, kind="adaptive", defense="")
            attack = self.attack(bare, victim, None)
            self._attacked[key] = attack.apply(clean, self.evaluation.rng_of(bare)).sweep
        return self._attacked[key]

    def attack(self, case: Case, victim: str, defense: Defense | None) -> BlackBox:
        """Return an attacker that queries the victim; if the defense has an alarm, it also tries not to raise it."""
        estimator: FovEstimator = self.evaluation.suite.estimators[victim]
        wedge = self.wedge
        if defense is not None:
            # The victim sees only the returns that the defense keeps.
            estimator = Changed(estimator, lambda bare, sweep: bare.estimate(defense.apply(sweep).sweep))
        attack = ADAPTIVE[case.name](int(case.level), Knowledge(estimator=estimator))
        if not isinstance(attack, BlackBox):
            raise ValueError(f"{case.name} must query its victim")
        sector_deg = float(np.rad2deg(wedge.width))
        attack = replace(attack, queries=self.queries, azimuth=wedge.azimuth, sector_deg=sector_deg)
        if defense is None or defense.apply(self.evaluation.sample.sweep).alarm is None:
            return attack
        return replace(attack, objective=Evade(attack.objective, lambda sweep: float(defense.apply(sweep).alarm or 0)))
