"""Load test of a node in its own process: publishes clouds or scans, and measures the latency of its grids.

Everything is published and received as serialized bytes, so that the measurement covers the node and not this process.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from struct import pack_into, unpack_from
from typing import Any

import numpy as np
import rclpy
from benchmarks.damage import Cloud
from lifecycle_msgs.srv import GetState
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.serialization import serialize_message
from sensor_msgs.msg import LaserScan, PointCloud2, PointField

from viewshed_ros.stops import LATCHED

STAMP_AT = 4
"""Byte offset of the header's stamp in a serialized message: seconds and nanoseconds, four bytes each."""

BEGIN_NS = 1_700_000_000 * 10**9
"""Time of the first message."""


def message_of(cloud: Cloud) -> bytes:
    """Return a serialized cloud."""
    message = PointCloud2(
        height=cloud.height, width=cloud.width, point_step=cloud.point_step, row_step=cloud.row_step,
        is_bigendian=cloud.is_bigendian, is_dense=True,
    )  # fmt: skip
    message.fields = [
        PointField(name=field.name, offset=field.offset, datatype=field.datatype, count=field.count)
        for field in cloud.fields
    ]  # fmt: skip
    message.header.frame_id = "lidar"
    message.data = array("B", cloud.data.tobytes())
    return bytes(serialize_message(message))


def scan_bytes(ranges_m: NDArray[np.float32], field_of_view: float, range_max_m: float) -> bytes:
    """Return a serialized LaserScan of ranges (N,) over an angle in radians."""
    step = field_of_view / (len(ranges_m) - 1)
    message = LaserScan(angle_min=-field_of_view / 2, angle_max=field_of_view / 2, angle_increment=step)
    message.range_min, message.range_max = 0.05, range_max_m
    message.header.frame_id = "lidar"
    message.ranges = array("f", ranges_m.astype("<f4").tobytes())
    return bytes(serialize_message(message))


def stamped(message: bytes, t_ns: int) -> bytes:
    """Return a serialized message with a new time in its header."""
    changed = bytearray(message)
    pack_into("<iI", changed, STAMP_AT, *divmod(t_ns, 10**9))
    return bytes(changed)


def stamp_ns(message: bytes) -> int:
    """Return the time in the header of a serialized message."""
    seconds, nanoseconds = unpack_from("<iI", message, STAMP_AT)
    return int(seconds) * 10**9 + int(nanoseconds)


@contextmanager
def running_node(parameters: Mapping[str, object]) -> Iterator[subprocess.Popen[bytes]]:
    """Run the node with autostart; end it by SIGINT and require exit code 0."""
    words = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    command = [sys.executable, "-m", "viewshed_ros.node", "--ros-args", "--log-level", "error", "-p", "autostart:=true"]
    process = subprocess.Popen([*command, *words], env=os.environ)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        code = process.wait(30)
    if code != 0:
        raise RuntimeError(f"the node ended with {code}")


def processor_s(process: int) -> float:
    """Return the CPU seconds that a process has used."""
    words = Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


@dataclass(slots=True)
class Stream:
    """One sensor's topic: its message, the time of each publication, latencies of grids, and dropped messages."""

    name: str
    message: bytes
    step_ns: int = 100_000_000
    t_ns: int = BEGIN_NS
    put_s: dict[int, float] = field(default_factory=dict)
    latency_s: list[float] = field(default_factory=list)
    dropped: int = 0
    publish: Callable[[bytes], None] = lambda _: None

    def send(self) -> None:
        """Publish the message at the next time."""
        self.t_ns += self.step_ns
        message = stamped(self.message, self.t_ns)
        self.put_s[self.t_ns] = time.perf_counter()
        self.publish(message)

    def take(self, grid: bytes) -> None:
        """Record the latency of a grid; earlier messages without a grid were dropped."""
        now_s, t_ns = time.perf_counter(), stamp_ns(grid)
        if t_ns in self.put_s:
            self.latency_s.append(now_s - self.put_s[t_ns])
            self.dropped += sum(sent_ns < t_ns for sent_ns in self.put_s)
            self.put_s = {sent_ns: put_s for sent_ns, put_s in self.put_s.items() if sent_ns > t_ns}

    def waiting(self) -> int:
        """Return the number of messages without a grid so far; those older than 0.5 s count as dropped."""
        lost_s = time.perf_counter() - 0.5
        self.dropped += sum(put_s <= lost_s for put_s in self.put_s.values())
        self.put_s = {sent_ns: put_s for sent_ns, put_s in self.put_s.items() if put_s > lost_s}
        return len(self.put_s)


class Load:
    """Publishes streams and receives their grids.

    Args:
        streams: one for each sensor.
        is_scan: whether they are laser scans.
    """

    def __init__(self, streams: Sequence[Stream], *, is_scan: bool = False) -> None:
        self.node: Node = rclpy.create_node("load")
        self.streams = streams
        self._publishers: list[Any] = []
        for stream in streams:
            publisher = self.node.create_publisher(
                LaserScan if is_scan else PointCloud2, f"{stream.name}/points", qos_profile_sensor_data
            )
            stream.publish = publisher.publish
            self._publishers.append(publisher)
            self.node.create_subscription(
                OccupancyGrid, f"{stream.name}/visibility", partial(self._take, stream), LATCHED, raw=True
            )
        self._states = self.node.create_client(GetState, "field_of_view/get_state")

    def _take(self, stream: Stream, grid: bytes) -> None:
        stream.take(grid)

    def spin(self, seconds: float) -> None:
        """Handle incoming messages for a time, or until the first one."""
        rclpy.spin_once(self.node, timeout_sec=max(seconds, 0.0))

    def wait_for_node(self, seconds: float = 60.0) -> None:
        """Wait until the node has subscribed to all topics."""
        end_s = time.monotonic() + seconds
        while not all(publisher.get_subscription_count() for publisher in self._publishers):
            if time.monotonic() > end_s:
                raise TimeoutError(f"the node did not listen within {seconds:g} s")
            self.spin(0.02)

    def first_answer(self) -> float:
        """Publish ten times a second until a grid comes, and return its time (``time.perf_counter``)."""
        stream = self.streams[0]
        while not stream.latency_s:
            stream.send()
            end_s = time.monotonic() + 0.1
            while time.monotonic() < end_s and not stream.latency_s:
                self.spin(end_s - time.monotonic())
        return time.perf_counter()

    def run_closed(self, seconds: float, under_way: int) -> float:
        """Keep ``under_way`` messages of the first stream in flight, and return the elapsed seconds."""
        stream = self.streams[0]
        begin_s = time.perf_counter()
        while time.perf_counter() - begin_s < seconds:
            if stream.waiting() < under_way:
                stream.send()
                self.spin(0.0)
            else:
                self.spin(0.1)
        while stream.waiting():
            self.spin(0.1)
        return time.perf_counter() - begin_s

    def run_at(self, seconds: float, hz: float, on_step: Callable[[int], None] = lambda _: None) -> None:
        """Publish all streams ``hz`` times a second, spread over the period."""
        begin_s = time.perf_counter()
        count = round(seconds * hz) * len(self.streams)
        for number in range(count):
            due_s = begin_s + number / (hz * len(self.streams))
            while (left_s := due_s - time.perf_counter()) > 0.0:
                self.spin(left_s)
            self.streams[number % len(self.streams)].send()
            on_step(number)
        end_s = time.perf_counter() + 0.5
        while time.perf_counter() < end_s:
            self.spin(0.1)

    def forget(self) -> None:
        """Reset latencies and counts."""
        for stream in self.streams:
            stream.latency_s.clear()
            stream.dropped = 0

    def close(self) -> None:
        """Destroy the node."""
        self.node.destroy_node()
