"""Report how near labels come to exact truth: simulate, label without looking at the truth, compare; as a page.

Usage: python tools/label_report.py [OUT.md] [SAMPLES_EACH]
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from statistics import median

import numpy as np
from numpy.typing import NDArray

from viewshed._jobs import engine_named
from viewshed._page import facts, page, table
from viewshed._results import write_page
from viewshed.datasets import Sample, Storage
from viewshed.datasets.archive.archive import ArchiveSource
from viewshed.datasets.labeling import LabeledDrive, LabelRules
from viewshed.datasets.presets import Preset, preset_named
from viewshed.datasets.recordings.source import SweepRef
from viewshed.datasets.simulated import simulate
from viewshed.estimators import ESTIMATORS
from viewshed.fov.estimate import FovEstimator
from viewshed.grid import BevGrid, polar_of_cells
from viewshed.metrics import ConfusionCounts

SEEDS = (61, 62, 63)
"""None of them was looked at while the rules were chosen; those were 41 to 43, 51 to 53 and 1001 to 1005."""
SWEEPS = 200
BESIDE = ("shadow_map", "majority_vote")
BANDS = (0.0, 0.25, 0.5, 0.75, 1.5)
_TEXT = """\
Simulated recordings, labeled from their sweeps, poses and times alone, against their exact truth: `probe`, a car.
*Known*: share of the cells where the label says that it can be trusted. *Alone*: the same without neighbors in time.
Cells are pooled over the samples, where the truth is known; ranges are horizontal. The label shares its counting loop
with the exact truth, so the figures tell what depths and ground cost, and not that both count alike; that loop is
checked elsewhere."""
_OTHERS = """\
The other definitions, by the label and by the exact truth. Both take every surface that could give light back; the
label knows the returns that the sensor stored, and infers where beams without one met the ground."""
Mask = NDArray[np.bool_]
Tallies = dict[tuple[str, str], ConfusionCounts]


@dataclass(frozen=True, slots=True)
class Domain:
    """One kind of recording.

    Attributes:
        title: for people.
        preset: that is simulated.
    """

    title: str
    preset: Preset


@dataclass(slots=True)
class Score:
    """What is found in one domain: tallies by row and part, share of known cells by row, milliseconds of labels."""

    tallies: Tallies
    known: dict[str, list[float]]
    label_ms: list[float]


def domains() -> Iterator[Domain]:
    """Yield what is reported."""
    for name in ("nuscenes", "carla", "ugv"):
        preset = preset_named(name)
        if name == "carla":  # fewer agents, so that a scene lasts
            preset = replace(preset, moving=2, roadside=1)
        yield Domain(f"{name}, clear", replace(preset, conditions=("clear",), condition_weights=(1.0,)))
    yield Domain("nuscenes, with its weather and faults", preset_named("nuscenes"))


def score_of(domain: Domain, samples: int) -> Score:
    """Return the score over all seeds."""
    score = Score(defaultdict(lambda: ConfusionCounts(samples=0)), defaultdict(list), [])
    for seed in SEEDS:
        preset = replace(domain.preset.scaled(SWEEPS), seed=seed)
        with tempfile.TemporaryDirectory() as folder:
            source = ArchiveSource(simulate(preset, Storage.of(folder), engine_named("local")))
            _add(score, source, samples)
    return score


def _add(score: Score, source: ArchiveSource, samples: int) -> None:
    """Add the samples of one archive, spread evenly over its sensors and times."""
    grid, stride = source.archive.manifest.layout.grid, max(len(source.archive) // samples, 1)
    estimators = {name: ESTIMATORS[name](grid) for name in BESIDE}
    number = 0
    for scene in source.scenes():
        refs = source.refs(scene)
        for agent in dict.fromkeys(ref.agent for ref in refs):
            mine = [ref for ref in refs if ref.agent == agent]
            tracks = {
                "label": LabeledDrive.of(source.read, mine, LabelRules(grid)),
                "label, alone": LabeledDrive.of(source.read, mine, LabelRules(grid, neighbors=0)),
            }
            for place, ref in enumerate(mine):
                number += 1
                if number % stride == 0:
                    _compare(score, source.sample(ref), (tracks, place), estimators)


def _compare(
    score: Score,
    sample: Sample,
    at: tuple[dict[str, LabeledDrive[SweepRef]], int],
    estimators: Mapping[str, FovEstimator],
) -> None:
    grid, true = sample.truth.grid, sample.truth.visible("car")
    tracks, place = at
    trusted: Mask = sample.known
    for name, track in tracks.items():
        start = time.thread_time()
        truth, known = track.label(place)
        score.label_ms.append(1e3 * (time.thread_time() - start))
        claimed = truth.visible("car")
        _tally(score, name, (claimed, true, sample.known & known), grid)
        _tally(score, f"{name}, every cell", (claimed, true, sample.known), grid)
        score.known[name].append(float(known[sample.known].mean()))
        if name == "label":
            trusted = sample.known & known
            for other in ("farthest", "first_blocker"):
                masks = (truth.definitions[other], sample.truth.definitions[other], sample.known)
                _tally(score, other, masks, grid)
    for name, estimator in estimators.items():
        claimed = estimator.estimate(sample.sweep).visible()
        _tally(score, name, (claimed, true, trusted), grid)
        _tally(score, f"{name}, every cell", (claimed, true, sample.known), grid)


def _tally(score: Score, name: str, masks: tuple[Mask, Mask, Mask], grid: BevGrid) -> None:
    claimed, true, among = masks
    score.tallies[name, ""] += ConfusionCounts.of(claimed, true, among, grid.cell_area_m2)
    range_m = polar_of_cells(grid)[0] / grid.half_extent_m
    for low, high in pairwise(BANDS):
        part = among & (range_m >= low) & (range_m < high)
        score.tallies[name, _band(low, high, grid)] += ConfusionCounts.of(claimed, true, part, grid.cell_area_m2)


def _band(low: float, high: float, grid: BevGrid) -> str:
    ends = f"to {high * grid.half_extent_m:g} m" if high < BANDS[-1] else "beyond"
    return f"F1 {ends}" if low == 0 else ends


def _rows(score: Score, names: list[str]) -> str:
    bands = list(dict.fromkeys(band for _, band in score.tallies if band))
    rows = []
    for name in names:
        tally = score.tallies[name, ""]
        share = f"{np.mean(score.known[name]):.1%}" if name in score.known else ""
        rates = [f"{rate:.3f}" for rate in (tally.precision, tally.recall, tally.f1)]
        ranges = [f"{score.tallies[name, band].f1:.3f}" for band in bands]
        rows.append([name, share, *rates, f"{tally.over_m2:.0f}", f"{tally.under_m2:.0f}", *ranges])
    return table(["", "known", "precision", "recall", "F1", "over m²", "under m²", *bands], rows)


def section(domain: Domain, samples: int) -> list[str]:
    """Return the parts of the page about one domain."""
    score = score_of(domain, samples)
    every = [name for name, band in score.tallies if not band]
    known = ["label", "label, alone", *BESIDE]
    others = ["farthest", "first_blocker"]
    count = score.tallies["label", ""].samples
    return [
        f"## {domain.title}",
        f"{count} sweeps of seeds {', '.join(map(str, SEEDS))}; {median(score.label_ms):.0f} ms of one core a label.",
        "Where the label is known (the estimators where the label with neighbors is):",
        _rows(score, known),
        "In every cell:",
        _rows(score, [name for name in every if name not in known + others]),
        _OTHERS,
        _rows(score, others),
    ]


def report(samples: int) -> str:
    """Return the page."""
    parts = [part for domain in domains() for part in section(domain, samples)]
    return page("Labels against exact truth", facts(target="car", samples=f"{samples} of each seed"), _TEXT, *parts)


if __name__ == "__main__":
    text = report(int(sys.argv[2]) if len(sys.argv) > 2 else 40)
    if len(sys.argv) > 1:
        write_page(Path(sys.argv[1]), text)
    else:
        print(text)
