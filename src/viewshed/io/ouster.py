"""Ouster captures: pcap and the sensor's metadata in the ``.json`` beside it, decoded by ouster-sdk."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed._extras import needed_for
from viewshed.geometry import Rigid
from viewshed.io._columns import IDENTITY, Columns
from viewshed.io._input import InputFile, one_line
from viewshed.io.velodyne import udp_payloads
from viewshed.sensors import LidarModel

_METADATA_BYTES = 1_000_000

_ROWS_MAX, _COLUMNS_MAX, _PIXELS_MAX = 512, 8192, 1 << 19  # 128 beams at 4096 columns; tables take 48 bytes a pixel


def metadata_path(path: str) -> Path:
    """Return where the metadata of a capture lies: the same name with ``.json``.

    >>> metadata_path("drive/a.pcap.gz").as_posix()
    'drive/a.json'
    """
    file = Path(path)
    return (file.with_suffix("") if file.suffix.lower() == ".gz" else file).with_suffix(".json")


def read_ouster(source: InputFile, frame: Rigid | None) -> Iterator[Columns]:
    """Yield the revolutions of an Ouster capture, in the sensor's frame; incomplete ones only where there is no other.

    Ring 0 is the lowest beam; azimuth is the encoder's angle of the column, without the beams' own offsets.
    """
    content = source.content()
    with needed_for("reading Ouster packets"):
        from ouster.sdk import core
    info = _sensor_info(core, metadata_path(source.path))
    yield from _revolutions(core, info, content, IDENTITY if frame is None else frame)


def _sensor_info(core: Any, path: Path) -> Any:
    try:
        with path.open("rb") as file:
            raw = file.read(_METADATA_BYTES + 1)
    except OSError as error:
        raise ValueError(f"an Ouster capture needs its metadata in {path.name}: {error.strerror}") from error
    if len(raw) > _METADATA_BYTES:
        raise ValueError(f"{path.name} must be at most {_METADATA_BYTES} bytes of Ouster metadata")
    try:
        text = raw.decode("utf-8")
        _check_shape(json.loads(text))
        return core.SensorInfo(text)
    except (RecursionError, Exception) as error:  # the SDK raises its own types on metadata it cannot use
        raise ValueError(f"{path.name} must be Ouster metadata: {error}") from error


def _check_shape(metadata: Any) -> None:
    """Refuse image sizes out of range wherever the metadata says them, before the SDK allocates."""
    limits = {"pixels_per_column": _ROWS_MAX, "columns_per_frame": _COLUMNS_MAX, "columns_per_packet": _COLUMNS_MAX}
    largest = dict.fromkeys(limits, 1)
    stack = [metadata]
    while stack:
        node = stack.pop()
        if isinstance(node, list):
            stack += node
        if not isinstance(node, dict):
            continue
        stack += node.values()
        for key in limits.keys() & node.keys():
            value = node[key]
            if not (isinstance(value, int) and 1 <= value <= limits[key]):
                raise ValueError(f"{key} must be a whole number in [1, {limits[key]}], got {one_line(value, 40)}")
            largest[key] = max(largest[key], value)
    if largest["pixels_per_column"] * largest["columns_per_frame"] > _PIXELS_MAX:
        raise ValueError(f"a revolution must have at most {_PIXELS_MAX} pixels, got {largest}")


def _revolutions(core: Any, info: Any, content: bytes, frame: Rigid) -> Iterator[Columns]:
    model = _model(info)
    lut = core.XYZLut(info, False)
    complete = 0
    rest = None
    for image in _images(core, info, content):
        if image.complete(info.format.column_window):
            complete += 1
            yield _columns(core, info, image, lut(image), model, frame)
        else:
            rest = image
    if not complete and rest is not None:
        yield _columns(core, info, rest, lut(rest), model, frame)
    elif not complete:
        raise ValueError("holds no lidar packets that agree with the metadata beside it")


def _images(core: Any, info: Any, content: bytes) -> Iterator[Any]:
    """Yield the range images of a capture, by frame number; late packets of the frame before are left out."""
    packet = core.LidarPacket(core.PacketFormat(info))
    size = len(packet.buf)
    image = number = last = None
    batcher: Any = None
    for _, payload in udp_payloads(content):
        if len(payload) != size:
            continue
        packet.buf[:] = np.frombuffer(payload, np.uint8)
        if packet.validate(info) != core.PacketValidationFailure.NONE or packet.frame_id() == last:
            continue
        if packet.frame_id() != number:
            if image is not None:
                yield image
            last, number = number, packet.frame_id()
            batcher, image = core.FrameBatcher(info), core.LidarFrame(info)
        batcher.batch(packet, image)
    if image is not None:
        yield image


_RANGES_M: dict[str, tuple[float, float | None, str]] = {
    "OS-0": (50.0, 22.0, "Ouster OS0 datasheet, 10 % target"),
    "OS-1": (120.0, 45.0, "Ouster OS1 datasheet, 10 % target"),
    "OS-2": (240.0, 80.0, "Ouster OS2 datasheet, 10 % target"),
}
"""Beginning of the product line → maximum range, reach and where the reach comes from; the metadata tell neither."""


def _model(info: Any) -> LidarModel | None:
    """Return the beams as the metadata describe them, or None where two beams share one elevation."""
    altitude = np.deg2rad(np.asarray(info.beam_altitude_angles, dtype=np.float64))
    order = np.argsort(altitude)
    if (np.diff(altitude[order]) <= 0).any():
        return None
    # Beams start on a circle around the axis, so that they meet the axis below the height at which they start.
    shift_m = float(info.lidar_to_sensor_transform[2, 3]) * 1e-3
    radius_m = float(info.lidar_origin_to_beam_origin_mm) * 1e-3
    most_m, reach_m, source = _RANGES_M.get(str(info.prod_line)[:4], (300.0, None, ""))
    return LidarModel(
        name=str(info.prod_line), elevation=altitude[order], azimuth_columns=int(info.format.columns_per_frame),
        azimuth_offset=-np.deg2rad(np.asarray(info.beam_azimuth_angles, dtype=np.float64))[order],
        origin_m=shift_m - radius_m * np.tan(altitude[order]), min_range_m=0.3, max_range_m=most_m,
        source="metadata beside the capture", reach_m=reach_m, reach_source=source,
    )  # fmt: skip


def _columns(core: Any, info: Any, image: Any, xyz: NDArray[np.float64], model: Any, frame: Rigid) -> Columns:
    """Return the columns of one range image; beams without a return are left out, order is column by column."""
    hit = (image.field(core.ChanField.RANGE) > 0) & ((image.status & 1) > 0)[None, :]
    column, row = np.nonzero(hit.T)
    rank = np.argsort(np.argsort(np.asarray(info.beam_altitude_angles)))
    azimuth = _column_azimuth(hit.shape[1])
    valid = image.timestamp[(image.status & 1) > 0]
    start = int(valid.min()) if valid.size else 0
    since = (image.timestamp[column].astype(np.int64) - start).astype(np.float64) * 1e-9
    reflectivity = next((name for name in ("SIGNAL", "REFLECTIVITY") if name in list(image.fields)), None)
    return Columns(
        xyz[row, column].astype(np.float32),
        None if reflectivity is None else image.field(reflectivity)[row, column].astype(np.float32),
        ring=rank[row].astype(np.int16), azimuth=azimuth[column], time_s=since.astype(np.float32),
        t_ns=start, model=model, frame=frame,
    )  # fmt: skip


def _column_azimuth(columns: int) -> NDArray[np.float32]:
    """Return the encoder's angle of each column in the sensor's frame: 2 π (1 - column / columns) + π, clockwise."""
    angle = np.pi - 2 * np.pi * np.arange(columns) / columns
    return np.where(angle <= -np.pi, angle + 2 * np.pi, angle).astype(np.float32)
