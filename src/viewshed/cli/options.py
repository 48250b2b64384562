"""Options that several commands share, and what they mean."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from viewshed.bev import BevGrid
    from viewshed.estimate import FovEstimator
    from viewshed.io import IndexEntry
    from viewshed.sweep import Sweep
    from viewshed.visible import Target

GridName = Annotated[
    str, typer.Option("--grid", help="road, indoor, paper, paper_indoor, or CELLSxHALF_EXTENT_M (256x64).")
]
SensorName = Annotated[str, typer.Option("--sensor", help="auto, none, a beam table's name, or a TOML file.")]
FormatName = Annotated[str, typer.Option("--format", help="File format; auto knows it by content and name.")]
FrameName = Annotated[str | None, typer.Option("--file-frame", help="Axes of the file: sensor, nuscenes, carla, …")]
Height = Annotated[float | None, typer.Option("--height", help="Sensor height above the ground in metres, if known.")]
Attitude = Annotated[str | None, typer.Option("--attitude", help="Quaternion W,X,Y,Z of level_from_sensor, if known.")]
Index = Annotated[Path | None, typer.Option("--index", help="JSON index of sweeps: frames, heights, poses.")]
TargetName = Annotated[str, typer.Option("--target", help="car or pedestrian.")]
Profile = Annotated[str, typer.Option("--profile", help="sound, or paper: the published parameters.")]
AUTO = "auto"
AUTO_SCORE = 0.5


@dataclass(frozen=True, slots=True)
class Reading:
    """How files are read: what the options say about them."""

    sensor: str = AUTO
    format: str = AUTO
    file_frame: str | None = None
    height_m: float | None = None
    attitude: str | None = None

    def sweep(self, path: Path, entry: IndexEntry | None = None) -> Sweep:
        """Return the sweep in a file, or of an index's entry, with the sensor that was asked for."""
        from viewshed.io import read_indexed, read_sweep
        from viewshed.sensors import lidar_model

        if entry is not None:
            sweep = read_indexed(entry)
        else:
            sweep = read_sweep(
                path, format=self.format, file_frame=self.file_frame,
                sensor_height_m=self.height_m, attitude=parse_numbers("attitude", self.attitude, 4),
            )  # fmt: skip
        if self.sensor == "none":
            return sweep
        if self.sensor == AUTO:
            return with_inferred_sensor(sweep)
        return sweep.replace(model=lidar_model(self.sensor))


def with_inferred_sensor(sweep: Sweep) -> Sweep:
    """Return the sweep with the beam table that explains it, or as it is where none does."""
    from viewshed.beams import infer_sensor

    if sweep.model is not None:
        return sweep
    model, score = infer_sensor(sweep.points, sweep.ring)
    if (
        model is None
        or score < AUTO_SCORE
        or (sweep.ring is not None and int(sweep.ring.max(initial=0)) >= model.rings)
    ):
        return sweep
    return sweep.replace(model=model)


def parse_numbers(name: str, text: str | None, count: int) -> list[float] | None:
    """Return ``count`` numbers from text with commas, or None.

    >>> parse_numbers("attitude", "1,0,0,0", 4)
    [1.0, 0.0, 0.0, 0.0]
    """
    if text is None:
        return None
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError as error:
        raise ValueError(f"{name} must be {count} numbers with commas, got {text!r}") from error
    if len(numbers) != count:
        raise ValueError(f"{name} must be {count} numbers with commas, got {len(numbers)} in {text!r}")
    return numbers


def parse_grid(text: str) -> BevGrid:
    """Return the grid of a preset's name or of CELLSxHALF_EXTENT_M.

    >>> parse_grid("128x32").cell_m
    0.5
    """
    from viewshed.bev import GRIDS, BevGrid

    if text in GRIDS:
        return GRIDS[text]
    cells, cross, half = text.partition("x")
    try:
        if not cross:
            raise ValueError(text)
        count, extent = int(cells), float(half)
    except ValueError as error:
        raise ValueError(f"grid must be one of {', '.join(GRIDS)} or CELLSxHALF_EXTENT_M, got {text!r}") from error
    return BevGrid(count, extent)


def parse_target(name: str) -> Target:
    """Return the target called ``name``."""
    from viewshed.visible import TARGETS

    if name not in TARGETS:
        raise ValueError(f"target must be one of {', '.join(TARGETS)}, got {name!r}")
    return TARGETS[name]


def make_estimator(method: str, grid: BevGrid, target: str, profile: str = "sound") -> FovEstimator:
    """Return the estimator called ``method`` in a profile, for a target."""
    from dataclasses import replace

    from viewshed.estimators import ESTIMATORS, PAPER_ESTIMATORS

    tables = {"sound": ESTIMATORS, "paper": {**PAPER_ESTIMATORS}}
    if profile not in tables:
        raise ValueError(f"profile must be sound or paper, got {profile!r}")
    table = tables[profile]
    name = method if method in table else f"{profile}_{method}"
    if name not in table:
        raise ValueError(f"method must be one of {', '.join(table)}, got {method!r}")
    return replace(table[name](grid), target=parse_target(target))  # type: ignore[type-var]


def chosen(files: list[Path], index: Path | None) -> Iterator[tuple[Path, IndexEntry | None]]:
    """Yield each file with its entry in the index; without files, every sweep of the index."""
    if index is None:
        if not files:
            raise ValueError("name at least one FILE, or an --index")
        yield from ((file, None) for file in files)
        return
    from viewshed.io import read_index

    entries = {entry.file: entry for entry in read_index(index)}
    if not files:
        yield from ((file, entry) for file, entry in entries.items() if entry.points)
    for file in files:
        if file.resolve() not in entries:
            raise ValueError(f"{file} is not in the index {index}")
        yield file, entries[file.resolve()]
