"""Moment: one agent at one of its sweeps, the input of all messages; its frames and its alarms."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from viewshed.agents.legend import ShownTracks, explained_rows, tracks_of_agent
from viewshed.agents.rounds import Round
from viewshed.geometry import Rigid, rotation_from_quaternion
from viewshed.monitor.evidence.base import SECTORS
from viewshed.pipeline import Answer
from viewshed.sweep import Sweep

MAP = "map"
"""Name of the world frame."""

DEFAULT_STEP_S = 0.1
"""Time step to the next sweep of an agent if times are missing or not ascending."""


class Severity(IntEnum):
    """Severity levels, equal to those of a DiagnosticStatus."""

    OK = 0
    WARNING = 1
    ERROR = 2


@dataclass(frozen=True, slots=True, eq=False)
class ObjectTruth:
    """One object of a simulated world."""

    number: int  # id, constant over time
    category: str  # category
    world_from_box: Rigid  # pose of its box: origin at the center, x along its heading
    size_m: tuple[float, float, float]  # length, width and height


@dataclass(frozen=True, slots=True, eq=False)
class DriveTruth:
    """Ground truth of a simulated drive at a sweep of an agent."""

    # agent → mounting of its sensor, ``carrier_from_sensor``; None on a mast
    mounts: Mapping[str, Rigid | None]
    objects: tuple[ObjectTruth, ...]  # all objects at the time of the sweep
    returns: NDArray[np.int32]  # (K,) int32 number of returns of the agent's sensor on each of ``objects``
    seen: tuple[ObjectTruth, ...]  # those of ``objects`` with at least five returns, without its own carrier
    carrier: int | None  # id of the object that carries the sensor; None for a mast
    world_from_carrier: Rigid  # pose of the carrier; for a mast, pose of the sensor
    velocity_mps: NDArray[np.float64]  # (3,) velocity of the carrier, in its own frame


@dataclass(frozen=True, slots=True)
class Transform:
    """Pose of one frame in another."""

    parent: str
    child: str
    parent_from_child: Rigid


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """One agent at one of its sweeps."""

    agent: str  # name of the agent
    t_ns: int  # time of the sweep in the recording, nanoseconds; ascending for each agent
    sweep: Sweep  # as it was read
    answer: Answer  # answer of the pipeline
    truth: DriveTruth | None = None  # ground truth of a simulated drive
    is_live: bool = False  # whether to write the latency, which has no meaning in an offline recording
    # metrics of its tracks against the truth, by name; empty if there are none
    metrics: Mapping[str, float] = field(default_factory=dict)
    attacked: tuple[str, ...] = ()  # agents under attack
    round: Round | None = None  # fusion of all agents, if this sweep completed a round
    trust: float | None = None  # trust of the center in this agent after the last round; None without one

    @property
    def sensor_frame(self) -> str:
        """Frame of the points: x forward, y left, z up, the sensor at the origin."""
        return f"{self.agent}/lidar"

    @property
    def level_frame(self) -> str:
        """Frame of grids and polygons: origin on the ground below the sensor, z up."""
        return f"{self.agent}/level"

    @property
    def carrier_frame(self) -> str:
        """Frame of the agent: its vehicle, or its sensor if no vehicle is known."""
        return f"{self.agent}/base_link" if self._is_carried else self.sensor_frame

    @property
    def _is_carried(self) -> bool:
        return self.truth is not None and self.truth.mounts[self.agent] is not None

    def transforms(self) -> list[Transform]:
        """Return the transforms at this time: map to carrier or sensor, sensor to footprint and level."""
        transforms, sweep, leveled = [], self.sweep, self.answer.leveled
        if self.truth is not None and self._is_carried:
            transforms.append(Transform(MAP, self.carrier_frame, self.truth.world_from_carrier))
        elif sweep.world_from_sensor is not None:
            transforms.append(Transform(MAP, self.sensor_frame, sweep.world_from_sensor))
        # The footprint is at the recorded sensor height, if known; the level frame is on the estimated ground.
        if sweep.sensor_height_m is not None:
            attitude = sweep.known_attitude
            rotation = np.eye(3) if attitude is None else rotation_from_quaternion(attitude)
            footprint_from_sensor = Rigid(rotation, np.array([0.0, 0.0, sweep.sensor_height_m]))
            footprint = f"{self.agent}/base_footprint"
            transforms.append(Transform(self.sensor_frame, footprint, footprint_from_sensor.inverse()))
        if leveled is not None:
            transforms.append(Transform(self.sensor_frame, self.level_frame, leveled.level_from_sensor.inverse()))
        return transforms

    def static_transforms(self) -> list[Transform]:
        """Return the constant transforms of the drive: the mountings of the sensors of all agents."""
        mounts = {} if self.truth is None else self.truth.mounts
        return [
            Transform(f"{agent}/base_link", f"{agent}/lidar", mount)
            for agent, mount in mounts.items() if mount is not None
        ]  # fmt: skip

    @property
    def tracks_frame(self) -> str:
        """Frame of the tracks: the map, or the level frame if the sweep has no pose."""
        objects = self.answer.objects
        return MAP if objects is not None and objects.explained.tracks.in_world else self.level_frame

    def tracks(self) -> ShownTracks | None:
        """Return the agent's tracks for display, in ``tracks_frame``; None without tracking."""
        return None if self.answer.objects is None else tracks_of_agent(self.answer.objects)

    def explained(self) -> list[dict[str, object]] | None:
        """Return the description of each track as plain values; None without tracking."""
        objects, tracks = self.answer.objects, self.tracks()
        return None if objects is None or tracks is None else explained_rows(objects, tracks)

    def verdict(self) -> Severity:
        """Return the severity: a missing estimate or an alarm is an error, a degraded view a warning."""
        answer = self.answer
        if answer.estimate is None:
            return Severity.ERROR
        if answer.report is None:
            return Severity.WARNING if answer.notes else Severity.OK
        if answer.report.alarm or answer.report.now.inconsistent:
            return Severity.ERROR
        return Severity.WARNING if answer.report.now.degraded or answer.notes else Severity.OK

    def alarms(self) -> list[str]:
        """Return the reasons of an alarm or degradation, the strongest first; empty if there is none."""
        report = self.answer.report
        if report is None or not (report.alarm or report.now.inconsistent or report.now.degraded):
            return []
        return list(report.now.reasons) or [f"alarm for {report.doubtful_sweeps} sweeps"]

    def summary(self) -> str:
        """Return a one-sentence summary of the answer."""
        answer = self.answer
        if answer.estimate is None:
            return answer.refused
        return (self.alarms() or [*answer.notes, f"visible {answer.estimate.area_m2():.0f} m²"])[0]

    def numbers(self) -> dict[str, str]:
        """Return the numbers of the answer, formatted as text."""
        answer, numbers = self.answer, {"caution": self.answer.reaction.caution.name}
        if answer.estimate is not None:
            numbers |= {"method": answer.estimate.method, "visible_m2": f"{answer.estimate.area_m2():.1f}"}
            numbers["speed_mps"] = f"{answer.speed_mps:.2f}"
        if answer.report is not None:
            now = answer.report.now
            numbers |= {"score": f"{now.score:.4f}", "threshold": f"{now.threshold:.4f}"}
            numbers |= {} if math.isnan(now.p_value) else {"p_value": f"{now.p_value:.4f}"}
            degrees = np.flatnonzero(answer.report.suspect) * (360 / SECTORS) - 180
            numbers["suspect_from_deg"] = " ".join(f"{degree:g}" for degree in degrees)
        if self.is_live:
            numbers["latency_ms"] = f"{1e3 * answer.latency_s:.1f}"
        return numbers


class RisingTimes:
    """Convert the times of sweeps to times of a recording: not negative, and ascending for each agent.

    A sweep without a time is 0.1 s after the previous one of its agent. If time goes back (a new scene, or a recording
    that restarts), all later times are shifted.

    >>> times = RisingTimes()
    >>> [times.of("ego", t_ns) for t_ns in (5, 2_000_000_000, 5, None)]
    [5, 2000000000, 2100000000, 2200000000]
    """

    def __init__(self) -> None:
        self._last_ns: dict[str, int] = {}
        self._shift_ns = 0

    def of(self, agent: str, t_ns: int | None) -> int:
        """Return the recording time of an agent's next sweep in nanoseconds."""
        last_ns = self._last_ns.get(agent)
        min_ns = 0 if last_ns is None else last_ns + round(DEFAULT_STEP_S * 1e9)
        if t_ns is None:
            now_ns = max(min_ns, max(self._last_ns.values(), default=0))
        else:
            now_ns = t_ns + self._shift_ns
            if now_ns < 0 or (last_ns is not None and now_ns <= last_ns):
                self._shift_ns += min_ns - now_ns
                now_ns = min_ns
        self._last_ns[agent] = now_ns
        return now_ns
