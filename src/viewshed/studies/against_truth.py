"""Estimates against exact truth: pooled over samples, by range, and without the cells that are a matter of one beam."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from viewshed.datasets.sample import Sample
from viewshed.fov.estimate import THRESHOLD, FovEstimator
from viewshed.fov.truth import OTHER_DEFINITIONS
from viewshed.fov.visibility import Target
from viewshed.grid import BevGrid, polar_of_cells
from viewshed.metrics import ConfusionCounts, Mask
from viewshed.sweep import Sweep, bare_points, unorganized, unorganized_no_sensor

ALL = "all"

CLEAR = "clear"
"""Names of the parts of a grid that are always told: every known cell; those not next to the threshold."""

SENSOR = "sensor "
"""What the names of the parts begin with that hold every known cell of one sensor's sweeps."""

Form = Callable[[Sweep], Sweep]


@dataclass(frozen=True, slots=True)
class Contest:
    """Who is compared, and how.

    Attributes:
        estimators: by name, what makes one for a grid.
        target: what would have to be seen.
        forms: by name, in which form the estimators are given the sweep.
        bands: edges of the range bands, as shares of half the grid's side.
        threshold: probability from which an estimate calls a cell visible.
    """

    estimators: Mapping[str, Callable[[BevGrid], FovEstimator]]
    target: Target
    forms: Mapping[str, Form]
    bands: tuple[float, ...] = (0.0, 0.125, 0.25, 0.5, 0.75, 1.0, 1.415)
    threshold: float = THRESHOLD


Scores = dict[tuple[str, str, str], ConfusionCounts]
"""By estimator, form of the sweep, and part of the grid."""


def evaluate_truth(samples: Iterable[Sample], contest: Contest) -> Scores:
    """Return the tallies of every estimator over the samples, pooled; one that cannot use a sweep claims nothing.

    Args:
        samples: with truth for the contest's target.
        contest: who is compared.
    """
    scores: Scores = defaultdict(lambda: ConfusionCounts(samples=0))
    made: dict[tuple[str, BevGrid], FovEstimator] = {}
    for sample in samples:
        grid, true = sample.truth.grid, sample.truth.visible(contest.target)
        parts = _parts(sample, contest)
        for form, change in contest.forms.items():
            sweep = change(sample.sweep)
            for name, make in contest.estimators.items():
                if (name, grid) not in made:
                    made[name, grid] = make(grid)
                claimed = made[name, grid].estimate(sweep).visible(contest.threshold)
                for part, among in parts.items():
                    scores[name, form, part] += ConfusionCounts.of(claimed, true, among, grid.cell_area_m2)
    return dict(scores)


def compare_definitions(samples: Iterable[Sample], contest: Contest) -> Scores:
    """Return the tallies of the other definitions of visible against ``probe``, ours; the form is empty."""
    scores: Scores = defaultdict(lambda: ConfusionCounts(samples=0))
    for sample in samples:
        true, parts = sample.truth.visible(contest.target), _parts(sample, contest)
        for name in OTHER_DEFINITIONS:
            if name in sample.truth.definitions:
                for part, among in parts.items():
                    tally = ConfusionCounts.of(
                        sample.truth.definitions[name], true, among, sample.truth.grid.cell_area_m2
                    )
                    scores[name, "", part] += tally
    return dict(scores)


def _parts(sample: Sample, contest: Contest) -> dict[str, Mask]:
    """Return the parts of the grid by name: all that is known, clear of the threshold, range bands, the sensor's."""
    target, grid = contest.target, sample.truth.grid
    gap = np.abs(sample.truth.expected_returns[target.name].astype(np.int16) - min(target.min_returns, 255))
    range_m, _ = polar_of_cells(grid)
    parts = {ALL: sample.known, CLEAR: sample.known & (gap > max(1, target.min_returns // 2))}
    for low, high in pairwise(edge * grid.half_extent_m for edge in contest.bands):
        parts[f"{low:g} to {high:.3g} m"] = sample.known & (range_m >= low) & (range_m < high)
    if sample.sweep.model is not None:
        parts[SENSOR + sample.sweep.model.name] = sample.known
    return parts


def as_measured(sweep: Sweep) -> Sweep:
    """Return the sweep as it is: ring, time and sensor known."""
    return sweep


FORMS: dict[str, Form] = {
    "rings known": as_measured,
    "unorganized": unorganized,
    "unorganized, no sensor": unorganized_no_sensor,
    "bare points": bare_points,
}
"""In which form a sweep may be given, by name."""
