"""Plan of the study of alarms: streams for calibration, and streams of other styles for the report."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from viewshed_lab.data.wild import wild_tables
from viewshed_lab.sim.lidar.weather import CONDITIONS
from viewshed_lab.sim.worlds import WORLDS
from viewshed_lab.studies.plan import JobKey, Plan, check_names, check_seed

PARTS = ("calibration", "report", "benign")
"""Streams for calibration; for the report, with attacks; without attacks at the same places as these, for false alarms.

The first shares no style, sensor family or mounting with the others, except ``vlp16``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MonitorPlan(Plan):
    """The streams of the study."""

    FOLDER: ClassVar[str] = "studies/monitor/plans"

    name: str
    about: str
    # calibration, report: styles of worlds, of ``WORLDS``
    calibration: tuple[str, ...]
    report: tuple[str, ...]
    # calibration_sensors, report_sensors: families of sensors, or beam tables, in turn
    calibration_sensors: tuple[str, ...]
    report_sensors: tuple[str, ...]
    # calibration_mountings, report_mountings: families of mountings, in turn; indoors that of a robot
    calibration_mountings: tuple[str, ...]
    report_mountings: tuple[str, ...]
    conditions: tuple[str, ...]  # weather and faults, in turn
    # calibration_streams, report_streams, benign_streams: number of streams per style
    calibration_streams: int
    report_streams: int
    benign_streams: int
    seconds: float  # duration of a stream
    hz: float  # sweeps per second
    pose_noise_every: int  # N: every Nth stream has noisy poses
    attacks: tuple[str, ...]  # attacks that branch off the streams, in turn
    attack_every_s: float  # interval at which two attacks begin
    seed: int  # of all random draws

    def __post_init__(self) -> None:
        for part in ("calibration", "report"):
            check_names(part, self.styles(part), WORLDS, once=True)
            check_names(f"{part}_mountings", self.turns(part, "mountings"), wild_tables().mountings)
        both: Iterable[str] = set(self.calibration) & set(self.report)
        if both:
            raise ValueError(f"calibration and report must share no style, got {', '.join(sorted(both))} in both")
        check_names("conditions", self.conditions, CONDITIONS)
        check_seed("seed", self.seed)
        self.check_at_least(1, "calibration_streams", "report_streams", "pose_noise_every")
        self.check_at_least(0, "benign_streams")
        if not (self.seconds > 0.0 and self.hz > 0.0 and self.attack_every_s > 0.0):
            raise ValueError("seconds, hz and attack_every_s must be positive")

    def styles(self, part: str) -> tuple[str, ...]:
        """Return the styles of a part."""
        return self.calibration if part == "calibration" else self.report

    def turns(self, part: str, kind: str) -> tuple[str, ...]:
        """Return the sensors or the mountings of a part."""
        names: tuple[str, ...] = getattr(self, f"{'calibration' if part == 'calibration' else 'report'}_{kind}")
        return names

    def job_keys(self) -> list[JobKey]:
        """Return part, style and number of each stream: those of the calibration first, then by number."""
        keys = [
            (part, style, number)
            for part in PARTS
            for style in self.styles(part)
            for number in range(getattr(self, f"{part}_streams"))
        ]
        keys.sort(key=lambda key: (key[0] != "calibration", key[2]))
        return [(part, style, str(number)) for part, style, number in keys]
