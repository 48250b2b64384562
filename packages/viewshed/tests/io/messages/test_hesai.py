"""PandarScan: packets that the test writes after the makers' layout, and a real one beside its maker's own cloud."""

import struct
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from viewshed import read_sweep
from viewshed.io.messages.hesai import sweep_of_hesai
from viewshed.recordings.read import open_source
from viewshed.recordings.read.source import each_sweep


def _xt(lasers: int, blocks: list[tuple[int, dict[int, tuple[int, int]]]], unit_mm: int = 4) -> bytes:
    """A packet: header; of each block an azimuth in .01° and (range, reflectivity) by laser from 0; tail."""
    payload = struct.pack("<BBBBH", 0xEE, 0xFF, 6, 1, 0) + bytes([lasers, len(blocks), 1, unit_mm, 1, 0])
    for azimuth, returns in blocks:
        payload += struct.pack("<H", azimuth)
        for laser in range(lasers):
            payload += struct.pack("<HBB", *returns.get(laser, (0, 0)), 0)
    return payload + bytes(28)


def _scan(*payloads: bytes) -> Any:
    """Messages hold 1500 bytes of each packet, and say how many of them count."""
    stamps = [SimpleNamespace(sec=100, nanosec=1000 * k) for k in range(len(payloads))]
    padded = [np.frombuffer(each.ljust(1500, b"\x07"), np.uint8) for each in payloads]
    packets = [
        SimpleNamespace(stamp=stamp, data=data, size=len(payload))
        for stamp, data, payload in zip(stamps, padded, payloads, strict=True)
    ]
    return SimpleNamespace(packets=packets)


def test_returns_of_a_pandar_xt_lie_where_the_manual_says() -> None:
    """Laser 1 looks up by 15°, laser 32 down by 16°; azimuth 0 is y, 90° is x."""
    empty: list[tuple[int, dict[int, tuple[int, int]]]] = [(0, {})] * 6
    first = _xt(32, [(9000, {0: (2500, 7)}), (0, {31: (500, 200)}), *empty])
    second = _xt(32, [(27000, {15: (1000, 1)}), (0, {}), *empty])
    sweep = sweep_of_hesai(_scan(first, second))
    up, down = np.deg2rad(15.0), np.deg2rad(-16.0)
    expected = [
        [10 * np.cos(up), 0, 10 * np.sin(up)], [0, 2 * np.cos(down), 2 * np.sin(down)], [-4, 0, 0],
    ]  # fmt: skip
    np.testing.assert_allclose(sweep.points, expected, atol=1e-5)
    assert (sweep.ring.tolist(), sweep.intensity.tolist()) == ([31, 0, 16], [7, 200, 1])
    np.testing.assert_allclose(sweep.time_s, [0, 0, 1e-6])
    assert (sweep.t_ns, sweep.model.name) == (100 * 10**9, "XT32")


def test_a_second_return_is_kept_and_a_repeated_one_is_not() -> None:
    twice = [(100, {0: (1000, 1), 1: (900, 1)}), (100, {0: (1000, 1), 1: (1200, 1)}), (118, {0: (1000, 1)})]
    sweep = sweep_of_hesai(_scan(_xt(16, [*twice, *[(0, {})] * 5])))
    np.testing.assert_allclose(np.linalg.norm(sweep.points, axis=1), [4.0, 3.6, 4.8, 4.0], atol=1e-5)
    assert sweep.model.name == "XT16"


_GOOD = _xt(32, [(0, {})] * 8)


@pytest.mark.parametrize(
    ("payloads", "message"),
    [
        ([], "1 to 4096 packets, got 0"),
        ([b""], "begin with ee ff, got $"),
        ([b"\xff\xee" + _GOOD[2:]], "begin with ee ff, got ff ee"),
        ([_GOOD[:-1]], "one sensor, of 1080 bytes each"),
        ([_GOOD, _xt(16, [(0, {})] * 8)], "one sensor, of 1080 bytes each"),
        ([_xt(40, [(0, {})] * 8)], "got 40 lasers in 8 blocks; record PointCloud2"),
    ],
)
def test_what_is_no_scan_is_refused(payloads: list[bytes], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        sweep_of_hesai(_scan(*payloads))


def test_a_real_scan_has_the_points_of_another_decoder(real_data: Path) -> None:
    """PandarQT64, decoded by nebula with the same unit's calibration: it leaves out what lies near or far."""
    recordings = real_data.parent / "recordings" / "tier4__nebula" / "hesai" / "qt64"
    if not recordings.is_dir():
        pytest.skip("no recordings")
    scipy = pytest.importorskip("scipy.spatial")
    sweeps = [sweep for _, sweep in each_sweep(open_source(recordings / "1673401195788312575"))]
    assert len(sweeps) == 4
    points = read_sweep(recordings / "1673401196087570870.pcd").points
    distance_m, _ = scipy.cKDTree(sweeps[2].points).query(points)  # the cloud comes once the next scan begins
    assert np.quantile(distance_m, 0.98) < 0.005
    assert {sweep.model.name for sweep in sweeps} == {"PandarQT64"}
