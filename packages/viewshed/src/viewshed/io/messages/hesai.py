"""Convert PandarScan of Hesai's drivers (packets of PandarXT-16, PandarXT-32 and PandarQT64) to a Sweep.

The three sensors share a packet layout (user manuals of Hesai): 12 bytes of header, blocks of an azimuth (hundredths
of a degree, clockwise) and four bytes a laser (range, reflectivity, and one that is not read), 28 bytes of tail.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from viewshed.io.messages.packets import Packet, Scan, check_count
from viewshed.sensors import lidar_model
from viewshed.sweep import Sweep

PANDAR = ("pandar_msgs/msg/PandarScan", "hesai_lidar/msg/PandarScan")
"""Message types of PandarScan."""

_HEADER_BYTES, _TAIL_BYTES = 12, 28

_TABLES = {(16, 8): "xt16", (32, 8): "xt32", (64, 4): "qt64"}
"""(lasers, blocks) of a packet → beam table."""

_HIGHEST_FIRST = ("xt16", "xt32")
"""Sensors whose laser 0 is the highest."""


class PandarScan(Scan, Protocol):
    """The field of the message that is read."""

    packets: Sequence[PandarPacket]


class PandarPacket(Packet, Protocol):
    """One packet of a scan; ``size`` is the number of valid bytes in ``data``."""

    size: int


def sweep_of_hesai(scan: PandarScan) -> Sweep:
    """Convert a message with the packets of about one revolution to a sweep (N returns, meters).

    Axes are those of the drivers: y at azimuth zero, x a quarter turn clockwise from it. Both returns of a beam are
    kept, unless they are equal. Times are those of the packets. Angles are those of the beam table, which come from
    another unit: PandarQT64 sensors differ by tenths of a degree.

    Raises:
        ValueError: there is no packet, one is cut off or of an unsupported sensor, or the sensors differ.
    """
    check_count(scan)
    payloads = [bytes(packet.data[: packet.size]) for packet in scan.packets]
    lasers, blocks, unit_mm = _layout(payloads[0])
    length = _HEADER_BYTES + blocks * (2 + 4 * lasers) + _TAIL_BYTES
    if any(_layout(payload) != (lasers, blocks, unit_mm) or len(payload) != length for payload in payloads):
        raise ValueError(f"packets must all be of one sensor, of {length} bytes each")

    # Blocks (packets, blocks): azimuth, then (lasers, 4) bytes.
    block = np.dtype([("azimuth", "<u2"), ("beam", [("range", "<u2"), ("reflectivity", "u1"), ("_", "u1")], lasers)])
    table = np.array([np.frombuffer(payload, block, blocks, _HEADER_BYTES) for payload in payloads])
    stamps_ns = np.array([packet.stamp.sec * 10**9 + packet.stamp.nanosec for packet in scan.packets], np.int64)

    # Drop repeated returns: the second return of a beam is in the next block, with the same azimuth.
    range_counts = table["beam"]["range"]
    repeated = np.zeros(range_counts.shape, np.bool_)
    repeated[:, 1:] = (table["azimuth"][:, 1:] == table["azimuth"][:, :-1])[..., None] & (
        range_counts[:, 1:] == range_counts[:, :-1]
    )
    packet, row, laser = np.nonzero((range_counts > 0) & ~repeated)
    name = _TABLES[lasers, blocks]
    model = lidar_model(name)
    ring = lasers - 1 - laser if name in _HIGHEST_FIRST else laser

    # Azimuth offsets of the table are counter-clockwise, the encoder is clockwise.
    range_m = range_counts[packet, row, laser] * (1e-3 * unit_mm)
    clockwise = np.deg2rad(0.01 * table["azimuth"][packet, row]) - model.azimuth_offset[ring]
    across_m = range_m * np.cos(model.elevation[ring])
    points = np.stack(
        [across_m * np.sin(clockwise), across_m * np.cos(clockwise), range_m * np.sin(model.elevation[ring])], axis=-1
    )
    return Sweep(
        points.astype(np.float32), table["beam"]["reflectivity"][packet, row, laser].astype(np.float32),
        ring.astype(np.int16), time_s=(1e-9 * (stamps_ns - stamps_ns.min())[packet]).astype(np.float32),
        t_ns=int(stamps_ns.min()), model=model,
    )  # fmt: skip


def _layout(payload: bytes) -> tuple[int, int, int]:
    """Return the number of lasers, the number of blocks, and millimeters a count, from the header."""
    if len(payload) < _HEADER_BYTES or payload[:2] != b"\xee\xff":
        raise ValueError(f"Hesai packets must begin with ee ff, got {payload[:2].hex(' ')}")
    lasers, blocks, unit_mm = payload[6], payload[7], payload[9]
    if (lasers, blocks) not in _TABLES:
        raise ValueError(
            f"Hesai packets must be of PandarXT-16, PandarXT-32 or PandarQT64, got {lasers} lasers in {blocks} blocks;"
            " record PointCloud2"
        )
    return lasers, blocks, unit_mm
