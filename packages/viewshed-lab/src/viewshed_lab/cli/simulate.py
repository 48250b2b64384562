"""``viewshed simulate`` and ``viewshed dataset``: make and inspect data sets."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from viewshed.cli import _options as options
from viewshed_lab.cli._data_sets import build_with_bar, data_set_line

if TYPE_CHECKING:
    from viewshed_lab.data import Archive
    from viewshed_lab.data.presets import Preset


dataset_app = typer.Typer(help="Inspect, verify or make a data set.")

Place = Annotated[str, typer.Argument(metavar="PLACE", help="Folder or URI of the data set.")]


def simulate(
    preset: Annotated[
        str,
        typer.Argument(
            metavar="PRESET",
            help="carla, nuscenes, ugv, each also as NAME-small; roads, rooms, drives; or release (published).",
        ),
    ],
    out: Annotated[
        str | None, typer.Option(help="Folder or URI (s3://bucket/data); named as the preset if not given.")
    ] = None,
    sweeps: Annotated[int | None, typer.Option(help="Number of sweeps; the preset's if not given.")] = None,
    workers: options.Workers = None,
    engine: options.EngineName = "local",
    seed: Annotated[int | None, typer.Option(help="Random seed; the preset's if not given.")] = None,
    grid: Annotated[
        str | None, typer.Option(help="Grid of the truth: road, indoor, …, or 256x64: 256 cells a side, out to 64 m.")
    ] = None,
    preview: Annotated[bool, typer.Option("--preview", help="Only draw some samples, to PRESET.png or --out.")] = False,
) -> None:
    """Simulate a data set with exact truth.

    A stopped run resumes. The output is the same, byte for byte, for any --workers.

    Example: viewshed simulate nuscenes-small --out sweeps
    """
    from viewshed_lab._jobs import engine_named
    from viewshed_lab.data.archive.storage import Storage
    from viewshed_lab.data.presets import preset_named
    from viewshed_lab.data.simulated import simulate as run

    runner = engine_named(engine, workers)
    chosen = _configured(preset_named(preset), sweeps, seed, grid)
    if preview:
        _preview(chosen, out)
        return
    store = Storage.of(out or preset)
    archive, _ = build_with_bar(chosen.name, chosen.sweeps, partial(run, chosen, store, runner))
    typer.echo(_summary(archive))
    if chosen == preset_named("release"):
        _publish(archive)


def _publish(archive: Archive) -> None:
    """Write the data card of the published data set, and check its shards against the recorded hashes."""
    from viewshed_lab.data import release

    archive.store.write(release.CARD, release.card(archive).encode())
    other = release.other_shards(archive)
    if other:
        made_with = ", ".join(f"{name} {version}" for name, version in release.published().made_with.items())
        raise ValueError(
            f"{len(other)} shards differ from the published ones, which were made with"
            f" {made_with}: {', '.join(other[:3])}"
        )
    typer.echo(f"all {len(archive.shards)} shards are identical to the published ones; data card: {release.CARD}")


@dataset_app.callback()
def dataset() -> None:
    """Inspect, verify or make a data set."""


@dataset_app.command()
def info(place: Place) -> None:
    """Show what a data set contains and how it was made.

    Example: viewshed dataset info sweeps
    """
    from viewshed_lab.data import Archive

    archive = Archive.open(place)
    typer.echo(_summary(archive))
    recipe, grid = archive.manifest.recipe, archive.manifest.layout.grid
    typer.echo(f"made by: {', '.join(f'{key} {recipe[key]}' for key in recipe if key not in ('config', 'targets'))}")
    typer.echo(f"code:    viewshed {archive.manifest.code.get('version')}")
    typer.echo(f"grid:    {grid.cells} × {grid.cells} cells of {grid.cell_m:g} m")
    typer.echo(f"truth:   {', '.join((*archive.manifest.layout.targets, *archive.manifest.layout.definitions))}")
    for split in archive.splits:
        part = archive.split(split)
        typer.echo(f"split:   {split}, {len(part)} sweeps in {len(part.scenes)} scene(s)")


@dataset_app.command()
def verify(place: Place) -> None:
    """Compare every file of a data set with its checksum.

    The exit code is 2 if one is damaged.

    Example: viewshed dataset verify sweeps
    """
    from viewshed_lab.data import Archive

    archive, damaged = Archive.open(place), 0
    for _, problem in archive.verify():
        if problem is not None:
            damaged += 1
            typer.echo(problem)
    if damaged:
        raise ValueError(f"{damaged} of {len(archive.shards)} shards of {archive.store.place} are damaged")
    typer.echo(f"{len(archive.shards)} shards, all checksums match")


@dataset_app.command()
def wild(
    set_name: Annotated[
        str, typer.Argument(metavar="SET", help="own, training, learning (roads) or development; not sealed.")
    ],
    domain: Annotated[str, typer.Argument(metavar="GRID", help="road or indoor.")],
    out: Annotated[str | None, typer.Option(help="Folder or URI; SET-GRID if not given.")] = None,
    given: Annotated[
        str,
        typer.Option(
            "--known", help="What sweeps tell about their sensor, in turn: table (its beams), rings, nothing."
        ),
    ] = "rings,nothing",
    scenes: Annotated[
        int | None, typer.Option(min=1, help="Only the first scenes, this number; all if not given.")
    ] = None,
    workers: options.Workers = None,
) -> None:
    """Make a set of unusual worlds, sensors and mountings.

    A stopped run resumes. The output is the same, byte for byte, for any --workers.

    Example: viewshed dataset wild training road --out wild-road
    """
    from viewshed_lab._jobs import LocalEngine
    from viewshed_lab.data.archive.storage import Storage
    from viewshed_lab.data.wild import make_wild_archive

    store = Storage.of(out or f"{set_name}-{domain}")
    names = tuple(given.split(","))
    archive = make_wild_archive(set_name, domain, store, LocalEngine(workers), given=names, scenes=scenes)
    typer.echo(_summary(archive))


def _configured(preset: Preset, sweeps: int | None, seed: int | None, grid: str | None) -> Preset:
    from dataclasses import replace

    if sweeps is not None:
        preset = preset.scaled(sweeps)
    if seed is not None:
        preset = replace(preset, seed=seed)
    if grid is not None:
        parsed = options.parse_grid(grid)
        preset = replace(preset, grid_cells=parsed.cells, grid_half_extent_m=float(parsed.half_extent_m))
    return preset


def _preview(preset: Preset, out: str | None) -> None:
    from viewshed._files import write_atomic
    from viewshed_lab.studies.preview import preview_png

    path = Path(out or f"{preset.name}.png")
    write_atomic(path, preview_png(preset.name, preset.seed))
    typer.echo(f"Look at {path.resolve()}")


def _summary(archive: Archive) -> str:
    return data_set_line(archive, f"{len(archive)} sweeps in {len(archive.scenes)} scene(s)")
