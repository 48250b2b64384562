"""NPY and NPZ files. Headers are parsed here, not by numpy.load: nothing is unpickled, and every size is checked."""

from __future__ import annotations

import io
import re
import warnings
import zipfile
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.io._columns import IDENTITY, Assumption, Columns, near_points
from viewshed.io._input import InputFile, read_bounded, unpack_limit
from viewshed.sensors import LidarModel
from viewshed.sweep import MAX_POINTS, PlanarScan, Sweep, has_points_in_rows, shape_remedy

_HEADER = re.compile(  # possessive (*+): no backtracking, so a damaged header fails in one pass
    r"\s*+\{\s*+'descr'\s*+:\s*+'([<>|=]?(?:[fiu][1248]|b1|U\d{1,7}))'\s*+,\s*+'fortran_order'\s*+:\s*+(True|False)"
    r"\s*+,\s*+'shape'\s*+:\s*+\(([\d\s,]*+)\)\s*+(?:,\s*+)?\}\s*+"
)

MILLIMETERS = "int32 points are read as millimeters; save meters as float32"

_MAX_DIMENSIONS = 4

_MAX_MEMBERS = 64

_ZIP_ENTRY = b"PK\x01\x02"

_VERSION = 1

_OPTIONAL_COLUMNS = ("intensity", "ring", "azimuth", "time_s")

_BEAM_ARRAYS = ("elevation", "azimuth_offset", "origin_m")

_MODEL_LIMITS = ("azimuth_columns", "min_range_m", "max_range_m")


def parse_npy(content: bytes) -> NDArray[Any]:
    """Return the array of an NPY file, as a read-only view of ``content``.

    Raises:
        ValueError: it is no NPY file of plain numbers or text, or its header does not match its size.
    """
    if content[:6] != b"\x93NUMPY" or len(content) < 12:
        raise ValueError("is not an NPY array or is cut off")
    wide = content[6] > 1
    start = (12 if wide else 10) + int.from_bytes(content[8 : 12 if wide else 10], "little")
    match = _HEADER.fullmatch(content[12 if wide else 10 : start].decode("latin-1")) if start <= 10_012 else None
    if match is None:
        raise ValueError("NPY header is damaged or its type is not plain numbers (pickled and structured are refused)")
    kind = np.dtype(match[1])
    sizes = match[3].replace(",", " ").split()
    if len(sizes) > _MAX_DIMENSIONS or any(len(size) > 12 for size in sizes):
        raise ValueError(f"NPY shape must be up to {_MAX_DIMENSIONS} sizes of up to 12 digits")
    shape = tuple(map(int, sizes))
    count = 1
    for size in shape:
        count *= size
    actual = len(content) - start
    if count * kind.itemsize != actual:
        raise ValueError(f"NPY shape {shape} of {kind} needs {count * kind.itemsize} bytes, the array holds {actual}")
    flat = np.frombuffer(content, kind, count, start) if actual else np.empty(0, kind)
    return flat.reshape(shape, order="F" if match[2] == "True" else "C")


def read_npy(source: InputFile, frame: Rigid | None) -> Iterator[Columns]:
    """Yield the sweep of an NPY file of shape (N, 3+), in meters, or in millimeters if int32."""
    yield _columns_of_points(parse_npy(source.content()), frame)


def _columns_of_points(array: NDArray[Any], frame: Rigid | None) -> Columns:
    if not has_points_in_rows(array.shape):
        raise ValueError(f"points must have shape (N, 3) or more columns, got {array.shape}{shape_remedy(array.shape)}")
    if len(array) > MAX_POINTS:
        raise ValueError(f"a sweep must have at most {MAX_POINTS} points, got {len(array)}")
    if array.dtype.kind != "f" and array.dtype.str[1:] != "i4":
        raise ValueError(f"points must be floats (meters) or int32 (millimeters), got {array.dtype}")
    millimeters = array.dtype.kind == "i"
    if millimeters:
        warnings.warn(MILLIMETERS, Assumption, stacklevel=2)
    with np.errstate(over="ignore"):
        meters = array[:, :3] * 1e-3 if millimeters else array[:, :3]
        points, remaining = near_points(list(meters.T), IDENTITY if frame is None else frame)
        intensity = array[:, 3].astype(np.float32) if array.shape[1] > 3 and not millimeters else None
    return Columns(points, intensity, frame=remaining)


def read_npz(source: InputFile, frame: Rigid | None) -> Iterator[Columns]:
    """Yield the sweep of an NPZ file: its array ``points`` (N, 3+), or its only array.

    Files written by this package hold all attributes of the Sweep.
    """
    members = _members(source)
    columns = _columns_of_points(members["points"], frame)
    yield _with_attributes(columns, members) if "viewshed_sweep" in members else columns


def _members(source: InputFile) -> dict[str, NDArray[Any]]:
    """Return the known arrays of a zip file by name; a single array is named ``points``.

    Sizes are measured while decompressing, not taken from the headers.
    """
    limit = unpack_limit(source.size)
    members: dict[str, NDArray[Any]] = {}
    entries = source.content().count(_ZIP_ENTRY)  # counted before zipfile allocates an object for each
    if entries > _MAX_MEMBERS:
        raise ValueError(f"NPZ must have at most {_MAX_MEMBERS} arrays, got {entries}")
    try:
        with zipfile.ZipFile(source.file) as archive:
            names = [info.filename.removesuffix(".npy") for info in archive.infolist()]
            for name, info in zip(names, archive.infolist(), strict=True):
                if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                    raise ValueError("NPZ must be stored or deflated, not compressed in another way")
                if name in _KEYS or len(names) == 1:
                    with archive.open(info) as stream:
                        content = read_bounded(stream, limit)  # type: ignore[arg-type]
                    limit -= len(content)
                    members[name if name in _KEYS else "points"] = parse_npy(content)
    except ValueError:
        raise
    except Exception as error:  # zipfile and zlib raise a dozen types on damaged archives
        raise ValueError(f"NPZ is damaged or cut off: {error or type(error).__name__}") from error
    if "points" not in members:
        got = ", ".join(sorted(names)) or "none"
        raise ValueError(f"NPZ must have an array 'points' or a single one, got {got}; save it with points=…")
    return members


def _with_attributes(columns: Columns, members: Mapping[str, NDArray[Any]]) -> Columns:
    if int(members["viewshed_sweep"]) != _VERSION:
        raise ValueError(
            f"NPZ is of version {members['viewshed_sweep']} of viewshed's format, this one reads {_VERSION}"
        )
    saved: dict[str, Any] = {name: members[name] for name in ("attitude", "pose_covariance") if name in members} | {
        "agent": str(members["agent"]),
        "dropped_points": int(members["dropped_points"]),
    }
    singles = (("sensor_height_m", float), ("vehicle_yaw", float), ("infer_sensor", bool))
    saved |= {name: kind(members[name]) for name, kind in singles if name in members}
    if "world_from_sensor" in members:
        saved["world_from_sensor"] = Rigid.from_matrix(members["world_from_sensor"])
    if "open_m" in members:
        saved["planar"] = PlanarScan(members["open_azimuth"], float(members["open_m"]))
    t_ns = int(members["t_ns"]) if "t_ns" in members else None
    return Columns(
        columns.points, members.get("intensity"), members.get("ring"), azimuth=members.get("azimuth"),
        time_s=members.get("time_s"), t_ns=t_ns, model=_saved_model(members), frame=columns.frame, saved=saved
    )  # fmt: skip


def _saved_model(members: Mapping[str, NDArray[Any]]) -> LidarModel | None:
    if "model_name" not in members:
        return None
    elevation, offset, origin = (members[f"model_{key}"] for key in _BEAM_ARRAYS)
    limits = members["model_limits"].reshape(3)
    return LidarModel(
        str(members["model_name"]), elevation, int(limits[0]), offset, origin,
        float(limits[1]), float(limits[2]), str(members["model_source"]),
        float(members["model_reach_m"]) if "model_reach_m" in members else None,
        str(members.get("model_reach_source", "")), members.get("model_shots"),
        "model_fires_no_rings" not in members, bool(members.get("model_inferred", True)),
    )  # fmt: skip


_KEYS = {
    "points", *_OPTIONAL_COLUMNS, "viewshed_sweep", "t_ns", "attitude", "sensor_height_m", "world_from_sensor", "agent",
    "pose_covariance", "dropped_points", "open_azimuth", "open_m", "model_name", "model_source", "model_limits",
    "model_reach_m", "model_reach_source", "model_fires_no_rings", "model_shots", "model_inferred",
    "vehicle_yaw", "infer_sensor", *(f"model_{key}" for key in _BEAM_ARRAYS),
}  # fmt: skip


def write_npy(sweep: Sweep) -> bytes:
    """Encode a sweep as NPY: float32 points (N, 3), or (N, 4) with intensity; other attributes are lost."""
    table = sweep.points if sweep.intensity is None else np.column_stack((sweep.points, sweep.intensity))
    buffer = io.BytesIO()
    np.save(buffer, np.ascontiguousarray(table, "<f4"), allow_pickle=False)
    return buffer.getvalue()


def write_npz(sweep: Sweep) -> bytes:
    """Encode all attributes of a sweep as NPZ."""
    arrays: dict[str, Any] = {
        "viewshed_sweep": _VERSION, "points": sweep.points, "agent": sweep.agent,
        "dropped_points": sweep.dropped_points,
        "t_ns": sweep.t_ns, "attitude": sweep.attitude, "sensor_height_m": sweep.sensor_height_m,
        **{name: getattr(sweep, name) for name in _OPTIONAL_COLUMNS},
        "world_from_sensor": None if sweep.world_from_sensor is None else sweep.world_from_sensor.as_matrix(),
        "pose_covariance": sweep.pose_covariance, "vehicle_yaw": sweep.vehicle_yaw,
        "infer_sensor": None if sweep.infer_sensor else False,
    }  # fmt: skip
    if sweep.planar is not None:
        arrays |= {"open_azimuth": sweep.planar.open_azimuth, "open_m": sweep.planar.max_range_m}
    if sweep.model is not None:
        arrays |= {"model_name": sweep.model.name, "model_source": sweep.model.source}
        arrays |= {f"model_{key}": getattr(sweep.model, key) for key in _BEAM_ARRAYS}
        arrays |= {} if sweep.model.fires_rings else {"model_fires_no_rings": True}
        arrays |= {"model_shots": sweep.model.shots, "model_inferred": None if sweep.model.inferred else False}
        arrays |= {"model_reach_m": sweep.model.reach_m, "model_reach_source": sweep.model.reach_source}
        arrays["model_limits"] = np.array([getattr(sweep.model, key) for key in _MODEL_LIMITS], dtype=np.float64)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=4) as archive:
        for name, value in arrays.items():
            if value is not None:
                member = io.BytesIO()
                np.save(member, np.asarray(value), allow_pickle=False)
                archive.writestr(zipfile.ZipInfo(f"{name}.npy"), member.getvalue(), zipfile.ZIP_DEFLATED)
    return buffer.getvalue()
