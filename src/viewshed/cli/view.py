"""``viewshed view``: a recording's estimates as one HTML page to watch."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from viewshed.cli import _options as options
from viewshed.cli._options import AUTO, HistorySweeps, NetworkOptions, Passes, Reading, Seed, Weights
from viewshed.cli._outputs import Failures, output_names, refuse_inputs, report_doubts, summary_line
from viewshed.cli._stream import Estimated, estimated, named_sweeps
from viewshed.cli.estimate import Files, Method

if TYPE_CHECKING:
    from viewshed.view import PackedFrame

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
    history: HistorySweeps = 0,
    every: Every = 1,
    sweeps: MostSweeps = None,
) -> None:
    """Write a page with a map and a timeline of what each sweep could see, for any browser, with no network.

    A file that cannot be read costs one line on standard error and does not stop the others; the exit code is then 2.

    Example: viewshed view drive.mcap --html run.html --every 5
    """
    from viewshed.estimators.temporal import SweepBuffer, TemporalEstimator
    from viewshed.view import write_page

    if html is None:
        raise ValueError("name the page to write: --html run.html")
    reading = Reading(sensor, format, file_frame, height, attitude, origin, ring, vehicle_yaw)
    estimator = NetworkOptions(weights, passes, seed).estimator(method, options.parse_grid(grid), target)
    if history:
        estimator = TemporalEstimator(estimator, SweepBuffer(history))
    jobs = list(options.chosen(files or [], index))
    places = [file for file, _ in jobs]
    refuse_inputs([html], places)
    failures = Failures()
    named = named_sweeps(reading, jobs, output_names(places), failures)
    taken = islice(named, 0, None if sweeps is None else every * sweeps, every)
    title = f"{places[0].name or places[0]}{f' and {len(places) - 1} more' if len(places) > 1 else ''}"
    size = write_page(html, _packed(estimated(taken, estimator, failures)), title)
    typer.echo(f"{html}: {size / 1e6:.2f} MB")
    if failures.count:
        raise typer.Exit(2)


def _packed(seen: Iterator[Estimated]) -> Iterator[PackedFrame]:
    """Yield each sweep as the page holds it, and print its line."""
    from viewshed.view import Frame, pack_frame

    for each in seen:
        report_doubts(each.leveled, each.named.name)
        frame = pack_frame(Frame(each.named.name, each.estimate, each.leveled))
        line = summary_line(each.estimate, each.elapsed_ms)
        typer.echo(f"{each.named.name}: {line}; {len(frame.data) / 1e3:.1f} kB")
        yield frame
