"""Moment: one agent at one of its sweeps, as every kind of message is made from it; its frames and its alarms."""

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
"""Frame of the world."""

SEAM_S = 0.1
"""Between two sweeps of a file whose times do not rise."""


class Severity(IntEnum):
    """How bad it is; the levels of a DiagnosticStatus."""

    OK = 0
    WARNING = 1
    ERROR = 2


@dataclass(frozen=True, slots=True, eq=False)
class ObjectTruth:
    """One object of a simulated world."""

    number: int  # the same for one object over time
    category: str  # what it is
    world_from_box: Rigid  # pose of its box: origin at the center, x along its heading
    size_m: tuple[float, float, float]  # length, width and height


@dataclass(frozen=True, slots=True, eq=False)
class DriveTruth:
    """What a simulated drive tells beside the sweep of an agent."""

    # how the sensor of each agent of the drive is mounted, ``carrier_from_sensor``; None on a mast
    mounts: Mapping[str, Rigid | None]
    objects: tuple[ObjectTruth, ...]  # all objects at the time of the sweep
    returns: NDArray[np.int32]  # (K,) int32 how many returns each of ``objects`` gave the agent's sensor
    seen: tuple[ObjectTruth, ...]  # those of ``objects`` that gave it at least five, without its own carrier
    carrier: int | None  # number of the object that carries the sensor; None for a mast
    world_from_carrier: Rigid  # pose of the vehicle that carries the sensor; of a sensor on a mast its own
    velocity_mps: NDArray[np.float64]  # (3,) of the carrier, in its own frame


@dataclass(frozen=True, slots=True)
class Transform:
    """Pose of one frame in another."""

    parent: str
    child: str
    parent_from_child: Rigid


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """One agent at one of its sweeps."""

    agent: str  # whose sweep it is
    t_ns: int  # time of the sweep in the recording, nanoseconds; rises from moment to moment of an agent
    sweep: Sweep  # as it was read
    answer: Answer  # what the pipeline made of it
    truth: DriveTruth | None = None  # of a simulated drive
    is_live: bool = False  # whether the latency is written; a recording made as fast as possible has no clock in it
    # of its tracks against the truth, by name; empty where there are none
    metrics: Mapping[str, float] = field(default_factory=dict)
    attacked: tuple[str, ...] = ()  # agents that somebody forges
    round: Round | None = None  # what a center made of all agents, where this sweep ended a round
    trust: float | None = None  # of the center in this agent after the last round; None without one

    @property
    def sensor_frame(self) -> str:
        """Frame of the points: x forward, y left, z up, the sensor at the origin."""
        return f"{self.agent}/lidar"

    @property
    def level_frame(self) -> str:
        """Frame of grids and polygons: on the ground below the sensor, z up."""
        return f"{self.agent}/level"

    @property
    def carrier_frame(self) -> str:
        """Frame of the agent itself: of its vehicle, or of the sensor where no vehicle is known."""
        return f"{self.agent}/base_link" if self._is_carried else self.sensor_frame

    @property
    def _is_carried(self) -> bool:
        return self.truth is not None and self.truth.mounts[self.agent] is not None

    def transforms(self) -> list[Transform]:
        """Return the transforms of this time: map to carrier or sensor, sensor to footprint and level."""
        out, sweep, leveled = [], self.sweep, self.answer.leveled
        if self.truth is not None and self._is_carried:
            out.append(Transform(MAP, self.carrier_frame, self.truth.world_from_carrier))
        elif sweep.world_from_sensor is not None:
            out.append(Transform(MAP, self.sensor_frame, sweep.world_from_sensor))
        # The footprint tells the height where the recording knows it; the level frame rests on the estimated ground.
        if sweep.sensor_height_m is not None:
            attitude = sweep.known_attitude
            turn = np.eye(3) if attitude is None else rotation_from_quaternion(attitude)
            raised = Rigid(turn, np.array([0.0, 0.0, sweep.sensor_height_m]))
            out.append(Transform(self.sensor_frame, f"{self.agent}/base_footprint", raised.inverse()))
        if leveled is not None:
            out.append(Transform(self.sensor_frame, self.level_frame, leveled.level_from_sensor.inverse()))
        return out

    def static_transforms(self) -> list[Transform]:
        """Return what holds for the whole drive: how the sensors of all agents are mounted."""
        mounts = {} if self.truth is None else self.truth.mounts
        return [
            Transform(f"{agent}/base_link", f"{agent}/lidar", mount)
            for agent, mount in mounts.items() if mount is not None
        ]  # fmt: skip

    @property
    def tracks_frame(self) -> str:
        """Frame of the tracks: the map, or the level frame where the sweep has no pose."""
        objects = self.answer.objects
        return MAP if objects is not None and objects.explained.tracks.in_world else self.level_frame

    def tracks(self) -> ShownTracks | None:
        """Return the agent's tracks as they are shown, in ``tracks_frame``; None where objects are not followed."""
        return None if self.answer.objects is None else tracks_of_agent(self.answer.objects)

    def explained(self) -> list[dict[str, object]] | None:
        """Return what describes each track as plain values; None where objects are not followed."""
        objects, tracks = self.answer.objects, self.tracks()
        return None if objects is None or tracks is None else explained_rows(objects, tracks)

    def verdict(self) -> Severity:
        """Return how bad it is: no answer or an alarm is an error, a worse view a warning."""
        answer = self.answer
        if answer.estimate is None:
            return Severity.ERROR
        if answer.report is None:
            return Severity.WARNING if answer.notes else Severity.OK
        if answer.report.alarm or answer.report.now.inconsistent:
            return Severity.ERROR
        return Severity.WARNING if answer.report.now.degraded or answer.notes else Severity.OK

    def alarms(self) -> list[str]:
        """Return why sweep or stream alarm or are degraded, the strongest reason first; none where they are not."""
        report = self.answer.report
        if report is None or not (report.alarm or report.now.inconsistent or report.now.degraded):
            return []
        return list(report.now.reasons) or [f"alarm for {report.doubtful_sweeps} sweeps"]

    def summary(self) -> str:
        """Return what became of the sweep in one sentence."""
        answer = self.answer
        if answer.estimate is None:
            return answer.refused
        return (self.alarms() or [*answer.notes, f"visible {answer.estimate.area_m2():.0f} m²"])[0]

    def numbers(self) -> dict[str, str]:
        """Return the numbers of the answer, ready to be read."""
        answer, out = self.answer, {"caution": self.answer.reaction.caution.name}
        if answer.estimate is not None:
            out |= {"method": answer.estimate.method, "visible_m2": f"{answer.estimate.area_m2():.1f}"}
            out["speed_mps"] = f"{answer.speed_mps:.2f}"
        if answer.report is not None:
            now = answer.report.now
            out |= {"score": f"{now.score:.4f}", "threshold": f"{now.threshold:.4f}"}
            out |= {} if math.isnan(now.p_value) else {"p_value": f"{now.p_value:.4f}"}
            degrees = np.flatnonzero(answer.report.suspect) * (360 / SECTORS) - 180
            out["suspect_from_deg"] = " ".join(f"{degree:g}" for degree in degrees)
        if self.is_live:
            out["latency_ms"] = f"{1e3 * answer.latency_s:.1f}"
        return out


class RisingTimes:
    """Times of a recording from the times of its sweeps: never negative, and rising for each agent.

    A sweep without a time comes 0.1 s after the one before of its agent. Where time goes back, as between scenes or
    when a recording begins again, all that follow are shifted.

    >>> times = RisingTimes()
    >>> [times.of("ego", t_ns) for t_ns in (5, 2_000_000_000, 5, None)]
    [5, 2000000000, 2100000000, 2200000000]
    """

    def __init__(self) -> None:
        self._last_ns: dict[str, int] = {}
        self._shift_ns = 0

    def of(self, agent: str, t_ns: int | None) -> int:
        """Return the time in the recording of an agent's next sweep, in nanoseconds."""
        last_ns = self._last_ns.get(agent)
        least_ns = 0 if last_ns is None else last_ns + round(SEAM_S * 1e9)
        if t_ns is None:
            now_ns = max(least_ns, max(self._last_ns.values(), default=0))
        else:
            now_ns = t_ns + self._shift_ns
            if now_ns < 0 or (last_ns is not None and now_ns <= last_ns):
                self._shift_ns += least_ns - now_ns
                now_ns = least_ns
        self._last_ns[agent] = now_ns
        return now_ns
