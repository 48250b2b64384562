"""Hold two versions against each other in the wild, on the same sweeps and by the same scoring.

    python tools/wild_versions.py sweeps SET FOLDER              # sweeps of a set with their exact truth
    python tools/wild_versions.py counts FOLDER OUT.json         # with this version
    python tools/with_checkout.py CHECKOUT tools/wild_versions.py counts FOLDER OUT.json  # with another
    python tools/wild_versions.py page BEFORE.json AFTER.json OUT.md

Sweeps of the sealed set are taken with those of a run whose opening is logged.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from viewshed import CAR, GRIDS, load_estimator, read_sweep, write_sweep
from viewshed.fov.estimate import CellState
from viewshed.grid import polar_of_cells
from viewshed.metrics import ConfusionCounts
from viewshed.monitor.roc import auroc
from viewshed_lab._page import facts, page, table

TOLD = ("rings", "nothing")
"""What the sweeps say: a file of an array holds no beam table."""

METHODS = ("default", "shadow_map", "viewnet")

BINS = 10

_ABOUT = """\
Road, car: {scenes} scenes of the set `{set_name}`, cells of known truth as far as the sensor sees a target of 10 %
reflectivity, all scenes together. *Told rings*: ring, time and intensity of each return; *nothing*: points alone.
*AUROC*: of the doubt for errors, the mean over scenes, cells left out at which fewer than `min_returns` beams aim.
*HIDDEN*: of these cells, the share that is called HIDDEN. Both versions read the same files."""


def write_sweeps(set_name: str, folder: Path) -> None:
    """Write the sweeps of a set on roads, told in each way: ``SCENE.TOLD.npz``, and the truth ``SCENE.truth.npz``."""
    from viewshed_lab.data.wild import OPEN_SEALED, SEALED, wild_scenes
    from viewshed_lab.sim.lidar.optics import optics_of

    folder.mkdir(parents=True, exist_ok=True)
    for scene in wild_scenes(set_name, "road", unseal=OPEN_SEALED if set_name == SEALED else ""):
        seen = scene.observe(0)
        model = seen.sensor.model
        reach_m = min(optics_of(model).reach_m, model.max_range_m)
        known = seen.known & (polar_of_cells(seen.truth.grid)[0] <= reach_m)
        aimed = seen.truth.state[CAR.name] != CellState.UNKNOWN
        np.savez_compressed(
            folder / f"{scene.name}.truth.npz", visible=seen.truth.visible(CAR), known=known, aimed=aimed
        )
        for told in TOLD:
            write_sweep(seen.sample(told).sweep, folder / f"{scene.name}.{told}.npz")


def counts_of(folder: Path) -> dict[str, Any]:
    """Return what this version makes of the files in a folder, as plain values."""
    grid = GRIDS["road"]
    estimators = {name: load_estimator(None if name == "default" else name, grid=grid) for name in METHODS}
    found: dict[str, list[Any]] = {f"{told}|{name}": [] for told in TOLD for name in METHODS}
    for file in sorted(folder.glob("*.truth.npz")):
        truth = np.load(file)
        known, visible, aimed = truth["known"], truth["visible"], truth["aimed"]
        for told in TOLD:
            sweep = read_sweep(folder / f"{file.name.removesuffix('.truth.npz')}.{told}.npz")
            for name, estimator in estimators.items():
                estimate = estimator.estimate(sweep)
                claimed, prob = estimate.visible(), estimate.visible_prob
                cells = ConfusionCounts.of(claimed, visible, known, grid.cell_area_m2)
                bins = np.minimum((prob[known] * BINS).astype(np.intp), BINS - 1)
                sums = [
                    np.bincount(bins, weights, BINS) for weights in (visible[known], prob[known].astype(np.float64))
                ]
                judged, wrong = known & aimed, claimed != visible
                doubt = 0.5 - np.abs(prob - 0.5)
                ranks = auroc(doubt[judged & ~wrong], doubt[judged & wrong]) if (judged & wrong).any() else None
                unaimed = known & ~aimed
                hidden = int((unaimed & (estimate.state == CellState.HIDDEN)).sum())
                found[f"{told}|{name}"].append(
                    [
                        cells.both,
                        cells.over,
                        cells.under,
                        ranks,
                        int(unaimed.sum()),
                        hidden,
                        *map(list, sums),
                        int(known.sum()),
                    ]
                )
    names = {name: estimator.name for name, estimator in estimators.items()}
    return {"version": facts()["version"], "default": names["default"], "set": folder.name, "scenes": found}


def _row(rows: list[Any]) -> list[str]:
    both, over, under = (sum(row[k] for row in rows) for k in range(3))
    precision, recall = both / max(both + over, 1), both / max(both + under, 1)
    visible, prob = (np.sum([row[k] for row in rows], axis=0) for k in (6, 7))
    known = sum(row[8] for row in rows)
    ranks = [row[3] for row in rows if row[3] is not None]
    unaimed, hidden = (sum(row[k] for row in rows) for k in (4, 5))
    f1, ece = 2 * precision * recall / max(precision + recall, 1e-9), np.abs(visible - prob).sum() / max(known, 1)
    rates = (f1, ece, float(np.mean(ranks)), hidden / max(unaimed, 1))
    return [f"{precision:.3f} / {recall:.3f}", *(f"{rate:.3f}" for rate in rates)]


def _rows(before: dict[str, Any], after: dict[str, Any], told: str) -> Iterator[list[str]]:
    for name in METHODS:
        for when, version in (("before", before), ("after", after)):
            which = f"{name} ({version['default']})" if name == "default" else name
            yield [which, when, *_row(version["scenes"][f"{told}|{name}"])]


def report(before: dict[str, Any], after: dict[str, Any]) -> str:
    """Return the page of two versions."""
    scenes = len(next(iter(after["scenes"].values())))
    blocks: list[str] = [_ABOUT.format(scenes=scenes, set_name=after["set"])]
    header = ("method", "", "precision / recall", "F1", "calibration error", "AUROC", "HIDDEN")
    for told in TOLD:
        blocks += [f"## Told {told}", table(header, _rows(before, after, told))]
    return page("In the wild, before and after", facts(before=before["version"], after=after["version"]), *blocks)


def main() -> None:
    """Do one of the three steps."""
    step, *words = sys.argv[1:]
    if step == "sweeps":
        write_sweeps(words[0], Path(words[1]))
    elif step == "counts":
        Path(words[1]).write_text(json.dumps(counts_of(Path(words[0]))), "utf-8")
    elif step == "page":
        before, after = (json.loads(Path(word).read_text("utf-8")) for word in words[:2])
        Path(words[2]).write_text(report(before, after), "utf-8")
    else:
        raise ValueError(f"the step must be sweeps, counts or page, got {step!r}")


if __name__ == "__main__":
    main()
