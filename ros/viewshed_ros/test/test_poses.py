"""Poses at a cloud's time, from topics and from tf."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry

from viewshed.geometry import Rigid
from viewshed.recordings.read.bag_files import open_bag
from viewshed.recordings.read.rosbag import TF, TRANSFORMS, decoder
from viewshed.recordings.read.tf_tree import TransformBuffer
from viewshed_ros.conversions import nanoseconds_of, pose_of, stamp_of
from viewshed_ros.poses import MAX_POSES, POSE_TOPICS, PoseBuffer, TfPoses, tf_buffer

RECORDINGS = Path(__file__).resolve().parents[4] / "shared" / "recordings"


def odometry(t_ns: int, rigid: Rigid, frame: str = "map") -> Odometry:
    message = Odometry()
    message.header.stamp, message.header.frame_id = stamp_of(t_ns), frame
    message.pose.pose = pose_of(rigid)
    return message


HERE = Rigid.identity()
"""A sensor that is mounted at the vehicle's own origin."""


def buffer(*times_ns: int) -> PoseBuffer:
    poses = PoseBuffer(POSE_TOPICS["odometry"], "map")
    for t_ns in times_ns:
        poses.add(odometry(t_ns, Rigid.from_yaw(t_ns * 1e-9, (t_ns * 1e-9, 0.0, 0.0))))
    return poses


def test_between_two_poses_the_pose_is_interpolated_and_the_mounting_added() -> None:
    mounting = Rigid(np.eye(3), np.array([0.0, 1.0, 2.0]))
    found = buffer(0, 400_000_000, 400_000_000).world_from_sensor("lidar", 100_000_000, mounting)
    np.testing.assert_allclose(
        found.as_matrix(), (Rigid.from_yaw(0.1, (0.1, 0.0, 0.0)) @ mounting).as_matrix(), atol=1e-9
    )


@pytest.mark.parametrize(
    ("times_ns", "t_ns", "why"),
    [
        ((), 5, "no pose has come yet"),
        ((0, 10**8), 2 * 10**8, "0.1 s newer than the last pose"),
        ((10**9, 2 * 10**9), 5 * 10**8, "0.5 s older than the first"),
        ((0, 3 * 10**9), 10**9, "poses are 3 s apart"),
        ((5 * 10**9, 10**9), 4 * 10**9, "3 s newer"),  # time went back: what was before is forgotten
    ],
)
def test_a_pose_that_is_not_known_is_not_made_up(times_ns: tuple[int, ...], t_ns: int, why: str) -> None:
    with pytest.raises(LookupError, match=why):
        buffer(*times_ns).world_from_sensor("lidar", t_ns, HERE)


def test_memory_is_bounded() -> None:
    assert len(buffer(*range(1, 10 * MAX_POSES, 5))) == MAX_POSES


def test_poses_in_another_frame_are_refused() -> None:
    with pytest.raises(ValueError, match="must be in frame 'map', got 'odom'"):
        buffer().add(odometry(0, Rigid.identity(), "odom"))


class StandIn:
    """Looks transforms up as ``tf2_ros.Buffer`` does, which has no wheel."""

    def __init__(self, transforms: TransformBuffer) -> None:
        self.transforms = transforms

    def lookup_transform(self, target, source, time, timeout):
        found = self.transforms.lookup(target, source, time.nanoseconds)
        if found is None:
            raise RuntimeError("Lookup would require extrapolation")
        pose = pose_of(found)
        message = TransformStamped()
        message.transform.rotation = pose.orientation
        for axis in "xyz":
            setattr(message.transform.translation, axis, getattr(pose.position, axis))
        return message


def test_poses_come_from_the_transforms_of_a_real_bag() -> None:
    bag = RECORDINGS / "facontidavide__PlotJuggler" / "datasamples" / "tilt_laser.bag"
    if not bag.exists():
        pytest.skip("no real recordings")
    transforms, times = TransformBuffer(), []
    for message in open_bag(bag.parent, bag).messages(TRANSFORMS):
        for each in decoder(message.encoding)(message.raw, TF).transforms:
            at, where, turn = each.header, each.transform.translation, each.transform.rotation
            t_ns = nanoseconds_of(SimpleNamespace(sec=at.stamp.sec, nanosec=at.stamp.nanosec))
            transforms.add(
                at.frame_id, each.child_frame_id, t_ns, (where.x, where.y, where.z), (turn.w, turn.x, turn.y, turn.z)
            )
            times.append((t_ns, at.frame_id, each.child_frame_id))
    assert len(times) > 100
    t_ns, parent, child = times[len(times) // 2]
    poses = TfPoses(StandIn(transforms), parent)
    expected = transforms.lookup(parent, child, t_ns)
    np.testing.assert_allclose(poses.world_from_sensor(child, t_ns, HERE).as_matrix(), expected.as_matrix(), atol=1e-9)
    with pytest.raises(LookupError, match="extrapolation"):
        poses.world_from_sensor(child, t_ns + 10**12, HERE)
    with pytest.raises(LookupError, match="no transform leads from frame 'moon'"):
        poses.world_from_sensor("moon", t_ns, HERE)


def test_without_tf2_the_message_says_what_to_take() -> None:
    with pytest.raises(ValueError, match="take odometry, pose or transform"):
        tf_buffer(None)
