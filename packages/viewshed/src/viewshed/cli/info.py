"""``viewshed info``: print the content and properties of a file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from viewshed.cli import _options as options
from viewshed.cli._options import DEFAULT_READING, Reading
from viewshed.cli._stream import one_sweep
from viewshed.cli._terminal import complain

if TYPE_CHECKING:
    from viewshed.preprocess.leveling import LeveledSweep
    from viewshed.sweep import Sweep


def info(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A sweep, in any known format.")],
    grid: options.GridName = "road",
    reading: Reading = DEFAULT_READING,
    index: options.Index = None,
    number: options.Number = 0,
) -> None:
    """Print what a file holds: points, rings, sensor, ground, coverage.

    Example: viewshed info sweep.pcd.bin
    """
    from viewshed.preprocess.leveling import level
    from viewshed.preprocess.plausibility import doubts

    sweep = one_sweep(reading, file, index, number)
    leveled = level(sweep, options.parse_grid(grid))
    for doubt in doubts(leveled):
        complain(f"{file.name}: warning: {doubt}")
    for name, value in (*_points(sweep, leveled), *_beams(sweep), *_ground(sweep, leveled)):
        typer.echo(f"{name + ':':<12} {value}")


def _points(sweep: Sweep, leveled: LeveledSweep) -> Iterator[tuple[str, str]]:
    import numpy as np

    yield "points", f"{len(sweep)}, {sweep.dropped_points} more were not finite"
    if len(sweep) == 0:
        return
    range_m = np.linalg.norm(sweep.points, axis=1)
    quantiles = " / ".join(f"{value:.1f}" for value in np.quantile(range_m, [0.01, 0.5, 0.99, 1.0]))
    yield "range", f"{quantiles} m (quantiles of 1, 50, 99 and 100 %)"
    yield "left out", f"{1 - len(leveled.points) / len(sweep):.1%}: null returns and returns of the vehicle itself"
    degrees = np.unique(np.floor(np.rad2deg(leveled.azimuth))).size
    yield "azimuth", f"returns in {degrees} of 360 degrees"


def _beams(sweep: Sweep) -> Iterator[tuple[str, str]]:
    from viewshed.preprocess.ring_recovery import recover_rings
    from viewshed.preprocess.sensor_identification import infer_sensor

    if sweep.planar is not None:
        yield "plane", f"one; {len(sweep.planar.open_azimuth)} beams met nothing up to {sweep.planar.max_range_m:g} m"
        return
    model = sweep.model
    if model is None and sweep.infer_sensor:
        model, score = infer_sensor(sweep.points, sweep.ring)
        name = f"{model.name} (inferred, score {score:.2f})" if model else f"not known (best score {score:.2f})"
    else:
        name = f"{model.name} (given)" if model else "none given, not inferred"
    yield "sensor", name
    beams = recover_rings(sweep, model)
    yield "rings", f"{beams.rings}, from {beams.source}; {beams.placed_share:.1%} of the points assigned to a ring"
    yield "columns", f"{beams.columns}; {beams.alone_share:.1%} of the points alone in their pixel"


def _ground(sweep: Sweep, leveled: LeveledSweep) -> Iterator[tuple[str, str]]:
    import numpy as np

    from viewshed.preprocess.reach import reach_of_sweep

    tilt = np.rad2deg(np.arccos(min(leveled.level_from_sensor.rotation[2, 2], 1.0)))
    source = "given" if sweep.known_attitude is not None else "estimated"
    yield "tilt", f"{tilt:.1f}° ({source})"
    ground = leveled.ground
    source = (
        "given" if sweep.sensor_height_m is not None else "estimated" if ground.support else "assumed: no ground seen"
    )
    yield "height", f"sensor {leveled.sensor_height_m:.2f} m above the ground ({source})"
    yield "reach", f"{reach_of_sweep(leveled):.0f} m: how far a dark target is seen"
    slope = np.rad2deg(np.arctan(np.hypot(ground.plane[0], ground.plane[1])))
    yield (
        "ground",
        f"slope {slope:.1f}°, {ground.support:.0%} of the near ground on one plane, {ground.seen.mean():.0%} seen",
    )
    yield (
        "pose",
        "none" if sweep.world_from_sensor is None else f"world {sweep.world_from_sensor.translation.round(2).tolist()}",
    )
