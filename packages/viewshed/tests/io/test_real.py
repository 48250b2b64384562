"""Real sweeps: every file of the index, against the numbers that were found when the data were collected."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from viewshed import Sweep
from viewshed.io import read_index, read_indexed, read_sweep, read_sweeps
from viewshed.preprocess.beam_matching import match_beams, polar


def elevation_deg(sweep: Sweep) -> np.ndarray:
    return np.rad2deg(np.arctan2(sweep.points[:, 2], np.hypot(sweep.points[:, 0], sweep.points[:, 1])))


@pytest.mark.slow
def test_every_real_sweep_has_the_points_and_ranges_of_the_index(real_data: Path) -> None:
    entries = read_index(real_data / "index.json")
    raw: list[dict[str, Any]] = json.loads((real_data / "index.json").read_text())
    assert len(entries) == len(raw) == 70
    read = 0
    for entry, told in zip(entries, raw, strict=True):
        if entry.points is None:
            continue
        sweep = read_indexed(entry)
        stats = told["stats"]
        packets = told["file"].endswith("einride_recording.bin")
        slack = 0.02 if packets else 0.0
        assert len(sweep) + sweep.dropped_points == pytest.approx(stats["points"], rel=slack), told["file"]
        real = sweep.points[(sweep.points != 0).any(axis=1)]
        assert len(real) == pytest.approx(stats["finite"], rel=0.002 + slack), told["file"]
        distance = np.hypot(real[:, 0], real[:, 1])
        wanted = stats["range_p1_p50_p99_max"]
        np.testing.assert_allclose(
            np.percentile(distance, (1, 50, 99)), wanted[:3], rtol=0.1 if packets else 0.02, atol=0.06
        )
        heights = np.percentile(real[:, 2], (1, 50, 99))
        np.testing.assert_allclose(heights, stats["z_p1_p50_p99_min_max"][:3], atol=0.02, err_msg=told["file"])
        assert sweep.sensor_height_m == entry.sensor_height_m
        assert (sweep.world_from_sensor is None) == (told["world_from_sensor"] is None)
        read += 1
    assert read == 66


def test_files_of_the_index_that_are_no_sweeps_say_what_they_are(real_data: Path) -> None:
    others = [entry for entry in read_index(real_data / "index.json") if entry.points is None]
    assert len(others) == 4
    for entry in others:
        with pytest.raises(ValueError, match=r"is a ROS 2 bag|format is not known by name or content"):
            read_indexed(entry)


@pytest.mark.parametrize(
    "pattern",
    ["nuscenes/*.pcd.bin", "argoverse2/*.feather", "ouster/*.pcap", "nebula/vlp16.pcd", "vlp16_packets/*.bin"],
)
def test_rings_ascend_with_elevation(pattern: str, real_data: Path) -> None:
    found = sorted(real_data.glob(pattern))
    assert found
    for file in found:
        sweep = read_sweep(file)
        far = np.linalg.norm(sweep.points, axis=1) > (3.0 if pattern[:2] in ("nu", "ou") else 0.0)
        rings = np.unique(sweep.ring[far])
        assert rings.size >= 14
        median = [np.median(elevation_deg(sweep)[far & (sweep.ring == ring)]) for ring in rings]
        assert (np.diff(median) > 0).all(), file.name


def test_points_of_a_capture_lie_at_the_beams_that_its_metadata_tell(real_data: Path) -> None:
    for capture in sorted((real_data / "ouster").glob("*.pcap")):
        sweep = read_sweep(capture)
        assert (sweep.model.reach_m or 0) < sweep.model.max_range_m < 200
        _, slope, range_m = polar(sweep.points)
        match = match_beams(slope, range_m, sweep.model)
        assert match.excess > 0.999
        assert (match.ring == sweep.ring)[range_m > 1].mean() > 0.999


def test_captures_with_several_revolutions(real_data: Path) -> None:
    ouster = list(read_sweeps(real_data / "ouster" / "OS-1-128_v2.3.0_1024x10.pcap"))
    assert [round(((sweep.t_ns or 0) - (ouster[0].t_ns or 0)) / 1e8) for sweep in ouster] == [0, 1, 2]
    velodyne = list(read_sweeps(real_data / "vlp16_packets" / "einride_recording.bin"))
    assert len(velodyne) in (12, 13)
    assert max(map(len, velodyne)) - min(map(len, velodyne)) < 200
