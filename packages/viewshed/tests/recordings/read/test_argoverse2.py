"""Argoverse 2 logs, written here with poses and boxes that are known, come back as what was written."""

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from viewshed.geometry import Rigid
from viewshed.recordings.read import open_source

made: Any = import_module("recording_files")
CITY_FROM_CAR = Rigid.from_yaw(2 * np.arctan2(0.6, 0.8), (5224.0, 2384.0, 69.0))
UP_LIDAR_M = np.array([1.35018, 0.0, 1.64042])


def test_a_log_gives_sweep_pose_and_boxes(tmp_path: Path) -> None:
    source = open_source(made.write(tmp_path, made.argoverse2()))
    assert source.scenes() == ("log",)
    [ref] = source.refs("log")
    sweep = source.read(ref)
    assert (ref.t_ns, sweep.t_ns, len(sweep)) == (315966265259836000, 315966265259836000, 6)
    np.testing.assert_allclose(sweep.world_from_sensor.translation, CITY_FROM_CAR @ UP_LIDAR_M, atol=1e-9)
    # What the file counts from the car is at the same place of the city by the sensor's pose.
    in_city = sweep.world_from_sensor @ sweep.points.astype(np.float64)
    np.testing.assert_allclose(in_city, CITY_FROM_CAR @ made.POINTS.astype(np.float16).astype(np.float64), atol=1e-4)
    [box] = source.boxes(ref) or ()
    np.testing.assert_allclose(box.center, CITY_FROM_CAR @ np.array([8.0, 3.0, 0.7]), atol=1e-9)
    assert box.yaw == pytest.approx(4 * np.arctan2(0.6, 0.8))
    assert (box.size_m, box.category, box.track, box.returns) == ((4.0, 1.8, 1.5), "REGULAR_VEHICLE", "a-1", 41)


def test_without_poses_boxes_are_in_the_sensors_frame_and_without_annotations_there_are_none(tmp_path: Path) -> None:
    place = made.write(tmp_path, made.argoverse2())
    (place / "log/city_SE3_egovehicle.feather").unlink()
    source = open_source(place / "log")
    [ref] = source.refs("log")
    assert source.read(ref).world_from_sensor is None
    [box] = source.boxes(ref) or ()
    np.testing.assert_allclose(box.center, np.array([8.0, 3.0, 0.7]) - UP_LIDAR_M, atol=1e-9)
    (place / "log/annotations.feather").unlink()
    assert open_source(place / "log").boxes(ref) is None


@pytest.mark.parametrize("missing", ["qw", "timestamp_ns", "track_uuid"])
def test_annotations_that_lack_a_column_are_refused(missing: str, tmp_path: Path) -> None:
    place = made.write(tmp_path, made.argoverse2())
    columns = {
        "timestamp_ns": [1], "qw": [1.0], "qx": [0.0], "qy": [0.0], "qz": [0.0], "tx_m": [0.0], "ty_m": [0.0],
        "tz_m": [0.0], "length_m": [4.0], "width_m": [2.0], "height_m": [1.5], "category": ["BUS"], "track_uuid": ["a"],
    }  # fmt: skip
    del columns[missing]
    (place / "log/annotations.feather").write_bytes(made.feather(**columns))
    source = open_source(place)
    with pytest.raises(ValueError, match=rf"annotations.feather: .*{missing}"):
        source.boxes(source.refs("log")[0])
