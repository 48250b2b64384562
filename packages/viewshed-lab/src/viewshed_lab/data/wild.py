"""Wild samples: many kinds of world, with random sensors and mountings, in sets that share none of them.

All random numbers of a sample depend only on its set's seed and its number, so samples can be made in any order. The
``sealed`` set is for final tables only: opening it requires :data:`OPEN_SEALED`, and every opening must be logged
(:mod:`viewshed_lab.studies.wild.openings`). An archive of a set has one shard per scene.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.height_map import NODES, HeightMap
from viewshed.fov.truth import Truth
from viewshed.fov.visibility import TARGETS
from viewshed.geometry import attitude_of
from viewshed.grid import GRIDS, BevGrid
from viewshed.sensors import sensor_names
from viewshed.sweep import Sweep, bare_points
from viewshed_lab import _config as flat
from viewshed_lab._config import one_of
from viewshed_lab._jobs import Engine
from viewshed_lab.data.archive.archive import Archive
from viewshed_lab.data.archive.build import ShardJob, ShardResult, build_archive
from viewshed_lab.data.archive.schema import Layout
from viewshed_lab.data.archive.storage import Storage
from viewshed_lab.data.sample import Sample
from viewshed_lab.sim.lidar.random_sensors import DrawnSensor, SensorFamily, draw_sensor
from viewshed_lab.sim.lidar.weather import CONDITIONS, conditions_named
from viewshed_lab.sim.mounting import Mounting, MountingFamily, draw_mounting
from viewshed_lab.sim.observe import Setting, observe
from viewshed_lab.sim.raycast.scan import ExactScan
from viewshed_lab.sim.world import Agent, AgentPlan, World
from viewshed_lab.sim.worlds import WORLDS

SETS = ("own", "training", "learning", "development", "sealed")
"""``own``: worlds and sensors of the presets, for comparison. ``training``, ``development`` and ``sealed`` share no
style, sensor or mounting. ``learning``: random land without styles, with sensors and mountings of ``training``."""

SEALED = "sealed"

OPEN_SEALED = "I open the sealed set for a final table, and log it"
"""Required argument to get samples of the sealed set."""

GIVEN = ("table", "rings", "nothing")
"""What a sweep provides besides its points. ``table``: ring, time, intensity and the manufacturer's beam table; height
and attitude if the points are in the sensor's frame. ``rings``: ring, time and intensity. ``nothing``: points only."""

_SWEEPS_APART_S = 3.0
_REVOLUTION_S = 0.1
_TABLE = "data/wild_sets.toml"


_FOR_WORLD, _FOR_SENSOR, _FOR_MOUNTING, _FOR_OBSERVATION, _FOR_DELIVERY, _FOR_CONDITIONS = range(6)


@dataclass(frozen=True, slots=True)
class WildDomain:
    """The road scenes or the indoor scenes of a set.

    Raises:
        ValueError: a name is unknown, or a number is out of range.
    """

    set_name: str  # of ``SETS``
    name: str  # ``road`` or ``indoor``, also the name of its grid
    styles: tuple[str, ...]  # kinds of world, of ``WORLDS``; used in turn over the scenes
    sensors: tuple[str, ...]  # names of sensor families or beam tables; used in turn
    mountings: tuple[str, ...]  # names of mounting families; used in turn
    conditions: tuple[str, ...]  # weather and faults, of ``CONDITIONS``; one per scene
    scenes: int  # number of scenes
    sweeps: int  # sweeps per scene, 3 s apart
    seed: int  # of all random numbers

    def __post_init__(self) -> None:
        if self.set_name not in SETS or self.name not in GRIDS:
            raise ValueError(f"a domain must be of {', '.join(SETS)} and of a grid, got {self.set_name} {self.name}")
        unknown = set(self.styles) - WORLDS.keys()
        if unknown or not self.styles:
            raise ValueError(f"styles must be among {', '.join(WORLDS)}, got {', '.join(sorted(unknown)) or 'none'}")
        for condition in self.conditions:
            conditions_named(condition)
        if min(self.scenes, self.sweeps, len(self.sensors), len(self.mountings), len(self.conditions)) < 1:
            raise ValueError(f"{self.set_name} {self.name} must have scenes, sweeps, sensors, mountings and conditions")

    @property
    def grid(self) -> BevGrid:
        """The grid of the domain."""
        return GRIDS[self.name]


@dataclass(frozen=True, slots=True, eq=False)
class WildTables:
    """Content of the TOML table: families by name, and the domains of all sets."""

    sensors: Mapping[str, SensorFamily]
    mountings: Mapping[str, MountingFamily]
    domains: tuple[WildDomain, ...]

    def of_set(self, name: str) -> tuple[WildDomain, ...]:
        """Return the domains of a set.

        Raises:
            ValueError: there is no such set.
        """
        one_of("set", name, SETS)
        return tuple(domain for domain in self.domains if domain.set_name == name)


@lru_cache(maxsize=1)
def wild_tables() -> WildTables:
    """Return the sets and families that the package ships.

    Raises:
        ValueError: a value is wrong, or two sets share a style, sensor or mounting.
    """
    table = tomllib.loads(resources.files("viewshed_lab").joinpath(_TABLE).read_text(encoding="utf-8"))
    sensors = {name: SensorFamily(**flat.from_dict(SensorFamily, {"name": name} | one, "sensor family"))
               for name, one in table["sensor"].items()}  # fmt: skip
    mountings = {name: MountingFamily(**flat.from_dict(MountingFamily, {"name": name} | one, "mounting family"))
                 for name, one in table["mounting"].items()}  # fmt: skip
    domains = tuple(
        WildDomain(**flat.from_dict(WildDomain, {"set_name": set_name, "name": name} | one, "domain"))
        for set_name, parts in table["set"].items()
        for name, one in parts.items()
    )
    for domain in domains:
        unknown = (set(domain.sensors) - sensors.keys() - set(sensor_names())) | (
            set(domain.mountings) - mountings.keys()
        )
        if unknown:
            raise ValueError(
                f"{domain.set_name} {domain.name} names unknown sensors or mountings: {', '.join(sorted(unknown))}"
            )
    check_apart(domains)
    return WildTables(sensors, mountings, domains)


def check_apart(domains: tuple[WildDomain, ...]) -> None:
    """Check that training, development and sealed share no style, sensor, mounting or seed.

    Raises:
        ValueError: two sets share a value; the message names it.
    """
    owners: dict[tuple[str, object], str] = {}
    for domain in domains:
        if domain.set_name == "own":
            continue
        named: list[tuple[str, object]] = [("seed", domain.seed)]
        set_name = "training" if domain.set_name == "learning" else domain.set_name
        for key in ("styles", "sensors", "mountings"):
            named += [(key, value) for value in getattr(domain, key)]
        for key, value in named:
            owner = owners.setdefault((key, value), set_name)
            if owner != set_name:
                raise ValueError(f"{owner} and {domain.set_name} must share no {key}, got {value} in both")


@dataclass(frozen=True, slots=True)
class WildScene:
    """One scene of a domain."""

    domain: WildDomain
    number: int  # in the domain, from 0

    @property
    def name(self) -> str:
        """Name in the archive: set, grid, number and style."""
        return f"{self.domain.set_name}-{self.domain.name}-{self.number:03d}-{self.style}"

    @property
    def style(self) -> str:
        """Kind of world, of ``WORLDS``."""
        return self.domain.styles[self.number % len(self.domain.styles)]

    @property
    def sensor(self) -> str:
        """Sensor family, or beam table."""
        return self._turn(self.domain.sensors, 1)

    @property
    def mounting(self) -> str:
        """Mounting family."""
        return self._turn(self.domain.mountings, 2)

    def _turn(self, names: tuple[str, ...], step: int) -> str:
        """Return one of the names; it advances by one from a scene of a style to the next scene of that style."""
        round_number, style = divmod(self.number, len(self.domain.styles))
        return names[(style * step + round_number) % len(names)]

    def rng(self, purpose: int, sweep: int = 0) -> np.random.Generator:
        """Return the random generator for one purpose."""
        return np.random.Generator(np.random.PCG64(self.seed(purpose, sweep)))

    def seed(self, purpose: int, sweep: int = 0) -> np.random.SeedSequence:
        """Return the seed for one purpose, in the scene or in one of its sweeps."""
        return np.random.SeedSequence([self.domain.seed, self.number, sweep, purpose])

    @property
    def conditions(self) -> str:
        """Weather and faults, of ``CONDITIONS``."""
        return str(self.rng(_FOR_CONDITIONS).choice(self.domain.conditions))

    def drawn_mounting(self) -> Mounting:
        """Return the mounting, sampled from its family."""
        return draw_mounting(wild_tables().mountings[self.mounting], self.rng(_FOR_MOUNTING))

    def drawn_sensor(self, sweep: int = 0) -> DrawnSensor:
        """Return the sensor as it fires in sweep ``sweep``, sampled from its family."""
        families = wild_tables().sensors
        if self.sensor not in families:
            return DrawnSensor.of_table(self.sensor)
        return draw_sensor(families[self.sensor], self.rng(_FOR_SENSOR), sweep)

    def observe(self, sweep: int) -> WildObservation:
        """Simulate one sweep, with its truth and the exact ground."""
        mounting, sensor = self.drawn_mounting(), self.drawn_sensor(sweep)
        world, agent = _mounted_world(self)
        # The truth's grid is centered at the origin of the points, which need not be the sensor.
        origin_from_sensor = np.asarray(mounting.origin_m(agent)) - agent.mount.translation
        grid = self.domain.grid
        if origin_from_sensor.any():
            grid = replace(grid, offset_m=(float(origin_from_sensor[0]), float(origin_from_sensor[1])))
        setting = Setting(grid, CONDITIONS[self.conditions], _REVOLUTION_S)
        seed, t_s = self.seed(_FOR_OBSERVATION, sweep), (sweep + 0.5) * _SWEEPS_APART_S
        observed = observe(world, agent, t_s, setting, seed, sensor.model)
        # The exact ground, above the sensor; then the ground below the origin of the points.
        centers, pose, terrain = grid.centers, observed.scan.world_from_sensor, world.ground_of(agent)
        ground = terrain.about(pose, centers[:, 0, 0].copy(), centers[0, :, 1].copy())[0]
        below = terrain.about(pose, np.array([grid.offset_m[0]]), np.array([grid.offset_m[1]]))[0][0, 0]
        world_from_carrier = pose.rotation @ agent.mount.rotation.T
        height_m = float((world_from_carrier @ origin_from_sensor)[2] - below)
        # The delivered sweep, in the frame of its points.
        delivered = sensor.deliver(observed.image.sweep(), self.rng(_FOR_DELIVERY, sweep))
        world_from_points = pose.rotation if mounting.family.frame == "sensor" else world_from_carrier
        truth = Truth(self.domain.grid, observed.truth.expected_returns, observed.truth.state)
        return WildObservation(
            self, sweep, mounting.given(delivered, agent), truth, observed.known, ground - below, height_m,
            attitude_of(world_from_points), sensor, mounting, observed.scan, world, agent,
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class WildObservation:
    """One sweep and everything that the simulator knows about it."""

    scene: WildScene
    number: int  # of the sweep in its scene
    delivered: Sweep  # the sweep with all its columns
    truth: Truth  # what the sensor could have seen, on the domain's grid around the origin of the points
    known: NDArray[np.bool_]  # (cells, cells) bool, where the truth is known
    # (cells, cells) float32 exact ground height at the cell centers, above the ground below the origin of the points
    ground_m: NDArray[np.float32]
    origin_height_m: float  # exact height of the origin of the points above the ground below it
    attitude: NDArray[np.float64]  # exact quaternion (w, x, y, z) of the frame of the points
    sensor: DrawnSensor
    mounting: Mounting
    scan: ExactScan  # exact hit of every beam
    world: World
    agent: Agent  # with the sensor

    def given(self, given: str) -> Sweep:
        """Return the sweep with only the information that ``given`` allows.

        Raises:
            ValueError: ``given`` is not of ``GIVEN``.
        """
        one_of("given", given, GIVEN)
        if given == "nothing":
            return bare_points(self.delivered)
        sweep = self.delivered.replace(world_from_sensor=None, sensor_height_m=None, attitude=None, azimuth=None)
        if given == "rings":
            return sweep.replace(model=None)
        if self.mounting.family.frame == "base":
            return sweep
        return sweep.replace(sensor_height_m=self.origin_height_m, attitude=self.attitude)

    def sample(self, given: str) -> WildSample:
        """Return the sample whose sweep has only the information that ``given`` allows."""
        return WildSample(
            self.given(given), self.truth, self.known, self.ground_m, self.origin_height_m, self.attitude,
            self.scene.style, self.scene.sensor, self.scene.mounting, given, self.scene.name,
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class WildSample:
    """One sweep with its exact truth and exact ground."""

    sweep: Sweep  # input of an estimator
    truth: Truth  # what the sensor could have seen, around the origin of the points
    known: NDArray[np.bool_]  # (cells, cells) bool, where the truth is known
    # (cells, cells) float32 exact ground height at the cell centers, above the ground below the origin of the points:
    # z of the ``level`` frame
    ground_m: NDArray[np.float32]
    origin_height_m: float  # exact height of that origin above the ground below it
    attitude: NDArray[np.float64]  # exact quaternion (w, x, y, z) of the frame of the points
    style: str  # kind of world
    sensor: str  # sensor family, or beam table
    mounting: str  # mounting family
    given: str  # of ``GIVEN``
    scene: str  # name of the scene; a scene is in one split only

    @property
    def exact_ground(self) -> HeightMap:
        """The exact ground on the height map of the estimators."""
        grid = self.truth.grid
        every = grid.cells // NODES
        blocks = self.ground_m.reshape(NODES, every, NODES, every)
        middle = blocks[:, (every - 1) // 2 : every // 2 + 1, :, (every - 1) // 2 : every // 2 + 1]
        heights = middle.mean(axis=(1, 3)).astype(np.float32)
        return HeightMap(heights, grid.half_extent_m, np.ones((NODES, NODES), np.bool_))


def wild_scenes(set_name: str, domain: str | None = None, *, unseal: str = "") -> list[WildScene]:
    """Return the scenes of a set, or of one of its domains.

    Args:
        set_name: of ``SETS``.
        domain: ``road`` or ``indoor``; None is both.
        unseal: :data:`OPEN_SEALED` opens the sealed set.

    Raises:
        ValueError: a name is unknown, or the set is sealed.
    """
    if set_name == SEALED and unseal != OPEN_SEALED:
        raise ValueError("set must not be sealed while methods are developed; use development")
    return [
        WildScene(one, number)
        for one in wild_tables().of_set(set_name)
        if domain in (None, one.name)
        for number in range(one.scenes)
    ]


def wild_samples(
    set_name: str,
    domain: str | None = None,
    given: tuple[str, ...] = ("rings", "nothing"),
    *,
    count: int | None = None,
    unseal: str = "",
) -> Iterator[WildSample]:
    """Yield the samples of a set, scene by scene, one sample per sweep and entry of ``given``.

    Args:
        set_name: of ``SETS``.
        domain: ``road`` or ``indoor``; None is both.
        given: of ``GIVEN``.
        count: limits the sweeps to the first ones; None is all.
        unseal: as for :func:`wild_scenes`.

    Raises:
        ValueError: as :func:`wild_scenes`.
    """
    scenes = wild_scenes(set_name, domain, unseal=unseal)
    sweeps = [(scene, sweep) for scene in scenes for sweep in range(scene.domain.sweeps)]
    for scene, sweep in sweeps[:count]:
        observation = scene.observe(sweep)
        yield from (observation.sample(one) for one in given)


@lru_cache(maxsize=2)
def _mounted_world(scene: WildScene) -> tuple[World, Agent]:
    """Return the world of a scene, and its only agent with the sensor mounted."""
    mounting = scene.drawn_mounting()
    plan = AgentPlan(
        moving=1, sensor_height_m=mounting.height_m, duration_s=scene.domain.sweeps * _SWEEPS_APART_S
    )  # fmt: skip
    return mounting.mounted(WORLDS[scene.style](scene.rng(_FOR_WORLD), plan), 0)


def _samples(scene: WildScene, given: tuple[str, ...], _: list[str]) -> Iterator[Sample]:
    split = split_of_set(scene.domain.set_name)
    for sweep in range(scene.domain.sweeps):
        seen = scene.observe(sweep)
        yield Sample(
            seen.given(given[(scene.number + sweep) % len(given)]),
            seen.truth,
            seen.known,
            scene.name,
            split,
        )


def split_of_set(set_name: str) -> str:
    """Return the split of a set's samples: ``train`` for the training set, as in every archive, else the set's name."""
    return "train" if set_name == "training" else set_name


def make_wild_archive(
    set_name: str,
    domain: str,
    store: Storage,
    engine: Engine,
    *,
    given: tuple[str, ...] = ("rings", "nothing"),
    scenes: int | None = None,
    on_progress: Callable[[ShardResult], None] | None = None,
) -> Archive:
    """Simulate one domain of a set into ``store`` and return the archive; its bytes do not depend on the engine.

    Intact shards of an interrupted run of the same set are kept. The sealed set has no archive: only its study
    simulates it.

    Args:
        set_name: of ``SETS``, except ``sealed``.
        domain: ``road`` or ``indoor``.
        store: destination.
        engine: runs the jobs.
        given: of ``GIVEN``: what the sweeps provide besides their points, used in turn.
        scenes: limits the scenes to the first ones; None is all.
        on_progress: called with each finished shard, including those of an earlier run.

    Raises:
        ValueError: a name is unknown, the set is sealed or has no such domain, or the destination holds something else.
        OSError: a shard could not be made or written; finished shards are kept.
    """
    if not given or not set(given) <= set(GIVEN):
        raise ValueError(f"given must be one or more of {', '.join(GIVEN)}, got {', '.join(given) or 'none'}")
    chosen = wild_scenes(set_name, domain)[:scenes]
    if not chosen:
        raise ValueError(f"{set_name} must have a domain {domain!r}, got none; choose road or indoor")
    wild_domain = chosen[0].domain
    about = {"command": "dataset wild", "set": set_name, "domain": domain, "seed": wild_domain.seed}
    config = flat.to_dict(wild_domain) | {"told": list(given), "scenes": len(chosen)}
    recipe = about | {"config": config, "targets": {name: asdict(target) for name, target in TARGETS.items()}}
    jobs = [ShardJob(f"{scene.name}.parquet", partial(_samples, scene, given)) for scene in chosen]
    layout = Layout(wild_domain.grid, tuple(sorted(TARGETS)), ())
    return build_archive(recipe, layout, jobs, store, engine, on_progress)
