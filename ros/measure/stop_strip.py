"""Cut sensor, poses, network and node one by one, as a timeline: ``ros/python.sh ros/measure/stop_strip.py PICTURE``.

Runs the node and the watchdog with the robot of the tests, draws a subscriber's state over time, and prints the seconds
from the last cloud or pose to masks that stop nav2, as JSON.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import rclpy
from PIL import Image, ImageDraw, ImageFont
from std_msgs.msg import UInt8MultiArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "viewshed_ros" / "test"))
from robot import STEP_NS, Robot, running
from test_stale import PARAMETERS

from viewshed.agents.signing import SigningKey
from viewshed_ros.node import VIEWS

CUTS = {"sensor": (3.0, 6.0), "poses": (9.0, 12.0), "network": (15.0, 18.0), "node": (21.0, 24.0)}
"""Start and end of each cut in seconds; a killed node does not come back."""

STEP_S, SCALE, ROW, LEFT = 0.1, 40, 26, 150
"""Time between clouds; pixels per second, of a row's height, and of the names."""

GREEN, YELLOW, RED, GRAY = (120, 190, 140), (240, 200, 80), (210, 50, 40), (225, 225, 225)
COLORS = {
    "on": GREEN, "cut": RED, "KEEP": GREEN, "ASK": YELLOW, "STALE": RED, "claims": GREEN, "stop": RED,
    "UNKNOWN": RED, "heard": GREEN, "silent": GRAY, "none": GRAY,
}  # fmt: skip


def main() -> None:
    """Run the test, draw the picture and print the times."""
    rclpy.init()
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        key = Path(folder) / "car.key"
        with os.fdopen(os.open(key, os.O_CREAT | os.O_WRONLY, 0o600), "w") as file:
            file.write(SigningKey.generate("car").private.hex())
        agent = {"agent": "car", "agent_key": str(key), "agent_topic": "views"}
        stack.enter_context(running({"sensors": "[front]"}, "watchdog"))
        node = stack.enter_context(running({**PARAMETERS, **agent, "autostart": "true"}))
        robot = Robot()
        while not any(0 in mask.data for mask in robot.got["speed_mask"]):
            robot.drive()
            robot.spin(STEP_S)
        rows, stopped_s = run(robot, node)
    rclpy.try_shutdown()
    draw(rows).save(sys.argv[1], optimize=True)
    print(json.dumps(stopped_s))


def run(robot: Robot, node: Any) -> tuple[list[dict[str, str]], dict[str, float]]:
    """Return the state of a subscriber at each time, and the time from each cut until nav2 stops."""
    views: list[float] = []
    heard: Any = None
    rows, last_s, stopped_s = list[dict[str, str]](), dict.fromkeys(CUTS, 0.0), dict[str, float]()
    begin_s, next_s = time.monotonic(), 0.0
    while (now_s := time.monotonic() - begin_s) < CUTS["node"][1]:
        cut = {name for name, (first_s, end_s) in CUTS.items() if first_s <= now_s < end_s}
        if now_s >= next_s:
            next_s += STEP_S
            robot.t_ns += STEP_NS
            if "poses" not in cut:
                robot.locate()
            if "sensor" not in cut:
                robot.publish_cloud()
            last_s |= dict.fromkeys(set(CUTS) - cut, now_s)
        if "node" in cut and node.poll() is None:
            node.kill()
        if ("network" in cut) == (heard is not None):
            if heard is not None:
                robot.node.destroy_subscription(heard)
            take = partial(hear, views)
            heard = None if "network" in cut else robot.node.create_subscription(UInt8MultiArray, "views", take, VIEWS)
        rclpy.spin_once(robot.node, timeout_sec=0.01)
        if not rows or now_s - float(rows[-1]["s"]) > 0.02:
            rows.append(held(robot, cut, bool(views) and time.monotonic() - views[-1] < 0.5, now_s))
        if rows[-1]["speed mask"] == rows[-1]["keep-out mask"] == "stop":
            for name in cut:
                stopped_s.setdefault(name, round(now_s - last_s[name], 3))
    return rows, stopped_s


def hear(times_s: list[float], _: UInt8MultiArray) -> None:
    """Record the arrival of an agent's message."""
    times_s.append(time.monotonic())


def held(robot: Robot, cut: set[str], is_heard: bool, now_s: float) -> dict[str, str]:
    """Return the current state of a subscriber."""
    row = {name: "cut" if name in cut else "on" for name in CUTS}
    values = {pair.key: pair.value for pair in robot.got["alarm"][-1].values} if robot.got["alarm"] else {}
    row["alarm"] = values.get("caution", "none")
    for name, topic, stop in (("speed mask", "speed_mask", 1), ("keep-out mask", "keepout_mask", 100)):
        row[name] = "stop" if set(robot.got[topic][-1].data) == {stop} else "claims"
    row["grid state"] = "UNKNOWN" if set(robot.got["state"][-1].data) == {-1} else "claims"
    row["agents' topic"] = "heard" if is_heard else "silent"
    return {"s": f"{now_s:.3f}", **row}


def draw(rows: list[dict[str, str]]) -> Image.Image:
    """Return the timeline: a colored row for each input that is cut, and for each output."""
    names, font = [name for name in rows[0] if name != "s"], ImageFont.load_default(14)
    end_s = CUTS["node"][1]
    picture = Image.new("RGB", (LEFT + int(end_s * SCALE) + 20, ROW * (len(names) + 1) + 8), (255, 255, 255))
    pen = ImageDraw.Draw(picture)
    for at, name in enumerate(names):
        top = ROW * at + 6
        pen.text((8, top + 2), name, (0, 0, 0), font)
        before = ""
        for row, later in zip(rows, [*rows[1:], {"s": str(end_s)}], strict=True):
            left, right = (LEFT + int(float(entry["s"]) * SCALE) for entry in (row, later))
            pen.rectangle((left, top, right, top + ROW - 7), COLORS[row[name]])
        for row in rows:
            if row[name] != before:
                pen.text((LEFT + int(float(row["s"]) * SCALE) + 3, top + 2), row[name], (0, 0, 0), font)
                before = row[name]
    for second in range(0, int(end_s) + 1, 3):
        pen.text((LEFT + second * SCALE, ROW * len(names) + 8), f"{second} s", (0, 0, 0), font)
    return picture


if __name__ == "__main__":
    main()
