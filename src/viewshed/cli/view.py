"""``viewshed view``: a recording's estimates as one HTML page to watch."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from viewshed.cli import _options as options
from viewshed.cli._options import AUTO, BAD_INPUTS, HistorySweeps, NetworkOptions, Passes, Reading, Seed, Weights
from viewshed.cli._outputs import (
    Failures,
    Named,
    output_names,
    refuse_inputs,
    report_doubts,
    summary_line,
    warm_up,
)
from viewshed.cli._stream import history_buffer, named_sweeps
from viewshed.cli.estimate import Files, Method
from viewshed.cli.monitor import estimator_of

if TYPE_CHECKING:
    from viewshed.estimators import Estimator
    from viewshed.estimators.temporal import SweepBuffer
    from viewshed.fov.estimate import FovEstimate
    from viewshed.integrity import IntegrityReport
    from viewshed.preprocess.leveling import LeveledSweep
    from viewshed.view import PackedFrame

    Check = Callable[[LeveledSweep, FovEstimate], IntegrityReport]
    """What a monitor says of the next sweep and its estimate."""

Every = Annotated[int, typer.Option(min=1, help="Take every so many sweeps.")]

MostSweeps = Annotated[int | None, typer.Option("--sweeps", min=1, help="End after so many sweeps.")]


def view(
    files: Files = None,
    html: Annotated[Path | None, typer.Option(help="The page to write, one file that needs no network.")] = None,
    method: Method = None,
    grid: options.GridName = "road",
    sensor: options.SensorName = AUTO,
    format: options.FormatName = AUTO,  # noqa: A002
    file_frame: options.FrameName = None,
    height: options.Height = None,
    attitude: options.Attitude = None,
    origin: options.Origin = None,
    ring: options.RingSource = "file",
    vehicle_yaw: options.VehicleYaw = None,
    index: options.Index = None,
    target: options.TargetName = "car",
    weights: Weights = None,
    passes: Passes = None,
    seed: Seed = None,
    monitor: Annotated[
        Path | None, typer.Option(help="File of monitor calibrate, or of monitor fit, which brings method and grid.")
    ] = None,
    history: HistorySweeps = 0,
    every: Every = 1,
    sweeps: MostSweeps = None,
) -> None:
    """Write a page with a map and a timeline of what each sweep could see, for any browser, with no network.

    A file that cannot be read costs one line on standard error and does not stop the others; the exit code is then 2.

    Example: viewshed view drive.mcap --html run.html --every 5
    """
    from viewshed.view import write_page

    if html is None:
        raise ValueError("name the page to write: --html run.html")
    reading = Reading(sensor, format, file_frame, height, attitude, origin, ring, vehicle_yaw)
    own, check = (None, None) if monitor is None else _monitored(monitor, weights, method)
    network = NetworkOptions(weights, passes, seed)
    estimator = own or network.estimator(method, options.parse_grid(grid), target)
    buffer = history_buffer(estimator, history)
    jobs = list(options.chosen(files or [], index))
    places = [file for file, _ in jobs]
    refuse_inputs([html], places)
    failures = Failures()
    named = named_sweeps(reading, jobs, output_names(places), failures)
    taken = islice(named, 0, None if sweeps is None else every * sweeps, every)
    title = f"{places[0].name or places[0]}{f' and {len(places) - 1} more' if len(places) > 1 else ''}"
    size = write_page(html, _packed(taken, estimator, buffer, check, failures), title)
    typer.echo(f"{html}: {size / 1e6:.2f} MB")
    if failures.count:
        raise typer.Exit(2)


def _monitored(file: Path, weights: str | None, method: str | None) -> tuple[Estimator | None, Check]:
    """Return the estimator that a monitor was fitted on, if it was on one, and what the monitor says of each sweep."""
    from viewshed.integrity import StreamMonitor, load_monitor, load_sweep_monitor
    from viewshed.integrity.deviation import NAME as DEVIATION
    from viewshed.integrity.over_time import EDetector
    from viewshed.integrity.sweep_monitor import kind_of_monitor

    if kind_of_monitor(file) == DEVIATION:
        if method not in {None, "mc_dropout"}:
            raise ValueError(f"--monitor was fitted on mc_dropout, got --method {method}; leave it out")
        fitted = load_monitor(file)
        return estimator_of(fitted, weights), lambda _, estimate: fitted.check(estimate)
    # The page shows sweep by sweep: doubt that adds up over them is not asked for.
    stream = StreamMonitor(load_sweep_monitor(file), EDetector(limit=math.inf))
    return None, lambda leveled, estimate: stream.check(leveled, {estimate.method: estimate}).now


def _packed(
    sweeps: Iterable[Named],
    estimator: Estimator,
    buffer: SweepBuffer | None,
    check: Check | None,
    failures: Failures,
) -> Iterator[PackedFrame]:
    """Yield each sweep as the page holds it, and print its line; the sensor of the one before is expected first."""
    from viewshed.preprocess.leveling import level
    from viewshed.view import Frame, pack_frame

    sensor, is_warm = None, False
    for named in sweeps:
        try:
            if not is_warm:
                warm_up(estimator, named.sweep)
                is_warm = True
            begin_s = time.perf_counter()
            leveled = level(named.sweep, estimator.grid, sensor)
            history = None if buffer is None else buffer.history(leveled)
            leveled = leveled if history is None else history.now
            estimate = estimator.estimate(leveled, history)
            elapsed_ms = 1e3 * (time.perf_counter() - begin_s)
            report = None if check is None else check(leveled, estimate)
        except BAD_INPUTS as error:
            failures.report(named.file, error)
            continue
        if buffer is not None:
            buffer.add(leveled)
        sensor = leveled.sensor_id.model
        report_doubts(leveled, named.name)
        frame = pack_frame(Frame(named.name, estimate, leveled, report))
        alarm = ", ALARM" if report is not None and report.alarm else ""
        typer.echo(f"{named.name}: {summary_line(estimate, elapsed_ms)}{alarm}; {len(frame.data) / 1e3:.1f} kB")
        yield frame
