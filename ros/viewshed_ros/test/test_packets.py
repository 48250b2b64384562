"""Packets of an Ouster sensor, one a message: gathered, decoded and answered by the node."""

import json
import os
import signal
import struct
import subprocess
import sys
import time
from array import array
from pathlib import Path

import numpy as np
import pytest
import rclpy
from nav_msgs.msg import OccupancyGrid
from std_msgs.msg import UInt8MultiArray

from viewshed_ros.node import LATCHED
from viewshed_ros.node import PACKETS as PACKETS_QOS
from viewshed_ros.packets import Revolutions

ROWS, COLUMNS = 16, 64
PACKETS = COLUMNS // 16


def metadata(folder: Path) -> Path:
    """Write metadata of a sensor of 16 beams and 64 columns."""
    path = folder / "ouster.json"
    path.write_text(
        json.dumps(
            {
                "prod_line": "OS-1-16", "lidar_mode": "64x10", "prod_sn": "123",
                "beam_altitude_angles": np.linspace(15.0, -15.0, ROWS).tolist(), "beam_azimuth_angles": [0.0] * ROWS,
                "lidar_origin_to_beam_origin_mm": 15.8,
                "data_format": {
                    "pixels_per_column": ROWS, "columns_per_frame": COLUMNS, "columns_per_packet": 16,
                    "udp_profile_lidar": "RNG19_RFL8_SIG16_NIR16",
                },
            }
        )
    )  # fmt: skip
    return path


def packet(first: int, frame: int, range_mm: int = 8000) -> bytes:
    """Return a packet of 16 columns, all of them at one range."""
    head = struct.pack("<HH", 1, frame) + (0).to_bytes(3, "little") + (123).to_bytes(5, "little")
    body = b"".join(
        struct.pack("<QHH", 5_000_000 + 1000 * column, column, 1)
        + struct.pack("<IBBHHH", range_mm, 1, 0, 7, 1, 2) * ROWS
        for column in range(first, first + 16)
    )
    return head.ljust(32, b"\x00") + body + bytes(32)


def revolution(frame: int) -> list[bytes]:
    return [packet(16 * number, frame) for number in range(PACKETS)]


def test_a_revolution_ends_where_the_next_begins(tmp_path: Path) -> None:
    revolutions = Revolutions.of(metadata(tmp_path))
    assert [revolutions.add(each, 100 + n) for n, each in enumerate(revolution(1))] == [None] * PACKETS
    ended = revolutions.add(packet(0, 2), 200)
    assert ended is not None
    assert (len(ended.packets), ended.t_ns) == (PACKETS, 100)
    sweep = revolutions.sweep(ended)
    assert (len(sweep), sweep.t_ns) == (ROWS * COLUMNS, 100)
    np.testing.assert_allclose(np.linalg.norm(sweep.points, axis=1), 8.0, atol=0.05)


def test_a_late_packet_is_left_out_and_one_of_another_sensor_refused(tmp_path: Path) -> None:
    revolutions = Revolutions.of(metadata(tmp_path))
    for each in revolution(1):
        revolutions.add(each, 0)
    assert revolutions.add(packet(0, 2), 1) is not None
    assert revolutions.add(packet(48, 1), 2) is None
    with pytest.raises(ValueError, match="must be a lidar packet of"):
        revolutions.add(bytes(48), 3)
    ended = revolutions.add(packet(0, 3), 4)
    assert ended is not None
    assert len(ended.packets) == 1
    # What was gathered before a gap, or for ever of one number, is no view of now.
    assert revolutions.add(packet(0, 3), 2 * 10**9) is revolutions.add(packet(16, 3), 4 * 10**9) is None
    ended = revolutions.add(packet(0, 4), 4 * 10**9 + 1)
    assert ended is not None
    assert (len(ended.packets), ended.t_ns) == (1, 4 * 10**9)


def test_metadata_that_are_none_name_their_file(tmp_path: Path) -> None:
    path = tmp_path / "no.json"
    path.write_text("{")
    with pytest.raises(ValueError, match=r"no\.json: is no JSON"):
        Revolutions.of(path)


def test_the_node_answers_packets(tmp_path: Path) -> None:
    parameters = {
        "autostart": "true", "profile": "infrastructure", "monitor": "never", "lidar.type": "ouster_bytes",
        "lidar.metadata": str(metadata(tmp_path)), "lidar.frame": "os_lidar",
    }  # fmt: skip
    given = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
    process = subprocess.Popen([sys.executable, "-m", "viewshed_ros.node", "--ros-args", *given], env=os.environ)
    rclpy.init()
    try:
        node, grids = rclpy.create_node("sensor"), list[OccupancyGrid]()
        publisher = node.create_publisher(UInt8MultiArray, "lidar/points", PACKETS_QOS)
        node.create_subscription(OccupancyGrid, "lidar/visibility", grids.append, LATCHED)
        end = time.monotonic() + 30.0
        frame = 0
        while not grids and time.monotonic() < end:
            frame += 1
            if publisher.get_subscription_count():
                for each in revolution(frame):
                    publisher.publish(UInt8MultiArray(data=array("B", each)))
            rclpy.spin_once(node, timeout_sec=0.1)
        assert grids
        assert grids[0].header.frame_id == "os_lidar"
        assert max(grids[0].data) > 50
        node.destroy_node()
    finally:
        rclpy.try_shutdown()
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
