"""Packets of an Ouster sensor, one a message: gathered, decoded and answered by the node."""

import time
from array import array
from pathlib import Path

import numpy as np
import pytest
import rclpy
from nav_msgs.msg import OccupancyGrid
from robot import running
from std_msgs.msg import UInt8MultiArray
from sweep_files import ouster_metadata, ouster_payloads

from viewshed_ros.node import LATCHED
from viewshed_ros.node import PACKETS as PACKETS_QOS
from viewshed_ros.packets import Revolutions

PACKETS = 4


def metadata(folder: Path) -> Path:
    """Write metadata of a sensor of 32 beams and 64 columns."""
    path = folder / "ouster.json"
    path.write_bytes(ouster_metadata())
    return path


def revolution(frame: int) -> list[bytes]:
    """Return its packets of 16 columns, all of them at 4 m and one more for each frame, from 1."""
    return ouster_payloads(frame)[-PACKETS:]


def packet(first: int, frame: int) -> bytes:
    return revolution(frame)[first // 16]


def test_a_revolution_ends_where_the_next_begins(tmp_path: Path) -> None:
    revolutions = Revolutions.of(metadata(tmp_path))
    assert [revolutions.add(each, 100 + n) for n, each in enumerate(revolution(1))] == [None] * PACKETS
    ended = revolutions.add(packet(0, 2), 200)
    assert ended is not None
    assert (len(ended.packets), ended.t_ns) == (PACKETS, 100)
    sweep = revolutions.sweep(ended)
    assert (len(sweep), sweep.t_ns) == (32 * 64, 100)
    np.testing.assert_allclose(np.linalg.norm(sweep.points, axis=1), 5.0, atol=0.05)


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
    with pytest.raises(ValueError, match=r"no\.json must be Ouster metadata: is no JSON"):
        Revolutions.of(path)


def test_the_node_answers_packets(tmp_path: Path) -> None:
    parameters = {
        "autostart": "true", "profile": "infrastructure", "monitor": "never", "lidar.type": "ouster_bytes",
        "lidar.metadata": str(metadata(tmp_path)), "lidar.frame": "os_lidar",
    }  # fmt: skip
    with running(parameters):
        rclpy.init()
        node, grids = rclpy.create_node("sensor", namespace="bot"), list[OccupancyGrid]()
        publisher = node.create_publisher(UInt8MultiArray, "lidar/points", PACKETS_QOS)
        node.create_subscription(OccupancyGrid, "lidar/visibility", grids.append, LATCHED)
        end = time.monotonic() + 30.0
        frame = 0
        while not grids and time.monotonic() < end:
            frame = frame % 3 + 1
            if publisher.get_subscription_count():
                for each in revolution(frame):
                    publisher.publish(UInt8MultiArray(data=array("B", each)))
            rclpy.spin_once(node, timeout_sec=0.1)
        node.destroy_node()
        rclpy.try_shutdown()
    assert grids
    assert grids[0].header.frame_id == "os_lidar"
    assert max(grids[0].data) > 50
