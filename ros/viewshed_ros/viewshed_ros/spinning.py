"""Running nodes until a signal ends them."""

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
"""Of timers that also run where the clock is set back, and where simulated time stands still."""


@contextmanager
def until_a_signal(arguments: list[str] | None = None) -> Iterator[None]:
    """Initialize rclpy, and end what is done with it at SIGINT or SIGTERM, also where that comes while a node starts.

    SIGINT, like SIGTERM, shuts the context down and raises nothing: Python would raise `KeyboardInterrupt` wherever the
    main thread is, in a half-made object, or in the handling of what fails because the context is down.
    """
    ending = {signal.SIGINT, signal.SIGTERM}
    # A signal that comes before rclpy has its handlers waits for them.
    signal.pthread_sigmask(signal.SIG_BLOCK, ending)
    signal.signal(signal.SIGINT, lambda number, frame: None)  # rclpy calls the handler that it finds, then shuts down
    rclpy.init(args=arguments or sys.argv)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ending)
    try:
        yield
    except ExternalShutdownException:
        pass
    except Exception:
        # A signal shuts the context down at once; whatever is made after that fails, each thing in its own words.
        if rclpy.ok():
            raise
    finally:
        rclpy.try_shutdown()


def spin(make: Callable[[], Node], arguments: list[str] | None = None) -> None:
    """Make a node and run it until a signal ends it; why it cannot be made is said in one line."""
    with until_a_signal(arguments):
        try:
            node = make()
        except (ValueError, OSError, ParameterException) as error:
            sys.exit(f"not started: {' '.join(str(error).split())}")
        rclpy.spin(node)
