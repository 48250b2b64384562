"""Packets of Velodyne and Ouster sensors: captures, whole and in fragments, and messages; what cannot be one."""

import json
import struct
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from viewshed import Sweep
from viewshed.io import read_sweep, read_sweeps
from viewshed.io.messages.packets import sweep_of_ouster, sweep_of_velodyne
from viewshed.io.ouster_packets import OusterDecoder, OusterMetadata
from viewshed.io.velodyne import udp_payloads

files: Any = import_module("sweep_files")


@pytest.mark.parametrize("order", ["<", ">"])
def test_payloads_come_out_of_a_capture_in_order(order: str) -> None:
    payloads = [bytes([number]) * (number + 1) for number in range(5)]
    capture = files.pcap([files.ip_packet(files.udp_packet(one)) for one in payloads], order)
    found = list(udp_payloads(capture))
    assert [one for _, one in found] == payloads
    np.testing.assert_allclose([time for time, _ in found], 1000 + 0.001 * np.arange(5))


def test_fragments_are_joined_also_out_of_order_and_mixed() -> None:
    first, second = bytes(range(256)) * 30, bytes(reversed(range(256))) * 20
    a, b = files.fragments(first, number=1), files.fragments(second, number=2)
    assert len(a) > 3
    assert [one for _, one in udp_payloads(files.pcap([a[1], b[0], a[-1], *b[1:], a[0], *a[2:-1]]))] == [second, first]
    assert list(udp_payloads(files.pcap(a[:-1]))) == []


def test_other_packets_are_skipped() -> None:
    good = files.ip_packet(files.udp_packet(b"abc"))
    tcp = good[:23] + b"\x06" + good[24:]
    arp = good[:12] + b"\x08\x06" + good[14:]
    tagged = good[:12] + b"\x81\x00\x00\x05" + good[12:]
    lying = files.ip_packet(struct.pack(">HHHH", 1, 1, 900, 0) + b"abc")
    assert [one for _, one in udp_payloads(files.pcap([tcp, arp, b"", b"\x00", lying, tagged]))] == [b"abc"]


def assert_seen_by_a_vlp16(sweep: Sweep) -> None:
    """Every beam ends at 5 m."""
    assert sweep.model.rings == 16
    assert sweep.time_s.min() == 0
    np.testing.assert_allclose(np.linalg.norm(sweep.points, axis=1), 5.0, atol=0.03)
    elevation = np.rad2deg(np.arcsin(sweep.points[:, 2] / np.linalg.norm(sweep.points, axis=1)))
    np.testing.assert_allclose(elevation, 2.0 * sweep.ring - 15.0, atol=0.3)


@pytest.mark.parametrize("name", ["v.bin", "v.pcap"])
def test_vlp16_revolution(name: str, tmp_path: Path) -> None:
    turns = files.vlp16_turns(turns=3.2, distance_m=5.0)
    bare = name.endswith(".bin")
    content = b"".join(turns) if bare else files.pcap([files.ip_packet(files.udp_packet(one)) for one in turns])
    (tmp_path / name).write_bytes(content)
    sweeps = list(read_sweeps(tmp_path / name))
    assert len(sweeps) == 3
    sweep = sweeps[0]
    assert_seen_by_a_vlp16(sweep)
    np.testing.assert_allclose(sweep.azimuth, np.arctan2(sweep.points[:, 1], sweep.points[:, 0]), atol=1e-5)
    assert abs(len(sweep) - 16 * 300) < 16 * 6
    clockwise = np.diff(np.unwrap(sweep.azimuth[sweep.ring == 3].astype(np.float64)))
    assert (clockwise < 0).all()
    assert clockwise.sum() == pytest.approx(-2 * np.pi, abs=0.06)


def test_only_the_first_of_two_sensors_of_a_capture_is_read(tmp_path: Path) -> None:
    near, far = (
        [files.ip_packet(files.udp_packet(one)) for one in files.vlp16_turns(turns=2.2, distance_m=distance_m)]
        for distance_m in (5.0, 9.0)
    )
    far = [frame.replace(b"\x0a" * 4, b"\x0a\x00\x00\x02") for frame in far]
    (tmp_path / "v.pcap").write_bytes(files.pcap([frame for pair in zip(near, far, strict=True) for frame in pair]))
    words = "only 10.10.10.10 to port 2368 is read, not 10.0.0.2 to port 2368"
    with pytest.warns(UserWarning, match=rf"v\.pcap: holds packets of several Velodyne sensors; {words}") as caught:
        sweeps = list(read_sweeps(tmp_path / "v.pcap"))
    assert (len(sweeps), len(caught)) == (2, 1)
    for sweep in sweeps:
        assert_seen_by_a_vlp16(sweep)


def test_a_cut_off_revolution_is_read_if_there_is_no_other(tmp_path: Path) -> None:
    (tmp_path / "v.bin").write_bytes(b"".join(files.vlp16_turns(turns=0.5)))
    sweeps = list(read_sweeps(tmp_path / "v.bin"))
    assert len(sweeps) == 1
    assert 0.4 < len(sweeps[0]) / (16 * 300) < 0.6


def test_ouster_without_metadata_and_with_metadata_of_another_sensor(tmp_path: Path) -> None:
    capture = files.pcap([files.ip_packet(files.udp_packet(one)) for one in files.ouster_payloads()])
    (tmp_path / "o.pcap").write_bytes(capture)
    with pytest.raises(ValueError, match=r"o\.pcap: .* put its metadata beside it as o\.json"):
        read_sweep(tmp_path / "o.pcap")
    with pytest.raises(ValueError, match=r"o\.pcap: an Ouster capture needs its metadata in o\.json: No such file"):
        read_sweep(tmp_path / "o.pcap", format="ouster")
    (tmp_path / "o.json").write_bytes(b"{}")
    with pytest.raises(ValueError, match=r"o\.pcap: o\.json must be Ouster metadata"):
        read_sweep(tmp_path / "o.pcap")
    for old, new in ((b'"pixels_per_column": 32', b'"pixels_per_column": 99999999'), (b"32", b'"a"')):
        (tmp_path / "o.json").write_bytes(files.ouster_metadata().replace(old, new))
        with pytest.raises(ValueError, match=r"o\.json must be Ouster metadata: pixels_per_column|o\.json must be"):
            read_sweep(tmp_path / "o.pcap")


def scan_of(payloads: list[bytes]) -> Any:
    """Return a message of payloads that came a millisecond apart from second 100 on."""
    stamps = [SimpleNamespace(sec=100, nanosec=1_000_000 * k) for k in range(len(payloads))]
    packets = zip(stamps, payloads, strict=True)
    return SimpleNamespace(
        packets=[SimpleNamespace(stamp=at, data=np.frombuffer(each, np.uint8)) for at, each in packets]
    )


def packet_of(payload: bytes) -> Any:
    return SimpleNamespace(buf=np.frombuffer(payload, np.uint8))


def test_a_scan_of_a_vlp16() -> None:
    sweep = sweep_of_velodyne(scan_of(files.vlp16_turns(turns=1.0, distance_m=5.0)))
    assert_seen_by_a_vlp16(sweep)
    assert 0.9 < len(sweep) / (16 * 300) <= 1.0
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
    messages = [packet_of(each) for each in files.ouster_payloads(frames=2)]
    sweep = sweep_of_ouster(messages[:4], decoder)
    assert len(sweep) == 32 * 64
    assert sweep.t_ns == 1_000_000_000
    assert sweep.model.rings == 32
    np.testing.assert_allclose(np.linalg.norm(sweep.points, axis=1), 5.0, atol=0.05)
    for wrong in (messages, [], [*messages[:4], packet_of(bytes(48))]):
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
