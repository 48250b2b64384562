"""Estimate every sweep of an index: a contact sheet of cell states, and a table.

``python tools/contact_sheet.py INDEX.json --out docs/results`` writes ``real_sweeps.png`` and ``real_sweeps.md``. The
sheet shows estimates only, no points of the data. Comments come from ``real_sweeps_judgement.md`` beside this file.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path

from viewshed import GRIDS, CellState
from viewshed._files import write_atomic
from viewshed.estimators import ESTIMATORS
from viewshed.io import IndexEntry, read_index, read_indexed
from viewshed.preprocess.leveling import level
from viewshed.show.plot import Panel, contact_sheet
from viewshed_lab._page import facts, page, table
from viewshed_lab._results import write_page

HEADER = ("no.", "file", "sensor", "grid", "points", "visible m²", "hidden", "unknown", "sensor height m", "tilt", "ms")
_INDOORS = ("indoor", "office", "room")


def main() -> None:
    """Estimate, draw, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("index", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/results"))
    arguments = parser.parse_args()
    environments = {entry["file"]: entry["environment"] for entry in json.loads(arguments.index.read_text())}
    folder = arguments.index.resolve().parent
    panels: list[Panel] = []
    rows: list[list[str]] = []
    for entry in read_index(arguments.index):
        environment = environments[str(entry.file.relative_to(folder))]
        grid = "indoor" if any(word in environment for word in _INDOORS) else "road"
        row, panel = _estimated(entry, grid, str(entry.file.relative_to(folder)))
        number = str(len(panels) + 1) if panel is not None else ""
        rows.append([number, *row])
        panels += [replace(panel, title=f"{number} · {panel.title}")] if panel is not None else []
        sys.stderr.write(f"{row[0]}\n")
    write_atomic(arguments.out / "real_sweeps.png", contact_sheet(panels))
    judgement = Path(__file__).with_name("real_sweeps_judgement.md").read_text(encoding="utf-8")
    picture = "![Contact sheet of the estimates](real_sweeps.png)"
    text = page("Every real sweep", facts(method="shadow_map, car"), picture, judgement.strip(), table(HEADER, rows))
    write_page(arguments.out / "real_sweeps.md", text)


def _estimated(entry: IndexEntry, grid: str, name: str) -> tuple[list[str], Panel | None]:
    try:
        sweep = read_indexed(entry)
    except (ValueError, OSError) as error:
        return [name, entry.sensor, "–", *[""] * 6, " ".join(str(error).split()).split(": ")[-1][:90]], None
    estimator = ESTIMATORS["shadow_map"](GRIDS[grid])
    start = time.perf_counter()
    estimate = estimator.estimate(sweep)
    elapsed_ms = 1e3 * (time.perf_counter() - start)
    leveled = level(sweep, GRIDS[grid])
    tilt = _tilt_deg(leveled.level_from_sensor.rotation[2, 2])
    height = f"{leveled.sensor_height_m:.2f}" + ("" if leveled.ground.support else " (ground not seen)")
    shares = [f"{estimate.share(state):.0%}" for state in (CellState.HIDDEN, CellState.UNKNOWN)]
    row = [
        name, entry.sensor, grid, str(len(sweep)), f"{estimate.area_m2():.0f}", *shares, height, tilt,
        f"{elapsed_ms:.1f}",
    ]  # fmt: skip
    short = entry.file.name.replace("__LIDAR_TOP__", " ")
    return row, Panel(estimate, f"{short[-22:]}\n{estimate.area_m2():.0f} m²")


def _tilt_deg(cosine: float) -> str:
    import numpy as np

    return f"{np.rad2deg(np.arccos(min(cosine, 1.0))):.1f}°"


if __name__ == "__main__":
    main()
