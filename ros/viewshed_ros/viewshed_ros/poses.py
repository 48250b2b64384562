"""Pose of a sensor at the time of a cloud: from tf if it is installed, or from a topic of poses."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from operator import itemgetter
from threading import Condition
from typing import Any, Protocol

from geometry_msgs.msg import PoseStamped, TransformStamped
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.time import Time

from viewshed.geometry import Rigid
from viewshed.recordings.read.tf_tree import between
from viewshed_ros.conversions import nanoseconds_of, rigid_of

MAX_POSES = 2000
"""Number of poses kept: 20 s at 100 Hz."""

MAX_GAP_S = 1.0
"""Maximum time between two poses for interpolation."""


class PoseSource(Protocol):
    """Gives the pose of a sensor; waits up to ``wait_s`` for a pose that has not arrived yet."""

    wait_s: float

    def world_from_sensor(self, frame: str, t_ns: int, base_from_sensor: Rigid) -> Rigid:
        """Return the pose of a sensor's frame at a time.

        Args:
            frame: of the sensor.
            t_ns: time in nanoseconds.
            base_from_sensor: its mounting, for sources without a tree of frames.

        Raises:
            LookupError: it is not known; the message says why.
        """
        ...


@dataclass(frozen=True, slots=True)
class PoseTopic:
    """A message type that holds a pose."""

    message_type: type[Any]  # of the topic
    rigid: Callable[[Any], Rigid]  # converts a message to ``world_from_base``


POSE_TOPICS = {
    "odometry": PoseTopic(
        Odometry, lambda message: rigid_of(message.pose.pose.position, message.pose.pose.orientation)
    ),
    "pose": PoseTopic(PoseStamped, lambda message: rigid_of(message.pose.position, message.pose.orientation)),
    "transform": PoseTopic(
        TransformStamped, lambda message: rigid_of(message.transform.translation, message.transform.rotation)
    ),
}
"""Message types by the value of the parameter ``pose_source``."""


class PoseBuffer:
    """Buffers and interpolates the last poses of a vehicle; sensor poses follow from the mounting.

    Args:
        topic: message type of the poses.
        world_frame: required frame of the poses.
        wait_s: maximum wait for a pose that has not arrived yet.
    """

    def __init__(self, topic: PoseTopic, world_frame: str, wait_s: float = 0.0) -> None:
        self._topic, self._world_frame, self.wait_s = topic, world_frame, wait_s
        self._poses: deque[tuple[int, Rigid]] = deque(maxlen=MAX_POSES)
        self._changed = Condition()

    def __len__(self) -> int:
        return len(self._poses)

    def add(self, message: Any) -> None:
        """Add a pose; one with the time of the last pose replaces it, an older one clears the buffer first."""
        if message.header.frame_id.lstrip("/") != self._world_frame:
            raise ValueError(f"a pose must be in frame {self._world_frame!r}, got {message.header.frame_id!r}")
        t_ns, pose = nanoseconds_of(message.header.stamp), self._topic.rigid(message)
        with self._changed:
            if self._poses and t_ns < self._poses[-1][0]:
                self._poses.clear()
            elif self._poses and t_ns == self._poses[-1][0]:
                self._poses.pop()
            self._poses.append((t_ns, pose))
            self._changed.notify_all()

    def world_from_sensor(self, frame: str, t_ns: int, base_from_sensor: Rigid) -> Rigid:
        """Return the pose of a sensor; see :class:`PoseSource`."""
        with self._changed:
            self._changed.wait_for(lambda: bool(self._poses) and self._poses[-1][0] >= t_ns, self.wait_s)
            return self._at(t_ns) @ base_from_sensor

    def _at(self, t_ns: int) -> Rigid:
        if not self._poses:
            raise LookupError("no pose has come yet")
        if t_ns > self._poses[-1][0]:
            raise LookupError(f"the cloud is {(t_ns - self._poses[-1][0]) / 1e9:.3g} s newer than the last pose")
        late = bisect_left(self._poses, t_ns, key=itemgetter(0))
        after_ns, after = self._poses[late]
        if after_ns == t_ns:
            return after
        if late == 0:
            raise LookupError(f"the cloud is {(after_ns - t_ns) / 1e9:.3g} s older than the first pose kept")
        before_ns, before = self._poses[late - 1]
        gap_ns = after_ns - before_ns
        if gap_ns > MAX_GAP_S * 1e9:
            raise LookupError(f"poses are {gap_ns / 1e9:.3g} s apart around the cloud, more than {MAX_GAP_S:g} s")
        return between(before, after, (t_ns - before_ns) / gap_ns)


class TfPoses:
    """Poses from a tf2 buffer.

    Args:
        buffer: a ``tf2_ros.Buffer``, or an object with its ``lookup_transform``.
        world_frame: name of the map frame.
        wait_s: maximum wait for a transform that has not arrived yet.
    """

    def __init__(self, buffer: Any, world_frame: str, wait_s: float = 0.0) -> None:
        self._buffer, self._world_frame, self.wait_s = buffer, world_frame, wait_s

    def world_from_sensor(self, frame: str, t_ns: int, base_from_sensor: Rigid) -> Rigid:
        """Return the pose of a sensor's frame; tf knows its mounting."""
        try:
            wait = Duration(seconds=self.wait_s)
            message = self._buffer.lookup_transform(self._world_frame, frame, Time(nanoseconds=t_ns), timeout=wait)
            return rigid_of(message.transform.translation, message.transform.rotation)
        except Exception as error:  # the base class of tf2's errors cannot be named without importing tf2
            raise LookupError(" ".join(str(error).split()) or type(error).__name__) from error


def tf_buffer(node: Any) -> Any:
    """Return a tf2 buffer with a listener."""
    try:
        from tf2_ros import Buffer, TransformListener
    except ImportError as error:
        raise ValueError(
            "pose_source tf needs tf2_ros, which is not installed; take odometry, pose or transform"
        ) from error
    buffer = Buffer()
    buffer.viewshed_listener = TransformListener(buffer, node)  # keeps the listener alive as long as the buffer
    return buffer
