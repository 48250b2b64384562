"""The parameters of the node, in one table, and their values checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from viewshed.geometry import Rigid, rotation_from_quaternion
from viewshed.pipeline.profiles import Profile, profile_named
from viewshed.pipeline.reactions import VEHICLE, Vehicle
from viewshed.sensors import LidarModel, lidar_model
from viewshed_ros.conversions import INPUTS, Input
from viewshed_ros.nav2 import SpeedLimits
from viewshed_ros.packets import Revolutions
from viewshed_ros.poses import POSE_TOPICS

Value = bool | str | float | int | list[str] | list[float]


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter: its value where none is given, what it means, and its values where they are few."""

    default: Value
    description: str
    choices: tuple[str, ...] = ()


OF_PROFILE = "profile"
"""The value of a parameter that leaves it to the profile."""

# No value is on, off, yes or no: on a command line these are true and false, not text.
PARAMETERS: dict[str, Parameter] = {
    "profile": Parameter("robot", "What the pipeline is for: robot, infrastructure, mapping or contested."),
    "method": Parameter(OF_PROFILE, "Name of the estimator, or profile."),
    "grid": Parameter(OF_PROFILE, "road, indoor, paper, paper_indoor, or profile."),
    "target": Parameter("car", "What would have to be seen: car or pedestrian."),
    "history": Parameter(
        -1, "Earlier sweeps of a sensor that help, where poses are known; -1 leaves it to the profile."
    ),
    "rate_hz": Parameter(-1.0, "Sweeps of a sensor estimated in a second; 0 for all, -1 leaves it to the profile."),
    "monitor": Parameter(OF_PROFILE, "Whether streams are watched.", (OF_PROFILE, "always", "never")),
    "monitor_file": Parameter("", "File of viewshed monitor calibrate; empty for the monitor in the box."),
    "sensors": Parameter(["lidar"], "Names of the sensors; each has the parameters and topics below its name."),
    "pose_source": Parameter("none", "Where poses are from.", ("none", "tf", *POSE_TOPICS)),
    "pose_topic": Parameter("odometry", "Topic of poses, unless they are from tf."),
    "pose_wait_s": Parameter(0.02, "How long a pose that is still to come is waited for."),
    "world_frame": Parameter("map", "Frame of poses and masks."),
    "output": Parameter("sensor", "Frame of grids, polygons and markers.", ("sensor", "world")),
    "speed_most_mps": Parameter(10.0, "100 percent of the speed mask."),
    "speed_unseen_mps": Parameter(1.0, "Speed of the mask where nothing is seen."),
    "vehicle_front_m": Parameter(VEHICLE.front_m, "From the sensor to the front of the vehicle."),
    "vehicle_half_width_m": Parameter(VEHICLE.half_width_m, "Half of the width of the lane that must be free."),
    "vehicle_delay_s": Parameter(VEHICLE.delay_s, "Time until the brakes act."),
    "vehicle_braking_mps2": Parameter(VEHICLE.braking_mps2, "How hard the vehicle brakes."),
    "objects": Parameter(False, "Detect, track and explain objects as well; needs scipy."),
    "agent": Parameter("", "Name under which the first sensor's answers are told to other agents; empty for not."),
    "agent_key": Parameter("", "File of the agent's private key, 64 hexadecimal digits."),
    "agent_topic": Parameter("/viewshed/views", "Topic of the signed messages of all agents."),
    "autostart": Parameter(False, "Configure and activate at once, where no manager of lifecycles does."),
    "diagnostics_hz": Parameter(1.0, "How often /diagnostics is published."),
}
"""Of the node."""

SENSOR_PARAMETERS: dict[str, Parameter] = {
    "topic": Parameter("", "Topic of its messages; empty for NAME/points."),
    "type": Parameter("cloud", "Type of its messages.", tuple(INPUTS)),
    "metadata": Parameter("", "Of type ouster or ouster_bytes: file of the sensor's metadata (JSON)."),
    "frame": Parameter("", "Frame of a sensor whose messages name none (packets); empty for NAME."),
    "model": Parameter("auto", "Name of a beam table, auto to infer it from the points, or none."),
    "height_m": Parameter(0.0, "Height above the ground; 0 to estimate it."),
    "attitude": Parameter([0.0, 0.0, 0.0, 0.0], "Quaternion w, x, y, z of level_from_sensor; zeros to estimate it."),
    "mounting": Parameter(
        [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
        "Where it stands on the vehicle: x, y, z, w, x, y, z of base_from_sensor; tf knows it by itself.",
    ),
}
"""Of each sensor, below its name."""


@dataclass(frozen=True, slots=True)
class SensorSettings:
    """What is known of a sensor."""

    name: str
    topic: str
    input: Input
    changes: dict[str, Any]
    """Attributes of its sweeps that are given."""
    base_from_sensor: Rigid
    frame: str
    """Of messages that name none."""
    revolutions: Revolutions | None
    """Gathers packets, of a sensor whose messages hold one each."""


@dataclass(frozen=True, slots=True)
class NodeSettings:
    """The values of all parameters, checked."""

    profile: Profile
    method: str
    grid: str
    target: str
    history: int
    rate_hz: float
    monitor: str
    monitor_file: str
    sensors: tuple[SensorSettings, ...]
    pose_source: str
    pose_topic: str
    pose_wait_s: float
    world_frame: str
    output: str
    limits: SpeedLimits
    vehicle: Vehicle
    diagnostics_hz: float
    objects: bool = False
    agent: str = ""
    agent_key: str = ""
    agent_topic: str = ""


def declare(node: Node) -> None:
    """Declare the parameters of the node."""
    declare_table(node, PARAMETERS)


def read(node: Node) -> NodeSettings:
    """Return the values of all parameters; those of the sensors are declared when they are named first.

    Raises:
        ValueError: a value is out of range or no choice; the text says which.
    """
    given: dict[str, Any] = values_of(node, PARAMETERS)
    profile = profile_named(given["profile"])
    names = given["sensors"]
    if not names or len(set(names)) != len(names) or not all(name.isidentifier() and name.isascii() for name in names):
        raise ValueError(f"sensors must be different names of letters and digits, got {list(names)}")
    for name in ("diagnostics_hz", "pose_wait_s"):
        if not 0.0 <= given[name] <= 100.0:
            raise ValueError(f"{name} must lie in [0, 100], got {given[name]}")
    if given["agent"] and (given["pose_source"] == "none" or not given["agent_key"] or len(names) > 1):
        raise ValueError(
            f"agent {given['agent']} needs one sensor, a pose_source and an agent_key, got sensors {list(names)},"
            f" pose_source {given['pose_source']} and agent_key {given['agent_key']!r}"
        )
    if given["output"] == "world" and given["pose_source"] == "none":
        raise ValueError("output world needs poses, got pose_source none; name tf, odometry, pose or transform")
    return NodeSettings(
        profile=profile,
        method=profile.method if given["method"] == OF_PROFILE else given["method"],
        grid=profile.grid if given["grid"] == OF_PROFILE else given["grid"],
        target=given["target"],
        history=profile.history if given["history"] < 0 else given["history"],
        rate_hz=profile.rate_hz if given["rate_hz"] < 0.0 else given["rate_hz"],
        monitor=given["monitor"],
        monitor_file=given["monitor_file"],
        sensors=tuple(_sensor(node, name) for name in names),
        pose_source=given["pose_source"],
        pose_topic=given["pose_topic"],
        pose_wait_s=given["pose_wait_s"],
        world_frame=given["world_frame"],
        output=given["output"],
        limits=SpeedLimits(given["speed_most_mps"], given["speed_unseen_mps"]),
        vehicle=Vehicle(
            given["vehicle_front_m"],
            given["vehicle_half_width_m"],
            given["vehicle_delay_s"],
            given["vehicle_braking_mps2"],
        ),
        diagnostics_hz=given["diagnostics_hz"],
        objects=given["objects"],
        agent=given["agent"],
        agent_key=given["agent_key"],
        agent_topic=given["agent_topic"],
    )


def _sensor(node: Node, name: str) -> SensorSettings:
    table = {f"{name}.{part}": parameter for part, parameter in SENSOR_PARAMETERS.items()}
    declare_table(node, table)
    given = {key.partition(".")[2]: value for key, value in values_of(node, table).items()}
    changes: dict[str, Any] = {}
    if given["model"] != "auto":
        model: LidarModel | None = None if given["model"] == "none" else lidar_model(given["model"])
        changes |= {"model": model, "infer_sensor": False}
    if given["height_m"]:
        changes["sensor_height_m"] = given["height_m"]
    if any(given["attitude"]):
        changes["attitude"] = np.array(given["attitude"])
        rotation_from_quaternion(changes["attitude"])
    if len(given["mounting"]) != 7:
        raise ValueError(f"{name}.mounting must be seven numbers, got {len(given['mounting'])}")
    base_from_sensor = Rigid.from_quaternion(given["mounting"][3:], given["mounting"][:3])
    topic = given["topic"] or f"{name}/points"
    kind, revolutions = INPUTS[given["type"]], None
    if kind.packet:
        if not given["metadata"]:
            raise ValueError(f"{name}.metadata must name the file of the sensor's metadata for packets, got none")
        revolutions = Revolutions.of(given["metadata"])
    return SensorSettings(name, topic, kind, changes, base_from_sensor, given["frame"] or name, revolutions)


def declare_table(node: Node, table: dict[str, Parameter]) -> None:
    """Declare the parameters of a table that are not declared yet."""
    for name, parameter in table.items():
        if not node.has_parameter(name):
            node.declare_parameter(
                name, parameter.default,
                ParameterDescriptor(
                    description=parameter.description, additional_constraints=", ".join(parameter.choices)
                ),
            )  # fmt: skip


def values_of(node: Node, table: dict[str, Parameter]) -> dict[str, Any]:
    """Return the values of the parameters of a table.

    Raises:
        ValueError: one is none of its choices.
    """
    values = {name: node.get_parameter(name).value for name in table}
    for name, parameter in table.items():
        _check_choice(name, values[name], parameter.choices)
    return values


def _check_choice(name: str, value: Any, choices: Sequence[str]) -> None:
    if choices and value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(choices)}, got {value!r}")
