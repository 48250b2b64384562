"""``viewshed label``: label a benign recording with what each sweep could have seen; write a data set."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

from viewshed.cli import _options as options
from viewshed.cli._options import AUTO
from viewshed_lab.cli._data_sets import build_with_bar, data_set_line

if TYPE_CHECKING:
    from viewshed_lab.data.labeling import LabelRules, Origin


def label(
    source: Annotated[
        str | None, typer.Argument(metavar="SRC", help="A recording or a data set; not needed with --index.")
    ] = None,
    out: Annotated[str, typer.Option(help="Folder or URI of the data set of labels.")] = "labels",
    definition: Annotated[
        str,
        typer.Option(
            help="Definition of visible: probe (enough beams on the target), farthest or first_blocker (by others)."
        ),
    ] = "probe",
    target: options.TargetName = "car",
    neighbors: Annotated[
        int, typer.Option(min=0, help="Number of sweeps before and after to use, where poses exist; 0 for none.")
    ] = 20,
    grid: Annotated[
        str | None, typer.Option(help="Grid around the sensor, as for estimate. If not given, that of SRC, or road.")
    ] = None,
    index: options.Index = None,
    kind: Annotated[
        str, typer.Option(help="Kind of SRC: auto, archive (a data set of viewshed), nuscenes, kitti, carla, …")
    ] = AUTO,
    sensor: options.SensorName = AUTO,
    between: Annotated[bool, typer.Option("--between", help="Also label sweeps between keyframes.")] = False,
    workers: options.Workers = None,
    engine: options.EngineName = "local",
) -> None:
    """Label benign sweeps with what the sensor could have seen.

    Uses the sweeps before and after where poses exist. A sweep that cannot be read is skipped with one line on standard
    error; the exit code is then 2. A stopped run resumes. The output is the same, byte for byte, for any --workers.

    Example: viewshed label /data/nuscenes --definition probe --out labels
    """
    from viewshed_lab._jobs import engine_named
    from viewshed_lab.data.archive.storage import Storage
    from viewshed_lab.data.labeling import Origin
    from viewshed_lab.data.labeling import label as run

    if (source is None) == (index is None):
        raise ValueError("name either a recording SRC or an --index")
    place = (str(source), kind) if index is None else (str(index), "index")
    origin = Origin(*place, sensor, between)
    rules = _rules(origin, grid, definition, target, neighbors)
    make = partial(run, origin, rules, Storage.of(out), engine_named(engine, workers))
    archive, problems = build_with_bar("label", None, make)
    typer.echo(data_set_line(archive, f"{len(archive)} labels in {len(archive.scenes)} scene(s)"))
    if problems:
        raise typer.Exit(2)


def _rules(origin: Origin, grid: str | None, definition: str, target: str, neighbors: int) -> LabelRules:
    from typing import cast

    from viewshed_lab.data.archive.archive import ArchiveSource
    from viewshed_lab.data.labeling import LabelRules
    from viewshed_lab.data.labeling.labeler import Definition
    from viewshed_lab.data.labeling.run import opened

    source = opened(origin)
    if grid is None and isinstance(source, ArchiveSource):
        cells = source.archive.manifest.layout.grid
    else:
        cells = options.parse_grid(grid or "road")
    return LabelRules(cells, cast(Definition, definition), target, neighbors)
