"""``viewshed estimate``: from files to fields of view."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from viewshed.cli import options
from viewshed.cli.learned import Network, Passes, PastSweeps, Seed, Sure, Wary, Weights
from viewshed.cli.options import AUTO, BAD_INPUTS, Reading, one_line, timed
from viewshed.cli.outputs import free_name, output_names, refuse_inputs

if TYPE_CHECKING:
    from viewshed.estimate import FovEstimate, FovEstimator
    from viewshed.io import IndexEntry
    from viewshed.level import LevelSweep
    from viewshed.sweep import Sweep

    Job = tuple[Path, IndexEntry | None]

_RESULTS = (".png", ".geojson", ".npz")


def estimate(
    files: Annotated[
        list[Path] | None, typer.Argument(metavar="FILE...", help="Sweeps in any known format, or recordings.")
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(help="Estimator, also unet or mcd; if not given viewnet, or shadow_map on grids of your own."),
    ] = None,
    grid: options.GridName = "road",
    sensor: options.SensorName = AUTO,
    format: options.FormatName = AUTO,  # noqa: A002
    file_frame: options.FrameName = None,
    height: options.Height = None,
    attitude: options.Attitude = None,
    index: options.Index = None,
    target: options.TargetName = "car",
    profile: options.Profile = "sound",
    weights: Weights = None,
    passes: Passes = None,
    seed: Seed = None,
    sure: Sure = None,
    threshold: Annotated[
        float | None,
        typer.Option(help="Probability from which a cell counts as visible; 0.5, or the network's, if not given."),
    ] = None,
    past: PastSweeps = 0,
    wary: Wary = False,
    out: Annotated[Path, typer.Option(help="Folder of the results.")] = Path("out"),
) -> None:
    """Estimate what each sweep could see: a picture, GeoJSON, NPZ and one line for each sweep.

    A file that cannot be read costs one line on standard error and does not stop the others; the exit code is then 2.

    Example: viewshed estimate sweep.pcd.bin --out out
    """
    reading = Reading(sensor, format, file_frame, height, attitude)
    network = Network(weights, passes, seed, sure)
    estimator = network.estimator(method, options.parse_grid(grid), target, profile)
    run = Run(network.remembering(estimator, past, wary), network.threshold(threshold, estimator, profile), out)
    jobs = list(options.chosen(files or [], index))
    names = output_names([file for file, _ in jobs])
    refuse_inputs((out / f"{name}{suffix}" for name in names for suffix in _RESULTS), (file for file, _ in jobs))
    out.mkdir(parents=True, exist_ok=True)
    if _run_all(run, reading, jobs, names):
        raise typer.Exit(2)


def _run_all(run: Run, reading: Reading, jobs: list[Job], names: list[str]) -> int:
    """Do every job and return how many failed."""
    taken, failed = {name.casefold() for name in names}, 0
    for (file, entry), name in zip(_with_bar(jobs), names, strict=True):
        try:
            for sweep, single in _named(reading.sweeps(file, entry), name, taken):
                typer.echo(run.one(sweep, single))
        except BAD_INPUTS as error:
            failed += 1
            typer.echo(f"viewshed: {_about(file, error)}", err=True)
    return failed


@dataclass(slots=True)
class Run:
    """What is done with every sweep.

    Attributes:
        estimator: what looks at it.
        threshold: probability from which a cell counts as visible.
        out: folder of the results.
    """

    estimator: FovEstimator
    threshold: float
    out: Path
    _warm: bool = field(default=False, init=False)

    def one(self, sweep: Sweep, name: str) -> str:
        """Write picture, GeoJSON and NPZ of one sweep and return its summary line."""
        from viewshed.atomic import write_bytes
        from viewshed.estimators.learned import LEARNED
        from viewshed.export import to_geojson, to_npz
        from viewshed.level import level_sweep
        from viewshed.plot import Panel, maps_picture, picture

        if not self._warm:  # the first call loads compiled code, which is no time of the estimator
            self.estimator.estimate(sweep)
            self._warm = True
        found, elapsed_ms = timed(self.estimator, sweep)
        level = level_sweep(sweep, self.estimator.grid)
        summary = summary_line(found, self.threshold, elapsed_ms)
        drawn = maps_picture if found.method in LEARNED else picture
        content = (
            drawn(Panel(found, f"{name}\n{summary}", level, self.threshold)),
            _json(to_geojson(found, self.threshold)),
            to_npz(found),
        )
        for suffix, made in zip(_RESULTS, content, strict=True):
            write_bytes(self.out / f"{name}{suffix}", made)
        return f"{name}: {summary}{_doubt(sweep, level)} → {self.out / name}.png"


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
        assumed = f"; ground not seen, sensor taken to be {level.sensor_height_m:.2f} m above it"
        return f"{assumed} (give --height, or --file-frame if the file's z points down)"
    return ""


def _json(content: object) -> bytes:
    import json

    return json.dumps(content, allow_nan=False).encode()


def _named(sweeps: Iterator[Sweep], name: str, taken: set[str]) -> Iterator[tuple[Sweep, str]]:
    """Yield each sweep with the name of its results: the file's, or numbered ones where it holds several."""
    first = next(sweeps)
    try:
        second = next(sweeps, None)
    except BAD_INPUTS:
        yield first, name
        raise
    if second is None:
        yield first, name
        return
    yield first, free_name(f"{name}_000", taken)
    yield second, free_name(f"{name}_001", taken)
    for number, sweep in enumerate(sweeps, start=2):
        yield sweep, free_name(f"{name}_{number:03}", taken)


def _about(file: Path, error: BaseException) -> str:
    text = one_line(error)
    return text if file.name in text else f"{file}: {text}"


def _with_bar(jobs: list[Job]) -> Iterable[Job]:
    """Return the jobs, with a progress bar on standard error where that is a terminal and they are several."""
    if len(jobs) < 2 or not sys.stderr.isatty():
        return jobs
    return _tracked(jobs)


def _tracked(jobs: list[Job]) -> Iterator[Job]:
    from rich.console import Console
    from rich.progress import Progress

    to_terminal = sys.stdout.isatty()  # else the lines belong in the file or pipe, not above the bar
    with Progress(console=Console(stderr=True), transient=True, redirect_stdout=to_terminal) as bar:
        yield from bar.track(jobs, description="sweeps")
