"""``viewshed compare``: several estimators on one sweep."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from viewshed.cli import options
from viewshed.cli.options import AUTO, Reading

if TYPE_CHECKING:
    from viewshed.estimate import CellState

_HEADER = ("method", "visible m²", "hidden", "unknown", "IoU with the first", "time ms")


def compare(
    file: Annotated[Path, typer.Argument(help="A sweep, in any known format.")],
    methods: Annotated[
        str, typer.Option(help="Estimators, with commas; 'all' for every one.")
    ] = "shadow_map,vote,first_blocker",
    grid: options.GridName = "road",
    sensor: options.SensorName = AUTO,
    format: options.FormatName = AUTO,  # noqa: A002
    file_frame: options.FrameName = None,
    height: options.Height = None,
    attitude: options.Attitude = None,
    index: options.Index = None,
    target: options.TargetName = "car",
    profile: options.Profile = "sound",
    out: Annotated[Path, typer.Option(help="The picture.")] = Path("compare.png"),
) -> None:
    """Show several estimators side by side: a picture and a table.

    Example: viewshed compare sweep.bin --methods shadow_map,quantized,concave_hull
    """
    import numpy as np

    from viewshed.estimators import ESTIMATORS, PAPER_ESTIMATORS
    from viewshed.export.atomic import write_bytes
    from viewshed.level import level_sweep
    from viewshed.plot import Panel, comparison
    from viewshed.report import table

    cells = options.parse_grid(grid)
    known = ESTIMATORS if profile == "sound" else PAPER_ESTIMATORS
    names = list(known) if methods == "all" else methods.split(",")
    estimators = {name: options.make_estimator(name, cells, target, profile) for name in names}
    [(path, entry)] = options.chosen([file], index)
    sweep = Reading(sensor, format, file_frame, height, attitude).sweep(path, entry)
    level = level_sweep(sweep, cells)
    panels, rows, first = [], [], None
    for name, estimator in estimators.items():
        estimator.estimate(sweep)
        start = time.perf_counter()
        found = estimator.estimate(sweep)
        elapsed_ms = 1e3 * (time.perf_counter() - start)
        mask = found.visible()
        first = mask if first is None else first
        overlap = float(np.sum(mask & first)) / max(float(np.sum(mask | first)), 1.0)
        shares = [f"{found.share(state):.1%}" for state in _hidden_and_unknown()]
        rows.append([name, f"{found.area_m2():.0f}", *shares, f"{overlap:.3f}", f"{elapsed_ms:.1f}"])
        panels.append(Panel(found, name, level))
    write_bytes(out, comparison(panels, rows, _HEADER))
    typer.echo(table(_HEADER, rows))
    typer.echo(f"→ {out}")


def _hidden_and_unknown() -> tuple[CellState, CellState]:
    from viewshed.estimate import CellState

    return CellState.HIDDEN, CellState.UNKNOWN
