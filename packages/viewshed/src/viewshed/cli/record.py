"""``viewshed record``: a simulated drive, or any recording, as a bag with what could be seen."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from viewshed._extras import plugin
from viewshed.cli._options import DEFAULT_READING, NO_OBJECTS, ObjectOptions, Reading
from viewshed.cli._outputs import Failures, output_names
from viewshed.cli._places import chosen_files
from viewshed.cli._profile import DEFAULT_PIPELINE, PipelineOptions, at_rate
from viewshed.cli._record import PendingSweep, SchemaNames, run_recorded
from viewshed.cli._stream import named_sweeps
from viewshed.cli.replay import DEFAULT_PERIOD_S

if TYPE_CHECKING:
    from viewshed.recordings.write.moment import DriveTruth
    from viewshed.sweep import Sweep

SIMULATED = "sim"
"""Argument that selects a simulated drive instead of files."""


def record(
    ctx: typer.Context,
    files: Annotated[
        list[Path], typer.Argument(metavar="sim|SRC...", help="sim for a simulated drive, or recordings and files.")
    ],
    to: Annotated[Path, typer.Option("--to", help="Bag to write: NAME.mcap, NAME.bag (ROS 1), or a folder (ROS 2).")],
    schemas: SchemaNames = "ros",
    reading: Reading = DEFAULT_READING,
    running: PipelineOptions = DEFAULT_PIPELINE,
    object_options: ObjectOptions = NO_OBJECTS,
    sweeps: Annotated[int | None, typer.Option("--sweeps", min=1, help="End after this number of sweeps.")] = None,
    preset: Annotated[
        str, typer.Option(help="For sim: preset of sensors and heights: drives, nuscenes, ugv, …")
    ] = "drives",
    world: Annotated[
        str | None, typer.Option(help="For sim: world, such as street or junction; the preset's first if not given.")
    ] = None,
    seconds: Annotated[float, typer.Option(help="For sim: duration of the drive in seconds.")] = 10.0,
    hz: Annotated[float, typer.Option(help="For sim: sweeps per second of each agent.")] = 10.0,
    agents: Annotated[int, typer.Option(help="For sim: number of vehicles with a LiDAR.")] = 1,
    seed: Annotated[int | None, typer.Option(help="For sim: random seed; the preset's if not given.")] = None,
) -> None:
    """Write a bag: a simulated drive, or sweeps and what they saw.

    A simulated drive includes its ground truth. As with viewshed replay --as-fast --to, every sweep is estimated, and
    the same command gives the same bytes.

    Example: viewshed record sim --world junction --agents 3 --seconds 5 --to drive.mcap
    """
    is_simulated = [str(file) for file in files] == [SIMULATED]
    if is_simulated and reading != DEFAULT_READING:
        raise ValueError("sim reads no file: leave out --topic, --poses and all other options for reading files")
    settings, failures = running.settings(ctx), Failures()
    stream: Iterator[tuple[Sweep, DriveTruth | None, str]]
    if is_simulated:
        drive = plugin("drives", "simulated", "viewshed record sim")
        made = drive(preset, seconds=seconds, hz=hz, agents=agents, world=world, seed=seed)
        stream = ((sweep, truth, "") for sweep, truth in made)
    else:
        jobs = list(chosen_files(files, None))
        names = output_names([file for file, _ in jobs])
        named = at_rate(named_sweeps(reading, jobs, names, failures, history=running.history), settings.rate_hz)
        stream = ((one.sweep, None, one.scene) for one in named)
    inputs = [] if is_simulated else files
    run_recorded(
        running, settings, _timed(islice(stream, sweeps)), object_options, failures, to=to, schemas=schemas,
        inputs=inputs, is_live=False,
    )  # fmt: skip


def _timed(stream: Iterable[tuple[Sweep, DriveTruth | None, str]]) -> Iterator[PendingSweep]:
    """Yield sweeps with their time since the first; sweeps without times are 0.1 s apart."""
    begin_ns = 0
    for count, (sweep, truth, scene) in enumerate(stream):
        begin_ns = sweep.t_ns or 0 if count == 0 else begin_ns
        due_s = count * DEFAULT_PERIOD_S if sweep.t_ns is None else (sweep.t_ns - begin_ns) / 1e9
        yield PendingSweep(sweep.agent, due_s, sweep, truth, scene)
