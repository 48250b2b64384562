"""Running a node without a lifecycle."""

from __future__ import annotations

import sys
from collections.abc import Callable

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node


def spin(make: Callable[[], Node], arguments: list[str] | None = None) -> None:
    """Make a node and run it until a signal ends it."""
    rclpy.init(args=arguments or sys.argv)
    try:
        rclpy.spin(make())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()
