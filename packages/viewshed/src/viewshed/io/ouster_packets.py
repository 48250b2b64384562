"""Decode Ouster's lidar packets and captures (UDP payloads and the sensor's metadata) to revolutions, in numpy.

The metadata of a capture are in the ``.json`` file beside it.

Layouts follow Ouster's software user manual ("Lidar Data Packet Format"), geometry its "Lidar Range to XYZ"; tests
compare both with ouster-sdk.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.io._columns import IDENTITY, Columns
from viewshed.io._input import InputFile, one_line
from viewshed.io.velodyne import udp_payloads
from viewshed.sensors import LidarModel

_MAX_ROWS, _MAX_COLUMNS, _MAX_PIXELS = 512, 8192, 1 << 19  # 128 beams at 4096 columns; tables take 48 bytes a pixel


@dataclass(frozen=True, slots=True)
class PacketLayout:
    """Byte layout of a lidar packet: a header, columns (each with header, pixels and footer), a footer."""

    pixel: int  # bytes a pixel; only its first (or strongest) return is read
    range: str = "<u4"  # dtype of the range at byte 0 of a pixel
    range_bits: int = 19  # number of low bits that are the range
    unit_mm: int = 1  # millimeters a count of range
    reflectivity: int = 4  # byte offset of the reflectivity in a pixel, one byte
    signal: int | None = 6  # byte offset of the signal, two bytes; None if absent
    frame: tuple[int, str] = (2, "<u2")  # byte offset in the packet and dtype of the frame number
    # byte offsets in the packet of the initialization id (three bytes) and the serial number (five bytes); None if
    # absent
    sender: tuple[int, int] | None = (4, 7)
    header: int = 32  # bytes
    column_header: int = 12  # bytes
    column_footer: int = 0  # bytes
    footer: int = 32  # bytes


def _low_rate(pixel: int) -> PacketLayout:
    return PacketLayout(pixel, "<u2", 15, 8, 2, None)


PROFILES = {
    "LEGACY": PacketLayout(12, range_bits=20, frame=(10, "<u2"), sender=None, header=0, column_header=16,
                           column_footer=4, footer=0),
    "RNG19_RFL8_SIG16_NIR16": PacketLayout(12),
    "RNG19_RFL8_SIG16_NIR16_ZONE16": PacketLayout(12),
    "RNG19_RFL8_SIG16_NIR16_DUAL": PacketLayout(16, reflectivity=3, signal=8),
    "RNG15_RFL8_NIR8": _low_rate(4),
    "RNG15_RFL8_WIN8": _low_rate(4),
    "RNG15_RFL8_NIR8_DUAL": _low_rate(8),
    "RNG15_RFL8_NIR8_ZONE16": _low_rate(8),
    "FUSA_RNG15_RFL8_NIR8_DUAL": PacketLayout(8, "<u2", 15, 8, 2, None, frame=(4, "<u4"), sender=(1, 11)),
}  # fmt: skip
"""Layouts by the metadata's ``udp_profile_lidar``."""


@dataclass(frozen=True, slots=True, eq=False)
class OusterMetadata:
    """Metadata of a sensor: packet layout and beam geometry; the highest beam first."""

    profile: PacketLayout  # packet layout
    columns: int  # columns a revolution
    columns_per_packet: int  # columns a packet
    window: tuple[int, int]  # first and last measured column; the window wraps around if first > last
    altitude: NDArray[np.float64]  # (rows,) float64 radians above the sensor's horizon
    azimuth: NDArray[np.float64]  # (rows,) float64 radians from the column to the beam, counter-clockwise
    origin_mm: tuple[float, float]  # beam origin in the plane of its column: distance from the axis, height
    sensor_from_lidar: NDArray[np.float64]  # (4, 4) float64, millimeters
    product: str  # product line
    start: int  # initialization id, 0 if unknown
    serial: int  # serial number, 0 if unknown

    @classmethod
    def parse(cls, text: str) -> OusterMetadata:
        """Parse the metadata JSON of any firmware from 1.13 on.

        Raises:
            ValueError: it is not JSON, a value is missing or out of range, or the profile is unknown.
        """
        try:
            metadata = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise ValueError(f"is no JSON: {one_line(error, 80)}") from error
        if not isinstance(metadata, dict):
            raise ValueError(f"must be an object, got {type(metadata).__name__}")
        # Newer firmware groups the same entries in sections.
        groups = ("sensor_info", "beam_intrinsics", "lidar_intrinsics")
        flat = {**metadata, **{key: value for group in groups for key, value in _section(metadata, group).items()}}
        layout = _section(metadata, "data_format") or _section(metadata, "lidar_data_format")
        altitude, azimuth = _numbers(flat, "beam_altitude_angles"), _numbers(flat, "beam_azimuth_angles")
        rows = _integer(layout, "pixels_per_column", len(altitude), _MAX_ROWS)
        if len(altitude) != rows or len(azimuth) != rows:
            raise ValueError(f"must name {rows} beam angles of each kind, got {len(altitude)} and {len(azimuth)}")
        columns = _integer(layout, "columns_per_frame", _columns_of_mode(flat), _MAX_COLUMNS)
        if rows * columns > _MAX_PIXELS:
            raise ValueError(f"a revolution must have at most {_MAX_PIXELS} pixels, got {rows} × {columns}")
        profile = layout.get("udp_profile_lidar", "LEGACY")
        if not isinstance(profile, str) or profile not in PROFILES:
            raise ValueError(f"udp_profile_lidar must be one of {', '.join(PROFILES)}, got {one_line(profile, 40)}")
        return cls(
            PROFILES[profile], columns, _integer(layout, "columns_per_packet", 16, _MAX_COLUMNS),
            _window(layout, columns), np.deg2rad(altitude), -np.deg2rad(azimuth), _origin_mm(flat),
            _transform(flat, "lidar_to_sensor_transform", _SENSOR_FROM_LIDAR), str(flat.get("prod_line", "")),
            _number_or_0(flat, "initialization_id"), _number_or_0(flat, "prod_sn"),
        )  # fmt: skip


_SENSOR_FROM_LIDAR = (-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, 36.18, 0, 0, 0, 1)
"""Default if the metadata lack ``lidar_to_sensor_transform``."""


def _section(metadata: dict[str, Any], name: str) -> dict[str, Any]:
    section = metadata.get(name, {})
    if not isinstance(section, dict):
        raise ValueError(f"{name} must be an object, got {type(section).__name__}")
    return section


def _numbers(metadata: dict[str, Any], name: str) -> NDArray[np.float64]:
    values = metadata.get(name)
    if not isinstance(values, list) or not 1 <= len(values) <= _MAX_ROWS or not all(map(_is_finite, values)):
        raise ValueError(f"{name} must be a list of 1 to {_MAX_ROWS} numbers")
    return np.array(values, np.float64)


def _is_finite(value: object) -> bool:
    return isinstance(value, int | float) and bool(abs(value) < 1e6)


def _integer(metadata: dict[str, Any], name: str, default: int, maximum: int) -> int:
    value = metadata.get(name, default)
    if not isinstance(value, int) or not 1 <= value <= maximum:
        raise ValueError(f"{name} must be a whole number in [1, {maximum}], got {one_line(value, 40)}")
    return value


def _columns_of_mode(metadata: dict[str, Any]) -> int:
    """Return the number of columns of a ``lidar_mode`` such as 1024x10, 0 if unknown."""
    columns = str(metadata.get("lidar_mode", "")).partition("x")[0]
    return int(columns) if columns.isascii() and columns.isdigit() and len(columns) < 6 else 0


def _window(layout: dict[str, Any], columns: int) -> tuple[int, int]:
    window = layout.get("column_window", [0, columns - 1])
    fits = isinstance(window, list) and len(window) == 2
    if not fits or not all(isinstance(column, int) and 0 <= column < columns for column in window):
        raise ValueError(f"column_window must be two columns in [0, {columns}), got {one_line(window, 40)}")
    return window[0], window[1]


def _origin_mm(metadata: dict[str, Any]) -> tuple[float, float]:
    if "beam_to_lidar_transform" in metadata:
        transform = _transform(metadata, "beam_to_lidar_transform", ())
        return float(transform[0, 3]), float(transform[2, 3])
    radius_mm = metadata.get("lidar_origin_to_beam_origin_mm")
    if not _is_finite(radius_mm):
        raise ValueError(f"lidar_origin_to_beam_origin_mm must be a number, got {one_line(radius_mm, 40)}")
    return float(radius_mm), 0.0  # type: ignore[arg-type]


def _transform(metadata: dict[str, Any], name: str, default: tuple[float, ...]) -> NDArray[np.float64]:
    values = metadata.get(name, default)
    if len(values) != 16 if isinstance(values, list | tuple) else True:
        raise ValueError(f"{name} must be 16 numbers, got {one_line(values, 40)}")
    if not all(map(_is_finite, values)):
        raise ValueError(f"{name} must be finite numbers, got {one_line(values, 40)}")
    return np.array(values, np.float64).reshape(4, 4)


def _number_or_0(metadata: dict[str, Any], name: str) -> int:
    """Return a non-negative integer, given as number or text; 0 if it is missing or invalid."""
    text = str(metadata.get(name, ""))
    return int(text) if text.isascii() and text.isdigit() and len(text) < 16 else 0


class OusterDecoder:
    """Decodes the packets of one sensor, revolution by revolution.

    Args:
        metadata: of the sensor.
        frame: ``sensor_from_columns`` of the returned columns.
    """

    def __init__(self, metadata: OusterMetadata, frame: Rigid = IDENTITY) -> None:
        self.metadata, self.frame = metadata, frame
        self._packet = _packet_type(metadata)
        self._direction, self._start_m = _beams(metadata)
        self._rank = np.argsort(np.argsort(metadata.altitude))
        self._azimuth = _column_azimuth(metadata.columns)
        self._model = _model(metadata)

    @property
    def packet_bytes(self) -> int:
        """Length of a lidar packet; packets of another length are of another kind or sensor."""
        return self._packet.itemsize

    def frame_number(self, packet: bytes) -> int | None:
        """Return the frame (revolution) number of a packet; None if it is no lidar packet of this sensor."""
        profile = self.metadata.profile
        if len(packet) != self.packet_bytes:
            return None
        if profile.sender is not None:
            start, serial = (
                int.from_bytes(packet[offset : offset + size], "little")
                for offset, size in zip(profile.sender, (3, 5), strict=True)
            )
            # An id of 0 is unknown and matches any sensor.
            pairs = ((start, self.metadata.start), (serial, self.metadata.serial))
            if any(received and expected and received != expected for received, expected in pairs):
                return None
        offset, kind = profile.frame
        return int.from_bytes(packet[offset : offset + np.dtype(kind).itemsize], "little")

    def revolutions(self, packets: Iterable[bytes]) -> Iterator[Columns]:
        """Yield the complete revolutions of packets in order; if there is none, the last incomplete one.

        Late packets of the previous revolution are dropped, and so are packets that are not of this sensor.

        Raises:
            ValueError: there is no lidar packet of this sensor.
        """
        complete = 0
        incomplete = None
        for group in self.grouped(packets):
            columns, is_complete = self.decode(group)
            complete += is_complete
            if is_complete:
                yield columns
            else:
                incomplete = columns
        if incomplete is None and not complete:
            raise ValueError("holds no lidar packets that agree with the metadata")
        if incomplete is not None and not complete:
            yield incomplete

    def grouped(self, packets: Iterable[bytes]) -> Iterator[list[bytes]]:
        """Yield lists of the packets of each revolution."""
        group: list[bytes] = []
        current = previous = None
        for packet in packets:
            number = self.frame_number(packet)
            if number is None or number == previous:  # no packet of this sensor, or a late one
                continue
            if number != current and group:
                yield group
                group, previous = [], current
            current = number
            group.append(packet)
        if group:
            yield group

    def decode(self, packets: list[bytes]) -> tuple[Columns, bool]:
        """Decode the packets of one revolution; return its returns, column by column, and whether it is complete."""
        columns = np.frombuffer(b"".join(packets), self._packet)["columns"].reshape(-1)
        valid = ((columns["status"] & 1) > 0) & (columns["number"] < self.metadata.columns)
        # If a column was sent twice, the later one is used.
        last = np.full(self.metadata.columns, -1)
        last[columns["number"][valid]] = np.flatnonzero(valid)
        numbers = np.flatnonzero(last >= 0)
        columns = columns[last[numbers]]
        pixels, profile = columns["pixels"], self.metadata.profile
        range_mm = (pixels["range"] & (2**profile.range_bits - 1)).astype(np.float64) * profile.unit_mm
        index, row = np.nonzero(range_mm)
        column = numbers[index]
        points = range_mm[index, row, None] * 1e-3 * self._direction[column, row] + self._start_m[column, row]
        stamp = columns["stamp"].astype(np.int64)
        start = int(stamp.min()) if len(stamp) else 0
        return Columns(
            points.astype(np.float32), pixels["intensity"][index, row].astype(np.float32),
            ring=self._rank[row].astype(np.int16), azimuth=self._azimuth[column],
            time_s=((stamp[index] - start) * 1e-9).astype(np.float32), t_ns=start, model=self._model, frame=self.frame,
        ), self._is_complete(last >= 0)  # fmt: skip

    def _is_complete(self, valid: NDArray[np.bool_]) -> bool:
        first, last = self.metadata.window
        return bool(valid[first : last + 1].all() if first <= last else valid[first:].all() and valid[: last + 1].all())


def _packet_type(metadata: OusterMetadata) -> np.dtype[Any]:
    """Return the structured dtype of a packet."""
    profile = metadata.profile
    intensity = (profile.reflectivity, "u1") if profile.signal is None else (profile.signal, "<u2")
    pixel = np.dtype({
        "names": ["range", "intensity"], "formats": [profile.range, intensity[1]], "offsets": [0, intensity[0]],
        "itemsize": profile.pixel,
    })  # fmt: skip
    rows = len(metadata.altitude)
    pixels_end = profile.column_header + rows * profile.pixel
    # The status of a column follows its pixels in the legacy layout, and is in its header in all others.
    status = (pixels_end, "<u4") if profile.column_footer else (10, "<u2")
    column = np.dtype({
        "names": ["stamp", "number", "status", "pixels"], "formats": ["<u8", "<u2", status[1], (pixel, (rows,))],
        "offsets": [0, 8, status[0], profile.column_header], "itemsize": pixels_end + profile.column_footer,
    })  # fmt: skip
    count = metadata.columns_per_packet
    return np.dtype({
        "names": ["columns"], "formats": [(column, (count,))], "offsets": [profile.header],
        "itemsize": profile.header + count * column.itemsize + profile.footer,
    })  # fmt: skip


def _beams(metadata: OusterMetadata) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the beam directions (columns, rows, 3) in the sensor's frame, and their points at range 0 in meters."""
    angle = 2 * np.pi * (1 - np.arange(metadata.columns) / metadata.columns)[:, None]
    azimuth = angle + metadata.azimuth
    altitude = np.broadcast_to(metadata.altitude, azimuth.shape)
    direction = np.stack(
        [np.cos(azimuth) * np.cos(altitude), np.sin(azimuth) * np.cos(altitude), np.sin(altitude)], axis=-1
    )
    # Ranges count from the lidar origin, not from the beam origin: subtract the distance between them.
    out_mm, up_mm = metadata.origin_mm
    origin_mm = np.stack([out_mm * np.cos(angle), out_mm * np.sin(angle), np.full_like(angle, up_mm)], axis=-1)
    start_mm = origin_mm - direction * np.hypot(out_mm, up_mm)
    rotation, translation = metadata.sensor_from_lidar[:3, :3], metadata.sensor_from_lidar[:3, 3]
    return direction @ rotation.T, (start_mm @ rotation.T + translation) * 1e-3


_RANGES_M: dict[str, tuple[float, float | None, str]] = {
    "OS-0": (50.0, 22.0, "Ouster OS0 datasheet, 10 % target"),
    "OS-1": (120.0, 45.0, "Ouster OS1 datasheet, 10 % target"),
    "OS-2": (240.0, 80.0, "Ouster OS2 datasheet, 10 % target"),
}
"""First letters of the product line → maximum range, reach and source of the reach; the metadata state neither."""


def _model(metadata: OusterMetadata) -> LidarModel | None:
    """Return the beam table of the metadata, or None if two beams have the same elevation."""
    order = np.argsort(metadata.altitude)
    altitude = metadata.altitude[order]
    if (np.diff(altitude) <= 0).any():
        return None
    # Beams start on a circle around the axis; extended backward, they meet the axis at another height.
    shift_m = float(metadata.sensor_from_lidar[2, 3]) * 1e-3
    max_range_m, reach_m, source = _RANGES_M.get(metadata.product[:4], (300.0, None, ""))
    return LidarModel(
        name=metadata.product or "Ouster", elevation=altitude, azimuth_columns=metadata.columns,
        azimuth_offset=metadata.azimuth[order],
        origin_m=shift_m - float(metadata.origin_mm[0]) * 1e-3 * np.tan(altitude), min_range_m=0.3,
        max_range_m=max_range_m, source="metadata of the sensor", reach_m=reach_m, reach_source=source,
    )  # fmt: skip


def _column_azimuth(columns: int) -> NDArray[np.float32]:
    """Return the encoder angle of each column in the sensor's frame: 2 π (1 - column / columns) + π, clockwise."""
    angle = np.pi - 2 * np.pi * np.arange(columns) / columns
    return np.where(angle <= -np.pi, angle + 2 * np.pi, angle).astype(np.float32)


_MAX_METADATA_BYTES = 1_000_000


def metadata_path(path: str) -> Path:
    """Return the path of the metadata of a capture: the same name with suffix ``.json``.

    >>> metadata_path("drive/a.pcap.gz").as_posix()
    'drive/a.json'
    """
    file = Path(path)
    return (file.with_suffix("") if file.suffix.lower() == ".gz" else file).with_suffix(".json")


def read_ouster(source: InputFile, frame: Rigid | None) -> Iterator[Columns]:
    """Yield the complete revolutions of an Ouster capture in the sensor's frame; if there is none, an incomplete one.

    Ring 0 is the lowest beam; azimuth is the encoder angle of the column, without the azimuth offset of each beam.
    """
    content = source.content()
    metadata = read_metadata(metadata_path(source.path))
    decoder = OusterDecoder(metadata, IDENTITY if frame is None else frame)
    return decoder.revolutions(payload for _, payload in udp_payloads(content))


def read_metadata(path: Path) -> OusterMetadata:
    """Read a metadata file.

    Raises:
        ValueError: it is missing, too large, or not Ouster metadata.
    """
    try:
        with path.open("rb") as file:
            raw = file.read(_MAX_METADATA_BYTES + 1)
    except OSError as error:
        raise ValueError(f"an Ouster capture needs its metadata in {path.name}: {error.strerror}") from error
    if len(raw) > _MAX_METADATA_BYTES:
        raise ValueError(f"{path.name} must be at most {_MAX_METADATA_BYTES} bytes of Ouster metadata")
    try:
        return OusterMetadata.parse(raw.decode("utf-8"))
    except ValueError as error:
        raise ValueError(f"{path.name} must be Ouster metadata: {one_line(error)}") from error
