"""Convert packet messages to sweeps: velodyne_msgs/VelodyneScan, and PacketMsg of Ouster's drivers.

Velodyne packets are decoded by velodyne-decoder, Ouster packets in numpy (:mod:`viewshed.io.ouster_packets`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from viewshed.io._columns import Columns
from viewshed.io.ouster_packets import OusterDecoder
from viewshed.io.velodyne import is_velodyne, revolution_of_packets
from viewshed.sweep import Sweep

UNSUPPORTED = {"nebula_msgs/msg/NebulaPackets": "packets of many makers"}
"""Unsupported types of LiDAR messages → description of their content."""

_MAX_PACKETS = 4096


class Time(Protocol):
    """A time stamp: seconds since 1970, and nanoseconds."""

    sec: int
    nanosec: int


class Packet(Protocol):
    """One packet of a scan: its arrival time and its bytes (1206 for Velodyne)."""

    stamp: Time
    data: NDArray[np.uint8]


class Scan(Protocol):
    """The fields that are read of a message with the packets of about one revolution."""

    packets: Sequence[Packet]


def check_count(scan: Scan) -> None:
    """Raise ValueError unless the number of packets of a scan is valid."""
    if not 0 < len(scan.packets) <= _MAX_PACKETS:
        raise ValueError(f"a scan must have 1 to {_MAX_PACKETS} packets, got {len(scan.packets)}")


class PacketMsg(Protocol):
    """One packet of an Ouster sensor."""

    buf: NDArray[np.uint8]


def sweep_of_velodyne(scan: Scan) -> Sweep:
    """Convert a message with the packets of about one revolution to a sweep.

    Points past one full turn are dropped.

    Raises:
        ValueError: there is no packet, one is no data packet, or their models differ or are unknown.
        ImportError: velodyne-decoder is not installed.
    """
    check_count(scan)
    packets = [(packet.stamp.sec + packet.stamp.nanosec * 1e-9, bytes(packet.data)) for packet in scan.packets]
    invalid = sum(not is_velodyne(payload) for _, payload in packets)
    if invalid:
        raise ValueError(f"{invalid} of {len(packets)} packets are no Velodyne data packets (1206 bytes from ff ee on)")
    return _sweep(revolution_of_packets(packets))


def sweep_of_ouster(messages: Sequence[PacketMsg], decoder: OusterDecoder) -> Sweep:
    """Convert the packets of one revolution (grouped by ``decoder.frame_number``) to a sweep.

    Raises:
        ValueError: one is no lidar packet of the decoder's sensor, or they are of several revolutions.
    """
    packets = [bytes(message.buf) for message in messages]
    numbers = {decoder.frame_number(packet) for packet in packets}
    if len(numbers) != 1 or None in numbers:
        raise ValueError("packets must be those of one revolution of the sensor that the metadata describe")
    return _sweep(decoder.decode(packets)[0])


def _sweep(columns: Columns) -> Sweep:
    return Sweep(
        columns.points, columns.intensity, columns.ring, columns.azimuth, columns.time_s, columns.t_ns,
        model=columns.model,
    )  # fmt: skip
