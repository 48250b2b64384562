"""PandarScan of Hesai's drivers: the packets of PandarXT-16, PandarXT-32 and PandarQT64, as a Sweep.

These three share a layout (user manuals of the makers): 12 bytes of header, blocks of an azimuth in hundredths of a
degree clockwise and four bytes for each laser (range, reflectivity, and one that is not read), 28 bytes of tail.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from viewshed.io.messages.packets import Packet, Scan, check_count
from viewshed.sensors import lidar_model
from viewshed.sweep import Sweep

PANDAR = ("pandar_msgs/msg/PandarScan", "hesai_lidar/msg/PandarScan")
"""Types of the messages that hold them."""

_HEADER_BYTES, _TAIL_BYTES = 12, 28

_TABLES = {(16, 8): "xt16", (32, 8): "xt32", (64, 4): "qt64"}
"""Beam tables by the numbers of lasers and of blocks in a packet."""

_TOP_FIRST = ("xt16", "xt32")
"""Sensors that number their lasers from the highest."""


class PandarScan(Scan, Protocol):
    """The part of the message that is read; ``size`` says how many bytes of a packet count."""

    packets: Sequence[PandarPacket]


class PandarPacket(Packet, Protocol):
    """One packet of a scan."""

    size: int


def sweep_of_hesai(scan: PandarScan) -> Sweep:
    """Return the sweep (N returns, meters) of a message, which holds the packets of about one revolution.

    Axes are those of the drivers: y where the azimuth is zero, x a quarter turn clockwise of it. Of two returns of a
    beam both are kept, a repeated one once. Times are those of the packets. Angles are those of the beam table, which
    are of another unit: PandarQT64 differ by tenths of a degree.

    Raises:
        ValueError: there is no packet, one is cut off or of another sensor, or they are of different ones.
    """
    check_count(scan)
    payloads = [bytes(each.data[: each.size]) for each in scan.packets]
    lasers, blocks, unit_mm = _layout(payloads[0])
    length = _HEADER_BYTES + blocks * (2 + 4 * lasers) + _TAIL_BYTES
    if any(_layout(payload) != (lasers, blocks, unit_mm) or len(payload) != length for payload in payloads):
        raise ValueError(f"packets must all be of one sensor, of {length} bytes each")

    # Blocks (packets, blocks): azimuth, then (lasers, 4) bytes.
    block = np.dtype([("azimuth", "<u2"), ("beam", [("range", "<u2"), ("reflectivity", "u1"), ("_", "u1")], lasers)])
    table = np.array([np.frombuffer(payload, block, blocks, _HEADER_BYTES) for payload in payloads])
    fired = np.array([each.stamp.sec * 10**9 + each.stamp.nanosec for each in scan.packets], np.int64)

    # Rows of returns: the second return of a beam is in the block after, with the same azimuth.
    counts = table["beam"]["range"]
    repeated = np.zeros(counts.shape, np.bool_)
    repeated[:, 1:] = (table["azimuth"][:, 1:] == table["azimuth"][:, :-1])[..., None] & (
        counts[:, 1:] == counts[:, :-1]
    )
    packet, row, laser = np.nonzero((counts > 0) & ~repeated)
    name = _TABLES[lasers, blocks]
    model = lidar_model(name)
    ring = lasers - 1 - laser if name in _TOP_FIRST else laser

    # Tables turn counter-clockwise, the encoder clockwise.
    range_m = counts[packet, row, laser] * (1e-3 * unit_mm)
    clockwise = np.deg2rad(0.01 * table["azimuth"][packet, row]) - model.azimuth_offset[ring]
    across_m = range_m * np.cos(model.elevation[ring])
    points = np.stack(
        [across_m * np.sin(clockwise), across_m * np.cos(clockwise), range_m * np.sin(model.elevation[ring])], axis=-1
    )
    return Sweep(
        points.astype(np.float32), table["beam"]["reflectivity"][packet, row, laser].astype(np.float32),
        ring.astype(np.int16), time_s=(1e-9 * (fired - fired.min())[packet]).astype(np.float32),
        t_ns=int(fired.min()), model=model,
    )  # fmt: skip


def _layout(payload: bytes) -> tuple[int, int, int]:
    """Return lasers, blocks and millimeters a count, as the header says them."""
    if len(payload) < _HEADER_BYTES or payload[:2] != b"\xee\xff":
        raise ValueError(f"Hesai packets must begin with ee ff, got {payload[:2].hex(' ')}")
    lasers, blocks, unit_mm = payload[6], payload[7], payload[9]
    if (lasers, blocks) not in _TABLES:
        raise ValueError(
            f"Hesai packets must be of PandarXT-16, PandarXT-32 or PandarQT64, got {lasers} lasers in {blocks} blocks;"
            " record PointCloud2"
        )
    return lasers, blocks, unit_mm
