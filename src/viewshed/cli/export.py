"""``viewshed export``: a field of view in other programs' formats."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from viewshed.cli import _options as options
from viewshed.cli._options import AS_THEY_ARE, Device, NetworkOptions, Passes, Reading, Seed, Weights
from viewshed.cli._outputs import refuse_inputs, report_doubts, stem_of


def export(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A sweep, or an estimate's .npz.")],
    to: Annotated[str, typer.Option(help="geojson, occupancy_grid, grid_map, osi, cpm or npz.")] = "geojson",
    sectors: Annotated[int, typer.Option(help="Sectors of a cpm region.")] = 16,
    method: Annotated[
        str | None, typer.Option(help="Estimator, where FILE is a sweep; as for estimate if not given.")
    ] = None,
    grid: options.GridName = "road",
    reading: Reading = AS_THEY_ARE,
    index: options.Index = None,
    target: options.TargetName = "car",
    weights: Weights = None,
    passes: Passes = None,
    seed: Seed = None,
    device: Device = "cpu",
    out: Annotated[
        Path | None, typer.Option(help="File, or a folder that exists; if not given, here, named after FILE.")
    ] = None,
) -> None:
    """Write the field of view as GeoJSON, ROS messages, OSI-style polygons or an ETSI CPM perception region.

    Example: viewshed export sweep.bin --to cpm --sectors 16
    """
    import json

    from viewshed._files import write_atomic
    from viewshed.io.export import EXPORTERS, read_npz, to_cpm
    from viewshed.preprocess.leveling import level

    if to not in EXPORTERS:
        raise ValueError(f"to must be one of {', '.join(EXPORTERS)}, got {to!r}")
    if _is_estimate(file):
        estimate = read_npz(file)
    else:
        estimator = NetworkOptions(weights, passes, seed, device=device).estimator(
            method, options.parse_grid(grid), target
        )
        leveled = level(reading.sweep(file, index), estimator.grid)
        report_doubts(leveled, file.name)
        estimate = estimator.estimate(leveled)
    content = json.dumps(to_cpm(estimate, sectors=sectors)).encode() if to == "cpm" else EXPORTERS[to].encode(estimate)
    name = stem_of(file.name) + EXPORTERS[to].suffix
    path_out = Path(name) if out is None else out / name if out.is_dir() else out
    refuse_inputs([path_out], [file])
    write_atomic(path_out, content)
    typer.echo(f"{path_out}: {len(content)} bytes. {EXPORTERS[to].states}")


def _is_estimate(file: Path) -> bool:
    """Whether a file is an NPZ with a field of view in it; anything else is read as a sweep."""
    import zipfile

    if file.suffix != ".npz" or not zipfile.is_zipfile(file):
        return False
    with zipfile.ZipFile(file) as archive:
        return "visible_prob.npy" in archive.namelist()
