"""Plan of the study of tracks: drives for counting evidence, for setting limits, and for attacks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

from viewshed.sensors import lidar_model
from viewshed_lab.data.drive import drive_plan
from viewshed_lab.data.presets import preset_named, preset_names
from viewshed_lab.data.simulated import ScenePlan
from viewshed_lab.sim.lidar.weather import CONDITIONS
from viewshed_lab.sim.worlds import WORLDS
from viewshed_lab.studies.plan import JobKey, Plan, check_names, check_seed
from viewshed_lab.studies.tracks.drives import FOVS, HZ
from viewshed_lab.studies.tracks.lidar_level import LIDAR_ATTACKS
from viewshed_lab.threats.object_attacks import OBJECT_ATTACKS

STEPS = ("count", "limit", "test", "lidar", "page")
"""Count evidence, set limits, attack detections, attack sweeps, write the page. The first three share no drive; sweeps
are attacked on the drives of ``test``."""

BENIGN_CASE = "benign"


@dataclass(frozen=True, slots=True, kw_only=True)
class TracksPlan(Plan):
    """Plan of the study of tracks and of trust in them.

    Raises:
        ValueError: a name is unknown or a number is out of range.
    """

    FOLDER: ClassVar[str] = "studies/tracks/plans"
    WHOLE_TABLES: ClassVar[Mapping[str, Iterable[str]]] = {
        "fovs": FOVS,
        "attacks": OBJECT_ATTACKS,
        "lidar_attacks": LIDAR_ATTACKS,
    }

    name: str
    about: str
    preset: str  # of simulated data, for the mounting of the sensors
    worlds: tuple[str, ...]  # kinds of world, in turn
    sensors: tuple[str, ...]  # beam tables
    conditions: tuple[str, ...]  # weather
    fovs: tuple[str, ...]  # fields of view, of ``FOVS``
    attacks: tuple[str, ...]  # names of ``OBJECT_ATTACKS``
    lidar_attacks: tuple[str, ...]  # names of ``LIDAR_ATTACKS``
    objects: int  # number of objects forged at a time
    seconds: float  # duration of a drive; attacks begin after two
    count: int  # number of drives for counting evidence
    limit: int  # number of drives for setting limits
    test: int  # number of attacked drives per sensor and weather
    lidar: int  # number of these whose sweeps are attacked as well
    accused: float  # target share of honest tracks that are accused
    seed: int  # of all random draws

    def __post_init__(self) -> None:
        check_names("preset", (self.preset,), preset_names())
        check_names("worlds", self.worlds, WORLDS, once=True)
        check_names("conditions", self.conditions, CONDITIONS, once=True)
        check_names("lidar_attacks", self.lidar_attacks, LIDAR_ATTACKS)
        check_names("fovs", self.fovs, FOVS, once=True)
        check_names("attacks", self.attacks, OBJECT_ATTACKS)
        for sensor in self.sensors:
            lidar_model(sensor)
        check_seed("seed", self.seed)
        self.check_at_least(1, "objects", "count", "limit", "test", "lidar")
        if not 0.0 < self.accused < 1.0:
            raise ValueError(f"accused must lie in (0, 1), got {self.accused}")
        if not 1.0 <= self.seconds <= 600.0:
            raise ValueError(f"seconds must lie in [1, 600], got {self.seconds}")

    def job_keys(self) -> list[JobKey]:
        """Return the keys of all jobs: one per drive."""
        return [key for step in STEPS[:-1] for key in self.drive_keys(step)]

    def drive_keys(self, step: str) -> list[JobKey]:
        """Return the keys of a step's drives: step, sensor, weather, number, and the attack on sweeps if any."""
        places = [(sensor, weather) for sensor in self.sensors for weather in self.conditions]
        if step in ("count", "limit"):
            return [(step, *places[n % len(places)], str(n)) for n in range(getattr(self, step))]
        tested: list[JobKey] = [
            (step, *place, str(number)) for number in range(getattr(self, step)) for place in places
        ]
        return tested if step == "test" else [(*drive, attack) for attack in self.lidar_attacks for drive in tested]

    def scene(self, key: JobKey) -> ScenePlan:
        """Return the scene of a drive; drives of one number in ``test`` and ``lidar`` share their world."""
        step, sensor, weather, number = key[:4]
        first = {"count": 0, "limit": self.count}.get(step, self.count + self.limit)
        place = first + int(number)
        world = self.worlds[place % len(self.worlds)]
        scene = drive_plan(
            preset_named(self.preset), seconds=self.seconds, hz=HZ, agents=1, world=world, seed=self.seed + place
        )
        return replace(scene, preset=replace(scene.preset, sensors=(sensor,), conditions=(weather,)))

    def cases(self) -> tuple[str, ...]:
        """Return the cases of each test drive: benign, then each attack."""
        return (BENIGN_CASE, *self.attacks)
