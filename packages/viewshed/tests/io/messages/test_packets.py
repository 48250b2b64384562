"""Messages of packets: scans of a VLP-16, revolutions of an Ouster sensor, and what cannot be one."""

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed.io.messages.packets import Time, VelodynePacket, sweep_of_ouster, sweep_of_velodyne
from viewshed.io.ouster_packets import OusterDecoder, OusterMetadata

files: Any = import_module("sweep_files")


@dataclass
class Stamp:
    sec: int
    nanosec: int


@dataclass
class Packet:
    stamp: Time
    data: NDArray[np.uint8]


@dataclass
class Scan:
    packets: Sequence[VelodynePacket]


@dataclass
class PacketMsg:
    buf: NDArray[np.uint8]


def scan_of(payloads: list[bytes]) -> Scan:
    """Return a message of payloads that came a millisecond apart from second 100 on."""
    stamps = [Stamp(100, 1_000_000 * k) for k in range(len(payloads))]
    return Scan([Packet(stamp, np.frombuffer(each, np.uint8)) for stamp, each in zip(stamps, payloads, strict=True)])


def test_a_scan_of_a_vlp16() -> None:
    sweep = sweep_of_velodyne(scan_of(files.vlp16_turns(turns=1.0, distance_m=5.0)))
    assert sweep.model.rings == 16
    np.testing.assert_allclose(np.linalg.norm(sweep.points, axis=1), 5.0, atol=0.03)
    elevation = np.rad2deg(np.arcsin(sweep.points[:, 2] / np.linalg.norm(sweep.points, axis=1)))
    np.testing.assert_allclose(elevation, 2.0 * sweep.ring - 15.0, atol=0.3)
    assert 0.9 < len(sweep) / (16 * 300) <= 1.0
    assert sweep.time_s.min() == 0
    assert abs(sweep.t_ns - 100 * 10**9) < 10**8  # the first point, by the sensor's clock before the last packet


def test_what_a_scan_holds_beyond_one_turn_is_left_out() -> None:
    one, more = (sweep_of_velodyne(scan_of(files.vlp16_turns(turns=turns))) for turns in (1.0, 1.1))
    assert abs(len(more) - 16 * 300) < 16 * 8
    assert len(one) <= len(more)


def changed(payload: bytes, at: int, value: int) -> bytes:
    return payload[:at] + bytes([value]) + payload[at + 1 :]


TURN = files.vlp16_turns(turns=1.0)


@pytest.mark.parametrize(
    ("payloads", "message"),
    [
        ([], r"a scan must have 1 to 4096 packets, got 0"),
        ([TURN[0]] * 4097, r"a scan must have 1 to 4096 packets, got 4097"),
        ([*TURN, TURN[0][:-1]], "1 of 13 packets are no Velodyne data packets"),
        ([*TURN, bytes(512)], "1 of 13 packets are no Velodyne data packets"),
        ([changed(TURN[0], 1100, 0)], "1 of 1 packets are no Velodyne data packets"),
        ([*TURN, changed(TURN[0], 1205, 0x21)], "packets must be of one model, got products 0x21, 0x22"),
        ([changed(TURN[0], 1205, 0x77)], "Velodyne product must be HDL32E, .* got id 0x77"),
    ],
)
def test_packets_that_are_no_scan_are_refused(payloads: list[bytes], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        sweep_of_velodyne(scan_of(payloads))


def test_a_revolution_of_an_ouster_sensor() -> None:
    decoder = OusterDecoder(OusterMetadata.parse(files.ouster_metadata().decode()))
    messages = [PacketMsg(np.frombuffer(each, np.uint8)) for each in files.ouster_payloads(frames=2)]
    sweep = sweep_of_ouster(messages[:4], decoder)
    assert len(sweep) == 32 * 64
    assert sweep.t_ns == 1_000_000_000
    assert sweep.model.rings == 32
    np.testing.assert_allclose(np.linalg.norm(sweep.points, axis=1), 5.0, atol=0.05)
    for wrong in (messages, [], [*messages[:4], PacketMsg(np.zeros(48, np.uint8))]):
        with pytest.raises(ValueError, match="packets must be those of one revolution of the sensor"):
            sweep_of_ouster(wrong, decoder)


def test_messages_need_numpy_alone() -> None:
    code = """
import json, sys
import viewshed.io.messages.laserscan, viewshed.io.messages.packets, viewshed.io.messages.pointcloud2
print(json.dumps(sorted(name for name in sys.modules)))
"""
    loaded = json.loads(subprocess.run((sys.executable, "-c", code), check=True, capture_output=True).stdout)
    heavy = ("rosbags", "velodyne_decoder", "ouster", "numba", "scipy", "pyarrow", "onnxruntime", "shapely", "mcap")
    assert not [name for name in loaded if name.startswith(("viewshed_lab.data", *heavy))]
