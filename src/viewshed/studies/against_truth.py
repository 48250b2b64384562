"""Estimators against exact truth: pooled over samples, by range, and without the cells that one beam decides."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isnan

import numpy as np

from viewshed._page import Heading, PageBlock, Table, Text, facts, to_markdown
from viewshed.datasets import Archive
from viewshed.datasets.sample import Sample
from viewshed.fov.estimate import THRESHOLD, FovEstimator
from viewshed.fov.truth import OTHER_DEFINITIONS
from viewshed.fov.visibility import Target
from viewshed.grid import BevGrid, polar_of_cells
from viewshed.metrics import ConfusionCounts, Mask
from viewshed.studies.formatting import pivot
from viewshed.studies.records import SEVERAL, VIEW, Case, Record, Results, Series
from viewshed.sweep import Sweep, bare_points, unorganized, unorganized_no_sensor

CLEAR = "clear"
"""Region of the known cells that are not next to the threshold; ``VIEW`` has every known cell."""

SENSOR = "sensor "
"""What the names of the regions begin with that hold every known cell of one sensor's sweeps."""

DEFINITION = Case("definition")
"""The case in which no estimator but another definition of visible is held against ours."""

Form = Callable[[Sweep], Sweep]


@dataclass(frozen=True, slots=True)
class TruthEvaluation:
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

    def records(self, samples: Iterable[Sample]) -> Iterator[Record]:
        """Yield the counts of every estimator on each sample in each form; one that cannot use a sweep claims nothing.

        Args:
            samples: with truth for the target.
        """
        made: dict[tuple[str, BevGrid], FovEstimator] = {}
        for sample in samples:
            for form, change in self.forms.items():
                sweep = change(sample.sweep)
                for name, make in self.estimators.items():
                    key = name, sample.truth.grid
                    if key not in made:
                        made[key] = make(sample.truth.grid)
                    claimed = made[key].estimate(sweep).visible(self.threshold)
                    yield from self._compare(sample, name, form_case(form), claimed)

    def definitions(self, samples: Iterable[Sample]) -> Iterator[Record]:
        """Yield the counts of the other definitions of visible against ``probe``, ours."""
        for sample in samples:
            for name in OTHER_DEFINITIONS:
                if name in sample.truth.definitions:
                    yield from self._compare(sample, name, DEFINITION, sample.truth.definitions[name])

    def _compare(self, sample: Sample, method: str, case: Case, claimed: Mask) -> Iterator[Record]:
        true = sample.truth.visible(self.target)
        for region, mask in self.regions(sample).items():
            counts = ConfusionCounts.of(claimed, true, mask, sample.truth.grid.cell_area_m2)
            yield Record(Series("", method, case, region), sample.scene, SEVERAL, counts)

    def regions(self, sample: Sample) -> dict[str, Mask]:
        """Return parts of the grid by name: all that is known, clear of the threshold, range bands, the sensor's."""
        target, grid = self.target, sample.truth.grid
        gap = np.abs(sample.truth.expected_returns[target.name].astype(np.int16) - min(target.min_returns, 255))
        range_m, _ = polar_of_cells(grid)
        regions = {VIEW: sample.known, CLEAR: sample.known & (gap > max(1, target.min_returns // 2))}
        for low, high in pairwise(edge * grid.half_extent_m for edge in self.bands):
            regions[f"{low:g} to {high:.3g} m"] = sample.known & (range_m >= low) & (range_m < high)
        if sample.sweep.model is not None:
            regions[SENSOR + sample.sweep.model.name] = sample.known
        return regions


def form_case(form: str) -> Case:
    """Return the case of sweeps in a form."""
    return Case("form", form)


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

_INTRODUCTION = """\
Cells pooled over the samples, where the truth is known. *Precision*: share of the claimed cells that are visible;
*recall*: share of the visible cells that are claimed. *Over* and *under*: area of a sample, on average, claimed and not
visible, visible and not claimed. *F1, clear*: without the cells next to the target's number of returns, where one beam
more or less decides."""

_FORMS = """\
*rings known*: the sweep as the sensor gives it. *unorganized*: without ring, firing azimuth and time. *no sensor*:
without the beam table as well. *bare points*: no mounting height, attitude or pose either."""

_DEFINITIONS = """\
What others call visible, from the same beams without noise, against ours (`probe`, exact)."""


def page_of(
    archives: Sequence[Archive], evaluation: TruthEvaluation, limit: int, split: str, on_step: Callable[[str], None]
) -> str:
    """Return the page as Markdown.

    Args:
        archives: simulated data sets.
        evaluation: who is compared, and how.
        limit: samples at most, spread evenly over each data set.
        split: of the data sets, for the reader.
        on_step: is called with what is done next.
    """
    blocks: list[PageBlock] = [Text(_INTRODUCTION), Text(_FORMS)]
    for data in archives:
        count, recipe = min(limit, len(data)), data.manifest.recipe
        on_step(f"{recipe.get('preset')}: {count} samples")
        results: Results[TruthEvaluation] = Results(evaluation)
        results.add(evaluation.records(data[k * len(data) // count] for k in range(count)))
        results.add(evaluation.definitions(data[k * len(data) // count] for k in range(count)))
        spread = f"{count} of {len(data)} samples, spread evenly over {len(data.scenes)} scenes."
        blocks += [Heading(2, str(recipe.get("preset"))), Text(f"Seed {recipe.get('seed')}; {spread}")]
        blocks += _blocks(results)
    return to_markdown("Estimators against exact truth", facts(target=evaluation.target.name, split=split), blocks)


def _blocks(results: Results[TruthEvaluation]) -> Iterator[PageBlock]:
    first = next(iter(results.plan.forms))
    for form in results.plan.forms:
        yield Heading(3, f"{form[0].upper()}{form[1:]}")
        yield _summary(results, form_case(form))
    yield Heading(3, f"F1 by range, {first}")
    yield _by_range(results, form_case(first))
    yield Heading(3, f"F1 by sensor, {first}")
    yield _by_sensor(results, form_case(first))
    yield Heading(3, "Other definitions")
    yield Text(_DEFINITIONS)
    yield _summary(results, DEFINITION)
    yield _by_range(results, DEFINITION)


def _methods(results: Results[TruthEvaluation], case: Case) -> dict[str, str]:
    return {series.method: series.method for series in results.series() if series.case == case}


def _regions(results: Results[TruthEvaluation], case: Case) -> list[str]:
    return list(dict.fromkeys(series.region for series in results.series() if series.case == case))


def _summary(results: Results[TruthEvaluation], case: Case) -> Table:
    rows = []
    for name in _methods(results, case):
        view, clear = (results.counts(Series("", name, case, region)) for region in (VIEW, CLEAR))
        rates = [_format(rate) for rate in (view.precision, view.recall, view.f1, view.iou)]
        rows.append([name, *rates, f"{view.over_m2:.0f}", f"{view.under_m2:.0f}", _format(clear.f1)])
    return Table(["", "precision", "recall", "F1", "IoU", "over m²", "under m²", "F1, clear"], rows)


def _by_range(results: Results[TruthEvaluation], case: Case) -> Table:
    bands = [name for name in _regions(results, case) if name not in (VIEW, CLEAR) and not name.startswith(SENSOR)]
    return _f1_by_region(results, case, {band: band for band in bands})


def _by_sensor(results: Results[TruthEvaluation], case: Case) -> Table:
    method = next(iter(_methods(results, case)))
    heads = {}
    for region in sorted(name for name in _regions(results, case) if name.startswith(SENSOR)):
        samples = results.counts(Series("", method, case, region)).samples
        heads[f"{region.removeprefix(SENSOR)} ({samples})"] = region
    return _f1_by_region(results, case, heads or {"all": VIEW})


def _f1_by_region(results: Results[TruthEvaluation], case: Case, heads: Mapping[str, str]) -> Table:
    """Return a table of F1 by region; ``heads`` are the regions by the words above their columns."""

    def f1(method: str, region: str) -> str:
        return _format(results.counts(Series("", method, case, region)).f1)

    return pivot("", _methods(results, case), heads, f1)


def _format(rate: float) -> str:
    return "–" if isnan(rate) else f"{rate:.3f}"
