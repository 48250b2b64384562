"""Simulated streams of one sensor with the evidence of each sweep; attacks branch off at some sweeps."""

from __future__ import annotations

import io
import json
import zlib
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from viewshed._files import write_atomic
from viewshed.arrays import F32, Mask
from viewshed.geometry import Rigid
from viewshed.grid import GRIDS, BevGrid
from viewshed.monitor.degraded import NOW_SWEEPS, SensorState
from viewshed.monitor.evidence import EVIDENCE, SECTORS, MonitoredSweep, measure_all
from viewshed.monitor.stream_monitor import EvidenceStream
from viewshed.preprocess.leveling import level
from viewshed.sweep import Sweep
from viewshed_lab._jobs import Engine
from viewshed_lab.data.wild import wild_tables
from viewshed_lab.sim.lidar.random_sensors import DrawnSensor, draw_sensor
from viewshed_lab.sim.lidar.weather import CONDITIONS
from viewshed_lab.sim.mounting import draw_mounting
from viewshed_lab.sim.observe import Setting, measure_sweep
from viewshed_lab.sim.world import Agent, AgentPlan, World
from viewshed_lab.sim.worlds import WORLDS
from viewshed_lab.studies.monitor.plan import MonitorPlan
from viewshed_lab.studies.store import bind
from viewshed_lab.threats.attacks import ATTACKS, Attack, Knowledge
from viewshed_lab.threats.corruptions import CORRUPTIONS

ATTACKED_SWEEPS = 5
"""Number of sweeps of an attack: half a second."""

SEVEREST = 5
"""Highest severity of a corruption."""

REPLAYED_SWEEPS = 20
"""Age of the sweeps of a replay: 2 s."""

INDOOR = ("rooms", "corridors", "hall", "warehouse", "loft", "tunnel")

ONSETS = ("fog", "crosstalk")
"""Conditions that begin within one sweep: weather, and interference by another sensor."""

POSE_NOISE = (0.1, np.deg2rad(0.2))
"""Standard deviations of noisy poses: position per axis in meters, and yaw in radians."""

SPEEDS = ((1.0, "less than 1 m/s"), (10.0, "1 to 10 m/s"))
"""Classes of speed, with their upper ends in m/s."""

UPRIGHT = 0.3
"""Factor on the noise of poses along z."""


@dataclass(frozen=True, slots=True)
class Stream:
    """A stream of one sensor in one world, without an attack."""

    plan: MonitorPlan
    part: str  # of ``PARTS``
    style: str
    number: int

    @property
    def name(self) -> str:
        """Name of its file."""
        return f"{self.part}-{self.style}-{self.number:02d}"

    @property
    def grid(self) -> BevGrid:
        """Grid of its ground estimate."""
        return GRIDS["indoor" if self.style in INDOOR else "road"]

    @property
    def sensor(self) -> str:
        """Family of its sensor, or its beam table."""
        return self._turn("sensors")

    @property
    def conditions(self) -> str:
        """Weather and faults."""
        return self.plan.conditions[(self._offset * 5 + self.number) % len(self.plan.conditions)]

    @property
    def has_noisy_poses(self) -> bool:
        """Whether its poses have the noise ``POSE_NOISE``."""
        every = self.plan.pose_noise_every
        return (self._offset + self.number) % every == every - 1

    @property
    def _offset(self) -> int:
        return self.plan.styles(self.part).index(self.style)

    def _turn(self, kind: str) -> str:
        names = self.plan.turns(self.part, kind)
        return names[(self._offset + self.number) % len(names)]

    def rng(self, *purpose: object) -> np.random.Generator:
        """Return the random generator for one purpose."""
        return np.random.Generator(np.random.PCG64(self.seed(*purpose)))

    def seed(self, *purpose: object) -> np.random.SeedSequence:
        """Return the seed for one purpose."""
        words = [zlib.crc32(str(word).encode()) for word in (self.part, self.style, self.number, *purpose)]
        return np.random.SeedSequence([self.plan.seed, *words])

    def drawn_sensor(self, sweep: int = 0) -> DrawnSensor:
        """Return its sensor in the state of one of its sweeps."""
        families = wild_tables().sensors
        if self.sensor not in families:
            return DrawnSensor.of_table(self.sensor)
        return draw_sensor(families[self.sensor], self.rng("sensor"), sweep)

    def sweep(self, number: int, conditions: str | None = None) -> Sweep:
        """Return one of its sweeps as delivered by the sensor, optionally under other conditions."""
        world, agent = _world_of(self)
        sensor = _sensor_of(self)
        setting = Setting(self.grid, CONDITIONS[conditions or self.conditions], 1.0 / self.plan.hz)
        paths, noise = self.seed("sweep", number).spawn(2)
        t_s = (number + 0.5) / self.plan.hz
        stored = measure_sweep(world, agent, t_s, setting, paths, noise, sensor.model)[1]
        sweep = sensor.deliver(stored.sweep(), self.rng("delivery", number)).replace(sensor_height_m=None)
        return _with_pose_noise(sweep, self.rng("pose", number)) if self.has_noisy_poses else sweep


def _with_pose_noise(sweep: Sweep, rng: np.random.Generator) -> Sweep:
    """Return a sweep with the noise ``POSE_NOISE`` on its pose, if it has one."""
    pose = sweep.world_from_sensor
    if pose is None:
        return sweep
    shift = rng.normal(0.0, POSE_NOISE[0], 3) * (1.0, 1.0, UPRIGHT)
    turn = Rigid.from_yaw(float(rng.normal(0.0, POSE_NOISE[1]))).rotation
    return sweep.replace(world_from_sensor=Rigid(turn @ pose.rotation, pose.translation + shift))


@lru_cache(maxsize=1)
def _world_of(stream: Stream) -> tuple[World, Agent]:
    """Return the world of a stream with the mounted sensor, and the agent that carries it."""
    mountings = wild_tables().mountings
    name = stream._turn("mountings")
    if stream.style in INDOOR:
        name = "train_robot" if stream.part == "calibration" else "dev_robot"
    mounting = draw_mounting(mountings[name], stream.rng("mounting"))
    plan = AgentPlan(moving=1, sensor_height_m=mounting.height_m, duration_s=stream.plan.seconds + 1.0)
    return mounting.mounted(WORLDS[stream.style](stream.rng("world"), plan), 0)


@lru_cache(maxsize=1)
def _sensor_of(stream: Stream) -> DrawnSensor:
    return stream.drawn_sensor()


@dataclass(frozen=True, slots=True, eq=False)
class StreamEvidence:
    """Evidence of a stream, and of the attacks that branch off it."""

    name: str  # of the stream
    style: str  # of its world
    facts: dict[str, str]  # sensor, conditions, poses and speed
    benign: F32  # (T, E, SECTORS) evidence of each sweep
    cases: tuple[tuple[str, int], ...]  # (C,) name of the attack, and its first sweep
    attacked: F32  # (C, ATTACKED_SWEEPS, E, SECTORS) evidence of the attacked sweeps
    degraded: Mask  # (T,) bool, sweeps whose sensor the monitor calls degraded
    # by name of a corruption that begins at the end of the stream and lasts: whether the monitor calls it degraded
    worsened: dict[str, bool]

    def save(self, path: Path) -> None:
        """Write the evidence atomically, with numbers in half precision."""
        about = {
            "name": self.name, "style": self.style, "facts": self.facts, "kinds": tuple(EVIDENCE), "cases": self.cases,
            "worsened": self.worsened,
        }  # fmt: skip
        file = io.BytesIO()
        np.savez_compressed(
            file, about=np.frombuffer(json.dumps(about).encode(), np.uint8), benign=_halved(self.benign),
            attacked=_halved(self.attacked), degraded=self.degraded,
        )  # fmt: skip
        write_atomic(path, file.getvalue())

    @classmethod
    def load(cls, path: Path) -> Self:
        """Return the evidence in a file of :meth:`save`."""
        with np.load(path, allow_pickle=False) as file:
            about = json.loads(file["about"].tobytes())
            cases = tuple((str(name), int(first)) for name, first in about["cases"])
            # Kinds of evidence that no longer exist are left out.
            rows = [about["kinds"].index(name) for name in EVIDENCE]
            return cls(
                about["name"], about["style"], about["facts"],
                file["benign"][:, rows].astype(np.float32), cases, file["attacked"][:, :, rows].astype(np.float32),
                file["degraded"], dict(about["worsened"]),
            )  # fmt: skip


def _halved(values: F32) -> NDArray[np.float16]:
    largest = float(np.finfo(np.float16).max)
    return np.clip(values, -largest, largest).astype(np.float16)


def measure_stream(stream: Stream) -> StreamEvidence:
    """Return the evidence of each sweep of a stream; in the part ``report`` also that of attacks and corruptions."""
    plan, grid = stream.plan, stream.grid
    every = round(plan.attack_every_s * plan.hz)
    sweeps, past, state, degraded = list[Sweep](), EvidenceStream(), SensorState(), list[bool]()
    benign, cases, attacked = [], list[tuple[str, int]](), []
    places_m = list[NDArray[np.float64]]()
    for number in range(round(plan.seconds * plan.hz)):
        sweep = stream.sweep(number)
        # Two attacks of five sweeps each branch off here; simulate the next sweeps of the stream for them.
        is_branch = stream.part == "report" and number % every == every - 1
        if is_branch and number + ATTACKED_SWEEPS <= round(plan.seconds * plan.hz):
            clean = [sweep, *(stream.sweep(number + k) for k in range(1, ATTACKED_SWEEPS))]
            turn = 2 * (number // every) + 7 * stream.number + 3 * len(stream.style)
            for name in (plan.attacks[(turn + k) % len(plan.attacks)] for k in range(2)):
                try:
                    tampered = list(_tamper(stream, name, number, clean, sweeps))
                except ValueError:
                    continue
                branch, evidence = past.copy(), []
                for one in tampered:
                    leveled = level(one, grid)
                    evidence.append(branch.measure(leveled))
                    branch.add(leveled)
                cases.append((name, number))
                attacked.append(np.stack(evidence))
        leveled = level(sweep, grid)
        benign.append(past.measure(leveled))
        past.add(leveled)
        degraded.append(bool(state.check(leveled, benign[-1])))
        sweeps = [*sweeps, sweep][-REPLAYED_SWEEPS:]
        places_m.append(np.zeros(3) if sweep.world_from_sensor is None else sweep.world_from_sensor.translation)
    facts = {
        "sensor": stream.sensor, "conditions": stream.conditions,
        "poses": "noisy" if stream.has_noisy_poses else "exact", "speed": _speed(np.array(places_m), plan.hz),
    }  # fmt: skip
    shape = (ATTACKED_SWEEPS, len(EVIDENCE), SECTORS)
    corruptions = CORRUPTIONS if stream.part == "report" else ()
    return StreamEvidence(
        stream.name, stream.style, facts, np.stack(benign), tuple(cases),
        np.array(attacked, np.float32).reshape(-1, *shape),
        np.array(degraded, np.bool_),
        {
            name: degrades
            for name in corruptions
            if (degrades := _degrades(stream, name, sweeps[-NOW_SWEEPS:], state)) is not None
        },
    )  # fmt: skip


def _speed(places_m: NDArray[np.float64], hz: float) -> str:
    """Return the class of a sensor's speed, from its places (T, 3) at intervals of 1 s, where pose noise is small."""
    each_second = places_m[:: round(hz)]
    speed_mps = float(np.median(np.hypot(*np.diff(each_second[:, :2], axis=0).T))) if len(each_second) > 1 else 0.0
    return next((words for upper_mps, words in SPEEDS if speed_mps < upper_mps), "10 m/s or more")


def _degrades(stream: Stream, name: str, sweeps: Sequence[Sweep], state: SensorState) -> bool | None:
    """Return whether the monitor calls the sensor degraded at the end of sweeps under a corruption of severity 5.

    None if the corruption is impossible on them, such as one of rings on a sensor without rings.
    """
    state, rng, degraded = deepcopy(state), stream.rng("corruption", name), False
    for sweep in sweeps:
        try:
            corrupted = CORRUPTIONS[name](SEVEREST).apply(sweep, rng)
        except ValueError:
            return None
        leveled = level(corrupted, stream.grid)
        degraded = bool(state.check(leveled, measure_all(MonitoredSweep(leveled))))
    return degraded


def _tamper(stream: Stream, name: str, first: int, clean: Sequence[Sweep], past: Sequence[Sweep]) -> Iterator[Sweep]:
    """Yield the sweeps of a stream under an attack; an aimed attack keeps its azimuth.

    Raises:
        ValueError: the attack is impossible on these sweeps.
    """
    if name in ONSETS:
        yield from (stream.sweep(first + k, name) for k in range(len(clean)))
        return
    azimuth: float | None = None
    rng_of_all = stream.rng("attack", name, first)
    direction = rng_of_all.normal(size=2)
    direction /= np.linalg.norm(direction)
    for k, sweep in enumerate(clean):
        rng = stream.rng("attack", name, first, "steady" if name == "pose_spoof" else k)
        if name in OWN_ATTACKS:
            yield OWN_ATTACKS[name](sweep, direction, k, rng)
            continue
        if name == "replay" and len(past) < REPLAYED_SWEEPS - 1:
            raise ValueError("a replay needs earlier sweeps")
        known = Knowledge((past[k] if name == "replay" else clean[0],), half_extent_m=stream.grid.half_extent_m)
        attack: Any = ATTACKS[name](None, known)
        if azimuth is not None and any(f.name == "azimuth" for f in fields(attack)) and attack.azimuth is None:
            attack = replace(attack, azimuth=azimuth)
        tampered = cast(Attack, attack).apply(sweep, rng)
        if azimuth is None and tampered.wedge is not None:
            azimuth = tampered.wedge.azimuth
        yield tampered.sweep


def _drift(sweep: Sweep, direction: NDArray[np.float64], k: int, _: np.random.Generator) -> Sweep:
    """Shift the pose by .1 m more in each sweep."""
    pose = sweep.world_from_sensor
    if pose is None:
        raise ValueError("sweep must have a pose to drift, got none")
    shift = np.array([*direction, 0.0]) * 0.1 * (k + 1)
    return sweep.replace(world_from_sensor=Rigid(pose.rotation, pose.translation + shift))


def _offset(sweep: Sweep, direction: NDArray[np.float64], _: int, __: np.random.Generator) -> Sweep:
    """Shift all points by 1 m along one axis."""
    shift = np.zeros(3, np.float32)
    shift[int(np.argmax(np.abs(direction)))] = 1.0
    return sweep.replace(points=sweep.points + shift)


def _stated_noise(sweep: Sweep, _: NDArray[np.float64], __: int, rng: np.random.Generator) -> Sweep:
    """Add noise to the pose and state its covariance; this is not an attack."""
    shift_m, yaw = POSE_NOISE
    variance = np.array([shift_m, shift_m, UPRIGHT * shift_m, 0.0, 0.0, yaw]) ** 2
    return _with_pose_noise(sweep, rng).replace(pose_covariance=np.diag(variance))


def _noise(sweep: Sweep, _: NDArray[np.float64], __: int, rng: np.random.Generator) -> Sweep:
    """Add noise of the size of the sensor's own, 2 cm, to all coordinates."""
    return sweep.replace(points=sweep.points + rng.normal(0.0, 0.02, sweep.points.shape).astype(np.float32))


def _blinded(sweep: Sweep, _: NDArray[np.float64], __: int, rng: np.random.Generator) -> Sweep:
    """Move all returns to the sensor."""
    return sweep.replace(points=rng.normal(0.0, 0.06, sweep.points.shape).astype(np.float32))


OWN_ATTACKS: dict[str, Callable[[Sweep, NDArray[np.float64], int, np.random.Generator], Sweep]] = {
    "drift": _drift, "offset": _offset, "noise": _noise, "blinded": _blinded,
    "stated_noise": _stated_noise,
}  # fmt: skip
"""Attacks on the whole sweep or on its pose, in addition to those of ``ATTACKS``."""


def run_streams(
    plan: MonitorPlan, folder: Path, engine: Engine, on_done: Callable[[str], None] = print
) -> Iterator[str]:
    """Measure all streams of a plan that are not in the folder yet, in the order of the plan.

    Yields:
        A line for each failed stream.

    Raises:
        ValueError: the folder holds streams of another plan or version.
    """
    bind(folder, plan.to_json(), "*.npz")
    jobs = [(one, path) for one in _streams(plan) if not (path := _path_of(folder, one)).exists()]
    for done in engine.run(_measure_and_save, jobs):
        name = jobs[done.index][0].name
        if done.error is None:
            on_done(name)
        else:
            yield f"{name}: {done.error}"


def _measure_and_save(job: tuple[Stream, Path]) -> None:
    stream, path = job
    measure_stream(stream).save(path)


def read_streams(plan: MonitorPlan, folder: Path, part: str) -> Iterator[StreamEvidence]:
    """Yield the measured streams of a part of a plan, in the order of their names.

    Raises:
        ValueError: the folder holds streams of another plan or version.
    """
    if any(folder.glob("*.npz")):
        bind(folder, plan.to_json(), "*.npz")
    paths = sorted(_path_of(folder, one) for one in _streams(plan) if one.part == part)
    yield from (StreamEvidence.load(path) for path in paths if path.exists())


def _streams(plan: MonitorPlan) -> Iterator[Stream]:
    return (Stream(plan, part, style, int(number)) for part, style, number in plan.job_keys())


def _path_of(folder: Path, stream: Stream) -> Path:
    return folder / f"{stream.name}.npz"
