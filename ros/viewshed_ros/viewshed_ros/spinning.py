"""Run nodes until a signal ends them."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

STEADY = Clock(clock_type=ClockType.STEADY_TIME)
"""Clock of timers that must run even if the system clock is set back or simulated time stands still."""


@contextmanager
def until_a_signal(arguments: list[str] | None = None) -> Iterator[None]:
    """Initialize rclpy, and leave the context cleanly at SIGINT or SIGTERM, also during the start of a node.

    SIGINT, like SIGTERM, shuts the context down and raises nothing. Python would raise `KeyboardInterrupt` anywhere in
    the main thread: in a half-constructed object, or while it handles an error that the shutdown caused.
    """
    ending = {signal.SIGINT, signal.SIGTERM}
    # Block signals until rclpy has installed its handlers.
    signal.pthread_sigmask(signal.SIG_BLOCK, ending)
    signal.signal(signal.SIGINT, lambda number, frame: None)  # rclpy calls the existing handler, then shuts down
    rclpy.init(args=arguments or sys.argv)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ending)
    try:
        yield
    except ExternalShutdownException:
        pass
    except Exception:
        # After a signal the context is down, and anything created later may fail with any error.
        if rclpy.ok():
            raise
    finally:
        rclpy.try_shutdown()


def spin(make: Callable[[], Node], arguments: list[str] | None = None) -> None:
    """Make a node and run it until a signal ends it; if it cannot be made, exit with a one-line message."""
    with until_a_signal(arguments):
        try:
            node = make()
        except (ValueError, OSError, ParameterException) as error:
            sys.exit(f"not started: {' '.join(str(error).split())}")
        rclpy.spin(node)
