"""Adversary node for tests: takes clouds or detections from a topic and republishes them, forged by an attack.

Messages that it does not forge pass unchanged.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from viewshed_lab.threats.adversary import Adversary
from viewshed_ros import parameters
from viewshed_ros.conversions import INPUTS, cloud_of, nanoseconds_of
from viewshed_ros.object_layers import detection_cubes, detections_of
from viewshed_ros.parameters import Parameter
from viewshed_ros.spinning import spin

PARAMETERS: dict[str, Parameter] = {
    "attack": Parameter("far_wall", "Name of an attack: of sweeps for clouds, of objects for detections."),
    "type": Parameter("cloud", "Kind of messages that are forged.", ("cloud", "detections")),
    "topic": Parameter("points", "Topic of the honest messages."),
    "forged_topic": Parameter("points_forged", "Topic of the forged messages."),
    "start_s": Parameter(2.0, "Seconds after the first message at which the attack begins."),
    "end_s": Parameter(0.0, "Seconds after the first message at which it ends; 0 for never."),
    "reset_s": Parameter(10.0, "Seconds after which other objects, or another place, are attacked."),
    "count": Parameter(2, "Number of objects forged at a time."),
    "seed": Parameter(0, "Random seed."),
}
"""Parameters of the node."""


class AdversaryNode(Node):
    """Forges incoming messages, configured by :data:`PARAMETERS`."""

    def __init__(self, **options: Any) -> None:
        super().__init__("viewshed_adversary", **options)
        parameters.declare_table(self, PARAMETERS, fixed=True)
        given: dict[str, Any] = parameters.values_of(self, PARAMETERS)
        self._adversary = Adversary(
            given["attack"], start_s=given["start_s"], end_s=given["end_s"] or np.inf, reset_s=given["reset_s"],
            count=given["count"], seed=given["seed"],
        )  # fmt: skip
        kind, take = (PointCloud2, self._take_cloud) if given["type"] == "cloud" else (MarkerArray, self._take_boxes)
        qos = qos_profile_sensor_data if given["type"] == "cloud" else 5
        self._forged = self.create_publisher(kind, given["forged_topic"], qos)
        self.create_subscription(kind, given["topic"], take, qos)
        self.get_logger().info(f"{given['attack']} on {given['topic']} from {given['start_s']:g} s on")

    def _take_cloud(self, message: PointCloud2) -> None:
        """Republish a cloud, forged during the attack."""
        try:
            sweep = INPUTS["cloud"].sweep(message)
            forged = self._adversary.sweep(sweep)
        except ValueError as error:
            self.get_logger().warning(f"forwarded unchanged: {error}", throttle_duration_sec=5.0)
            forged = sweep = None
        self._forged.publish(message if forged is sweep or forged is None else cloud_of(forged, message))

    def _take_boxes(self, message: MarkerArray) -> None:
        """Republish detections, forged during the attack; forged objects stand still in the frame of the message."""
        if not message.markers:
            self._forged.publish(message)
            return
        header = message.markers[0].header
        t_s = 1e-9 * nanoseconds_of(header.stamp)
        try:
            forged = self._adversary.objects(header.frame_id, t_s, detections_of(message), np.zeros(3))
        except ValueError as error:
            self.get_logger().warning(f"forwarded unchanged: {error}", throttle_duration_sec=5.0)
            self._forged.publish(message)
            return
        self._forged.publish(detection_cubes(forged, header))


def main(arguments: list[str] | None = None) -> None:
    """Run the node until a signal ends it."""
    spin(AdversaryNode, arguments)


if __name__ == "__main__":
    main()
