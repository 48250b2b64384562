"""How much of the visible area inner polygons and perception regions keep on real sweeps.

``python tools/export_report.py INDEX.json --every 4`` writes ``docs/results/exports.md``.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from viewshed import ESTIMATORS, GRIDS, FovEstimate
from viewshed._files import write_atomic
from viewshed._page import facts, page, table
from viewshed.grid import polar_of_cells
from viewshed.io import read_index, read_indexed
from viewshed.io.export import claimed_by_cpm, to_cpm

SECTORS = (16, 64)
VARIANTS: dict[str, tuple[float, bool]] = {
    "whole cells (default)": (0.0, True),
    "whole cells, footprint 2.5 m": (2.5, True),
    "centers of cells": (0.0, False),
    "centers of cells, footprint 2.5 m": (2.5, False),
}
TARGETS = {16: 0.80, 64: 0.97}


def main() -> None:
    """Estimate, export, measure, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("index", type=Path)
    parser.add_argument("--every", type=int, default=4)
    parser.add_argument("--out", type=Path, default=Path("docs/results/exports.md"))
    given = parser.parse_args()
    entries = [entry for entry in read_index(given.index) if entry.points][:: given.every]
    shadow_map = ESTIMATORS["shadow_map"](GRIDS["road"])
    kept: dict[tuple[str, int], list[float]] = {}
    for entry in entries:
        estimate = shadow_map.estimate(read_indexed(entry))
        for name, share in _shares(estimate).items():
            kept.setdefault(name, []).append(share)
        sys.stderr.write(f"{entry.file.name}\n")
    told = facts(sweeps=str(len(entries)), mask="shadow_map, car, road grid")
    text = page("Exports: area kept", told, _WORDS, table(("shape", *map(str, SECTORS)), _rows(kept)))
    write_atomic(given.out, text.encode())


_WORDS = """\
Share of the visible cells that the exported shape still claims: median over the sweeps, lowest and highest in brackets.
No shape claims a cell that is not visible: *whole cells* does not touch one, *centers of cells* does not hold its
center. A *footprint* is the ground under the vehicle itself, which counts as known although no beam reaches it.
The targets are .80 with 16 sectors and .97 with 64."""


def _shares(estimate: FovEstimate) -> dict[tuple[str, int], float]:
    visible = estimate.visible()
    shares = {}
    for count in SECTORS:
        for name, (footprint_m, whole) in VARIANTS.items():
            message = to_cpm(estimate, count, footprint_m=footprint_m, whole_cells=whole)
            claimed = claimed_by_cpm(message, estimate.grid.centers)
            beyond = polar_of_cells(estimate.grid)[0] > footprint_m + estimate.grid.cell_m
            if (claimed & ~visible & beyond).any():
                raise AssertionError(f"{name}, {count} sectors claim a cell that is not visible")
            shares[f"CPM sectors, {name}", count] = float((claimed & visible).sum() / max(visible.sum(), 1))
        shares["inner polygon, vertices", count] = estimate.inner_polygon(count).area / max(estimate.area_m2(), 1e-9)
    return shares


def _rows(kept: dict[tuple[str, int], list[float]]) -> list[list[str]]:
    names = list(dict.fromkeys(name for name, _ in kept))
    return [[name, *(_cell(name, count, kept[name, count]) for count in SECTORS)] for name in names]


def _cell(name: str, count: int, shares: list[float]) -> str:
    median = float(np.median(shares))
    verdict = "" if "CPM" not in name else ", met" if median >= TARGETS[count] else ", **missed**"
    return f"{median:.2f} ({min(shares):.2f}–{max(shares):.2f}){verdict}"


if __name__ == "__main__":
    main()
