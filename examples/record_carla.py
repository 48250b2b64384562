"""Record LiDAR sweeps, poses and boxes in a running CARLA server, in the layout of viewshed.recordings.read.carla.

    pip install carla
    ./CarlaUE4.sh -RenderOffScreen &
    python examples/record_carla.py --out town03 --town Town03 --agents 3 --roadside 2 --ticks 200
    viewshed estimate town03 --out fields

THIS SCRIPT WAS NEVER RUN AGAINST A CARLA SERVER. It ran against a mock of the client, all of whose names exist in the
real one (0.9.16); the real client without a server gives the expected error line. Not tested: that spawning, traffic
and sensors behave as the client's documentation says, the order of points by channel, and the speed.
"""

from __future__ import annotations

import argparse
import csv
import json
import queue
import socket
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from viewshed.io import write_sweep
from viewshed.recordings.read.carla import MIRROR, POSE_COLUMNS, rotation_of_carla
from viewshed.sweep import Sweep

if TYPE_CHECKING:
    import carla


TRAFFIC_MANAGER_PORT = 8000

_MAST_ASIDE_M = 2.0

_ABOVE_ROOF_M = 0.3

_WAIT_S = 20.0


@dataclass(frozen=True, slots=True)
class Plan:
    """What is recorded.

    Attributes:
        town: name of the map to load; None stays on the server's.
        agents: vehicles with a sensor on the roof, on autopilot.
        roadside: sensors on masts beside the road.
        ticks: sweeps of each sensor.
        traffic: further vehicles on autopilot.
        step_s: seconds between two ticks, and the time of one revolution.
        channels: beams of each sensor.
        columns: firings in a revolution.
        range_m: farthest return.
        vehicle_fov_deg: lowest and highest beam on vehicles.
        mast_fov_deg: the same on masts.
        mast_height_m: height of the masts' sensors above the road.
        seed: of places, models and traffic.

    Raises:
        ValueError: a number is out of range.
    """

    town: str | None = None
    agents: int = 2
    roadside: int = 1
    ticks: int = 100
    traffic: int = 30
    step_s: float = 0.1
    channels: int = 64
    columns: int = 1024
    range_m: float = 100.0
    vehicle_fov_deg: tuple[float, float] = (-25.0, 5.0)
    mast_fov_deg: tuple[float, float] = (-60.0, 0.0)
    mast_height_m: float = 5.0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.agents < 0 or self.roadside < 0 or self.agents + self.roadside == 0:
            raise ValueError(f"agents and roadside must be at least one sensor, got {self.agents} and {self.roadside}")
        if self.ticks < 1 or self.traffic < 0:
            raise ValueError(f"ticks must be positive and traffic not negative, got {self.ticks} and {self.traffic}")
        if not 0.01 <= self.step_s <= 0.1:
            raise ValueError(f"step_s must lie in [0.01, 0.1], what CARLA's physics can step, got {self.step_s}")

    def beams(self, fov_deg: tuple[float, float]) -> dict[str, float | int]:
        """Return the beams of a sensor as ``recording.json`` says them."""
        return {
            "channels": self.channels, "lower_fov_deg": fov_deg[0], "upper_fov_deg": fov_deg[1],
            "range_m": self.range_m, "points_per_second": self.channels * self.columns / self.step_s,
            "rotation_hz": 1.0 / self.step_s,
        }  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class _Sensor:
    """One running sensor: its agent, its actor, and the measurements that it has sent."""

    agent: str
    actor: Any
    sent: queue.SimpleQueue[Any] = field(default_factory=queue.SimpleQueue)

    def at(self, frame: int) -> Any:
        """Return the measurement of a tick; older ones are dropped."""
        try:
            while True:
                measurement = self.sent.get(timeout=_WAIT_S)
                if measurement.frame >= frame:
                    return measurement
        except queue.Empty as error:
            raise TimeoutError(f"the sensor of {self.agent} sent nothing for tick {frame} in {_WAIT_S:g} s") from error


@dataclass(frozen=True, slots=True)
class Carrier:
    """What carries an agent's sensor.

    Attributes:
        actor: number of the vehicle, or None for a mast.
        sensor_height_m: height of the sensor above the road.
        beams: what ``recording.json`` says about them, :data:`viewshed.recordings.read.carla.BEAMS`.
    """

    actor: int | None
    sensor_height_m: float
    beams: Mapping[str, float | int]


@dataclass(frozen=True, slots=True, eq=False)
class RecordingWriter:
    """Writes one recording, from :meth:`create`."""

    folder: Path
    _open: ExitStack
    _poses: dict[str, IO[str]] = field(default_factory=dict)

    @classmethod
    @contextmanager
    def create(cls, folder: Path) -> Iterator[RecordingWriter]:
        """Give a writer into a new or empty folder, and close its files.

        Raises:
            ValueError: the folder is not empty.
            OSError: it cannot be written.
        """
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise ValueError(f"out must be a new or empty folder, {folder} is not empty")
        with ExitStack() as files:
            yield cls(folder, files)

    def describe(self, town: str, carla: str, step_s: float, carriers: Mapping[str, Carrier]) -> None:
        """Write ``recording.json``: the axes of the points, the town, and the sensor of each agent."""
        agents = {
            agent: {"sensor_height_m": carrier.sensor_height_m, "lidar": dict(carrier.beams)}
            for agent, carrier in carriers.items()
        }
        about = {"axes": "sensor", "town": town, "carla": carla, "step_s": step_s, "agents": agents}
        (self.folder / "recording.json").write_text(json.dumps(about, indent=1))

    def write(self, agent: str, frame: int, t_ns: int, sweep: Sweep, transform: Any) -> None:
        """Write one sweep, and the ``carla.Transform`` of its sensor as it is."""
        (self.folder / agent).mkdir(exist_ok=True)
        write_sweep(sweep, self.folder / agent / f"{frame:06d}.ply")
        if agent not in self._poses:
            self._poses[agent] = self._file(f"{agent}/poses.csv")
            csv.writer(self._poses[agent]).writerow(POSE_COLUMNS)
        csv.writer(self._poses[agent]).writerow((frame, t_ns, *_numbers(transform)))
        self._poses[agent].flush()

    def write_actors(self, frame: int, t_ns: int, actors: Iterable[Any], agents: Mapping[int | None, str]) -> None:
        """Write the boxes of a tick's ``carla.Actor``s; ``agents``: number of the actor → agent that it carries."""
        rows = [_actor(actor, agents.get(actor.id)) for actor in actors]
        with (self.folder / "actors.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps({"frame": frame, "t_ns": t_ns, "actors": rows}) + "\n")

    def _file(self, name: str) -> IO[str]:
        return self._open.enter_context((self.folder / name).open("w", encoding="utf-8", newline=""))


def _numbers(transform: Any) -> tuple[float, ...]:
    place, turn = transform.location, transform.rotation
    return place.x, place.y, place.z, turn.roll, turn.pitch, turn.yaw


def _actor(actor: Any, agent: str | None) -> dict[str, Any]:
    """Return one actor as a row: the center of its box in CARLA's world, its turn, half of its size."""
    x, y, z, roll, pitch, yaw = _numbers(actor.get_transform())
    box = actor.bounding_box
    ahead = rotation_of_carla(roll, pitch, yaw) @ np.array([box.location.x, box.location.y, box.location.z])
    center = dict(zip("xyz", (np.array([x, y, z]) + ahead).tolist(), strict=True))
    extent = [box.extent.x, box.extent.y, box.extent.z]
    row = {"id": actor.id, "type": actor.type_id, **center, "roll": roll, "pitch": pitch, "yaw": yaw, "extent": extent}
    return row if agent is None else row | {"agent": agent}


def connect(host: str = "localhost", port: int = 2000, timeout_s: float = 5.0) -> carla.Client:
    """Return a client that has heard from a server.

    Raises:
        ImportError: CARLA's client is not installed.
        ConnectionError: no server answers in time.
    """
    try:
        import carla
    except ImportError as error:
        raise ImportError("recording needs CARLA's client: pip install carla") from error
    try:
        socket.create_connection((host, port), timeout_s).close()
        client = carla.Client(host, port)
        client.set_timeout(timeout_s)
        client.get_server_version()
    except (OSError, RuntimeError) as error:
        start = "start one with: ./CarlaUE4.sh -RenderOffScreen"
        raise ConnectionError(f"no CARLA server answers at {host}:{port} within {timeout_s:g} s; {start}") from error
    client.set_timeout(60.0)
    return client


def record_carla(client: carla.Client, plan: Plan, out: Path, on_tick: Callable[[int], None] | None = None) -> None:
    """Record in a server that nobody else steps; its settings are put back and what was spawned is removed.

    Args:
        client: from :func:`connect`.
        plan: what is recorded.
        out: a folder that does not exist or is empty.
        on_tick: called with the number of each tick that has been written.

    Raises:
        ValueError: the folder is not empty, or the map has no room for the vehicles.
        OSError: it cannot be written, or a sensor is silent.
    """
    try:
        world = client.get_world() if plan.town is None else client.load_world(plan.town)
        with RecordingWriter.create(out) as writer, _synchronous(client, world, plan), ExitStack() as spawned:
            sensors, carriers = _sensors(world, plan, spawned)
            writer.describe(world.get_map().name, client.get_server_version(), plan.step_s, carriers)
            for number in range(plan.ticks):
                _write_tick(world, sensors, carriers, writer)
                if on_tick is not None:
                    on_tick(number)
    except RuntimeError as error:  # what the client raises for a lost server, an unknown map, a blocked place
        raise OSError(f"CARLA: {' '.join(str(error).split())}") from error


def _write_tick(
    world: carla.World, sensors: list[_Sensor], carriers: dict[str, Carrier], writer: RecordingWriter
) -> None:
    frame = world.tick()
    for sensor in sensors:
        measurement = sensor.at(frame)
        writer.write(sensor.agent, frame, _t_ns(measurement), sweep_of(measurement), measurement.transform)
    snapshot_ns = round(world.get_snapshot().timestamp.elapsed_seconds * 1e9)
    actors = world.get_actors()
    moving = [*actors.filter("vehicle.*"), *actors.filter("walker.pedestrian.*")]
    writer.write_actors(frame, snapshot_ns, moving, {carrier.actor: agent for agent, carrier in carriers.items()})


def _t_ns(measurement: Any) -> int:
    return round(float(measurement.timestamp) * 1e9)


def sweep_of(measurement: Any) -> Sweep:
    """Return a ``carla.LidarMeasurement`` as a sweep in the sensor's frame, ring 0 the lowest beam.

    Its points come channel by channel, the highest first.
    """
    table = np.frombuffer(measurement.raw_data, "<f4").reshape(-1, 4)
    counts = [measurement.get_point_count(channel) for channel in range(measurement.channels)]
    rings = np.repeat(np.arange(measurement.channels - 1, -1, -1, dtype=np.int16), counts)
    return Sweep(
        table[:, :3] * MIRROR.astype(np.float32), intensity=table[:, 3],
        ring=rings if rings.size == len(table) else None, t_ns=_t_ns(measurement),
    )  # fmt: skip


@contextmanager
def _synchronous(client: carla.Client, world: carla.World, plan: Plan) -> Iterator[None]:
    """Step the world by ticks of ours, and let it run as before at the end."""
    before, ours = world.get_settings(), world.get_settings()
    ours.synchronous_mode = True
    ours.fixed_delta_seconds = plan.step_s
    traffic = client.get_trafficmanager(TRAFFIC_MANAGER_PORT)
    world.apply_settings(ours)
    try:
        traffic.set_synchronous_mode(True)
        traffic.set_random_device_seed(plan.seed)
        yield
    finally:
        traffic.set_synchronous_mode(False)
        world.apply_settings(before)


def _sensors(world: carla.World, plan: Plan, spawned: ExitStack) -> tuple[list[_Sensor], dict[str, Carrier]]:
    """Spawn vehicles, then masts; return the sensors and what carries them."""
    rng = np.random.default_rng(plan.seed)
    places = world.get_map().get_spawn_points()
    if not places:
        raise ValueError(f"the map must have places to spawn, got none in {world.get_map().name}")
    order = rng.permutation(len(places))
    vehicles, used = _vehicles(world, plan, [places[at] for at in order], rng, spawned)
    sensors: list[_Sensor] = []
    carriers: dict[str, Carrier] = {}
    beams = plan.beams(plan.vehicle_fov_deg)
    for number, vehicle in enumerate(vehicles[: plan.agents]):
        agent, box = f"vehicle_{number}", vehicle.bounding_box
        height_m = float(box.location.z + box.extent.z + _ABOVE_ROOF_M)
        sensors.append(_lidar(world, _model(world, beams), agent, _above(height_m), vehicle, spawned))
        carriers[agent] = Carrier(vehicle.id, height_m, beams)
    beams = plan.beams(plan.mast_fov_deg)
    for number in range(plan.roadside):
        agent, mast = (
            f"roadside_{number}",
            _mast(world, places[order[(used + number) % len(order)]], plan.mast_height_m),
        )
        sensors.append(_lidar(world, _model(world, beams), agent, mast, None, spawned))
        carriers[agent] = Carrier(None, plan.mast_height_m, beams)
    return sensors, carriers


def _vehicles(
    world: carla.World, plan: Plan, places: list[carla.Transform], rng: np.random.Generator, spawned: ExitStack
) -> tuple[list[Any], int]:
    """Return the vehicles, those of the agents first, and how many places were tried."""
    models = sorted((model for model in world.get_blueprint_library().filter("vehicle.*") if _is_car(model)), key=_name)
    found: list[Any] = []
    for tried, place in enumerate(places):
        if len(found) == plan.agents + plan.traffic:
            return found, tried
        vehicle: Any = world.try_spawn_actor(models[rng.integers(len(models))], place)
        if vehicle is not None:
            spawned.callback(vehicle.destroy)
            vehicle.set_autopilot(True, TRAFFIC_MANAGER_PORT)
            found.append(vehicle)
    if len(found) < plan.agents:
        raise ValueError(f"the map must have room for {plan.agents} agents, got {len(found)}; ask for fewer")
    return found, len(places)


def _is_car(model: carla.ActorBlueprint) -> bool:
    return bool(model.has_attribute("number_of_wheels") and int(model.get_attribute("number_of_wheels")) == 4)


def _name(model: carla.ActorBlueprint) -> str:
    return str(model.id)


def _above(height_m: float) -> carla.Transform:
    """Return the place of a sensor above the origin of its vehicle, which CARLA has on the road."""
    import carla

    return carla.Transform(carla.Location(x=0.0, y=0.0, z=height_m), carla.Rotation(pitch=0.0, yaw=0.0, roll=0.0))


def _mast(world: carla.World, place: carla.Transform, height_m: float) -> carla.Transform:
    """Return the place of a sensor beside the lane that a place lies on, upright, along the lane."""
    import carla

    waypoint = world.get_map().get_waypoint(place.location)
    road, right = waypoint.transform, waypoint.transform.get_right_vector()
    aside = 0.5 * waypoint.lane_width + _MAST_ASIDE_M
    spot = carla.Location(
        x=road.location.x + aside * right.x, y=road.location.y + aside * right.y, z=road.location.z + height_m
    )
    return carla.Transform(spot, carla.Rotation(pitch=0.0, yaw=road.rotation.yaw, roll=0.0))


def _lidar(world: carla.World, model: Any, agent: str, place: Any, vehicle: Any, spawned: ExitStack) -> _Sensor:
    """Return a running sensor, on a vehicle or by itself; it is stopped before its vehicle is removed."""
    actor: Any = world.spawn_actor(model, place, attach_to=vehicle)
    spawned.callback(actor.destroy)
    sensor = _Sensor(agent, actor)
    actor.listen(sensor.sent.put)
    spawned.callback(actor.stop)
    return sensor


def _model(world: carla.World, beams: dict[str, float | int]) -> carla.ActorBlueprint:
    """Return the blueprint of a sensor with these beams that loses no points and has no noise."""
    model = world.get_blueprint_library().find("sensor.lidar.ray_cast")
    attributes = {
        "channels": beams["channels"], "lower_fov": beams["lower_fov_deg"], "upper_fov": beams["upper_fov_deg"],
        "range": beams["range_m"], "points_per_second": round(beams["points_per_second"]),
        "rotation_frequency": beams["rotation_hz"], "dropoff_general_rate": 0.0, "dropoff_zero_intensity": 0.0,
        "noise_stddev": 0.0,
    }  # fmt: skip
    for name, value in attributes.items():
        model.set_attribute(name, str(value))
    return model


def main(arguments: list[str] | None = None) -> int:
    """Record what the options say; without any, say how to use this. Return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="new or empty folder for the recording")
    parser.add_argument("--host", default="localhost", help="where the server runs")
    parser.add_argument("--port", type=int, default=2000)
    parser.add_argument("--timeout", type=float, default=5.0, help="seconds to wait for the server to answer")
    parser.add_argument("--town", help="map to load (Town03); the server's own if not given")
    parser.add_argument("--agents", type=int, default=2, help="vehicles with a sensor, on autopilot")
    parser.add_argument("--roadside", type=int, default=1, help="sensors on masts beside the road")
    parser.add_argument("--ticks", type=int, default=100, help="sweeps of each sensor")
    parser.add_argument("--traffic", type=int, default=30, help="further vehicles")
    parser.add_argument("--step", type=float, default=0.1, help="seconds of a tick and of a revolution")
    parser.add_argument("--seed", type=int, default=0, help="seed of places, models and traffic")
    if not (sys.argv[1:] if arguments is None else arguments):
        parser.print_help()
        return 0
    given = parser.parse_args(arguments)
    try:
        plan = Plan(
            town=given.town, agents=given.agents, roadside=given.roadside, ticks=given.ticks, traffic=given.traffic,
            step_s=given.step, seed=given.seed,
        )  # fmt: skip
        record_carla(connect(given.host, given.port, given.timeout), plan, given.out)
    except (ValueError, OSError, ImportError) as error:
        print(f"record_carla: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    print(f"{given.out}: {plan.ticks} ticks of {plan.agents} vehicle(s) and {plan.roadside} mast(s)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
