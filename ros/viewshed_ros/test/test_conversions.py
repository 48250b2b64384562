"""Sweeps and poses from messages."""

import numpy as np
import pytest
from geometry_msgs.msg import Point, Quaternion
from messages import cloud
from sensor_msgs.msg import LaserScan, PointField

from viewshed.geometry import Rigid
from viewshed.sensors import lidar_model
from viewshed.sweep import Sweep
from viewshed_ros.conversions import INPUTS, cloud_of, nanoseconds_of, pose_of, rigid_of, stamp_of

POINTS = np.array([[1.0, 2.0, 3.0], [-4.0, 5.0, -6.0]], np.float32)


@pytest.mark.parametrize("t_ns", [0, 1, 1_700_000_000_123_456_789])
def test_stamps_are_nanoseconds_and_back(t_ns: int) -> None:
    assert nanoseconds_of(stamp_of(t_ns)) == t_ns


def test_a_cloud_is_a_sweep_at_its_time_with_what_is_known() -> None:
    sweep = INPUTS["cloud"].sweep(cloud(POINTS, 5_000_000_001), agent="front", sensor_height_m=1.5)
    np.testing.assert_array_equal(sweep.points, POINTS)
    assert (sweep.t_ns, sweep.agent, sweep.sensor_height_m) == (5_000_000_001, "front", 1.5)


def test_rings_from_the_top_are_counted_by_the_beam_table_that_is_known() -> None:
    model = lidar_model("VLP-16")
    beam = np.tile(np.arange(1, 16), 40)  # the lowest has no return
    points = np.column_stack([np.full(600, 10.0), np.repeat(np.arange(40.0), 15), np.zeros(600)])
    points[:, 2] = np.hypot(points[:, 0], points[:, 1]) * np.tan(model.elevation[beam])
    message = cloud_of(Sweep(points, ring=15 - beam), cloud(POINTS))
    np.testing.assert_array_equal(INPUTS["cloud"].sweep(message, model=model).ring, beam)


def test_a_scan_is_a_sweep_in_one_plane() -> None:
    scan = LaserScan(angle_min=0.0, angle_max=1.5, angle_increment=0.5, range_min=0.1, range_max=10.0)
    scan.ranges = [2.0, float("inf"), float("nan"), 4.0]
    sweep = INPUTS["scan"].sweep(scan)
    np.testing.assert_allclose(sweep.points, [[2, 0, 0], [4 * np.cos(1.5), 4 * np.sin(1.5), 0]], atol=1e-6)
    assert sweep.planar is not None
    np.testing.assert_allclose(sweep.planar.open_azimuth, [0.5], atol=1e-6)


def test_a_cloud_that_lies_about_its_size_is_refused_in_words() -> None:
    message = cloud(POINTS)
    message.width = 3
    with pytest.raises(ValueError, match="a cloud is cut off"):
        INPUTS["cloud"].sweep(message)
    message = cloud(POINTS)
    message.fields = [PointField(name="x", offset=0, datatype=7, count=1)]
    with pytest.raises(ValueError, match="must have fields x, y and z"):
        INPUTS["cloud"].sweep(message)


def test_a_type_whose_package_is_missing_is_named() -> None:
    with pytest.raises(ValueError, match="needs the package velodyne_msgs"):
        INPUTS["velodyne"].message_type()


def test_a_pose_is_a_transform_and_back() -> None:
    rigid = Rigid.from_yaw(0.7, (1.0, -2.0, 3.0))
    pose = pose_of(rigid)
    again = rigid_of(pose.position, pose.orientation)
    np.testing.assert_allclose(again.as_matrix(), rigid.as_matrix(), atol=1e-12)


def test_a_pose_that_is_none_is_refused() -> None:
    with pytest.raises(ValueError, match="norm 1"):
        rigid_of(Point(), Quaternion(w=0.0))
    with pytest.raises(ValueError, match="finite"):
        rigid_of(Point(x=float("nan")), Quaternion(w=1.0))
