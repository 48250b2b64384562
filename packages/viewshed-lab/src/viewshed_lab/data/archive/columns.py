"""Convert a sample to the columns that an archive stores, and back, bit by bit.

A range image is stored as its range steps, a sweep without one as points. An attacked sweep is stored as its clean
range image, the rows that the attacker added, and two masks: which rows were added, and which clean rows were removed.

Arrays are packed into bytes that compress well. Parquet's own encodings are worse: on simulated frames of 30,000
returns, Arrow lists take 1.6 times the size and 7 times the time to read, plain bytes 1.3 times the size and the same
time. Unpacking is compiled, because frames are read many times. All unpack functions raise a ValueError if the number
of bytes does not fit the shape; their arrays are read-only.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.fov.truth import Truth
from viewshed.geometry import Rigid
from viewshed.sweep import PlanarScan, Sweep
from viewshed_lab.data.archive.schema import Footer, Layout, Sensors
from viewshed_lab.data.sample import Sample
from viewshed_lab.sim.lidar.stored_sweep import StoredSweep
from viewshed_lab.sim.raycast.scan import Motion

if TYPE_CHECKING:
    from viewshed_lab.threats.attacks.base import Tampered

Buffer = bytes | memoryview
Bytes = NDArray[np.uint8]

_SHIFTS = np.arange(0, 8, 2, dtype=np.uint8)


def pack_ranges(steps: NDArray[np.uint16]) -> bytes:
    """Pack a range image (C, R): per ring the differences along the columns, all low bytes first.

    Neighboring columns of a ring differ little, so almost all high bytes are 0. A difference d is stored as the zigzag
    number 2·d or -2·d - 1, modulo 2¹⁶.
    """
    changes = np.ascontiguousarray(np.diff(steps.T, axis=1, prepend=np.uint16(0))).view(np.int16)
    return pack_column((changes << 1) ^ (changes >> 15))


def unpack_ranges(raw: Buffer, shape: tuple[int, int]) -> NDArray[np.uint16]:
    """Return the range image (C, R) of :func:`pack_ranges`."""
    steps = np.empty(shape, np.uint16)
    _unpack_ranges(_exactly(raw, steps.nbytes), steps)
    return _frozen(steps)


@njit(cache=True, nogil=True, error_model="numpy")
def _unpack_ranges(raw: Any, steps: Any) -> None:
    columns, rings = steps.shape
    high = columns * rings
    for ring in range(rings):
        value = np.int32(0)
        for column in range(columns):
            k = ring * columns + column
            zigzag = np.int32(raw[k]) | (np.int32(raw[high + k]) << 8)
            value += (zigzag >> 1) ^ -(zigzag & 1)
            steps[column, ring] = value & 0xFFFF


def pack_states(states: NDArray[np.uint8]) -> bytes:
    """Pack states of 0 to 3, four per byte, the first in the lowest bits.

    >>> pack_states(np.array([1, 2, 3, 0, 3], np.uint8)).hex()
    '3903'
    """
    if states.size and states.max() > 3:
        raise ValueError(f"state must lie in [0, 3], got {states.max()}")
    padded = np.zeros((states.size + 3) // 4 * 4, np.uint8)
    padded[: states.size] = states.reshape(-1)
    packed: Bytes = np.bitwise_or.reduce(padded.reshape(-1, 4) << _SHIFTS, axis=1, dtype=np.uint8)
    return packed.tobytes()


def unpack_states(raw: Buffer, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return the states of :func:`pack_states`."""
    states = np.empty(shape, np.uint8)
    _unpack_states(_exactly(raw, (states.size + 3) // 4), states.reshape(-1))
    return _frozen(states)


@njit(cache=True, nogil=True, error_model="numpy")
def _unpack_states(raw: Any, states: Any) -> None:
    for k in range(states.shape[0]):
        states[k] = (raw[k >> 2] >> (2 * (k & 3))) & 3


def pack_masks(masks: NDArray[np.bool_]) -> bytes:
    """Pack masks (M, …) into one bit per cell, each mask padded to whole bytes, the first cell in the highest bit.

    >>> pack_masks(np.array([[True, False, True]])).hex()
    'a0'
    """
    return np.packbits(masks.reshape(len(masks), -1), axis=1).tobytes()


def unpack_masks(raw: Buffer, shape: tuple[int, int, int]) -> NDArray[np.bool_]:
    """Return the masks (M, cells, cells) of :func:`pack_masks`."""
    count = shape[1] * shape[2]
    rows = _exactly(raw, shape[0] * ((count + 7) // 8)).reshape(shape[0], -1)
    return _frozen(np.unpackbits(rows, axis=1, count=count).view(np.bool_).reshape(shape))


def pack_column(values: NDArray[np.number[Any]]) -> bytes:
    """Pack numbers (N,) or (N, k): all first bytes, all second bytes, and so on."""
    return np.ascontiguousarray(values).reshape(-1, 1).view(np.uint8).T.tobytes()


def unpack_column(raw: Buffer, dtype: type[np.generic], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return the numbers of :func:`pack_column`."""
    out = np.empty(shape, dtype)
    _merge(_exactly(raw, out.nbytes).reshape(out.itemsize, -1), out.reshape(-1, 1).view(np.uint8))
    return _frozen(out)


@njit(cache=True, nogil=True, error_model="numpy")
def _merge(planes: Any, numbers: Any) -> None:
    for byte in range(planes.shape[0]):
        for k in range(planes.shape[1]):
            numbers[k, byte] = planes[byte, k]


def bytes_of(raw: Buffer, shape: tuple[int, ...]) -> Bytes:
    """Return ``raw`` as a uint8 array of ``shape``, without a copy."""
    return _exactly(raw, int(np.prod(shape))).reshape(shape)


def _exactly(raw: Buffer, count: int) -> Bytes:
    flat = np.frombuffer(raw, np.uint8)
    if len(flat) != count:
        raise ValueError(f"a column must hold {count} bytes, got {len(flat)}")
    return flat


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    array.setflags(write=False)
    return array


_COLUMNS: dict[str, type[np.generic]] = {
    "intensity": np.float32, "ring": np.int16, "azimuth": np.float32, "time_s": np.float32,
}  # fmt: skip
"""Columns of a sweep besides its points, in stored order."""

BLOBS = ("ranges", "intensity", "points", "returns", "states", "masks")
"""Binary columns; ``about`` comes before them."""

TOUCHED = "touched"
"""Additional last binary column in archives of attacked sweeps; readers may ignore it."""

Row = tuple[str, Buffer | None, Buffer | None, Buffer | None,
            Buffer, Buffer, Buffer, Buffer | None]  # fmt: skip
"""``about``, the columns of :data:`BLOBS`, and :data:`TOUCHED`."""

MAX_ADDED_SHARE = 0.5
"""If the attacker added a larger share of the rows, storing all points takes less space."""


def row_of_sample(sample: Sample, layout: Layout, sensors: Sensors) -> Row:
    """Convert a sample to columns; its beam table is added to ``sensors``."""
    truth, tampered = sample.truth, sample.tampered
    if Layout.of(truth) != layout:
        raise ValueError(f"truth must have the layout of the archive, {layout}, got {Layout.of(truth)}")
    about, ranges, intensity, points = _pack_measured(sample, sensors)
    returns = b"".join(truth.expected_returns[name].tobytes() for name in layout.targets)
    states = pack_states(np.array([truth.state[name] for name in layout.targets], np.uint8))
    masks = np.stack([*(truth.definitions[name] for name in layout.definitions), sample.known])
    touched = None
    if tampered is not None:
        wedge = None if tampered.wedge is None else [float(tampered.wedge.azimuth), float(tampered.wedge.width)]
        about[TOUCHED] = {"added": len(tampered.added), "removed": len(tampered.removed), "wedge": wedge}
        touched = pack_masks(np.concatenate([tampered.added, tampered.removed])[None])
    text = json.dumps(about, ensure_ascii=False)
    return text, ranges, intensity, points, returns, states, pack_masks(masks), touched


def _pack_measured(sample: Sample, sensors: Sensors) -> tuple[dict[str, Any], bytes | None, bytes | None, bytes | None]:
    """Return the metadata of the sweep, and its columns ranges, intensity and points."""
    measured, clean, tampered = sample.measured, sample.clean, sample.tampered
    if not isinstance(measured, Sweep):
        return _about(measured, sensors), *_pack_image(measured), None
    rows = None if clean is None or tampered is None else added_rows(clean.sweep(), tampered)
    if clean is None or rows is None:
        return _about(measured, sensors), None, None, _pack_points(measured)
    return _about(rows, sensors) | {"clean": _about(clean, sensors)}, *_pack_image(clean), _pack_points(rows)


def sample_of_row(row: Row, footer: Footer) -> Sample:
    """Return the sample of a row; raise a ValueError if its columns do not fit the footer or each other."""
    text, ranges, intensity, points, returns, states, masks, touched = row
    clean = tampered = None
    try:
        about, sensors = json.loads(text), footer.sensors
        measured = _image(about, ranges, intensity, sensors) if points is None else _sweep(about, points, sensors)
        if touched is not None:
            # Imported here, because reading clean sweeps needs no attacks.
            from viewshed_lab.threats.attacks.base import Tampered, Wedge

            rows, clean_rows = int(about[TOUCHED]["added"]), int(about[TOUCHED]["removed"])
            added, removed = np.split(unpack_masks(touched, (1, 1, rows + clean_rows))[0, 0], [rows])
            ends = about[TOUCHED]["wedge"]
            wedge = None if ends is None else Wedge(float(ends[0]), float(ends[1]))
            if "clean" in about and isinstance(measured, Sweep):
                clean = _image(about["clean"], ranges, intensity, sensors)
                measured = merge_rows(clean.sweep(), measured, added, removed)
            tampered = Tampered(measured if isinstance(measured, Sweep) else measured.sweep(), added, removed, wedge)
    except (KeyError, TypeError, IndexError, AttributeError) as error:
        raise ValueError(f"about must describe the frame: {error!r}") from error
    truth, known = _truth(footer.layout, returns, states, masks)
    return Sample(measured, truth, known, footer.scene, footer.split, tampered, clean)


def added_rows(clean: Sweep, tampered: Tampered) -> Sweep | None:
    """Return the rows that an attacker added; None if other rows are not the clean ones, or too many were added."""
    attacked, added, removed = tampered.sweep, tampered.added, tampered.removed
    if np.count_nonzero(added) > MAX_ADDED_SHARE * len(attacked) or len(removed) != len(clean):
        return None
    for name in ("points", *_COLUMNS):
        after, before = getattr(attacked, name), getattr(clean, name)
        if (after is None) != (before is None):
            return None
        if after is not None and after[~added].tobytes() != before[~removed].tobytes():
            return None
    return attacked.select(added)


def merge_rows(clean: Sweep, rows: Sweep, added: NDArray[np.bool_], removed: NDArray[np.bool_]) -> Sweep:
    """Return the attacked sweep of :func:`added_rows`; its fields other than the columns are those of ``rows``.

    ``added`` (N,): which rows of the attacked sweep the attacker added; ``removed`` (M,): which clean rows are gone.
    """
    new, old, source = np.flatnonzero(added), np.flatnonzero(~added), np.flatnonzero(~removed)
    if len(removed) != len(clean) or len(source) != len(old) or len(rows) != len(new):
        counts = f"{len(source)} of {len(removed)} and {len(new)} in {len(added)}"
        raise ValueError(
            f"kept and added rows must match {len(clean)} clean and {len(rows)} added points, got {counts}"
        )
    columns = {}
    for name in ("points", *_COLUMNS):
        before, after = getattr(clean, name), getattr(rows, name)
        if (before is None) != (after is None):
            raise ValueError(f"added points must have {name} exactly if the sweep has it")
        if after is not None:
            column = columns[name] = np.empty((len(added), *before.shape[1:]), before.dtype)
            column[old], column[new] = before[source], after
    return rows.replace(**columns)


def _about(measured: StoredSweep | Sweep, sensors: Sensors) -> dict[str, Any]:
    """Return the sweep's fields that are no arrays, as plain values; JSON keeps Python's floats exactly."""
    pose = measured.world_from_sensor
    about: dict[str, Any] = {
        "agent": measured.agent,
        "t_ns": None if measured.t_ns is None else int(measured.t_ns),
        "sensor": sensors.number(measured.model),
        "sensor_height_m": None if measured.sensor_height_m is None else float(measured.sensor_height_m),
        "world_from_sensor": None if pose is None else [*pose.rotation.ravel().tolist(), *pose.translation.tolist()],
    }
    if isinstance(measured, StoredSweep):
        motion = measured.motion
        numbers = [*motion.velocity_mps, motion.yaw_rate, motion.period_s]
        return about | {"step_m": float(measured.step_m), "motion": [float(value) for value in numbers]}
    about |= {
        "points": len(measured),
        "columns": [name for name in _COLUMNS if getattr(measured, name) is not None],
        "attitude": None if measured.attitude is None else measured.attitude.tolist(),
        "dropped_points": int(measured.dropped_points),
    }
    planar, covariance = measured.planar, measured.pose_covariance
    optional = {
        "infer_sensor": None if measured.infer_sensor else False,
        "vehicle_yaw": None if measured.vehicle_yaw is None else float(measured.vehicle_yaw),
        "planar": None if planar is None else [planar.open_azimuth.tolist(), float(planar.max_range_m)],
        "pose_covariance": None if covariance is None else covariance.tolist(),
    }
    return about | {name: value for name, value in optional.items() if value is not None}


def _pack_image(image: StoredSweep) -> tuple[bytes, bytes]:
    return pack_ranges(image.steps), image.intensity.tobytes()


def _pack_points(sweep: Sweep) -> bytes:
    columns = [getattr(sweep, name) for name in _COLUMNS]
    return b"".join(pack_column(column) for column in (sweep.points, *columns) if column is not None)


def _image(about: dict[str, Any], ranges: Buffer | None, intensity: Buffer | None, sensors: Sensors) -> StoredSweep:
    model = sensors.model(about["sensor"])
    if model is None or ranges is None or intensity is None:
        raise ValueError("a frame without points must have a sensor, ranges and intensity")
    shape = (model.azimuth_columns, model.rings)
    vx, vy, vz, yaw_rate, period_s = about["motion"]
    pose = _pose(about["world_from_sensor"])
    if pose is None:
        raise ValueError("a range image must have a pose")
    return StoredSweep(
        model=model,
        steps=unpack_ranges(ranges, shape),
        intensity=bytes_of(intensity, shape),
        step_m=about["step_m"],
        world_from_sensor=pose,
        motion=Motion((vx, vy, vz), yaw_rate, period_s),
        sensor_height_m=about["sensor_height_m"],
        t_ns=about["t_ns"],
        agent=about["agent"],
    )


def _sweep(about: dict[str, Any], raw: Buffer, sensors: Sensors) -> Sweep:
    count, view = int(about["points"]), memoryview(raw)
    points = unpack_column(view[: 12 * count], np.float32, (count, 3))
    start = 12 * count
    columns: dict[str, Any] = {}
    for name in about["columns"]:
        end = start + count * np.dtype(_COLUMNS[name]).itemsize
        columns[name] = unpack_column(view[start:end], _COLUMNS[name], (count,))
        start = end
    planar, covariance = about.get("planar"), about.get("pose_covariance")
    return Sweep(
        points=points,
        **columns,
        t_ns=about["t_ns"],
        attitude=None if about["attitude"] is None else np.array(about["attitude"]),
        sensor_height_m=about["sensor_height_m"],
        world_from_sensor=_pose(about["world_from_sensor"]),
        model=sensors.model(about["sensor"]),
        agent=about["agent"],
        dropped_points=int(about["dropped_points"]),
        infer_sensor=about.get("infer_sensor", True),
        vehicle_yaw=about.get("vehicle_yaw"),
        planar=None if planar is None else PlanarScan(np.array(planar[0], np.float32), planar[1]),
        pose_covariance=None if covariance is None else np.array(covariance),
    )


def _pose(numbers: list[float] | None) -> Rigid | None:
    if numbers is None:
        return None
    return Rigid(np.array(numbers[:9]).reshape(3, 3), np.array(numbers[9:]))


def _truth(layout: Layout, returns: Buffer, states: Buffer, masks: Buffer) -> tuple[Truth, NDArray[np.bool_]]:
    shape = layout.grid.shape
    targets, definitions = len(layout.targets), len(layout.definitions)
    counts = bytes_of(returns, (targets, *shape))
    state = unpack_states(states, (targets, *shape))
    bits = unpack_masks(masks, (definitions + 1, *shape))
    truth = Truth(
        layout.grid,
        dict(zip(layout.targets, counts, strict=True)),
        dict(zip(layout.targets, state, strict=True)),
        dict(zip(layout.definitions, bits[:-1], strict=True)),
    )
    return truth, bits[-1]
