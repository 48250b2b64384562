"""Messages of a bag through the node: ``ros/python.sh ros/measure/play.py MESSAGES.npz KIND TARGET`` prints JSON.

``python -m benchmarks.ugv`` writes the messages (``raw``, one after the other, and where each ends) and compares what
is printed with what the pipeline answers. Each message is published as it was recorded, when the grids of the one
before have come.
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import rclpy
from load import LATCHED, running_node, stamp_ns
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import LaserScan, PointCloud2

LAYERS = ("state", "visibility")
LONGEST_S = 30.0
"""A message without grids for this time is counted as lost."""


def main() -> None:
    """Play and print."""
    path, kind, target = Path(sys.argv[1]), sys.argv[2], sys.argv[3]
    with np.load(path) as file:
        messages = [part.tobytes() for part in np.split(file["raw"], file["ends"][:-1])]
    rclpy.init()
    # Reliable, so that a busy machine loses no message: what follows depends on it.
    parameters = {
        "profile": "robot", "target": target, "lidar.type": kind,
        "qos_overrides./lidar/points.subscription.reliability": "reliable",
    }  # fmt: skip
    player = Player(LaserScan if kind == "scan" else PointCloud2)
    with running_node(parameters) as process:
        begin_s = player.play(messages[:1])
        player.play(messages[1:])
        passed_s = time.perf_counter() - begin_s
        ended = process.poll()
    rclpy.try_shutdown()
    print(json.dumps({"seconds": passed_s, "sent": len(messages), "found": player.found, "ended": ended}))


class Player:
    """Publishes messages and keeps a digest of each grid that comes back, by the message's time.

    Args:
        message_type: of the messages.
    """

    def __init__(self, message_type: type[LaserScan] | type[PointCloud2]) -> None:
        self.node = rclpy.create_node("player")
        self.found: dict[int, dict[str, str]] = {}
        self._publisher = self.node.create_publisher(message_type, "lidar/points", QoSProfile(depth=2))
        for layer in LAYERS:
            self.node.create_subscription(
                OccupancyGrid, f"lidar/{layer}", partial(self._take, layer), LATCHED, raw=True
            )

    def play(self, messages: list[bytes]) -> float:
        """Publish messages one after the other, and return when the first went out (of ``time.perf_counter``)."""
        while not self._publisher.get_subscription_count():
            rclpy.spin_once(self.node, timeout_sec=0.02)
        begin_s = time.perf_counter()
        for message in messages:
            self._publisher.publish(message)
            t_ns, end_s = stamp_ns(message), time.perf_counter() + LONGEST_S
            while len(self.found.get(t_ns, ())) < len(LAYERS) and time.perf_counter() < end_s:
                rclpy.spin_once(self.node, timeout_sec=0.05)
        return begin_s

    def _take(self, layer: str, raw: bytes) -> None:
        data = deserialize_message(raw, OccupancyGrid).data
        self.found.setdefault(stamp_ns(raw), {})[layer] = hashlib.sha256(bytes(data)).hexdigest()


if __name__ == "__main__":
    main()
