"""Message of one agent about one sweep: pose, field of view, ground, detections, and the report of its monitor.

The payload is a map of deterministic CBOR; its schema is ``docs/view_message.cddl``. Numbers of many objects are typed
arrays.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from viewshed.agents import cbor
from viewshed.agents.fov_code import decode_fov, encode_fov, has_std
from viewshed.arrays import F64
from viewshed.detections import Detections
from viewshed.fov.estimate import FovEstimate
from viewshed.fov.height_map import HeightMap
from viewshed.fov.visibility import Target
from viewshed.geometry import Rigid, pose_covariance_of, quaternion_from_rotation
from viewshed.grid import BevGrid
from viewshed.monitor.evidence.base import SECTORS
from viewshed.monitor.report import IntegrityReport

T = TypeVar("T", str, bytes, int, float)

VERSION = 4
"""Version of the payload format; a receiver refuses others."""

MAX_BYTES = 49_152
"""Maximum size of a signed message in bytes."""

GROUND_NODES = 32
"""Ground heights per side."""

MAX_HEIGHT_M = 30.0
"""Maximum height of a sensor above the ground; of a higher one, silence says less about near objects."""

MAX_DETECTIONS = 512

MAX_EPOCH = 2**53
MAX_SEQUENCE = 2**53
MAX_T_NS = 2**63 - 1

FIELDS = (
    "version", "agent", "number", "t_ns", "frame", "pose",
    "sensor", "view", "ground", "detections", "report",
)  # fmt: skip
"""Names of the fields of a payload; their indices are the keys."""

_NAME = re.compile(r"[A-Za-z0-9_.\-]{1,32}")

_GROUND_STEPS_PER_M, _MAX_STEPS = 100.0, 2**15 - 1

_UPPER6 = np.triu_indices(6)

# Index of each element of a symmetric matrix (6, 6) among those of its upper triangle.
_SQUARE6 = np.zeros((6, 6), np.intp)
_SQUARE6[_UPPER6] = np.arange(21)
_SQUARE6 = np.maximum(_SQUARE6, _SQUARE6.T)


@dataclass(frozen=True, slots=True)
class SensorFacts:
    """Sensor of a view."""

    name: str  # name of its beam table, or the sender's own name for it; at most 32 characters
    height_m: float = math.nan  # above the ground below it; NaN if unknown
    reach_m: float = math.nan  # range at which it still sees a dark target; NaN if unknown

    def __post_init__(self) -> None:
        if not (0 < len(self.name) <= 32 and self.name.isprintable()):
            raise ValueError(f"the name of a sensor must have 1 to 32 printable characters, got {self.name[:40]!r}")
        if self.reach_m < 0.0 or math.isinf(self.reach_m):
            raise ValueError(f"reach must be finite and not negative, or NaN, got {self.reach_m}")
        if abs(self.height_m) > MAX_HEIGHT_M:
            raise ValueError(f"height must be at most {MAX_HEIGHT_M:g} m, or NaN, got {self.height_m}")


@dataclass(frozen=True, slots=True, eq=False)
class ViewMessage:
    """Message of one agent about one sweep.

    Raises:
        ValueError: a value is out of range.
    """

    agent: str  # name of the sender: 1 to 32 letters, digits, ``_``, ``.`` or ``-``
    sequence: int  # sequence number, greater than in all earlier messages of this epoch
    t_ns: int  # time of the sweep by the agent's clock, nanoseconds since 1970
    frame: str  # name of the map of the pose
    world_from_level: Rigid  # pose of the ``level`` frame in that map
    pose_covariance: F64  # (6, 6) of x, y, z in meters and rotations about x, y, z in radians, in the map
    sensor: SensorFacts  # sensor of the view
    view: FovEstimate | None = None  # field of view, or None; the receiver gets it quantized (``fov_code``)
    # ground heights in ``level``, or None; the receiver gets ``GROUND_NODES`` per side, rounded to a centimeter
    ground: HeightMap | None = None
    detections: Detections | None = None  # objects of this sweep in ``level``, or None
    report: IntegrityReport | None = None  # monitor's report, or None; reasons and suspect cells are not sent
    # number of the agent's start, greater at each: milliseconds since 1970 at the start, or a counter in a file.
    # Sequence numbers restart with each epoch.
    epoch: int = 0

    def __post_init__(self) -> None:
        for name in ("agent", "frame"):
            require_name(name, getattr(self, name))
        for name, highest in (("epoch", MAX_EPOCH), ("sequence", MAX_SEQUENCE), ("t_ns", MAX_T_NS)):
            if not 0 <= getattr(self, name) <= highest:
                raise ValueError(f"{name} must lie in [0, {highest}], got {getattr(self, name)}")
        pose_covariance_of(self.pose_covariance, f"pose_covariance of {self.agent}")
        if self.detections is not None and len(self.detections) > MAX_DETECTIONS:
            raise ValueError(f"a message must have at most {MAX_DETECTIONS} detections, got {len(self.detections)}")


def require_name(what: str, name: str) -> None:
    """Raise ValueError where a name is not 1 to 32 letters, digits, ``_``, ``.`` or ``-``."""
    if not _NAME.fullmatch(name):
        raise ValueError(f"{what} must be 1 to 32 letters, digits, '_', '.' or '-', got {name[:40]!r}")


def encode_message(message: ViewMessage) -> bytes:
    """Return the payload of a message as CBOR.

    Raises:
        ImportError: cbor2 is not installed.
        ValueError: the view is too large or too irregular.
    """
    origin = message.world_from_level.translation
    fields: dict[int, Any] = {
        0: VERSION,
        1: message.agent,
        2: [message.epoch, message.sequence],
        3: message.t_ns,
        4: message.frame,
        5: [
            np.concatenate([origin, quaternion_from_rotation(message.world_from_level.rotation)]),
            message.pose_covariance[_UPPER6].astype(np.float32),
        ],
        6: [message.sensor.name, float(message.sensor.height_m), float(message.sensor.reach_m)],
    }
    if message.view is not None:
        fields[7] = _view_fields(message.view)
    if message.ground is not None:
        fields[8] = _ground_fields(message.ground)
    if message.detections is not None:
        detections = message.detections
        fields[9] = [detections.boxes.astype(np.float32).ravel(), detections.kinds, detections.returns]
    if message.report is not None:
        fields[10] = _report_fields(message.report)
    return cbor.dumps(fields)


def _view_fields(view: FovEstimate) -> dict[int, Any]:
    grid, target = view.grid, view.target
    sizes = [float(target.length_m), float(target.width_m), float(target.height_m)]
    return {
        0: [grid.cells, float(grid.half_extent_m), *map(float, grid.offset_m)],
        1: [target.name, *sizes, target.min_returns],
        2: float(view.threshold),
        3: view.method,
        4: has_std(view),
        5: encode_fov(view),
    }


def _report_fields(report: IntegrityReport) -> list[Any]:
    return [
        report.monitor[:64],
        float(report.score),
        float(report.threshold),
        float(report.p_value),
        bool(report.degraded),
        float(report.degraded_p_value),
        np.packbits(report.suspect).tobytes(),
    ]


def decode_message(payload: bytes) -> ViewMessage:
    """Return the validated message in a payload, with the cells of its view decoded.

    Raises:
        ValueError: it is not a payload of this version, or a value is out of range.
    """
    if len(payload) > MAX_BYTES:
        raise ValueError(f"a payload must have at most {MAX_BYTES} bytes, got {len(payload)}")
    fields = cbor.loads(payload)
    if not isinstance(fields, dict) or fields.get(0) != VERSION:
        raise ValueError(f"a payload must be a map whose version is {VERSION}")
    try:
        return _message_of(fields)
    except (KeyError, TypeError, AttributeError, IndexError, OverflowError) as error:
        raise ValueError(f"a payload must have the fields of its schema, of their types: {error!r}") from error


def _message_of(fields: dict[int, Any]) -> ViewMessage:
    unknown = fields.keys() - set(range(len(FIELDS)))
    if unknown:
        raise ValueError(f"keys of a payload must lie in [0, {len(FIELDS) - 1}], got {min(unknown)}")
    pose, upper = _columns(fields[5], (np.float64, np.float32))
    world_from_level = Rigid.from_quaternion(pose[3:], pose[:3])
    covariance = upper.astype(np.float64)[_SQUARE6]
    name, height_m, reach_m = fields[6]
    agent, t_ns = _typed(str, fields[1]), _typed(int, fields[3])
    epoch, sequence = fields[2]
    view, ground, detections, report = (fields.get(key) for key in range(7, 11))
    return ViewMessage(
        agent=agent,
        sequence=_typed(int, sequence),
        t_ns=t_ns,
        frame=_typed(str, fields[4]),
        world_from_level=world_from_level,
        pose_covariance=covariance,
        sensor=SensorFacts(_typed(str, name), _typed(float, height_m), _typed(float, reach_m)),
        view=None if view is None else _view_of(view, agent, t_ns, world_from_level),
        ground=None if ground is None else _ground_of(ground),
        detections=None if detections is None else _detections_of(detections),
        report=None if report is None else _report_of(report),
        epoch=_typed(int, epoch),
    )


def _view_of(fields: dict[int, Any], agent: str, t_ns: int, pose: Rigid) -> FovEstimate:
    cells, *extent = fields[0]
    name, *sizes, min_returns = fields[1]
    half_extent_m, x_m, y_m = (_typed(float, each) for each in extent)
    length_m, width_m, height_m = (_typed(float, each) for each in sizes)
    grid = BevGrid(_typed(int, cells), half_extent_m, (x_m, y_m))
    threshold, with_std = _typed(float, fields[2]), fields[4] is True
    cells_of_view = decode_fov(_typed(bytes, fields[5]), grid, threshold, with_std)
    return FovEstimate(
        grid=grid,
        visible_prob=cells_of_view.visible_prob,
        state=cells_of_view.state,
        std=cells_of_view.std,
        method=_typed(str, fields[3])[:64],
        target=Target(_typed(str, name)[:64], length_m, width_m, height_m, _typed(int, min_returns)),
        threshold=threshold,
        world_from_level=pose,
        t_ns=t_ns,
        agent=agent,
    )


def _ground_fields(ground: HeightMap) -> list[Any]:
    heights_m = ground.at(BevGrid(GROUND_NODES, ground.half_extent_m).centers)
    steps = np.clip(np.rint(_GROUND_STEPS_PER_M * heights_m), -_MAX_STEPS, _MAX_STEPS)
    return [float(ground.half_extent_m), steps.astype("<i2").tobytes()]


def _ground_of(fields: list[Any]) -> HeightMap:
    half_extent_m, code = fields
    shape = BevGrid(GROUND_NODES, _typed(float, half_extent_m)).shape
    if len(_typed(bytes, code)) != 2 * GROUND_NODES**2:
        raise ValueError(f"the ground must have {GROUND_NODES} times {GROUND_NODES} heights, got {len(code)} bytes")
    heights_m = np.frombuffer(code, "<i2").reshape(shape).astype(np.float32) / np.float32(_GROUND_STEPS_PER_M)
    return HeightMap(heights_m, half_extent_m, np.ones(shape, np.bool_))


def _detections_of(fields: list[Any]) -> Detections:
    boxes, kinds, returns = _columns(fields, (np.float32, np.uint8, np.int32))
    if len(kinds) > MAX_DETECTIONS:
        raise ValueError(f"a message must have at most {MAX_DETECTIONS} detections, got {len(kinds)}")
    if len(boxes) != 7 * len(kinds):
        raise ValueError(f"a message must have 7 numbers for each box, got {len(boxes)} for {len(kinds)} objects")
    return Detections(boxes.reshape(-1, 7).astype(np.float64), kinds, returns)


def _report_of(fields: list[Any]) -> IntegrityReport:
    monitor, score, threshold, p_value, degraded, degraded_p_value, suspect = fields
    suspect_sectors = np.unpackbits(np.frombuffer(_typed(bytes, suspect), np.uint8))
    if len(suspect_sectors) != SECTORS:
        raise ValueError(f"a report must have {SECTORS} sectors, got {len(suspect_sectors)}")
    return IntegrityReport(
        _typed(str, monitor)[:64],
        _typed(float, score),
        _typed(float, threshold),
        _typed(float, p_value),
        degraded is True,
        _typed(float, degraded_p_value),
        suspect_sectors.astype(np.bool_),
    )


def _columns(arrays: list[Any], types: tuple[Any, ...]) -> list[NDArray[Any]]:
    """Return the arrays if each has its type, else raise ValueError."""
    if [getattr(array, "dtype", None) for array in arrays] != [np.dtype(kind) for kind in types]:
        raise ValueError("arrays of a payload must have the types of its schema")
    return list(arrays)


_WORDS = {str: "text", bytes: "bytes", int: "a whole number", float: "a float"}


def _typed(kind: type[T], value: Any) -> T:
    """Return a value if it has exactly this type, else raise ValueError."""
    if type(value) is not kind:
        raise ValueError(f"a payload must have {_WORDS[kind]} here, got {type(value).__name__}")
    return value


def field_sizes(payload: bytes) -> dict[str, int]:
    """Return the encoded bytes of each field of a payload with its key, by name; ``map`` is the header of the map.

    Raises:
        ValueError: it is not a payload.
    """
    reader = cbor.Reader(payload)
    major, _, count = reader.head()
    if major != 5:
        raise ValueError("a payload must be a map")
    sizes = {"map": reader.at}
    for _ in range(count):
        start = reader.at
        key = reader.value()
        if key not in range(len(FIELDS)):
            raise ValueError(f"keys of a payload must lie in [0, {len(FIELDS) - 1}], got {key}")
        reader.value(1)
        sizes[FIELDS[key]] = reader.at - start
    return sizes
