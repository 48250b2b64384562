"""``viewshed export``: write a field of view in formats of other programs."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from viewshed.cli import _options as options
from viewshed.cli._options import DEFAULT_READING, Device, NetworkOptions, Passes, Reading, Seed, Weights
from viewshed.cli._outputs import refuse_inputs, report_doubts, stem_of, stem_of_result
from viewshed.cli._places import place_of_result
from viewshed.cli._stream import one_sweep


def export(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A sweep, or an estimate's .npz.")],
    to: Annotated[
        str,
        typer.Option(
            help="geojson, geotiff, nav2_map, nav2_mask, occupancy_grid, grid_map, osi, cpm, cpm_uper (bytes) or npz."
        ),
    ] = "geojson",
    sectors: Annotated[int, typer.Option(help="For cpm: number of sectors of the view.")] = 16,
    method: Annotated[str | None, typer.Option(help="Method, if FILE is a sweep; shadow_map if not given.")] = None,
    grid: options.GridOfWeights = None,
    reading: Reading = DEFAULT_READING,
    index: options.Index = None,
    crs: options.Crs = None,
    number: options.Number = 0,
    target: options.TargetOfWeights = None,
    weights: Weights = None,
    passes: Passes = None,
    seed: Seed = None,
    device: Device = "cpu",
    out: Annotated[
        str | None, typer.Option(help="Folder of the result, or its file NAME.ENDING; the current folder if not given.")
    ] = None,
) -> None:
    """Write the field of view for GIS, nav2, ROS, OSI or ETSI CPM.

    Example: viewshed export sweep.bin --to cpm --sectors 16
    """
    from viewshed._files import write_atomic
    from viewshed.io.export import EXPORTERS, Exporter, format_of_content, read_npz, to_cpm
    from viewshed.io.export.cpm import STATES, UPER_SUFFIX, to_cpm_uper
    from viewshed.io.export.crs import crs_named
    from viewshed.preprocess.leveling import level

    # Not in EXPORTERS, because the message needs a position on earth.
    message = Exporter(partial(to_cpm_uper, sectors=sectors), UPER_SUFFIX, b"", STATES, has_crs=True)
    exporters = EXPORTERS | {"cpm_uper": message}
    if to not in exporters:
        raise ValueError(f"to must be one of {', '.join(exporters)}, got {to!r}")
    exporter = exporters[to]
    exporter.check_crs(crs)
    stem = stem_of(file.name) or "viewshed"
    estimator = None
    if not _is_estimate(file):
        network = NetworkOptions(weights, passes, seed, device=device)
        estimator = network.estimator(method, None if grid is None else options.parse_grid(grid), target)
        stem = stem_of_result(stem, estimator.name)
    elif (
        {method, grid, index, target, weights, passes, seed} != {None}
        or (number, device) != (0, "cpu")
        or (reading != DEFAULT_READING)
    ):
        raise ValueError(f"{file} is an estimate: leave out all but --to, --sectors, --crs, --out, or name its sweep")
    place = place_of_result(out, stem + exporter.suffix)
    refuse_inputs([place], [file])
    existing = format_of_content(place)
    if existing not in {"", to}:
        raise ValueError(
            f"--out must not replace an export of another format, got {place}, which is {existing}; choose another name"
            f" for {to}, or remove it"
        )
    if estimator is None:
        estimate = read_npz(file)
    else:
        sweep = one_sweep(replace(reading, crs=crs), file, index, number)
        if crs is not None:
            crs_named(crs, sweep.world_from_sensor)
        leveled = level(sweep, estimator.grid)
        report_doubts(leveled, file.name)
        estimate = estimator.estimate(leveled)
    if to == "cpm":
        exporter = replace(exporter, function=partial(to_cpm, sectors=sectors))
    files = exporter.files(estimate, place.name, crs)
    for name, content in files.items():
        write_atomic(place.with_name(name), content)
    typer.echo(f"{place}: {sum(map(len, files.values()))} bytes. {exporter.states}")


def _is_estimate(file: Path) -> bool:
    """Return whether a file is an NPZ of an estimate; any other file is read as a sweep."""
    import zipfile

    from viewshed._files import DAMAGED

    if file.suffix == ".npz":
        with suppress(*DAMAGED), zipfile.ZipFile(file) as archive:
            return "visible_prob.npy" in archive.namelist()
    return False
