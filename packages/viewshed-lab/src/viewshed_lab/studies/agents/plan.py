"""Plan of the study of many agents: scenes of three splits, and the lies of each scene."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

from viewshed_lab.data.presets import Preset, preset_named
from viewshed_lab.data.simulated import ScenePlan
from viewshed_lab.sim.worlds import WORLDS
from viewshed_lab.studies.agents.lies import LIES
from viewshed_lab.studies.plan import JobKey, Plan, check_names, check_seed

SPLITS = ("learning", "calibration", "test")
"""Disjoint sets of scenes: the first fits the model of honest agents, the second sets the limits, the third is reported
on and has other kinds of world and other sensors."""

ONSET_S = 2.0
"""Time in a scene at which the lies start."""

HONEST_MODEL = "honest.json"
"""File of the model of honest agents, fitted on the scenes of the first split."""

STEPS = ("scenes", "runs", "page")

HONEST, STATED, UNSTATED = "honest", "pose noise stated", "pose noise not stated"
"""Cases without lies: exact poses, or poses off by .2 m and .5°, with this error stated or not."""

POSE_NOISE = (STATED, UNSTATED)


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentsPlan(Plan):
    """Plan of the study of many agents.

    Raises:
        ValueError: a name is unknown, or a number is out of range.
    """

    FOLDER: ClassVar[str] = "studies/agents/plans"
    WHOLE_TABLES: ClassVar[Mapping[str, Iterable[str]]] = {"lies": LIES}

    name: str
    about: str
    worlds: tuple[str, ...]  # kinds of world for learning and calibration; the scenes cycle through them
    sensors: tuple[str, ...]  # beam tables of their vehicles; the scenes cycle through them
    test_worlds: tuple[str, ...]  # kinds of world of the test scenes
    test_sensors: tuple[str, ...]  # beam tables of their vehicles
    heights_m: tuple[float, ...]  # of the vehicles' sensors; the scenes cycle through them
    moving: int  # number of vehicles that measure and report
    roadside: int  # number of sensors on masts that measure and report
    tall_masts: int  # every k-th scene has masts of the published 20 m instead of 4 to 8 m; 0 for none
    seconds: float  # duration of a scene
    hz: float  # reports per second of each agent
    learning: int  # number of scenes to fit the model of honest agents
    calibration: int  # number of scenes to set the limits
    test: int  # number of scenes that are reported on
    lies: tuple[str, ...]  # names of ``LIES``
    each: int  # number of lies per test scene, in turn; every scene also runs without lies
    seed: int  # of all random draws

    def __post_init__(self) -> None:
        check_names("worlds", self.worlds, WORLDS)
        check_names("test_worlds", self.test_worlds, WORLDS)
        check_names("lies", self.lies, LIES, once=True)
        check_seed("seed", self.seed)
        self.check_at_least(1, "learning", "calibration", "test", "moving")
        self.check_at_least(0, "roadside", "tall_masts", "each")
        if not (self.seconds > ONSET_S and 0 < self.hz <= 10):
            raise ValueError(f"seconds must be above {ONSET_S:g} and hz in (0, 10], got {self.seconds:g}, {self.hz:g}")

    def job_keys(self) -> list[JobKey]:
        """Return the keys of all jobs: scenes, then runs."""
        return self.scene_keys() + self.run_keys()

    def scene_keys(self) -> list[JobKey]:
        """Return the keys of the jobs that simulate scenes: split and number."""
        return [("scene", split, str(number)) for split in SPLITS for number in range(getattr(self, split))]

    def run_keys(self) -> list[JobKey]:
        """Return the keys of the jobs that run all cases of a scene: split and number."""
        return [("run", *key[1:]) for key in self.scene_keys() if key[1] != SPLITS[0]]

    def cases_of(self, split: str, number: int) -> list[str]:
        """Return the cases of a scene: calibration honest or stated noise; test honest, both noises, ``each`` lies."""
        if split != "test":
            return [(HONEST, STATED)[number // len(self.worlds) % 2]]
        count = min(self.each, len(self.lies))
        return [HONEST, *POSE_NOISE, *(self.lies[(number * count + k) % len(self.lies)] for k in range(count))]

    def has_tall_masts(self, number: int) -> bool:
        """Return whether the masts of a scene are as tall as published; this occurs with each world and sensor."""
        return self.tall_masts > 0 and (number // len(self.worlds) + number) % self.tall_masts == 0

    def scene(self, split: str, number: int) -> ScenePlan:
        """Return the plan of one scene of a split: its world, its sensors and its agents."""
        base: Preset = preset_named("carla")
        frames = round(self.seconds * self.hz) * (self.moving + self.roadside)
        is_test = split == "test"
        worlds, sensors = (self.test_worlds, self.test_sensors) if is_test else (self.worlds, self.sensors)
        rounds = number // len(worlds)
        one = replace(
            base, worlds=(worlds[number % len(worlds)],), world_weights=(1.0,), splits=SPLITS,
            scenes=(number + 1,) * len(SPLITS), frames=((number + 1) * frames,) * len(SPLITS), moving=self.moving,
            roadside=self.roadside, sensors=(sensors[rounds % len(sensors)],), interval_s=1 / self.hz,
            sensor_height_m=self.heights_m[(number + rounds) % len(self.heights_m)], conditions=("clear",),
            condition_weights=(1.0,), seed=self.seed,
        )  # fmt: skip
        return ScenePlan(one, SPLITS.index(split), number)
