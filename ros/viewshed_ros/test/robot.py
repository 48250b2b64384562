"""What is around a node under test: a process of it, publishers of clouds and odometry, and subscribers."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from messages import cloud
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan, PointCloud2

from viewshed.geometry import Rigid
from viewshed.io import read_sweep
from viewshed.io.samples import junction_path
from viewshed_ros.conversions import pose_of, stamp_of
from viewshed_ros.layers import LAYERS
from viewshed_ros.stops import LATCHED

STEP_NS = 100_000_000
GOALS = {
    Transition.TRANSITION_CONFIGURE: State.PRIMARY_STATE_INACTIVE,
    Transition.TRANSITION_ACTIVATE: State.PRIMARY_STATE_ACTIVE,
    Transition.TRANSITION_DEACTIVATE: State.PRIMARY_STATE_INACTIVE,
    Transition.TRANSITION_CLEANUP: State.PRIMARY_STATE_UNCONFIGURED,
    Transition.TRANSITION_ACTIVE_SHUTDOWN: State.PRIMARY_STATE_FINALIZED,
}
"""The state that a transition leads to."""
POINTS = read_sweep(junction_path()).points[::2]


class Robot:
    """What is around the node: publishers of clouds and odometry, subscribers of all that comes back."""

    def __init__(self) -> None:
        self.node: Node = rclpy.create_node("robot", namespace="bot")
        self.got: dict[str, list[Any]] = {}
        self.t_ns = 10**12
        self.clouds = self.publisher()
        self.scans = self.node.create_publisher(LaserScan, "laser/points", qos_profile_sensor_data)
        self.odometry = self.node.create_publisher(Odometry, "odometry", 10)
        for name, layer in LAYERS.items():
            self.subscribe(layer.message_type, f"front/{name}", LATCHED if layer.latched else 10)
        self.subscribe(DiagnosticStatus, "front/alarm", LATCHED)
        self.subscribe(DiagnosticArray, "/diagnostics", 10)
        self.change = self.node.create_client(ChangeState, "field_of_view/change_state")
        self.state = self.node.create_client(GetState, "field_of_view/get_state")

    def publisher(self) -> Any:
        return self.node.create_publisher(PointCloud2, "lidar_front", qos_profile_sensor_data)

    def subscribe(self, message_type: type[Any], topic: str, qos: Any) -> None:
        name = topic.rpartition("/")[2]
        self.got[name] = []
        self.node.create_subscription(message_type, topic, self.got[name].append, qos)

    def spin(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            rclpy.spin_once(self.node, timeout_sec=left)

    def until(self, is_so: Callable[[], bool], seconds: float = 20.0) -> None:
        end = time.monotonic() + seconds
        while not is_so():
            assert time.monotonic() < end, f"not within {seconds} s"
            rclpy.spin_once(self.node, timeout_sec=0.1)

    def call(self, client: Any, request: Any) -> Any:
        """Return the answer; an answer is lost where the node has not found the client yet: it is asked again."""
        for _ in range(6):
            assert client.wait_for_service(timeout_sec=20.0)
            future = client.call_async(request)
            rclpy.spin_until_future_complete(self.node, future, timeout_sec=10.0)
            if future.done():
                return future.result()
            client.remove_pending_request(future)
        raise AssertionError(f"{client.srv_name} does not answer")

    def transition(self, number: int) -> bool:
        """Ask for a transition; where its answer was lost, the second is a refusal, and the state tells."""
        succeeded = self.call(self.change, ChangeState.Request(transition=Transition(id=number))).success
        return bool(succeeded) or self.state_now() == GOALS[number]

    def state_now(self) -> int:
        return int(self.call(self.state, GetState.Request()).current_state.id)

    def drive(self, step_ns: int = STEP_NS) -> int:
        """Publish the next cloud and the odometry around it, and return its time."""
        self.t_ns += step_ns
        self.locate()
        self.publish_cloud()
        return self.t_ns

    def publish_cloud(self) -> None:
        self.clouds.publish(cloud(POINTS, self.t_ns))

    def locate(self) -> None:
        """Publish the odometry around the time of the last cloud."""
        for t_ns in (self.t_ns - STEP_NS // 2, self.t_ns + STEP_NS // 2):
            message = Odometry()
            message.header.stamp, message.header.frame_id = stamp_of(t_ns), "map"
            message.pose.pose = pose_of(pose_at(t_ns) @ Rigid(np.eye(3), np.array([0.0, 0.0, -1.8])))
            self.odometry.publish(message)

    def answer(self, name: str = "state", step_ns: int = STEP_NS) -> Any:
        """Publish a cloud until its answer comes, and return that; a best-effort cloud may be lost."""
        for _ in range(5):
            stamp = stamp_of(self.drive(step_ns))
            end = time.monotonic() + 4.0
            while time.monotonic() < end:
                rclpy.spin_once(self.node, timeout_sec=0.1)
                for message in self.got[name]:
                    if message.header.stamp == stamp:
                        return message
            step_ns = STEP_NS
        raise AssertionError(f"no {name} came")

    def reported(self, word: str) -> bool:
        """Return whether the last diagnostics hold a word."""
        return bool(self.got["diagnostics"]) and word in str(self.got["diagnostics"][-1])


def pose_at(t_ns: int) -> Rigid:
    return Rigid.from_yaw(0.5, (1e-9 * t_ns % 100, 3.0, 1.8))


@contextmanager
def running(parameters: Mapping[str, str], module: str = "node") -> Iterator["subprocess.Popen[bytes]"]:
    """Run a module of the package in the namespace ``bot``; it must end by Ctrl-C's signal unless it was killed."""
    given = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    command = [sys.executable, "-m", f"viewshed_ros.{module}", "--ros-args", "-r", "__ns:=/bot"]
    process = subprocess.Popen([*command, "-r", "cloud:=lidar_front", *given], env=os.environ)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(30) in (0, -signal.SIGKILL)
