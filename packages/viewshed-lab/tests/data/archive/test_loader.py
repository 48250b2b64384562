"""Frames for training: the arrays are the sample's, in the level frame, in any process."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from viewshed.fov.truth import Truth
from viewshed.fov.visibility import PEDESTRIAN
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.sweep import Sweep
from viewshed_lab.data import Sample, write_archive
from viewshed_lab.data.archive.archive import ArchiveFrames

MakeSample = Callable[..., Sample]


@pytest.fixture
def frames(make_sample: MakeSample, tmp_path: Path) -> ArchiveFrames:
    return ArchiveFrames(write_archive(tmp_path / "a", [make_sample(k) for k in range(6)], {}))


def test_the_truth_is_the_sample_s(frames: ArchiveFrames) -> None:
    for index in range(len(frames)):
        arrays, sample = frames[index], frames.archive[index]
        assert (arrays["visible"] == (sample.truth.expected_returns["car"] >= 5)).all()
        assert (arrays["known"] == sample.known).all()
        for name, dtype in (("counts", np.int32), ("visible", np.bool_), ("known", np.bool_)):
            assert arrays[name].shape == sample.truth.grid.shape
            assert arrays[name].dtype == dtype
            assert arrays[name].flags.writeable
    pedestrian = ArchiveFrames(frames.archive, PEDESTRIAN)[2]["visible"]
    assert (pedestrian == (frames.archive[2].truth.expected_returns["pedestrian"] >= 3)).all()


def test_a_tilted_sensor_is_leveled(tmp_path: Path) -> None:
    """A sensor that looks 30° down and left: a point 10 m along its own x falls where trigonometry says."""
    pitch, yaw = np.deg2rad(30.0), 1.1
    down = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    pose = Rigid.from_yaw(yaw) @ Rigid(down, np.array([3.0, 4.0, 5.0]))
    points = np.array([[10.0, 0.0, 0.0], [0.0, 6.0, 0.0]], np.float32)
    sweep = Sweep(points, sensor_height_m=5.0, world_from_sensor=pose)
    grid = BevGrid(32, 16.0)
    zeros = np.zeros(grid.shape, np.uint8)
    truth = Truth(grid, {"car": zeros}, {"car": zeros})
    sample = Sample(sweep, truth, zeros == 0, "s", "train")
    counts = ArchiveFrames(write_archive(tmp_path / "a", [sample], {}))[0]["counts"]
    assert {(int(i), int(j)) for i, j in np.argwhere(counts)} == {(16 + 8, 16), (16, 16 + 6)}
