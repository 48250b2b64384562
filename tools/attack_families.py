"""Report how an estimator does under every attack and corruption against another version of itself, sweep by sweep.

Both versions are given the same files, so that every difference is the version's:

    python tools/attack_families.py sweeps FOLDER [SCENES]    # attacked sweeps with their truth
    python tools/attack_families.py counts FOLDER OUT.json    # with this version
    python tools/with_checkout.py CHECKOUT tools/attack_families.py counts FOLDER OUT.json  # with another
    python tools/attack_families.py page BEFORE.json AFTER.json OUT.md
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from viewshed import CAR, GRIDS, BevGrid, FovEstimate, LidarModel, load_estimator, read_sweep, write_sweep
from viewshed._page import facts, page, table
from viewshed.datasets.presets import preset_named
from viewshed.grid import polar_of_cells
from viewshed.integrity.roc import auroc
from viewshed.metrics import ConfusionCounts, Mask
from viewshed.sim.lidar.optics import optics_of
from viewshed.studies.cases import DEFAULT, TOUCHING, apply, case_generator, visible_with
from viewshed.studies.records import BENIGN, Case
from viewshed.studies.samples import StudySample, sample_of_preset
from viewshed.studies.statistics import DRAWS, f1
from viewshed.threats.corruptions import CORRUPTIONS

DOMAIN, SEED = "roads", 9302

SEVERITY = 3
"""Of the corruptions."""

DEFAULT_METHOD = "default"
"""Stands for the method that a version takes by default on the grid."""

METHODS = (DEFAULT_METHOD, "shadow_map", "viewnet")

LEAST = -0.005
"""A difference of F1 below this is worse."""

CASES = (
    BENIGN,
    *(Case("attack", name, DEFAULT) for name in TOUCHING),
    *(Case("corruption", name, str(SEVERITY)) for name in CORRUPTIONS),
)

_INTRODUCTION = """\
{scenes} scenes of the preset `{domain}` (every outdoor world, weather, seven sensors), one sweep each, against exact
truth for a car: each attack with its default budget, each corruption with severity {severity}. Both versions read the
same files. *F1* is of all cells of all scenes, as far as the sensor sees a target of 10 % reflectivity; in brackets the
90 % interval of its difference by a bootstrap over scenes, the same draws for both. *Beyond benign*: that difference
less the one without any attack, which is what the case itself adds. **worse**: the difference is below {least:g};
*perhaps*: its interval reaches below."""

Counts = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Counted:
    """What one version made of the files.

    Attributes:
        version: and commit.
        default: the method that it takes by default.
        counts: (S, 4) cells (both, over, under, neither) of each scene, by method and case.
        ranks: AUROC of the doubt for errors, the mean over scenes, by method and case.
    """

    version: str
    default: str
    counts: Mapping[tuple[str, str], Counts]
    ranks: Mapping[tuple[str, str], float]

    def of(self, method: str) -> dict[str, Counts]:
        """Return the counts of a method by case."""
        return {case: counts for (name, case), counts in self.counts.items() if name == method}

    def to_json(self) -> str:
        """Return it as text."""
        rows = {f"{method}|{case}": counts.astype(int).tolist() for (method, case), counts in self.counts.items()}
        ranks = {f"{method}|{case}": rank for (method, case), rank in self.ranks.items()}
        return json.dumps({"version": self.version, "default": self.default, "counts": rows, "ranks": ranks})

    @classmethod
    def of_json(cls, text: str) -> Counted:
        """Return what :meth:`to_json` wrote."""
        read = json.loads(text)
        counts = {tuple(key.split("|")): np.array(rows, np.float64) for key, rows in read["counts"].items()}
        ranks = {tuple(key.split("|")): rank for key, rank in read["ranks"].items()}
        return cls(read["version"], read["default"], counts, ranks)


def name_of(case: Case) -> str:
    """Return a case in one word."""
    return case.name or case.kind


def write_scene(folder: Path, number: int, sample: StudySample) -> None:
    """Write a sample in every case that it allows: ``NUMBER.CASE.npz`` and its truth, ``NUMBER.CASE.truth.npz``."""
    rng_of = partial(case_generator, SEED, DOMAIN, number)
    model = sample.sweep.model
    known = sample.known if model is None else sample.known & _within_reach(model, sample.truth.grid)
    for case in CASES:
        try:
            sweep = apply(case, sample, rng_of(case)).sweep
        except ValueError:
            continue
        visible = visible_with(case, sample, rng_of(case))
        visible = sample.truth.visible(CAR) if visible is None else visible
        stem = f"{number:03d}.{name_of(case)}"
        write_sweep(sweep, folder / f"{stem}.npz")
        sensor = "" if sweep.model is None or model is None else model.name
        np.savez_compressed(folder / f"{stem}.truth.npz", visible=visible, known=known, sensor=np.array(sensor))


def _within_reach(model: LidarModel, grid: BevGrid) -> Mask:
    """Return the cells (cells, cells) as far as a sensor sees a target of 10 % reflectivity."""
    return np.asarray(polar_of_cells(grid)[0] <= min(optics_of(model).reach_m, model.max_range_m))


def samples(scenes: int) -> Iterator[StudySample]:
    """Yield the samples, one a scene."""
    preset = preset_named(DOMAIN)
    return (sample_of_preset(preset, number, scenes, SEED) for number in range(scenes))


def counted(folder: Path) -> Counted:
    """Return what this version makes of the files in a folder."""
    grid = GRIDS["road"]
    methods = {name: load_estimator(None if name == DEFAULT_METHOD else name, grid=grid) for name in METHODS}
    rows: dict[tuple[str, str], list[list[int]]] = {}
    ranks: dict[tuple[str, str], list[float]] = {}
    for file in sorted(folder.glob("*.truth.npz")):
        number, case, *_ = file.name.split(".")
        truth = np.load(file)
        sweep = read_sweep(folder / f"{number}.{case}.npz", sensor=str(truth["sensor"]) or None)
        for name, method in methods.items():
            estimate = method.estimate(sweep)
            claimed = estimate.visible()
            found = ConfusionCounts.of(claimed, truth["visible"], truth["known"], grid.cell_area_m2)
            rows.setdefault((name, case), []).append([found.both, found.over, found.under, found.neither])
            ranks.setdefault((name, case), []).append(_rank(estimate, truth["visible"], truth["known"]))
    about = facts()
    counts = {key: np.array(row) for key, row in rows.items()}
    means = {key: float(np.nanmean(row)) for key, row in ranks.items()}
    return Counted(about["version"], methods[DEFAULT_METHOD].name, counts, means)


def _rank(estimate: FovEstimate, visible: Mask, known: Mask) -> float:
    """Return the AUROC of an estimate's doubt for its errors, over cells of known truth; NaN where there is none."""
    doubt, wrong = 0.5 - np.abs(estimate.visible_prob - 0.5), estimate.visible() != visible
    if not (wrong & known).any():
        return float("nan")
    return auroc(doubt[known & ~wrong], doubt[known & wrong])


def difference(before: Counts, after: Counts) -> tuple[float, float, float]:
    """Return F1 of ``after`` less that of ``before`` (S, 4), with the ends of the 90 % interval."""
    scenes = len(before)
    rng = np.random.Generator(np.random.PCG64(scenes))
    weights = rng.multinomial(scenes, np.full(scenes, 1.0 / scenes), DRAWS)
    drawn = f1(weights @ after) - f1(weights @ before)
    low, high = np.nanquantile(drawn, (0.05, 0.95))
    return float(f1(after.sum(axis=0)) - f1(before.sum(axis=0))), float(low), float(high)


def _rows(names: Sequence[str], before: Mapping[str, Counts], after: Mapping[str, Counts]) -> Iterator[list[str]]:
    benign, _, _ = difference(before[BENIGN.kind], after[BENIGN.kind])
    for name in names:
        value, low, high = difference(before[name], after[name])
        verdict = "**worse**" if value < LEAST else "perhaps" if low < LEAST else ""
        rates = [f"{f1(counts[name].sum(axis=0)):.3f}" for counts in (before, after)]
        yield [name, *rates, f"{value:+.3f} [{low:+.3f}, {high:+.3f}]", f"{value - benign:+.3f}", verdict]


def report(before: Counted, after: Counted) -> str:
    """Return the page of two versions.

    Raises:
        ValueError: they did not count the same cells.
    """
    names = [name_of(case) for case in CASES if ("shadow_map", name_of(case)) in after.counts]
    for key, counts in after.counts.items():
        if key not in before.counts or not np.array_equal(before.counts[key].sum(axis=1), counts.sum(axis=1)):
            raise ValueError(f"both versions must count the same files, got others for {key[1]}; run counts again")
    head, blocks = ("difference", "beyond benign", ""), []
    for method in METHODS:
        one = f"{before.default}, then {after.default}" if method == DEFAULT_METHOD else method
        rows = _rows(names, before.of(method), after.of(method))
        blocks += [f"## {method.capitalize()}: {one}", table(["case", "before", "after", *head], rows)]
    own = _rows(names, after.of("shadow_map"), after.of("viewnet"))
    blocks += ["## After: the network against the shadow map", table(["case", "shadow_map", "viewnet", *head], own)]
    judged = [(one, method) for one in (before, after) for method in ("shadow_map", "viewnet")]
    ranks = ([name, *(f"{one.ranks[method, name]:.3f}" for one, method in judged)] for name in names)
    doubts = ["case", "before: shadow_map", "before: viewnet", "after: shadow_map", "after: viewnet"]
    blocks += ["## AUROC of the doubt for errors", table(doubts, ranks)]
    scenes = max(len(counts) for counts in after.counts.values())
    about = _INTRODUCTION.format(scenes=scenes, domain=DOMAIN, severity=SEVERITY, least=LEAST)
    provenance = facts(seed=str(SEED), before=before.version, after=after.version)
    return page("Attacks and corruptions, before and after", provenance, about, *blocks)


def main() -> None:
    """Do one of the three steps."""
    step, *words = sys.argv[1:]
    if step == "sweeps":
        folder = Path(words[0])
        folder.mkdir(parents=True, exist_ok=True)
        for number, sample in enumerate(samples(int(words[1]) if len(words) > 1 else 16)):
            write_scene(folder, number, sample)
    elif step == "counts":
        Path(words[1]).write_text(counted(Path(words[0])).to_json(), "utf-8")
    else:
        before, after = (Counted.of_json(Path(word).read_text("utf-8")) for word in words[:2])
        Path(words[2]).write_text(report(before, after), "utf-8")


if __name__ == "__main__":
    main()
