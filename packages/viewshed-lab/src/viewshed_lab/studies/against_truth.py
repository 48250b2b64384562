"""Compares estimators with exact truth: pooled over samples, by range, and without cells near the threshold."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Self

from viewshed.arrays import Mask
from viewshed.fov.estimate import THRESHOLD, FovEstimator
from viewshed.fov.truth import OTHER_DEFINITIONS
from viewshed.fov.visibility import Target
from viewshed.grid import BevGrid
from viewshed.metrics import ConfusionCounts
from viewshed.sweep import Sweep, bare_points, unorganized, unorganized_no_sensor
from viewshed_lab._page import facts
from viewshed_lab.data import Archive
from viewshed_lab.data.sample import Sample
from viewshed_lab.studies.formatting import by_name, format_number, lines, pivot
from viewshed_lab.studies.pages import Table, fill_template
from viewshed_lab.studies.records import SEVERAL, VIEW, Case, Domain, Results, Row, Series, row_of
from viewshed_lab.studies.samples import CLEAR, SENSOR, parts_of

DEFINITION = Case("definition")
"""The case that compares another definition of visible, not an estimator, with ours."""

Form = Callable[[Sweep], Sweep]


@dataclass(frozen=True, slots=True)
class TruthEvaluation:
    """Estimators to compare, and parameters of the comparison."""

    estimators: Mapping[str, Callable[[BevGrid], FovEstimator]]  # by name, factory for a grid
    target: Target  # target whose visibility counts
    forms: Mapping[str, Form]  # by name, conversion of the sweep before it is estimated
    # edges of the range bands, as shares of the grid's half extent
    bands: tuple[float, ...] = (0.0, 0.125, 0.25, 0.5, 0.75, 1.0, 1.415)
    threshold: float = THRESHOLD  # minimum probability of a visible cell

    def rows(self, samples: Iterable[Sample]) -> Iterator[Row]:
        """Yield the counts of every estimator on each sample in each form; without an estimate nothing is claimed."""
        cache: dict[tuple[str, BevGrid], FovEstimator] = {}
        for sample in samples:
            for form, change in self.forms.items():
                sweep = change(sample.sweep)
                for name, make in self.estimators.items():
                    key = name, sample.truth.grid
                    if key not in cache:
                        cache[key] = make(sample.truth.grid)
                    claimed = cache[key].estimate(sweep).visible(self.threshold)
                    yield from self._compare(sample, name, form_case(form), claimed)

    def definitions(self, samples: Iterable[Sample]) -> Iterator[Row]:
        """Yield the counts of the other definitions of visible against ours, ``probe``."""
        for sample in samples:
            for name in OTHER_DEFINITIONS:
                if name in sample.truth.definitions:
                    yield from self._compare(sample, name, DEFINITION, sample.truth.definitions[name])

    def _compare(self, sample: Sample, method: str, case: Case, claimed: Mask) -> Iterator[Row]:
        true = sample.truth.visible(self.target)
        for region, mask in self.regions(sample).items():
            counts = ConfusionCounts.of(claimed, true, mask, sample.truth.grid.cell_area_m2)
            yield row_of(Series("", method, case, region), sample.scene, SEVERAL, counts)

    def regions(self, sample: Sample) -> dict[str, Mask]:
        """Return masks of known cells by region: all of them, and the parts of the view."""
        parts = parts_of(sample, self.target, self.bands, max(1, self.target.min_returns // 2))
        return {VIEW: sample.known} | {name: sample.known & part for name, part in parts.items()}


def form_case(form: str) -> Case:
    """Return the case of sweeps in a form."""
    return Case("form", form)


FORMS: dict[str, Form] = {
    "rings known": lambda sweep: sweep,
    "unorganized": unorganized,
    "unorganized, no sensor": unorganized_no_sensor,
    "bare points": bare_points,
}
"""Forms of a sweep by name; the first is as measured."""


@dataclass(frozen=True, slots=True, eq=False)
class ArchiveResults:
    """Results on one data set."""

    name: str  # of its preset
    about: str  # its seed, and the number of samples
    found: Domain[TruthEvaluation]  # the results; the domain of these rows has an empty name

    @classmethod
    def of(cls, data: Archive, evaluation: TruthEvaluation, limit: int, on_step: Callable[[str], None]) -> Self:
        """Return the results on at most ``limit`` samples, spread evenly over a data set."""
        count, recipe = min(limit, len(data)), data.manifest.recipe
        on_step(f"{recipe.get('preset')}: {count} samples")
        samples = [k * len(data) // count for k in range(count)]
        rows = [*evaluation.rows(data[k] for k in samples), *evaluation.definitions(data[k] for k in samples)]
        spread = f"{count} of {len(data)} samples, spread evenly over {len(data.scenes)} scenes."
        found = Domain(Results.of(evaluation, rows), "")
        return cls(str(recipe.get("preset")), f"Seed {recipe.get('seed')}; {spread}", found)

    def methods(self, case: Case) -> dict[str, str]:
        """Return the methods that have rows in a case."""
        return by_name(series.method for series in self.found.results.series() if series.case == case)

    def regions(self, case: Case) -> list[str]:
        """Return the regions that have rows in a case."""
        return list(dict.fromkeys(series.region for series in self.found.results.series() if series.case == case))

    def summary(self, case: Case) -> Table:
        """Return the table of rates and areas of each method."""

        def figure(digits: int, value: Callable[[ConfusionCounts], float], region: str = VIEW) -> Callable[[str], str]:
            return lambda name: format_number(value(self.found.counts(name, case, region)), digits)

        return lines("", self.methods(case), {
            "precision": figure(3, lambda counts: counts.precision),
            "recall": figure(3, lambda counts: counts.recall),
            "F1": figure(3, lambda counts: counts.f1),
            "IoU": figure(3, lambda counts: counts.iou),
            "over m²": figure(0, lambda counts: counts.over_m2),
            "under m²": figure(0, lambda counts: counts.under_m2),
            "F1, clear": figure(3, lambda counts: counts.f1, CLEAR),
        })  # fmt: skip

    def by_range(self, case: Case) -> Table:
        """Return the table of F1 by range band."""
        bands = [name for name in self.regions(case) if name not in (VIEW, CLEAR) and not name.startswith(SENSOR)]
        return self._f1_by_region(case, by_name(bands))

    def by_sensor(self, case: Case) -> Table:
        """Return the table of F1 by sensor, with the number of its samples."""
        method, heads = next(iter(self.methods(case))), {}
        for region in sorted(name for name in self.regions(case) if name.startswith(SENSOR)):
            heads[f"{region.removeprefix(SENSOR)} ({self.found.counts(method, case, region).samples})"] = region
        return self._f1_by_region(case, heads or {"all": VIEW})

    def _f1_by_region(self, case: Case, heads: Mapping[str, str]) -> Table:
        """Return a table of F1 by region; ``heads`` maps column headers to regions."""
        return pivot("", self.methods(case), heads,
                     lambda method, region: format_number(self.found.counts(method, case, region).f1, 3))  # fmt: skip


def page_of(
    archives: Sequence[Archive], evaluation: TruthEvaluation, limit: int, split: str, on_step: Callable[[str], None]
) -> str:
    """Return the page of simulated data sets as Markdown: at most ``limit`` samples, spread evenly over each."""
    results = [ArchiveResults.of(data, evaluation, limit, on_step) for data in archives]
    first, *_ = evaluation.forms
    forms = {f"{form[0].upper()}{form[1:]}": form_case(form) for form in evaluation.forms}
    page = fill_template("against_truth.md", archives=results, forms=forms, first=first, clean=form_case(first),
                         definition=DEFINITION)  # fmt: skip
    return page.markdown(facts(target=evaluation.target.name, split=split))
