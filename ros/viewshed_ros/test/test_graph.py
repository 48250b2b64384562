"""A real graph: the node in a process of its own, a publisher and a subscriber here, over DDS."""

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import State, Transition
from messages import cloud
from nav_msgs.msg import OccupancyGrid
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from robot import POINTS, STEP_NS, Robot, pose_at, running
from sensor_msgs.msg import LaserScan

import viewshed
from viewshed.io.export.ros import visibility_layer
from viewshed.sweep import Sweep
from viewshed_ros.conversions import stamp_of
from viewshed_ros.layers import LAYERS
from viewshed_ros.stops import LATCHED


@pytest.fixture(scope="module")
def robot() -> Iterator[Robot]:
    """A node under way in a namespace, its topics remapped, and the robot around it."""
    parameters = {
        "sensors": "[front, laser]", "profile": "contested", "history": "2", "monitor": "never",
        "pose_source": "odometry", "pose_wait_s": "0.2", "front.topic": "cloud", "laser.type": "scan",
        "front.mounting": "[0.0, 0.0, 1.8, 1.0, 0.0, 0.0, 0.0]",
        "diagnostics_hz": "5.0", "stale_s": "5.0",
    }  # fmt: skip
    with running(parameters):
        rclpy.init()
        yield (made := Robot())
        made.node.destroy_node()
        rclpy.try_shutdown()


def test_nothing_is_published_before_it_is_active(robot: Robot) -> None:
    assert robot.state_now() == State.PRIMARY_STATE_UNCONFIGURED
    assert not robot.transition(Transition.TRANSITION_DEACTIVATE)  # refused, and the node lives on
    assert robot.transition(Transition.TRANSITION_CONFIGURE)
    assert robot.state_now() == State.PRIMARY_STATE_INACTIVE
    robot.drive()
    robot.spin(0.5)
    assert not any(robot.got.values())
    assert robot.transition(Transition.TRANSITION_ACTIVATE)


def test_what_comes_back_is_what_the_library_says(robot: Robot) -> None:
    message: OccupancyGrid = robot.answer()
    t_ns = robot.t_ns
    sweep = Sweep(POINTS, t_ns=t_ns, world_from_sensor=pose_at(t_ns), agent="front")
    expected = viewshed.estimate(sweep, method="shadow_map")
    values = visibility_layer(expected, "state")
    got = np.array(message.data, np.int8).reshape(expected.grid.shape).T
    # Earlier sweeps from the same place help: they may open what this one alone leaves UNKNOWN.
    assert (got == values).mean() > 0.98
    assert message.header.frame_id == "lidar"


def test_every_layer_and_the_alarm_come(robot: Robot) -> None:
    robot.answer("visibility")
    robot.until(lambda: all(robot.got[name] for name in (*LAYERS, "alarm", "diagnostics")))
    alarm = robot.got["alarm"][-1]
    assert {pair.key for pair in alarm.values} >= {"caution", "speed in m/s", "latency in ms"}
    assert robot.got["speed_mask"][-1].header.frame_id == "map"
    assert len(robot.got["clearing"][-1].data) > 1000
    # Masks lie on the raster of the map, whatever the pose.
    origin = robot.got["speed_mask"][-1].info.origin
    assert (origin.orientation.w, origin.position.y % 0.5) == (1.0, 0.0)


def test_a_laser_in_the_same_process_has_its_own_view(robot: Robot) -> None:
    robot.subscribe(OccupancyGrid, "laser/visibility", LATCHED)
    robot.got["scans"], robot.got["visibility"] = robot.got["visibility"], []
    step = 2 * np.pi / 720
    scan = LaserScan(angle_min=-np.pi, angle_max=np.pi - step, angle_increment=step, range_min=0.1, range_max=30.0)
    scan.ranges = [8.0] * 720
    scan.header.frame_id = "laser"

    def came() -> bool:
        robot.t_ns += STEP_NS
        scan.header.stamp = stamp_of(robot.t_ns)
        robot.scans.publish(scan)
        return any(message.header.frame_id == "laser" for message in robot.got["scans"])

    robot.until(came)
    grid = next(message for message in robot.got["scans"] if message.header.frame_id == "laser")
    seen = np.array(grid.data, np.int8).reshape(256, 256) > 50
    assert seen.sum() * 0.25 == pytest.approx(np.pi * 8.0**2, rel=0.15)
    robot.answer()


def test_ten_clouds_a_second_are_answered(robot: Robot) -> None:
    before, begin = len(robot.got["state"]), time.monotonic()
    for number in range(20):
        robot.drive()
        robot.spin(max(0.0, begin + 0.1 * (number + 1) - time.monotonic()))
    robot.spin(0.5)
    # Of ten a second, as many as a loaded machine with every topic subscribed can be asked for.
    assert len(robot.got["state"]) - before >= 5


def test_a_cloud_that_is_broken_costs_that_cloud_and_is_counted(robot: Robot) -> None:
    broken = cloud(POINTS, robot.t_ns + STEP_NS // 2)
    broken.point_step = 11
    robot.clouds.publish(broken)
    robot.until(lambda: robot.reported("leaves a point of 11 bytes"))
    # STALE where the last view has grown too old meanwhile; either way the reason is reported.
    worst = (DiagnosticStatus.ERROR, DiagnosticStatus.STALE)
    robot.until(
        lambda: any(each.level in worst and "leaves a point of 11 bytes" in str(each) for each in robot.got["alarm"])
    )
    other = cloud(POINTS, robot.t_ns + STEP_NS // 2, frame="rear")
    robot.clouds.publish(other)
    robot.until(lambda: robot.reported("a cloud must be in frame 'lidar'"))
    robot.answer()


def test_time_that_goes_back_is_told_and_answered(robot: Robot) -> None:
    robot.answer(step_ns=-20 * STEP_NS)
    robot.until(lambda: robot.reported("time went back"))
    robot.answer()


def test_parameters_change_while_it_runs_or_say_why_not(robot: Robot) -> None:
    client = robot.node.create_client(SetParameters, "field_of_view/set_parameters")

    def change(name: str, value: Any) -> Any:
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return robot.call(client, request).results[0]

    assert "must lie" in change("rate_hz", 5e3).reason or "range" in change("rate_hz", 5e3).reason
    assert "deactivate it" in change("target", "pedestrian").reason
    assert change("rate_hz", 0.1).successful
    robot.drive(step_ns=20 * 10**9)
    for _ in range(20):
        robot.drive()
        robot.spin(0.1)
    robot.until(lambda: robot.reported("beyond the rate"))
    beyond = next(
        int(pair.value) for status in robot.got["diagnostics"][-1].status for pair in status.values
        if pair.key == "beyond the rate" and int(pair.value)
    )  # fmt: skip
    assert beyond >= 10
    assert change("rate_hz", 0.0).successful
    robot.answer()


def test_without_a_pose_there_is_a_view_but_no_mask_and_that_is_told(robot: Robot) -> None:
    masks = len(robot.got["speed_mask"])
    robot.t_ns += 60 * 10**9
    stamp = stamp_of(robot.t_ns)
    robot.clouds.publish(cloud(POINTS, robot.t_ns))
    robot.until(lambda: any(message.header.stamp == stamp for message in robot.got["state"]))
    robot.until(lambda: robot.reported("without a pose"))
    assert not any(message.header.stamp == stamp for message in robot.got["speed_mask"][masks:])


def test_a_publisher_that_begins_anew_is_heard(robot: Robot) -> None:
    robot.node.destroy_publisher(robot.clouds)
    robot.spin(0.3)
    robot.clouds = robot.publisher()
    robot.until(lambda: robot.clouds.get_subscription_count() == 1)
    robot.answer()


def test_the_lifecycle_goes_round_again_and_again(robot: Robot) -> None:
    for _ in range(2):
        assert robot.transition(Transition.TRANSITION_DEACTIVATE)
        robot.spin(0.3)
        for messages in robot.got.values():
            messages.clear()
        robot.drive()
        robot.spin(0.5)
        assert not robot.got["state"]
        assert robot.transition(Transition.TRANSITION_CLEANUP)
        assert robot.state_now() == State.PRIMARY_STATE_UNCONFIGURED
        assert robot.transition(Transition.TRANSITION_CONFIGURE)
        assert robot.transition(Transition.TRANSITION_ACTIVATE)
        robot.until(lambda: robot.clouds.get_subscription_count() == 1)
        robot.answer()
    assert robot.transition(Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert robot.state_now() == State.PRIMARY_STATE_FINALIZED
