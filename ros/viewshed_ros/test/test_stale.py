"""Silence never reads as clear: sensor, poses and the node itself are cut one by one, and nav2 stops each time."""

import math
import time
from collections.abc import Iterator
from contextlib import ExitStack

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from nav_msgs.msg import OccupancyGrid
from robot import STEP_NS, Robot, pose_at, running

from viewshed_ros.conversions import nanoseconds_of
from viewshed_ros.outlets import FrameVote, Outlet, Pace
from viewshed_ros.stops import LATCHED, MASK_STOPS, everywhere

PARAMETERS = {
    "sensors": "[front]", "profile": "infrastructure", "monitor": "never", "pose_source": "odometry",
    "pose_wait_s": "0.05", "front.topic": "cloud", "front.mounting": "[0.0, 0.0, 1.8, 1.0, 0.0, 0.0, 0.0]",
    "speed_unseen_mps": "2.0",
}  # fmt: skip
MAX_AGE_S = 0.6
"""Of the newest sweep when a stop message is made: .5 s and one period."""

SLACK_S = 0.3
"""For a machine that others use as well."""

PATIENCE_S = 2.0
"""Until it is here, likewise."""


def value_at(mask: OccupancyGrid, x: float, y: float) -> int:
    """Return the value of the cell at (x, y), as nav2's filters read it; -1 outside."""
    info = mask.info
    column = int((x - info.origin.position.x) // info.resolution)
    row = int((y - info.origin.position.y) // info.resolution)
    inside = 0 <= column < info.width and 0 <= row < info.height
    return int(mask.data[row * info.width + column]) if inside else -1


def speed_percent(mask: OccupancyGrid, x: float, y: float, before: int) -> int:
    """SpeedFilter: -1 is skipped, the limit before holds; 0 is no limit; else percent of the greatest speed."""
    return before if (value := value_at(mask, x, y)) == -1 else value or 100


def is_kept_out(mask: OccupancyGrid, x: float, y: float) -> bool:
    """KeepoutFilter: -1 is skipped; 100 is lethal."""
    return value_at(mask, x, y) == 100


class Vehicle:
    """What nav2 makes of the masks of a robot: those that came last, for who joins now."""

    def __init__(self, robot: Robot, name: str = "vehicle") -> None:
        self.robot, self.masks = robot, dict[str, list[OccupancyGrid]]()
        self.node = rclpy.create_node(name, namespace="bot")
        for mask in MASK_STOPS:
            self.masks[mask] = []
            self.node.create_subscription(OccupancyGrid, f"front/{mask}", self.masks[mask].append, LATCHED)

    def spin(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            rclpy.spin_once(self.node, timeout_sec=left)

    def is_stopped(self) -> bool:
        """Whether it stops where it is, and is kept out of all around it."""
        if not all(self.masks.values()):
            return False
        x, y = pose_at(self.robot.t_ns).translation[:2].tolist()
        speed, keepout = self.masks["speed_mask"][-1], self.masks["keepout_mask"][-1]
        around = [(x + dx, y + dy) for dx in (-20.0, 0.0, 20.0) for dy in (-20.0, 0.0, 20.0)]
        return speed_percent(speed, x, y, before=100) == 1 and all(is_kept_out(keepout, *place) for place in around)

    def may_drive(self) -> bool:
        """Whether no limit holds in some cell, and it may go there."""
        fresh = all(self.masks.values()) and 0 in self.masks["speed_mask"][-1].data
        return fresh and 0 in self.masks["keepout_mask"][-1].data

    def stopped_after_s(self, since_s: float) -> float:
        """Wait until it stops, and return how long that took."""
        while not self.is_stopped():
            assert time.monotonic() - since_s < 10.0, "it drives on"
            rclpy.spin_once(self.node, timeout_sec=0.01)
        return time.monotonic() - since_s

    def close(self) -> None:
        self.node.destroy_node()


def late_joiner_stops(robot: Robot) -> bool:
    """Return whether all that a late joiner is given in a second stops it."""
    late = Vehicle(robot, "late")
    late.spin(1.0)
    masks = late.masks
    late.close()
    return all(masks.values()) and all(
        set(mask.data) == {value} for name, value in MASK_STOPS.items() for mask in masks[name]
    )


def drive(robot: Robot, vehicle: Vehicle, seconds: float = 20.0) -> float:
    """Drive at 10 Hz until the vehicle may for a second, and return when the last cloud went out."""
    end, free = time.monotonic() + seconds, 0
    while True:
        robot.drive()
        last_s = time.monotonic()
        free = free + 1 if vehicle.may_drive() else 0
        if free == 10:
            return last_s
        assert time.monotonic() < end, "it may never drive"
        vehicle.spin(0.1)


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    rclpy.init()
    with ExitStack() as made:
        yield made
    rclpy.try_shutdown()


def test_nav2_stops_when_the_sensor_or_the_poses_stop_and_when_the_node_does(stack: ExitStack) -> None:
    stack.enter_context(running({**PARAMETERS, "autostart": "true"}))
    robot = Robot()
    vehicle = Vehicle(robot)
    # 1. From activation on, before the first sweep: it is unknown where the vehicle is, and it stops wherever that is.
    assert vehicle.stopped_after_s(time.monotonic() + 20.0) < 20.0
    assert late_joiner_stops(robot)
    # 2. The sensor is cut, poses go on.
    last_s = drive(robot, vehicle)
    vehicle.spin(0.2)  # the masks of the last sweep may be on their way
    area = vehicle.masks["speed_mask"][-1].info
    while not vehicle.is_stopped():
        robot.locate()
        vehicle.spin(0.02)
        assert time.monotonic() - last_s < PATIENCE_S
    for name, value in MASK_STOPS.items():
        mask = vehicle.masks[name][-1]
        assert set(mask.data) == {value}
        assert (mask.info.width, mask.info.origin) == (area.width, area.origin)
        age_s = 1e-9 * (nanoseconds_of(mask.header.stamp) - nanoseconds_of(mask.info.map_load_time))
        assert 0.5 < age_s < MAX_AGE_S + SLACK_S
    assert late_joiner_stops(robot)
    robot.spin(0.5)
    alarm = robot.got["alarm"][-1]
    values = {pair.key: pair.value for pair in alarm.values}
    assert alarm.level == DiagnosticStatus.STALE
    assert (values["caution"], values["speed in m/s"], values["speed limit in m/s"]) == ("STALE", "0.00", "2.00")
    assert float(values["age in s"]) > 0.5
    assert set(robot.got["state"][-1].data) == set(robot.got["visibility"][-1].data) == {-1}
    assert len(robot.got["view"][-1].polygon.points) == len(robot.got["clearing"][-1].data) == 0
    # 3. The poses are cut, the sensor goes on: the view does, the masks do not.
    last_s = drive(robot, vehicle)
    while not vehicle.is_stopped():
        robot.t_ns += STEP_NS
        robot.publish_cloud()
        vehicle.spin(0.1)
        assert time.monotonic() - last_s < PATIENCE_S + 0.1
    robot.spin(0.2)  # what was under way
    for messages in robot.got.values():
        messages.clear()
    for _ in range(10):
        robot.t_ns += STEP_NS
        robot.publish_cloud()
        robot.spin(0.1)
    assert any(0 in grid.data for grid in robot.got["state"])
    assert {alarm.level for alarm in robot.got["alarm"]} == {DiagnosticStatus.STALE}
    assert all(set(mask.data) == {100} for mask in robot.got["keepout_mask"])
    assert late_joiner_stops(robot)
    # 4. What comes back holds at once; and whoever deactivates the node stops the vehicle.
    drive(robot, vehicle)
    assert robot.transition(Transition.TRANSITION_DEACTIVATE)
    assert vehicle.stopped_after_s(time.monotonic()) < PATIENCE_S
    assert late_joiner_stops(robot)
    vehicle.close()


def test_the_watchdog_stops_in_place_of_a_node_that_was_killed_and_withdraws_when_it_lives_again(
    stack: ExitStack,
) -> None:
    stack.enter_context(running({"sensors": "[front]", "speed_unseen_mps": "2", "stale_s": ".nan"}, "watchdog"))
    robot = Robot()
    vehicle = Vehicle(robot)
    # 1. Before the node lives at all.
    assert vehicle.stopped_after_s(time.monotonic() + 20.0) < 20.0
    node = stack.enter_context(running({**PARAMETERS, "autostart": "true"}))
    last_s = drive(robot, vehicle)
    vehicle.spin(0.5)
    # 2. Killed, it can withdraw nothing itself.
    last_s = drive(robot, vehicle)
    node.kill()
    assert vehicle.stopped_after_s(last_s) < PATIENCE_S
    assert vehicle.masks["keepout_mask"][-1].info.width == 256
    assert late_joiner_stops(robot)
    robot.spin(0.5)
    alarm = robot.got["alarm"][-1]
    assert alarm.level == DiagnosticStatus.STALE
    assert "heartbeat of the node" in alarm.message
    # 3. A node that lives again is the only one that speaks, as soon as its heartbeats are heard.
    stack.enter_context(running({**PARAMETERS, "autostart": "true"}))
    end = time.monotonic() + 20.0
    fresh_s = math.inf
    while time.monotonic() < fresh_s + 1.0:
        assert time.monotonic() < end, "the watchdog does not withdraw"
        vehicle.masks["keepout_mask"].clear()
        drive(robot, vehicle)
        has_stop = any(set(mask.data) == {100} for mask in vehicle.masks["keepout_mask"])
        fresh_s = math.inf if has_stop else min(fresh_s, time.monotonic())
    # And who comes late is given nothing of the watchdog any more.
    late = Vehicle(robot, "late")
    for _ in range(10):
        robot.drive()
        late.spin(0.1)
    assert late.may_drive()
    assert not any(set(mask.data) == {100} for mask in late.masks["keepout_mask"])
    late.close()
    vehicle.close()


class Listened:
    """A publisher with this number of listeners that keeps what it is given."""

    def __init__(self, listeners: int) -> None:
        self.listeners, self.got = listeners, list[str]()

    def get_subscription_count(self) -> int:
        return self.listeners

    def publish(self, message: str) -> None:
        self.got.append(message)


def test_what_stays_latched_while_nobody_listens_is_replaced_once_and_for_listeners_again_and_again() -> None:
    publisher = Listened(1)
    outlet = Outlet(publisher, lambda: "stop")
    outlet.stop_if_older(0.5, 100.0)  # nothing was said: nothing is to be replaced
    outlet.publish(lambda: "clear", 100.0)
    outlet.stop_if_older(0.5, 100.4)
    assert publisher.got == ["clear"]
    publisher.listeners = 0
    outlet.publish(lambda: "never made", 100.5)
    for now_s in (100.6, 101.2, 101.8):
        outlet.stop_if_older(0.5, now_s)
    assert publisher.got == ["clear", "stop"]
    publisher.listeners = 1
    for now_s in (102.4, 102.5, 103.0):
        outlet.stop_if_older(0.5, now_s)
    assert publisher.got == ["clear", "stop", "stop", "stop"]
    # A message that comes in time, but from a sweep that is too old, is replaced at once.
    outlet.publish(lambda: "late", 102.0)
    outlet.stop_if_older(0.5, 103.1)
    outlet.close(103.2)
    outlet.publish(lambda: "after the end", 103.3)
    assert publisher.got[4:] == ["late", "stop", "stop"]


def test_a_gap_is_no_period() -> None:
    pace = Pace()
    assert pace.period_s() == 0.0
    for number in range(5):
        pace.note(50.0 + 0.4 * number)
    assert pace.period_s() == pytest.approx(0.4)
    pace.note(90.0)
    pace.note(90.5)
    assert pace.period_s() == pytest.approx(0.4)


def frames_taken(frames: list[str], vote: FrameVote, step_s: float) -> list[bool]:
    """Return for each cloud whether it is taken."""
    taken = []
    for number, frame in enumerate(frames):
        vote.add(frame, 10.0 + step_s * number)
        try:
            vote.check(frame)
            taken.append(True)
        except ValueError:
            taken.append(False)
    return taken


@pytest.mark.parametrize("step_s", [0.05, 0.1, 1.0])
def test_a_stray_cloud_costs_that_cloud_whenever_it_comes(step_s: float) -> None:
    # The first of all binds until most of five clouds are in another frame.
    assert frames_taken(["rear", *["lidar"] * 20], FrameVote(), step_s) == [True, *[False] * 3, *[True] * 17]
    frames = ["lidar"] * 20
    frames[9] = "rear"
    assert [at for at, taken in enumerate(frames_taken(frames, FrameVote(), step_s)) if not taken] == [9]
    # A sensor that is renamed is believed when most clouds say so.
    renamed = frames_taken(["lidar"] * 30 + ["top"] * 30, FrameVote(), step_s)
    assert all(renamed[:30])
    assert all(renamed[-10:])


def test_a_frame_that_is_given_is_the_only_one() -> None:
    assert not any(frames_taken(["rear"] * 20, FrameVote("lidar"), 0.1))
    assert all(frames_taken(["lidar"] * 20, FrameVote("lidar"), 0.1))


def test_masks_before_any_pose_cover_the_map_also_as_the_keepout_filter_reads_it() -> None:
    area = everywhere()
    # Its window begins half a cell inside the lower corner.
    low_m = area.origin.position.x + 0.5 * area.resolution
    high_m = area.origin.position.x + area.width * area.resolution
    assert low_m <= -1e7
    assert high_m >= 1e7
    # Cells of a costmap are counted in 32 bits.
    assert (high_m + 0.5 * area.resolution) / 0.01 < np.iinfo(np.int32).max
    assert math.isclose(area.origin.orientation.w, 1.0)
