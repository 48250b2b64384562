"""Options shared by several commands, and their effect: how files are read, which estimator is used."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast, get_type_hints

import typer
from typer.core import TyperCommand

from viewshed._extras import plugin
from viewshed.cli._terminal import complain, note, raise_if_interrupted

if TYPE_CHECKING:
    from viewshed.estimators import Estimator
    from viewshed.fov.visibility import Target
    from viewshed.grid import BevGrid
    from viewshed.io import IndexEntry
    from viewshed.objects.object_stream import ObjectStream
    from viewshed.pipeline.adversary import Adversary
    from viewshed.sweep import Sweep


_GRID_HELP = "Grid around the sensor: road, indoor, paper, paper_indoor, or 256x64: 256 cells a side, out to 64 m"

GridName = Annotated[str, typer.Option("--grid", help=f"{_GRID_HELP}.")]

GridOfWeights = Annotated[
    str | None, typer.Option("--grid", help=f"{_GRID_HELP}. If not given, that of --weights, or road.")
]

SensorName = Annotated[
    str,
    typer.Option("--sensor", help="The LiDAR: auto (from the points), none, a model (hdl32e), or a TOML beam table."),
]
FormatName = Annotated[str, typer.Option("--format", help="File format; auto detects it from content and name.")]
FrameName = Annotated[
    str | None,
    typer.Option("--file-frame", help="Axes of the file's points: sensor (x forward, y left), nuscenes, carla, …"),
]
Height = Annotated[float | None, typer.Option("--height", help="Sensor height above the ground in meters, if known.")]
Origin = Annotated[str | None, typer.Option("--origin", help="Sensor position in the file's frame, X,Y,Z in meters.")]
Topic = Annotated[str | None, typer.Option("--topic", help="Topic to read, if a bag has several with clouds or scans.")]
Poses = Annotated[
    Path | None,
    typer.Option("--poses", help="File of sweep poses: KITTI, TUM, or latitude and longitude (.pose files)."),
]
Crs = Annotated[
    str | None,
    typer.Option(
        "--crs", help="Coordinate reference system of the poses, or of the points with --origin, such as EPSG:25832."
    ),
]
Number = Annotated[
    int, typer.Option("--number", min=0, help="Which sweep of a file or recording with several, counted from 0.")
]
RingSource = Annotated[
    str,
    typer.Option("--ring", help="file: use the rings in the file, if it has any; none: recover them from the points."),
]
VehicleYaw = Annotated[
    float | None,
    typer.Option("--vehicle-yaw", help="Heading of the ego vehicle in the sensor's frame, in degrees, if known."),
]
Attitude = Annotated[
    str | None,
    typer.Option(
        "--attitude", help="Tilt of the sensor, if known: unit quaternion W,X,Y,Z that rotates its axes to level."
    ),
]
Index = Annotated[
    Path | None, typer.Option("--index", help="JSON file that lists sweeps with their axes, heights and poses.")
]
_TARGET_HELP = "Object whose visibility is estimated: car or pedestrian"
TargetName = Annotated[str, typer.Option("--target", help=f"{_TARGET_HELP}.")]
TargetOfWeights = Annotated[
    str | None, typer.Option("--target", help=f"{_TARGET_HELP}. If not given, that of --weights, or car.")
]
Parameters = Annotated[
    str, typer.Option("--parameters", help="Parameters of the method: sound (viewshed's own) or paper (as published).")
]
Sources = Annotated[list[str], typer.Argument(metavar="SRC...", help="A data set, recordings, or files.")]
Split = Annotated[str | None, typer.Option(help="Only this split of a data set.")]
Workers = Annotated[int | None, typer.Option(help="Number of processes; one per core if not given.")]
EngineName = Annotated[str, typer.Option(help="Where jobs run: local, or ray (a cluster).")]
AUTO = "auto"

NO_SENSOR = "none"
"""No sensor is given, and none is inferred from the points."""

RING_SOURCES = ("file", "none")

PARAMETERS = ("sound", "paper")

_NO_OPTION = "no option"

_FAR_M = 10_000.0
"""An origin farther than this is in map coordinates."""

_IN_FLOAT64 = (".pcd", ".ply", ".npy", ".las", ".laz", ".csv", ".xyz", ".asc")
"""Files whose coordinates may be float64."""

_COARSE_M = 0.02
"""A note is printed if the float32 resolution of the points is coarser than this."""


@dataclass(frozen=True, slots=True)
class Reading:
    """Options for reading files; see :func:`with_groups`."""

    sensor: SensorName = AUTO
    format: FormatName = AUTO
    file_frame: FrameName = None
    height_m: Height = None
    attitude: Attitude = None
    origin: Origin = None
    ring: RingSource = "file"
    vehicle_yaw_deg: VehicleYaw = None
    topic: Topic = None
    poses: Poses = None
    crs: str | None = field(default=None, metadata={_NO_OPTION: True})

    def __post_init__(self) -> None:
        if self.ring not in RING_SOURCES:
            raise ValueError(f"ring must be one of {', '.join(RING_SOURCES)}, got {self.ring!r}")

    def sweeps(self, path: Path) -> Iterator[Sweep]:
        """Yield the sweeps in a file, with the sensor that the options name."""
        return (sweep for _, _, sweep in self.numbered_sweeps(path))

    def numbered_sweeps(self, path: Path, entry: IndexEntry | None = None) -> Iterator[tuple[str, int, Sweep]]:
        """Yield the sweeps in a file, or that of an index entry, with scene and number; damaged ones have numbers too.

        The scene is that of a recording or the drive of the index entry; empty for other files.
        """
        from viewshed.sensors import lidar_model

        model = None if self.sensor in {AUTO, NO_SENSOR} else lidar_model(self.sensor)
        origin_m, is_moved = parse_numbers("origin", self.origin, 3), entry is None and self._is_moved(path)
        for scene, number, sweep in self._read(path, is_moved) if entry is None else self._indexed(entry):
            raise_if_interrupted()
            if origin_m is not None:
                sweep = self._seen_from(origin_m, sweep, is_moved)  # noqa: PLW2901
            changes: dict[str, Any] = {} if self.ring == "file" else {"ring": None}
            if self.sensor != AUTO:
                changes |= {"model": model, "infer_sensor": False}
            if self.vehicle_yaw_deg is not None:
                changes["vehicle_yaw"] = math.radians(self.vehicle_yaw_deg)
            yield scene, number, sweep.replace(**changes) if changes else sweep

    def _is_moved(self, path: Path) -> bool:
        """Return whether the reader itself subtracts a far origin, in float64 before rounding to float32."""
        origin_m = parse_numbers("origin", self.origin, 3)
        if origin_m is None or self.file_frame is not None:
            return False
        return max(map(abs, origin_m)) > _FAR_M and path.name.lower().removesuffix(".gz").endswith(_IN_FLOAT64)

    def _seen_from(self, origin_m: list[float], sweep: Sweep, is_moved: bool) -> Sweep:
        """Return a sweep relative to the sensor; with a reference system, the sensor's position becomes its pose."""
        import numpy as np

        from viewshed.geometry import Rigid

        if self.crs is not None and sweep.world_from_sensor is None and self.poses is None:
            place = np.array(origin_m) if is_moved else np.zeros(3)
            sweep = sweep.replace(world_from_sensor=Rigid(np.eye(3), place))
        if is_moved:
            return sweep
        step_m = float(np.spacing(np.float32(max(map(abs, origin_m)))))
        if step_m > _COARSE_M:
            note(
                f"the points are rounded to {step_m:g} m at coordinates as large as --origin; subtract the sensor's"
                " position before you save them"
            )
        return sweep.seen_from(origin_m)

    def _read(self, path: Path, is_moved: bool) -> Iterator[tuple[str, int, Sweep]]:
        import numpy as np

        from viewshed.geometry import Rigid
        from viewshed.io import read_sweeps
        from viewshed.io.formats import is_recording

        if self.format == AUTO and is_recording(path):
            return self._recorded(path)
        if self.topic is not None:
            raise ValueError(f"--topic is only for bags, got {path}; leave it out")
        file_frame: str | Rigid | None = self.file_frame
        if is_moved:
            file_frame = Rigid(np.eye(3), -np.array(parse_numbers("origin", self.origin, 3)))
        sweeps = read_sweeps(
            path, format=self.format, file_frame=file_frame,
            sensor_height_m=self.height_m, attitude=parse_numbers("attitude", self.attitude, 4),
        )  # fmt: skip
        return (("", number, sweep) for number, sweep in enumerate(sweeps))

    def _recorded(self, path: Path) -> Iterator[tuple[str, int, Sweep]]:
        """Yield the sweeps of a recording; print a line for each problem and raise at the end if there were any."""
        from viewshed.recordings.read.source import each_sweep
        from viewshed.recordings.recording import open_sweep_source

        if self.file_frame is not None:
            raise ValueError("--file-frame does not go with a recording, which knows its own axes")
        count = problems = skipped = 0

        def on_damage(scene: str, line: str) -> None:
            nonlocal problems, skipped
            problems += 1
            skipped += scene != ""
            complain(line)

        source = open_sweep_source(path, topic=self.topic)
        for line in source.notes():
            note(line)
        for ref, sweep in each_sweep(source, on_damage=on_damage):
            yield f"{path} {ref.scene}", count + skipped, self._overridden(sweep)
            count += 1
        if problems or not count:
            raise ValueError(f"{path}: {count} sweeps read, {problems} problems")

    def _indexed(self, entry: IndexEntry) -> Iterator[tuple[str, int, Sweep]]:
        from viewshed.io import read_indexed

        if self.format != AUTO or self.file_frame is not None:
            raise ValueError("--format and --file-frame do not go with --index, which names the axes of its files")
        yield entry.seq or "", 0, self._overridden(read_indexed(entry))

    def _overridden(self, sweep: Sweep) -> Sweep:
        """Return the sweep with the height and attitude of the options."""
        given = {"sensor_height_m": self.height_m, "attitude": parse_numbers("attitude", self.attitude, 4)}
        return sweep.replace(**{name: value for name, value in given.items() if value is not None})


DEFAULT_READING = Reading()
"""No option is given."""


@dataclass(frozen=True, slots=True)
class ObjectOptions:
    """Options for objects, fusion and simulated attacks; see :func:`with_groups`."""

    objects: Annotated[bool, typer.Option("--objects", help="Detect, track and explain objects as well.")] = False
    fuse: Annotated[
        bool, typer.Option("--fuse", help="Fuse several agents as well: joint tracks, trust, disputes.")
    ] = False
    attack: Annotated[
        str | None,
        typer.Option(
            "--attack", help="Simulate an attack that forges sweeps, objects or claimed views (a wrong name lists all)."
        ),
    ] = None
    attacked: Annotated[
        str | None, typer.Option("--attacked", help="Agents that are attacked, AGENT,AGENT; all if not given.")
    ] = None
    attack_from: Annotated[
        float,
        typer.Option(
            "--attack-from", min=0.0, help="Seconds after the first sweep of an agent at which the attack begins."
        ),
    ] = 2.0

    def __post_init__(self) -> None:
        if self.attacked is not None and self.attack is None:
            raise ValueError("--attacked goes with --attack")

    @property
    def wants_objects(self) -> bool:
        """Whether objects are tracked, for display or for fusion."""
        return self.objects or self.fuse

    def adversary(self) -> Adversary | None:
        """Return the adversary of ``--attack``, or None."""
        if self.attack is None:
            return None
        agents = frozenset((self.attacked or "").split(",")) - {""}
        make_adversary = plugin("adversaries", "attacks", "--attack")
        return cast("Adversary", make_adversary(self.attack, agents, start_s=self.attack_from))

    def object_stream(self, adversary: Adversary | None) -> ObjectStream | None:
        """Return the detector and tracker of objects, or None."""
        if not self.wants_objects:
            return None
        from viewshed.objects.object_stream import ObjectStream

        return ObjectStream(tamper=None if adversary is None else adversary.detections)


NO_OBJECTS = ObjectOptions()
"""Fields of view only."""


def with_groups(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command in which each parameter that is a dataclass is replaced by one option for each of its fields.

    Fields marked ``_NO_OPTION`` are left out: only commands that write maps have an option for the reference system.
    """
    signature, kind = inspect.signature(command, eval_str=True), inspect.Parameter.KEYWORD_ONLY
    groups: dict[str, type[Any]] = {
        name: parameter.annotation
        for name, parameter in signature.parameters.items()
        if isinstance(parameter.annotation, type) and is_dataclass(parameter.annotation)
    }
    if not groups:
        return command
    of_group = {name: _parameters(group) for name, group in groups.items()}

    @wraps(command)
    def with_options(**given: Any) -> None:
        values = {
            name: group(**{option.name: given.pop(option.name) for option in of_group[name]})
            for name, group in groups.items()
        }
        command(**given, **values)

    # Typer reads options from the signature and their types from the annotations.
    parameters: list[inspect.Parameter] = []
    for parameter in signature.parameters.values():
        parameters += of_group.get(parameter.name, [parameter.replace(kind=kind)])
    with_options.__dict__["__signature__"] = signature.replace(parameters=parameters)
    with_options.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return with_options


def _parameters(group: type[Any]) -> list[inspect.Parameter]:
    """Return a parameter for each field of a dataclass that is an option."""
    hints, kind = get_type_hints(group, include_extras=True), inspect.Parameter.KEYWORD_ONLY
    return [
        inspect.Parameter(option.name, kind, default=option.default, annotation=hints[option.name])
        for option in fields(group)
        if _NO_OPTION not in option.metadata
    ]


SECTIONS = {
    "Reading": (
        "sensor", "format", "file_frame", "height_m", "attitude", "origin", "ring", "vehicle_yaw_deg", "topic", "poses",
        "index", "crs", "number", "step", "sweeps", "split",
    ),
    "Method": (
        "method", "methods", "grid", "target", "parameters", "profile", "weights", "passes", "seed", "abstain_below",
        "device", "threshold", "history", "require_confirmation", "monitor", "monitor_file", "objects", "fuse",
    ),
    "Attack": ("attack", "attacked", "attack_from"),
}  # fmt: skip
"""Options by section of the help, in this order; options in no section come first."""

_SECTIONED_ABOVE = 12
"""Help has sections for commands with more options than this."""


class SectionedCommand(TyperCommand):
    """A command whose help lists its options by :data:`SECTIONS`."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments and options, in sections if there are many."""
        parameters = self.get_params(ctx)
        of_section = {name: f"{title} options" for title, names in SECTIONS.items() for name in names}
        titles = of_section if len(parameters) > _SECTIONED_ABOVE else {}
        sections: dict[str, list[Any]] = {
            title: [] for title in ("Arguments", "Options", *dict.fromkeys(titles.values()))
        }
        for param in parameters:
            is_argument = param.param_type_name == "argument"
            title = "Arguments" if is_argument else titles.get(str(param.name), "Options")
            if (record := param.get_help_record(ctx)) is not None:
                sections[title].append(record)
        for title, records in sections.items():
            if records:
                with formatter.section(title):
                    formatter.write_dl(records)


def parse_numbers(name: str, text: str | None, count: int) -> list[float] | None:
    """Parse ``count`` numbers separated by commas; None stays None.

    >>> parse_numbers("attitude", "1,0,0,0", 4)
    [1.0, 0.0, 0.0, 0.0]
    """
    if text is None:
        return None
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError as error:
        raise ValueError(f"{name} must be {count} numbers separated by commas, got {text!r}") from error
    if len(numbers) != count:
        raise ValueError(f"{name} must be {count} numbers separated by commas, got {len(numbers)} in {text!r}")
    return numbers


def parse_grid(text: str) -> BevGrid:
    """Return the grid of a preset or of CELLSxHALF_EXTENT_M.

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


Weights = Annotated[
    str | None,
    typer.Option("--weights", help="For a network: its ONNX file, or the name of weights shipped with viewshed."),
]
Passes = Annotated[int | None, typer.Option("--passes", help="Passes of the method mc_dropout; 10 if not given.")]
Seed = Annotated[int | None, typer.Option("--seed", help="Seed of the method mc_dropout; 0 if not given.")]

HistorySweeps = Annotated[
    int,
    typer.Option(
        "--history", min=0, max=20,
        help="Number of earlier sweeps that shadow_map uses, a second or more apart; 5 is a good choice.",
    ),
]  # fmt: skip

RequireConfirmation = Annotated[
    bool,
    typer.Option(
        "--require-confirmation",
        help="With --history: call visible only what an earlier sweep would have seen as well.",
    ),
]

WithMonitor = Annotated[
    bool,
    typer.Option(
        "--monitor",
        help="Report whether each sweep is inconsistent (as forged ones are) or degraded (rain, dirt), and why.",
    ),
]

MonitorFile = Annotated[
    Path | None,
    typer.Option(
        "--monitor-file",
        help="Monitor made by viewshed monitor calibrate; the one shipped with viewshed if not given.",
    ),
]

Device = Annotated[str, typer.Option("--device", help="Where networks run: cpu or cuda.")]

AbstainBelow = Annotated[
    float | None,
    typer.Option(
        "--abstain-below",
        help="Cells are visible from this probability, hidden below 1 minus it, else unknown; not for methods that"
        " only give 0 or 1.",
    ),
]


@dataclass(frozen=True, slots=True)
class NetworkOptions:
    """Options for networks; other estimators accept none of them."""

    weights: str | None = None
    passes: int | None = None
    seed: int | None = None
    abstain_below: float | None = None
    device: str = "cpu"

    def estimator(
        self, method: str | None, grid: BevGrid | None, target: str | None, parameters: str = "sound"
    ) -> Estimator:
        """Return the estimator named ``method``; None is the default, or with ``paper`` parameters the paper's label.

        With ``paper`` parameters the prefix ``paper_`` may be left out. If grid or target is None, it is that of the
        weights, or road and car.
        """
        from viewshed.estimators import load_estimator, paper_estimators_on

        if parameters not in PARAMETERS:
            raise ValueError(f"parameters must be {' or '.join(PARAMETERS)}, got {parameters!r}")
        if parameters == "paper":
            known = paper_estimators_on(grid or parse_grid("road"))
            method = "paper_label" if method is None else method
            method = f"paper_{method}" if f"paper_{method}" in known else method
        return load_estimator(
            method, grid=grid, target=target, device=self.device, weights=self.weights, passes=self.passes,
            seed=self.seed, abstain_below=self.abstain_below,
        )  # fmt: skip

    def threshold(self, given: float | None, estimator: Estimator, parameters: str = "sound") -> float:
        """Return the threshold of visibility; None is the estimator's own, or the paper's."""
        from viewshed.estimators import PAPER_THRESHOLD

        if given is None:
            return PAPER_THRESHOLD if parameters == "paper" else estimator.threshold
        if not 0 < given <= 1:
            raise ValueError(f"threshold must lie in (0, 1], got {given}")
        if self.abstain_below is not None and given < self.abstain_below:
            raise ValueError(
                f"--threshold must be at least --abstain-below {self.abstain_below:g}, got {given:g}; leave one of"
                " them out"
            )
        return given
