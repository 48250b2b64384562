"""Options that several commands share, and what they mean.

Options of the estimators that are networks.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from viewshed.estimators import EstimatorFactory
    from viewshed.fov.estimate import FovEstimate, FovEstimator
    from viewshed.fov.visibility import Target
    from viewshed.grid import BevGrid
    from viewshed.io import IndexEntry
    from viewshed.sweep import Sweep


GridName = Annotated[
    str, typer.Option("--grid", help="road, indoor, paper, paper_indoor, or CELLSxHALF_EXTENT_M (256x64).")
]

SensorName = Annotated[str, typer.Option("--sensor", help="auto, none, a beam table's name (hdl32e), or a TOML file.")]

FormatName = Annotated[str, typer.Option("--format", help="File format; auto knows it by content and name.")]

FrameName = Annotated[str | None, typer.Option("--file-frame", help="Axes of the file: sensor, nuscenes, carla, …")]

Height = Annotated[float | None, typer.Option("--height", help="Sensor height above the ground in meters, if known.")]

Attitude = Annotated[str | None, typer.Option("--attitude", help="Unit quaternion W,X,Y,Z of level_from_sensor.")]

Index = Annotated[Path | None, typer.Option("--index", help="JSON index of sweeps: frames, heights, poses.")]

TargetName = Annotated[str, typer.Option("--target", help="car or pedestrian.")]

Profile = Annotated[str, typer.Option("--profile", help="sound, or paper: the published parameters.")]

AUTO = "auto"

BAD_INPUTS = (ValueError, OSError, ImportError, MemoryError)
"""What the library raises for input that it cannot use; anything else is a fault of ours and may trace."""

_ROOM_M = 20.0

_BAGS = (".bag", ".mcap", ".db3")


@dataclass(frozen=True, slots=True)
class Reading:
    """How files are read: what the options say about them."""

    sensor: str = AUTO
    format: str = AUTO
    file_frame: str | None = None
    height_m: float | None = None
    attitude: str | None = None

    def sweep(self, path: Path, entry: IndexEntry | None = None) -> Sweep:
        """Return the first sweep of :meth:`sweeps`."""
        return next(self.sweeps(path, entry))

    def sweeps(self, path: Path, entry: IndexEntry | None = None) -> Iterator[Sweep]:
        """Yield the sweeps in a file, or the one of an index's entry, with the sensor that was asked for."""
        from viewshed.sensors import lidar_model

        model = None if self.sensor in {AUTO, "none"} else lidar_model(self.sensor)
        for sweep in self._read(path) if entry is None else self._indexed(entry):
            if model is not None:
                yield sweep.replace(model=model)
            else:
                yield with_inferred_sensor(sweep) if self.sensor == AUTO else sweep

    def _read(self, path: Path) -> Iterator[Sweep]:
        from viewshed.io import read_sweeps

        if self.format == AUTO and (path.is_dir() or path.suffix.lower() in _BAGS):
            return self._recorded(path)
        return read_sweeps(
            path, format=self.format, file_frame=self.file_frame,
            sensor_height_m=self.height_m, attitude=parse_numbers("attitude", self.attitude, 4),
        )  # fmt: skip

    def _recorded(self, path: Path) -> Iterator[Sweep]:
        """Yield the sweeps of a recording; what cannot be read costs one line each and an error at the end."""
        from viewshed.datasets.archive.archive import ArchiveSource, is_archive
        from viewshed.datasets.recordings import open_source
        from viewshed.datasets.recordings.source import each_sweep

        if self.file_frame is not None:
            raise ValueError("--file-frame does not go with a recording, which knows its own axes")
        problems: list[str] = []
        found = 0
        source = ArchiveSource.open(path) if is_archive(path) else open_source(path)
        for _, sweep in each_sweep(source, on_damage=lambda scene, line: _told(problems, line)):
            found += 1
            yield self._overridden(sweep)
        if problems or not found:
            raise ValueError(f"{path}: {found} sweeps read, {len(problems)} problems")

    def _indexed(self, entry: IndexEntry) -> Iterator[Sweep]:
        from viewshed.io import read_indexed

        if self.format != AUTO or self.file_frame is not None:
            raise ValueError("--format and --file-frame do not go with --index, which names the axes of its files")
        yield self._overridden(read_indexed(entry))

    def _overridden(self, sweep: Sweep) -> Sweep:
        """Return the sweep with the height and attitude that the options give."""
        given = {"sensor_height_m": self.height_m, "attitude": parse_numbers("attitude", self.attitude, 4)}
        return sweep.replace(**{name: value for name, value in given.items() if value is not None})


def _told(problems: list[str], line: str) -> None:
    problems.append(line)
    typer.echo(f"viewshed: {line}", err=True)


def with_inferred_sensor(sweep: Sweep) -> Sweep:
    """Return the sweep with the beam table that explains it, or as it is where none does."""
    from viewshed.preprocess.sensor_identification import identify_sensor

    model = identify_sensor(sweep).model
    return sweep if model is sweep.model else sweep.replace(model=model)


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
    from viewshed.grid import GRIDS, BevGrid

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
    from viewshed.fov.visibility import TARGETS

    if name not in TARGETS:
        raise ValueError(f"target must be one of {', '.join(TARGETS)}, got {name!r}")
    return TARGETS[name]


def make_estimator(method: str | None, grid: BevGrid, target: str, profile: str = "sound") -> FovEstimator:
    """Return the estimator called ``method`` in a profile, for a target; None is the profile's main one."""
    from dataclasses import replace

    table = estimators_of(profile, grid)
    main = "shadow_map" if profile == "sound" else "label"
    name = main if method is None else method
    name = name if name in table else f"{profile}_{name}"
    if name not in table:
        raise ValueError(f"method must be one of {', '.join(table)}, got {method!r}")
    return replace(table[name](grid), target=parse_target(target))  # type: ignore[type-var]


def estimators_of(profile: str, grid: BevGrid) -> dict[str, EstimatorFactory]:
    """Return the estimators of a profile; the paper's own depend on whether the grid is a room's or a road's."""
    from viewshed.estimators import ESTIMATORS, PAPER_ESTIMATORS, PAPER_INDOOR_ESTIMATORS

    papers = PAPER_INDOOR_ESTIMATORS if grid.half_extent_m <= _ROOM_M else PAPER_ESTIMATORS
    tables = {"sound": ESTIMATORS, "paper": papers}
    if profile not in tables:
        raise ValueError(f"profile must be sound or paper, got {profile!r}")
    return tables[profile]


def parse_threshold(threshold: float | None, profile: str) -> float:
    """Return the probability from which a cell counts as visible; None is the profile's own."""
    from viewshed.estimators import PAPER_THRESHOLD
    from viewshed.fov.estimate import THRESHOLD

    if threshold is None:
        return THRESHOLD if profile == "sound" else PAPER_THRESHOLD
    if not 0 < threshold <= 1:
        raise ValueError(f"threshold must lie in (0, 1], got {threshold}")
    return threshold


def timed(estimator: FovEstimator, sweep: Sweep) -> tuple[FovEstimate, float]:
    """Return the estimate and the milliseconds that it took."""
    start = time.perf_counter()
    estimate = estimator.estimate(sweep)
    return estimate, 1e3 * (time.perf_counter() - start)


def one_line(error: BaseException) -> str:
    r"""Return an error's message without line breaks.

    >>> one_line(ValueError("a\nb"))
    'a b'
    """
    return " ".join(str(error).split()) or type(error).__name__


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
        entry = entries.get(Path(os.path.realpath(file)))
        if entry is None:
            raise ValueError(f"{file} is not in the index {index}")
        yield file, entry


Weights = Annotated[
    str | None,
    typer.Option("--weights", help="Network of unet, mcd and viewnet: a file, or the name of shipped weights."),
]

Passes = Annotated[int | None, typer.Option("--passes", help="Passes of mcd; 20 if not given.")]

Seed = Annotated[int | None, typer.Option("--seed", help="Seed of mcd's dropout masks; 0 if not given.")]

PastSweeps = Annotated[
    int,
    typer.Option(
        "--past", min=0, max=20,
        help="Earlier sweeps of a recording that help viewnet and shadow_map, a second or more apart; 5 do well.",
    ),
]  # fmt: skip

Wary = Annotated[
    bool,
    typer.Option("--wary", help="With --past: claim only what an earlier sweep would have seen as well."),
]

Device = Annotated[str, typer.Option("--device", help="Where unet, mcd and viewnet run: cpu or cuda.")]

Sure = Annotated[
    float | None,
    typer.Option(
        "--sure",
        help="Of unet, mcd and viewnet: claim from this probability, deny up to 1 less it, leave the rest unknown.",
    ),
]


_ENGINES = {"cpu": "onnxruntime", "cuda": "cuda"}

OURS = "viewnet"
"""The method that is taken where none is asked for and weights for it are shipped."""


def _is_shipped(method: str, grid: BevGrid, target: str) -> bool:
    from viewshed.networks.weights import default_name

    try:
        return bool(default_name(method, grid, target))
    except ValueError:
        return False


@dataclass(frozen=True, slots=True)
class Network:
    """What the options say about the network."""

    weights: str | None = None
    passes: int | None = None
    seed: int | None = None
    sure: float | None = None
    device: str = "cpu"

    def __post_init__(self) -> None:
        if self.device not in _ENGINES:
            raise ValueError(f"device must be one of {', '.join(_ENGINES)}, got {self.device!r}")

    def estimator(self, method: str | None, grid: BevGrid, target: str, profile: str = "sound") -> FovEstimator:
        """Return the estimator called ``method``, a network or not; None is the best that there is for a profile.

        That is our network on the grids and for the targets that it is shipped for, else the profile's own.
        """
        from viewshed.estimators.unet import LEARNED, learned

        if method is None and profile == "sound" and _is_shipped(OURS, grid, target):
            method = OURS
        if method in LEARNED:
            engine = _ENGINES[self.device]
            made = learned(method, grid, target, self.weights, self.passes, self.seed or 0, engine=engine)
            return made if self.sure is None else made.with_abstention(self.sure)
        if self.sure is not None:
            raise ValueError(f"--sure goes with --method unet, mcd or viewnet, got method {method!r}")
        if self != Network():
            raise ValueError(
                f"--weights, --passes, --seed and --device go with --method unet, mcd or viewnet, got method {method!r}"
            )
        table = estimators_of(profile, grid)
        if method is not None and not {method, f"{profile}_{method}"} & set(table):
            raise ValueError(f"method must be one of {', '.join([*table, *LEARNED])}, got {method!r}")
        return make_estimator(method, grid, target, profile)

    def remembering(self, estimator: FovEstimator, sweeps: int, wary: bool = False) -> FovEstimator:
        """Return the estimator with so many earlier sweeps to help it, wary or not; as it is for none.

        Raises:
            ValueError: earlier sweeps do not help it.
        """
        from viewshed.estimators.temporal import SweepBuffer, TemporalEstimator
        from viewshed.estimators.unet import uses_history

        if sweeps == 0 and wary:
            raise ValueError("--wary goes with --past 1 or more: it claims what earlier sweeps support")
        if sweeps == 0:
            return estimator
        if uses_history(estimator):
            return TemporalEstimator(estimator, SweepBuffer(sweeps), wary)
        raise ValueError("--past goes with --method viewnet or shadow_map, whose estimates earlier sweeps help")

    def threshold(self, given: float | None, estimator: FovEstimator, profile: str) -> float:
        """Return the probability from which a cell counts as visible; a network has its own."""
        from viewshed.estimators.unet import UnetEstimator

        if given is not None and self.sure is not None and given < self.sure:
            raise ValueError(f"--threshold must be at least --sure {self.sure:g}, got {given:g}; leave one of them out")
        own = estimator.decision_threshold if given is None and isinstance(estimator, UnetEstimator) else given
        return parse_threshold(own, profile)
