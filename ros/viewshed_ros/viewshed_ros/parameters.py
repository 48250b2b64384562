"""Table of the node's parameters, and checks of their values."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node

from viewshed.estimators import load_estimator
from viewshed.fov.visibility import TARGETS
from viewshed.geometry import Rigid, rotation_from_quaternion
from viewshed.grid import GRIDS
from viewshed.guarantees.envelope import Threat
from viewshed.monitor.calibration import load_calibration
from viewshed.networks.runtime import load_runner
from viewshed.pipeline.profiles import PROFILES, Profile, profile_named
from viewshed.pipeline.reactions import VEHICLE, Vehicle
from viewshed.sensors import LidarModel, lidar_model
from viewshed_ros.conversions import INPUTS, Input
from viewshed_ros.nav2 import SpeedLimits
from viewshed_ros.packets import Revolutions
from viewshed_ros.poses import POSE_TOPICS
from viewshed_ros.stops import STALE_PERIODS, STALE_S

FROM_PROFILE = "profile"
"""Value of a parameter that takes its value from the profile."""

Value = bool | str | float | int | list[str] | list[float]

_KINDS: dict[type, tuple[type, ...]] = {float: (float, int), list: (list, array)}
"""Accepted types of values by type of the default, if there are several."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of a node."""

    default: Value
    description: str
    choices: tuple[str, ...] = ()  # valid values; empty for no restriction
    bounds: tuple[float, float] | None = None  # minimum and maximum of a number
    check: Callable[[Any], object] | None = None  # raises for an invalid value
    at_run: bool = False  # whether a change applies at once; else only when the node is configured
    fixed: bool = False  # whether it is read only once, when the process starts

    def descriptor(self, *, is_strict: bool = True) -> ParameterDescriptor:
        """Return the descriptor for ``ros2 param describe``; without ``is_strict`` it accepts any value."""
        words = [", ".join(self.choices)] if self.choices else []
        words += [] if self.at_run or self.fixed else ["read when the node is configured"]
        descriptor = ParameterDescriptor(
            description=self.description, additional_constraints="; ".join(words), read_only=self.fixed,
            dynamic_typing=not is_strict,
        )  # fmt: skip
        if is_strict and self.bounds is not None:
            low, high = self.bounds
            if isinstance(self.default, float):
                descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
            else:
                descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
        return descriptor

    def refuse(self, name: str, value: Any) -> None:
        """Raise a ValueError for a value of another type, not among the choices, or out of bounds."""
        if type(value) not in _KINDS.get(type(self.default), (type(self.default),)):
            raise ValueError(f"{name} must be a value like {self.default!r}, got {value!r}")
        if self.choices and value not in self.choices:
            raise ValueError(f"{name} must be one of {', '.join(self.choices)}, got {value!r}")
        if self.bounds is not None:
            low, high = self.bounds
            if not low <= value <= high:
                raise ValueError(f"{name} must lie in [{low:g}, {high:g}], got {value}")


def _threat(value: str, profile: Profile) -> Threat | None:
    """Return the threat named by a parameter value, that of the profile, or None."""
    return profile.certify if value == FROM_PROFILE else None if value == "never" else Threat.parse(value)


def _check_sensors(names: Sequence[str]) -> None:
    words = [str(name) for name in names if str(name).isidentifier() and str(name).isascii()]
    if not names or len(set(words)) != len(names):
        raise ValueError(f"sensors must be different names of letters and digits, got {list(names)}")


def _model(value: str) -> LidarModel | None:
    return None if value in ("auto", "none") else lidar_model(value)


def _mounting(value: Sequence[float]) -> Rigid:
    if len(value) != 7:
        raise ValueError(f"mounting must be seven numbers, got {len(value)}")
    return Rigid.from_quaternion(value[3:], value[:3])


_SPEEDS_MPS = (1e-3, 1e3)


# No value is on, off, yes or no, because the command line parses these as booleans.
PARAMETERS: dict[str, Parameter] = {
    "profile": Parameter("robot", "Use case that sets the defaults.", tuple(PROFILES)),
    "method": Parameter(
        FROM_PROFILE,
        "Name of the estimator; profile takes that of the profile.",
        check=lambda value: value == FROM_PROFILE or load_estimator(value),
    ),
    "weights": Parameter(
        "",
        "For unet and mc_dropout: file or name of a network; empty for the shipped one of grid and target.",
        check=lambda value: value and load_runner(value),
    ),
    "passes": Parameter(0, "For mc_dropout: number of passes, 2 or more; 0 for the default of 10.", bounds=(0, 1000)),
    "grid": Parameter(
        FROM_PROFILE,
        "Name of the grid; profile takes that of the profile, or that of the weights if given.",
        (FROM_PROFILE, *GRIDS),
    ),
    "target": Parameter("car", "Object whose visibility is estimated.", tuple(TARGETS)),
    "history": Parameter(
        -1,
        "Number of earlier sweeps of a sensor to use, if poses are known; -1 takes that of the profile.",
        bounds=(-1, 1000),
    ),
    "rate_hz": Parameter(
        -1.0,
        "Maximum number of sweeps of a sensor estimated per second; 0 for all, -1 takes that of the profile.",
        bounds=(-1.0, 1e3),
        at_run=True,
    ),
    "monitor": Parameter(FROM_PROFILE, "Whether the monitor checks the sweeps.", (FROM_PROFILE, "always", "never")),
    "monitor_file": Parameter(
        "",
        "Monitor made by viewshed monitor calibrate; empty for the shipped one.",
        check=lambda value: value and load_calibration(value),
    ),
    "certify": Parameter(
        FROM_PROFILE,
        "Attack against which claims are certified during an alarm (added, window:5, …), profile, or never.",
        check=lambda value: _threat(value, PROFILES["robot"]),
    ),
    "certified_only": Parameter(False, "Whether only certified cells are claimed, even without an alarm."),
    "sensors": Parameter(
        ["lidar"], "Names of the sensors; each has the parameters and topics below its name.", check=_check_sensors
    ),
    "pose_source": Parameter("none", "Source of the poses.", ("none", "tf", *POSE_TOPICS)),
    "pose_topic": Parameter("odometry", "Topic of poses, unless they are from tf."),
    "pose_wait_s": Parameter(
        0.02, "How long to wait for a pose that has not arrived yet.", bounds=(0.0, 100.0), at_run=True
    ),
    "world_frame": Parameter("map", "Frame of poses and masks."),
    "output": Parameter("sensor", "Frame of grids, polygons and markers.", ("sensor", "world")),
    "speed_most_mps": Parameter(10.0, "Speed that is 100 percent in the speed mask.", bounds=_SPEEDS_MPS),
    "speed_unseen_mps": Parameter(
        1.0,
        "Speed of the mask where nothing is seen, and speed limit of a stale alarm.",
        bounds=_SPEEDS_MPS,
        at_run=True,
    ),
    "stale_s": Parameter(
        STALE_S,
        "Nothing is claimed from a view of this age, once stale_periods have passed as well.",
        bounds=(0.05, 60.0),
        at_run=True,
    ),
    "stale_periods": Parameter(
        STALE_PERIODS,
        "Nothing is claimed from a view that is this many periods of its sensor old, once stale_s have passed as well.",
        bounds=(1.0, 100.0),
        at_run=True,
    ),
    "vehicle_front_m": Parameter(
        VEHICLE.front_m, "Distance from the sensor to the front of the vehicle.", bounds=(-1e3, 1e3)
    ),
    "vehicle_half_width_m": Parameter(
        VEHICLE.half_width_m, "Half of the width of the lane that must be free.", bounds=(1e-3, 1e3)
    ),
    "vehicle_delay_s": Parameter(VEHICLE.delay_s, "Time until the brakes act.", bounds=(0.0, 1e3)),
    "vehicle_braking_mps2": Parameter(
        VEHICLE.braking_mps2, "Deceleration of the vehicle when it brakes.", bounds=(1e-3, 1e3)
    ),
    "objects": Parameter(False, "Detect, track and explain objects as well; needs scipy."),
    "agent": Parameter(
        "", "Name under which the first sensor's views are shared with other agents; empty to share none."
    ),
    "agent_key": Parameter("", "File of the agent's private key, 64 hexadecimal digits."),
    "agent_topic": Parameter("/viewshed/views", "Topic of the signed messages of all agents."),
    "autostart": Parameter(False, "Configure and activate at once, if no lifecycle manager does.", fixed=True),
    "diagnostics_hz": Parameter(
        1.0, "How often /diagnostics is published; 0 for never.", bounds=(0.0, 100.0), at_run=True
    ),
}
"""Parameters of the node."""

SENSOR_PARAMETERS: dict[str, Parameter] = {
    "topic": Parameter("", "Topic of its messages; empty for NAME/points."),
    "type": Parameter("cloud", "Type of its messages.", tuple(INPUTS)),
    "metadata": Parameter("", "For type ouster or ouster_bytes: file of the sensor's metadata (JSON)."),
    "frame": Parameter(
        "", "Frame of the clouds to accept, and of packets; empty for the frame of most clouds, and NAME for packets."
    ),
    "model": Parameter("auto", "Name of a beam table, auto to infer it from the points, or none.", check=_model),
    "height_m": Parameter(0.0, "Height above the ground; 0 to estimate it.", bounds=(0.0, 99.0)),
    "attitude": Parameter(
        [0.0, 0.0, 0.0, 0.0],
        "Quaternion w, x, y, z of level_from_sensor; zeros to estimate it.",
        check=lambda value: any(value) and rotation_from_quaternion(np.array(value)),
    ),
    "mounting": Parameter(
        [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
        "Where it stands on the vehicle: x, y, z, w, x, y, z of base_from_sensor; not needed with tf.",
        check=_mounting,
    ),
}
"""Parameters of each sensor, below its name."""


@dataclass(frozen=True, slots=True)
class SensorSettings:
    """Parameters of one sensor, checked."""

    name: str
    topic: str
    input: Input
    changes: dict[str, Any]
    """Known attributes of its sweeps."""
    base_from_sensor: Rigid
    frame: str
    """Required frame of its messages; empty if not given."""
    revolutions: Revolutions | None
    """Collects packets into revolutions, if each message holds one packet."""


@dataclass(frozen=True, slots=True)
class NodeSettings:
    """Values of all parameters, checked."""

    profile: Profile
    method: str
    weights: str
    passes: int
    grid: str | None
    """None is that of the weights."""
    target: str
    history: int
    rate_hz: float
    monitor: str
    monitor_file: str
    certify: Threat | None
    certified_only: bool
    sensors: tuple[SensorSettings, ...]
    pose_source: str
    pose_topic: str
    pose_wait_s: float
    world_frame: str
    output: str
    limits: SpeedLimits
    vehicle: Vehicle
    diagnostics_hz: float
    stale_s: float = STALE_S
    stale_periods: float = STALE_PERIODS
    objects: bool = False
    agent: str = ""
    agent_key: str = ""
    agent_topic: str = ""


def declare(node: Node) -> None:
    """Declare the parameters of the node."""
    declare_table(node, PARAMETERS)


def read(node: Node) -> NodeSettings:
    """Return the values of all parameters; declare the parameters of sensors that are named for the first time."""
    given: dict[str, Any] = values_of(node, PARAMETERS)
    profile = profile_named(given["profile"])
    names = given["sensors"]
    _check_sensors(names)
    if given["agent"] and (given["pose_source"] == "none" or not given["agent_key"] or len(names) > 1):
        raise ValueError(
            f"agent {given['agent']} needs one sensor, a pose_source and an agent_key, got sensors {list(names)},"
            f" pose_source {given['pose_source']} and agent_key {given['agent_key']!r}"
        )
    if given["output"] == "world" and given["pose_source"] == "none":
        raise ValueError("output world needs poses, got pose_source none; name tf, odometry, pose or transform")
    derived = {
        "profile": profile,
        "method": profile.method if given["method"] == FROM_PROFILE else given["method"],
        "grid": given["grid"] if given["grid"] != FROM_PROFILE else None if given["weights"] else profile.grid,
        "history": profile.history if given["history"] < 0 else given["history"],
        "rate_hz": _rate_hz(profile, given["rate_hz"]),
        "certify": _threat(given["certify"], profile),
        "sensors": tuple(_sensor(node, name) for name in names),
        "limits": SpeedLimits(given["speed_most_mps"], given["speed_unseen_mps"]),
        "vehicle": Vehicle(
            *(given[f"vehicle_{name}"] for name in ("front_m", "half_width_m", "delay_s", "braking_mps2"))
        ),
    }
    # All others are used as given.
    same = {field.name: given[field.name] for field in fields(NodeSettings) if field.name not in derived}
    return NodeSettings(**derived, **same)


def _sensor(node: Node, name: str) -> SensorSettings:
    table = {f"{name}.{part}": parameter for part, parameter in SENSOR_PARAMETERS.items()}
    declare_table(node, table)
    given = {key.partition(".")[2]: value for key, value in values_of(node, table).items()}
    changes: dict[str, Any] = {}
    if given["model"] != "auto":
        changes |= {"model": _model(given["model"]), "infer_sensor": False}
    if given["height_m"]:
        changes["sensor_height_m"] = given["height_m"]
    if any(given["attitude"]):
        changes["attitude"] = np.array(given["attitude"])
        rotation_from_quaternion(changes["attitude"])
    base_from_sensor = _mounting(given["mounting"])
    if not np.array_equal(base_from_sensor.rotation, np.eye(3)):
        changes["vehicle_yaw"] = base_from_sensor.inverse().yaw
    topic = given["topic"] or f"{name}/points"
    kind, revolutions = INPUTS[given["type"]], None
    if kind.packet:
        if not given["metadata"]:
            raise ValueError(f"{name}.metadata must name the file of the sensor's metadata for packets, got none")
        revolutions = Revolutions.of(given["metadata"])
    return SensorSettings(name, topic, kind, changes, base_from_sensor, given["frame"], revolutions)


def declare_table(node: Node, table: dict[str, Parameter], *, fixed: bool = False) -> None:
    """Declare the parameters of a table that are not declared yet, with ``fixed`` all of them as read-only."""
    for name, parameter in table.items():
        declared = replace(parameter, fixed=fixed or parameter.fixed)
        if not node.has_parameter(name):
            try:
                node.declare_parameter(name, declared.default, declared.descriptor())
            except (InvalidParameterTypeException, InvalidParameterValueException):
                # Accept the invalid value for now; reading it reports the error, and it can be corrected.
                node.declare_parameter(name, declared.default, declared.descriptor(is_strict=False))


def values_of(node: Node, table: dict[str, Parameter]) -> dict[str, Any]:
    """Return the checked values of the parameters of a table."""
    values = {name: node.get_parameter(name).value for name in table}
    for name, parameter in table.items():
        parameter.refuse(name, values[name])
        values[name] = float(values[name]) if isinstance(parameter.default, float) else values[name]
    return values


def check_change(name: str, value: Any, *, is_configured: bool) -> None:
    """Raise a ValueError for a parameter value of node or sensor that is invalid, or changed too late."""
    parameter = PARAMETERS.get(name) or SENSOR_PARAMETERS.get(name.partition(".")[2])
    if parameter is None:
        return
    parameter.refuse(name, value)
    if parameter.check is not None:
        try:
            parameter.check(value)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from error
    if is_configured and not parameter.at_run:
        raise ValueError(
            f"{name} must be set before the node is configured, got {value!r} after it; deactivate it, clean it up,"
            f" set {name}, and configure it again"
        )


def changed(settings: NodeSettings, values: Mapping[str, Any]) -> NodeSettings:
    """Return settings with new values of parameters that may change at run time; other values are ignored."""
    changes = {name: value for name, value in values.items() if name in PARAMETERS and PARAMETERS[name].at_run}
    if "rate_hz" in changes:
        changes["rate_hz"] = _rate_hz(settings.profile, changes["rate_hz"])
    if "speed_unseen_mps" in changes:
        changes["limits"] = SpeedLimits(settings.limits.most_mps, changes.pop("speed_unseen_mps"))
    return replace(settings, **changes)


def _rate_hz(profile: Profile, given: float) -> float:
    return profile.rate_hz if given < 0.0 else given
