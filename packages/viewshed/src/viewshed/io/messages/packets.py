"""Raw packets in messages as sweeps: velodyne_msgs/VelodyneScan, and PacketMsg of Ouster's drivers.

Packets of Velodyne are decoded by velodyne-decoder, those of Ouster by numpy alone
(:mod:`viewshed.io.ouster_packets`).
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

UNREAD = {"nebula_msgs/msg/NebulaPackets": "packets of many makers"}
"""Types of messages that hold a LiDAR's returns and are not read, and what they hold."""

_PACKETS_MAX = 4096


class Time(Protocol):
    """A stamp: seconds since 1970, and nanoseconds."""

    sec: int
    nanosec: int


class Packet(Protocol):
    """One packet of a scan: when it came, and its bytes, 1206 of a Velodyne's."""

    stamp: Time
    data: NDArray[np.uint8]


class Scan(Protocol):
    """The part that is read of a message with the packets of about one revolution."""

    packets: Sequence[Packet]


def check_count(scan: Scan) -> None:
    """Raise a ValueError unless a scan has a packet, and no more than a revolution has."""
    if not 0 < len(scan.packets) <= _PACKETS_MAX:
        raise ValueError(f"a scan must have 1 to {_PACKETS_MAX} packets, got {len(scan.packets)}")


class PacketMsg(Protocol):
    """One packet of an Ouster sensor."""

    buf: NDArray[np.uint8]


def sweep_of_velodyne(scan: Scan) -> Sweep:
    """Return the sweep of a message, which holds the packets of about one revolution.

    What it holds beyond one turn is left out.

    Raises:
        ValueError: there is no packet, one is no data packet, or they are of different or unknown models.
        ImportError: velodyne-decoder is not installed.
    """
    check_count(scan)
    packets = [(each.stamp.sec + each.stamp.nanosec * 1e-9, bytes(each.data)) for each in scan.packets]
    strangers = sum(not is_velodyne(payload) for _, payload in packets)
    if strangers:
        raise ValueError(
            f"{strangers} of {len(packets)} packets are no Velodyne data packets (1206 bytes from ff ee on)"
        )
    return _sweep(revolution_of_packets(packets))


def sweep_of_ouster(messages: Sequence[PacketMsg], decoder: OusterDecoder) -> Sweep:
    """Return the sweep of the packets of one revolution (``decoder.frame_number`` tells which belong together).

    Raises:
        ValueError: none of them is a lidar packet of the decoder's sensor, or they are of several revolutions.
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
