"""``viewshed estimate``: from files to fields of view."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from viewshed.cli import options
from viewshed.cli.options import AUTO, Reading

if TYPE_CHECKING:
    from viewshed.estimate import FovEstimate, FovEstimator
    from viewshed.io import IndexEntry
    from viewshed.level import LevelSweep
    from viewshed.sweep import Sweep

    Job = tuple[Path, IndexEntry | None]

_SUFFIXES = (".gz", ".pcd.bin", ".bin", ".pcd", ".ply", ".npy", ".npz", ".feather", ".pcap")


def estimate(
    files: Annotated[list[Path] | None, typer.Argument(metavar="FILE...", help="Sweeps, in any known format.")] = None,
    method: Annotated[str, typer.Option(help="Estimator; see docs/estimators.md.")] = "shadow_map",
    grid: options.GridName = "road",
    sensor: options.SensorName = AUTO,
    format: options.FormatName = AUTO,  # noqa: A002
    file_frame: options.FrameName = None,
    height: options.Height = None,
    attitude: options.Attitude = None,
    index: options.Index = None,
    target: options.TargetName = "car",
    profile: options.Profile = "sound",
    threshold: Annotated[float, typer.Option(help="Probability from which a cell counts as visible.")] = 0.5,
    out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("out"),
) -> None:
    """Estimate what each sweep could see: a picture, GeoJSON, NPZ and one line for each file.

    Example: viewshed estimate sweep.pcd.bin --out out
    """
    reading = Reading(sensor, format, file_frame, height, attitude)
    estimator = options.make_estimator(method, options.parse_grid(grid), target, profile)
    if not 0 < threshold <= 1:
        raise ValueError(f"threshold must lie in (0, 1], got {threshold}")
    jobs = list(options.chosen(files or [], index))
    out.mkdir(parents=True, exist_ok=True)
    failed = 0
    names = _stems([file for file, _ in jobs])
    for (file, entry), name in zip(_with_bar(jobs), names, strict=True):
        try:
            typer.echo(run_one(reading.sweep(file, entry), name, estimator, threshold, out))
        except (ValueError, OSError, ImportError, MemoryError) as error:
            failed += 1
            typer.echo(f"viewshed: {_named(file, error)}", err=True)
    if failed:
        raise typer.Exit(2)


def run_one(sweep: Sweep, name: str, estimator: FovEstimator, threshold: float, out: Path) -> str:
    """Write picture, GeoJSON and NPZ of one sweep into ``out`` and return the summary line."""
    from viewshed.export import to_geojson, to_npz
    from viewshed.export.atomic import write_bytes
    from viewshed.level import level_sweep
    from viewshed.plot import Panel, picture

    start = time.perf_counter()
    found = estimator.estimate(sweep)
    elapsed_ms = 1e3 * (time.perf_counter() - start)
    level = level_sweep(sweep, estimator.grid)
    summary = summary_line(found, threshold, elapsed_ms)
    made = {
        ".png": picture(Panel(found, f"{name[-32:]}: {summary}", level)),
        ".geojson": _json(to_geojson(found, threshold)),
        ".npz": to_npz(found),
    }
    for suffix, content in made.items():
        write_bytes(out / f"{name}{suffix}", content)
    return f"{name}: {summary}{_doubt(sweep, level)} → {out / name}.png"


def summary_line(found: FovEstimate, threshold: float, elapsed_ms: float) -> str:
    """Return visible area, shares of hidden and unknown cells, method and time, in one line."""
    from viewshed.estimate import CellState

    hidden, unknown = found.share(CellState.HIDDEN), found.share(CellState.UNKNOWN)
    return (
        f"visible {found.area_m2(threshold):.0f} m², hidden {hidden:.0%}, unknown {unknown:.0%} "
        f"({found.method}, {found.target.name}, {elapsed_ms:.1f} ms)"
    )


def _doubt(sweep: Sweep, level: LevelSweep) -> str:
    if len(level.points) == 0:
        return f"; no usable return among {len(sweep)} points: nothing is known"
    if level.ground.support == 0 and sweep.sensor_height_m is None:
        return f"; ground not seen, sensor taken to be {level.sensor_height_m:.2f} m above it (give --height)"
    return ""


def _json(content: object) -> bytes:
    import json

    return json.dumps(content, allow_nan=False).encode()


def _stems(files: list[Path]) -> list[str]:
    """Return one output name for each file; files of one name get their folder's before it, then a number.

    >>> _stems([Path("a/x.bin"), Path("b/x.bin"), Path("y.pcd.bin.gz")])
    ['a_x', 'b_x', 'y']
    """
    stems = [_stem(file.name) for file in files]
    longer = [
        f"{file.parent.name}_{stem}" if stems.count(stem) > 1 else stem for file, stem in zip(files, stems, strict=True)
    ]
    return [f"{name}_{longer[:k].count(name)}" if name in longer[:k] else name for k, name in enumerate(longer)]


def _stem(name: str) -> str:
    for suffix in _SUFFIXES:
        if name.lower().endswith(suffix) and len(name) > len(suffix):
            name = name[: -len(suffix)]
    return name


def _named(file: Path, error: BaseException) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    return text if file.name in text else f"{file}: {text}"


def _with_bar(jobs: list[Job]) -> Iterable[Job]:
    """Return the jobs, with a progress bar on standard error where that is a terminal and they are several."""
    if len(jobs) < 2 or not sys.stderr.isatty():
        return jobs
    from rich.console import Console
    from rich.progress import track

    return track(jobs, description="sweeps", console=Console(stderr=True), transient=True)
