"""Watchdog node: if the node's heartbeat stops, it publishes stop messages for nav2 on the topics of the node's masks.

A separate process, because the latched messages of a process that died are gone. While the node is alive the watchdog
has no publisher on these topics, so that late subscribers receive no contradicting message.
"""

from __future__ import annotations

import math
import time
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import MapMetaData, OccupancyGrid
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node
from std_msgs.msg import Header

from viewshed_ros.spinning import STEADY, spin
from viewshed_ros.stops import CHECK_S, LATCHED, MASK_STOPS, STALE_S, Stale, everywhere, stale_alarm, stop_mask


class Watchdog(Node):
    """Publishes stop messages for a silent node; parameters are ``sensors``, ``world_frame`` and limits."""

    def __init__(self, **options: Any) -> None:
        super().__init__("field_of_view_watchdog", **options)
        names = self.declare_parameter("sensors", ["lidar"]).value
        self._frame: str = self.declare_parameter("world_frame", "map").value
        self._limit_s = self._positive("stale_s", STALE_S, 60.0)
        self._unseen_mps = self._positive("speed_unseen_mps", 1.0, 1e3)
        self._heard_s = dict.fromkeys(names, -math.inf)
        self._areas: dict[str, MapMetaData] = {name: everywhere() for name in names}
        self._stops: dict[str, dict[str, Any]] = {}
        self._stopped_s: dict[str, float] = {}
        self._began_s = time.monotonic()
        for name in names:
            self.create_subscription(OccupancyGrid, f"{name}/heartbeat", partial(self._hear, name), 5)
        self.create_timer(CHECK_S, self._check, clock=STEADY)
        self.get_logger().info(f"{', '.join(names)} stop {self._limit_s:g} s after the last heartbeat")

    def _positive(self, name: str, default: float, maximum: float) -> float:
        """Return the value of a parameter, or its default if that is invalid: bad input must not end the watchdog."""
        value = self.declare_parameter(name, default, ParameterDescriptor(dynamic_typing=True, read_only=True)).value
        if type(value) in (int, float) and 0.0 < value <= maximum:
            return float(value)
        self.get_logger().error(f"{name} must be a number in (0, {maximum:g}], got {value}; {default:g} is taken")
        return default

    def _hear(self, name: str, heartbeat: OccupancyGrid) -> None:
        """Note the heartbeat and the area of the masks, and destroy own publishers to withdraw their messages."""
        self._heard_s[name], self._areas[name] = time.monotonic(), heartbeat.info
        self._frame = heartbeat.header.frame_id
        for publisher in self._stops.pop(name, {}).values():
            self.destroy_publisher(publisher)

    def _check(self) -> None:
        """Stop the sensors of a silent node, repeatedly, because an older message of the node may arrive later."""
        now_s = time.monotonic()
        for name, heard_s in self._heard_s.items():
            is_due = now_s - self._stopped_s.get(name, -math.inf) > self._limit_s
            if now_s - max(heard_s, self._began_s) > self._limit_s and (is_due or name not in self._stops):
                self._stop(name, Stale("heartbeat of the node", now_s - heard_s, self._limit_s, self._unseen_mps))
                self._stopped_s[name] = now_s

    def _stop(self, name: str, stale: Stale) -> None:
        if name not in self._stops:
            self._stops[name] = {
                topic: self.create_publisher(OccupancyGrid, f"{name}/{topic}", LATCHED) for topic in MASK_STOPS
            } | {"alarm": self.create_publisher(DiagnosticStatus, f"{name}/alarm", LATCHED)}
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id=self._frame)
        for topic, value in MASK_STOPS.items():
            self._stops[name][topic].publish(stop_mask(header, self._areas[name], value))
        self._stops[name]["alarm"].publish(stale_alarm(f"{self.get_name()}: {name}", stale))


def main(arguments: list[str] | None = None) -> None:
    """Run the watchdog until a signal ends it."""
    spin(Watchdog, arguments)


if __name__ == "__main__":
    main()
