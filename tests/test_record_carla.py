"""The CARLA recorder against a small stand-in for the client: what it asks for, and that its files tell the truth.

The stand-in's sensors see three signs whose places in CARLA's world are known; every agent of the recording must put
them at the same place in ours. No server takes part.
"""

import re
import socket
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from examples.record_carla import Plan, connect, main, record_carla, sweep_of
from viewshed.recordings.read import open_source
from viewshed.recordings.read.source import each_sweep

SIGNS = np.array([[30.0, 5.0, 2.5], [-12.0, 21.0, 4.0], [8.0, -17.0, 1.0]])
"""In CARLA's left-handed world; ours has y with the other sign."""


@dataclass
class Vector:
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


@dataclass
class Rotation:
    pitch: float = 0.0
    yaw: float = 0.0
    roll: float = 0.0


@dataclass
class Transform:
    location: Any = field(default_factory=Vector)
    rotation: Rotation = field(default_factory=Rotation)

    def matrix(self) -> NDArray[np.float64]:
        """Left-handed: turn about z by yaw, then about the new y by -pitch, then about the new x by -roll."""
        p, y, r = np.deg2rad([self.rotation.pitch, self.rotation.yaw, self.rotation.roll])
        yaw = np.array([[np.cos(y), -np.sin(y), 0], [np.sin(y), np.cos(y), 0], [0, 0, 1]])
        pitch = np.array([[np.cos(p), 0, -np.sin(p)], [0, 1, 0], [np.sin(p), 0, np.cos(p)]])
        roll = np.array([[1, 0, 0], [0, np.cos(r), np.sin(r)], [0, -np.sin(r), np.cos(r)]])
        return np.asarray(yaw @ pitch @ roll)

    def get_right_vector(self) -> Vector:
        return Vector(*self.matrix()[:, 1])


def _xyz(place: Any) -> NDArray[np.float64]:
    return np.array([place.x, place.y, place.z])


@dataclass
class Settings:
    synchronous_mode: bool = False
    fixed_delta_seconds: float | None = None


@dataclass
class Blueprint:
    id: str
    wheels: int = 4
    attributes: dict[str, str] = field(default_factory=dict)

    def has_attribute(self, name: str) -> bool:
        return name == "number_of_wheels"

    def get_attribute(self, name: str) -> int:
        return self.wheels

    def set_attribute(self, name: str, value: str) -> None:
        self.attributes[name] = value


@dataclass
class Box:
    location: Vector = field(default_factory=lambda: Vector(0.5, 0.0, 0.75))
    extent: Vector = field(default_factory=lambda: Vector(2.0, 1.0, 0.75))


class Actor:
    def __init__(self, world: "World", blueprint: Blueprint, place: Transform, parent: "Actor | None") -> None:
        self.world, self.blueprint, self.place, self.parent = world, blueprint, place, parent
        self.id, self.type_id, self.bounding_box = 100 + len(world.actors), blueprint.id, Box()
        self.sends: Any = None
        world.actors.append(self)

    def set_autopilot(self, enabled: bool, port: int) -> None:
        self.world.calls.append(f"autopilot {self.id} {enabled} {port}")

    def get_transform(self) -> Transform:
        return self.place

    def sensor_transform(self) -> Transform:
        if self.parent is None:
            return self.place
        rotated = self.parent.place.matrix() @ _xyz(self.place.location)
        return Transform(Vector(*(_xyz(self.parent.place.location) + rotated)), self.parent.place.rotation)

    def listen(self, callback: Any) -> None:
        self.sends = callback

    def stop(self) -> None:
        self.world.calls.append(f"stop {self.id}")
        self.sends = None

    def destroy(self) -> None:
        self.world.calls.append(f"destroy {self.id}")
        self.world.actors.remove(self)


@dataclass
class Measurement:
    frame: int
    timestamp: float
    transform: Transform
    raw_data: bytes
    channels: int = 2

    def get_point_count(self, channel: int) -> int:
        return (2, 1)[channel]


class World:
    def __init__(self, calls: list[str], silent: bool) -> None:
        self.calls, self.silent = calls, silent
        self.actors: list[Actor] = []
        self.settings, self.frame = Settings(), 40
        self.name, self.timestamp = "Town07", self
        turn = Rotation(pitch=4.0, yaw=33.0, roll=-3.0)
        self.places = [Transform(Vector(9.0 * k, 3.0 - 2 * k, 0.2 * k), turn) for k in range(4)]

    elapsed_seconds = 1.5
    lane_width = 3.0

    @property
    def transform(self) -> Transform:
        return Transform(Vector(40.0, -8.0, 0.5), Rotation(yaw=90.0))

    def get_settings(self) -> Settings:
        return Settings(self.settings.synchronous_mode, self.settings.fixed_delta_seconds)

    def apply_settings(self, settings: Settings) -> None:
        self.settings = settings
        self.calls.append(f"settings {settings.synchronous_mode} {settings.fixed_delta_seconds}")

    def get_map(self) -> "World":
        return self

    def get_spawn_points(self) -> list[Transform]:
        return self.places

    def get_waypoint(self, location: Vector) -> "World":
        return self

    def get_snapshot(self) -> "World":
        return self

    def get_blueprint_library(self) -> "World":
        return self

    def get_actors(self) -> "World":
        return self

    def filter(self, pattern: str) -> list[Any]:
        if len(self.actors) == 0:
            return [Blueprint("vehicle.b.bike", 2), Blueprint("vehicle.a.car")]
        return [actor for actor in self.actors if re.match(pattern.replace("*", ".*"), actor.type_id)]

    def find(self, name: str) -> Blueprint:
        return Blueprint(name)

    def try_spawn_actor(self, blueprint: Blueprint, place: Transform) -> Actor | None:
        return None if place is self.places[2] else Actor(self, blueprint, place, None)

    def spawn_actor(self, blueprint: Blueprint, place: Transform, attach_to: Actor | None = None) -> Actor:
        self.calls.append(f"{blueprint.id} {sorted(blueprint.attributes.items())}")
        return Actor(self, blueprint, place, attach_to)

    def tick(self) -> int:
        self.frame += 1
        for actor in self.actors:
            if actor.sends is not None and not self.silent:
                where = actor.sensor_transform()
                seen = (SIGNS - _xyz(where.location)) @ where.matrix()
                raw = np.column_stack([seen, [0.9, 0.5, 0.1]]).astype("<f4").tobytes()
                for frame in (self.frame - 1, self.frame):  # an old one may still lie in the queue
                    actor.sends(Measurement(frame, 0.1 * frame, where, raw))
        return self.frame


class Client:
    def __init__(self, host: str = "", port: int = 0, silent: bool = False) -> None:
        self.calls: list[str] = []
        self.world = World(self.calls, silent)

    def set_timeout(self, seconds: float) -> None:
        self.calls.append(f"timeout {seconds}")

    def get_server_version(self) -> str:
        return "0.9.16"

    def get_world(self) -> World:
        return self.world

    def load_world(self, town: str) -> World:
        self.calls.append(f"load {town}")
        if town == "Nowhere":
            raise RuntimeError("map 'Nowhere' not found")
        return self.world

    def get_trafficmanager(self, port: int) -> "Client":
        return self

    def set_synchronous_mode(self, on: bool) -> None:
        self.calls.append(f"traffic {on}")

    def set_random_device_seed(self, seed: int) -> None:
        self.calls.append(f"seed {seed}")


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    module: Any = ModuleType("carla")
    module.Location, module.Rotation, module.Transform, module.Client = Vector, Rotation, Transform, Client
    monkeypatch.setitem(sys.modules, "carla", module)
    return module  # type: ignore[no-any-return]


PLAN = Plan("Town07", agents=2, roadside=1, ticks=3, traffic=1, seed=5)


@pytest.mark.usefixtures("stand_in")
def test_every_agent_puts_the_signs_where_they_are(tmp_path: Path) -> None:
    ticks: list[int] = []
    record_carla(Client(), PLAN, tmp_path / "r", ticks.append)
    source = open_source(tmp_path / "r")
    sweeps = list(each_sweep(source))
    assert (ticks, source.damage()) == ([0, 1, 2], ())
    assert [(ref.agent, ref.t_ns) for ref, _ in sweeps[:4]] == [
        ("roadside_0", 4_100_000_000), ("vehicle_0", 4_100_000_000), ("vehicle_1", 4_100_000_000),
        ("roadside_0", 4_200_000_000),
    ]  # fmt: skip
    for _, sweep in sweeps:
        assert sweep.world_from_sensor is not None
        np.testing.assert_allclose(sweep.world_from_sensor @ sweep.points, SIGNS * [1, -1, 1], atol=1e-4)
        assert sweep.intensity is not None
        np.testing.assert_allclose(sweep.intensity, [0.9, 0.5, 0.1], atol=1e-6)
        assert sweep.ring is not None
        assert sweep.ring.tolist() == [1, 1, 0]  # channel 0, with two points, is the highest
        assert sweep.model is not None
        assert (sweep.model.rings, sweep.model.azimuth_columns) == (64, 1024)
    roadside, vehicle = sweeps[0][1], sweeps[1][1]
    assert roadside.sensor_height_m == 5.0
    assert vehicle.sensor_height_m == pytest.approx(0.75 + 0.75 + 0.3)
    assert roadside.world_from_sensor is not None
    # The lane heads for CARLA's +y, so its right is -x: 1.5 m of lane and 2 m more; 5 m above its road at z = 0.5.
    np.testing.assert_allclose(roadside.world_from_sensor.translation, [40.0 - 3.5, 8.0, 5.5], atol=1e-6)


@pytest.mark.usefixtures("stand_in")
def test_boxes_are_those_of_the_other_vehicles(tmp_path: Path) -> None:
    client = Client()
    record_carla(client, PLAN, tmp_path / "r")
    source = open_source(tmp_path / "r")
    refs = {ref.agent: ref for ref in source.refs("r")}
    for agent, count in (("roadside_0", 3), ("vehicle_0", 2), ("vehicle_1", 2)):
        boxes = source.boxes(refs[agent])
        assert boxes is not None
        assert len(boxes) == count
    boxes = source.boxes(refs["roadside_0"]) or ()
    free = [place for place in client.world.places if place is not client.world.places[2]]
    truth = np.array([_xyz(place.location) + place.matrix() @ [0.5, 0.0, 0.75] for place in free]) * [1, -1, 1]
    found = np.array(sorted(box.center.tolist() for box in boxes))
    np.testing.assert_allclose(found, truth[np.argsort(truth[:, 0])], atol=1e-9)
    assert {box.size_m for box in boxes} == {(4.0, 2.0, 1.5)}
    assert all(box.yaw == pytest.approx(-np.deg2rad(33.0)) for box in boxes)


@pytest.mark.usefixtures("stand_in")
def test_the_server_is_left_as_it_was(tmp_path: Path) -> None:
    client = Client()
    record_carla(client, PLAN, tmp_path / "r")
    calls = client.calls
    assert calls[0] == "load Town07"
    assert calls.index("settings True 0.1") < calls.index("traffic True") < calls.index("seed 5")
    assert calls[-2:] == ["traffic False", "settings False None"]
    assert client.world.actors == []
    made = [call.split()[1] for call in calls if call.startswith("destroy")]
    assert len(made) == 6
    assert [f"autopilot {number} True 8000" in calls for number in (100, 101, 102)] == [True] * 3
    for number in (103, 104, 105):
        assert calls.index(f"stop {number}") < calls.index(f"destroy {number}") < calls.index("destroy 100")


@pytest.mark.usefixtures("stand_in")
def test_sensors_are_asked_for_whole_revolutions_without_losses(tmp_path: Path) -> None:
    client = Client()
    plan = Plan(agents=1, roadside=1, ticks=1, traffic=0, step_s=0.05, channels=32, columns=500, range_m=80.0)
    record_carla(client, plan, tmp_path / "r")
    car, mast = (call for call in client.calls if call.startswith("sensor.lidar.ray_cast"))
    for words in ("'points_per_second', '320000'", "'rotation_frequency', '20.0'", "'dropoff_general_rate', '0.0'",
                  "'channels', '32'", "'range', '80.0'", "'noise_stddev', '0.0'"):  # fmt: skip
        assert words in car
        assert words in mast
    assert "'lower_fov', '-25.0'" in car
    assert "'lower_fov', '-60.0'" in mast
    assert not any(call.startswith("load") for call in client.calls)


@pytest.mark.usefixtures("stand_in")
def test_a_silent_sensor_a_lost_map_and_a_full_map_are_one_line_and_cleaned_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("examples.record_carla._WAIT_S", 0.05)
    client = Client(silent=True)
    with pytest.raises(TimeoutError, match="the sensor of vehicle_0 sent nothing for tick 41"):
        record_carla(client, PLAN, tmp_path / "a")
    assert client.world.actors == []
    assert client.calls[-1] == "settings False None"
    with pytest.raises(OSError, match="CARLA: map 'Nowhere' not found"):
        record_carla(Client(), Plan("Nowhere"), tmp_path / "b")
    with pytest.raises(ValueError, match="must have room for 4 agents, got 3"):
        record_carla(Client(), Plan(agents=4), tmp_path / "c")
    with pytest.raises(ValueError, match="out must be a new or empty folder"):
        record_carla(Client(), PLAN, tmp_path)


def test_plans_are_checked() -> None:
    for words, plan in (("at least one sensor", {"agents": 0, "roadside": 0}), ("ticks must be positive", {"ticks": 0}),
                        ("step_s must lie in", {"step_s": 0.5})):  # fmt: skip
        with pytest.raises(ValueError, match=words):
            Plan(**plan)


def test_counts_that_do_not_fit_give_no_rings() -> None:
    measurement = Measurement(1, 0.1, Transform(), np.zeros((5, 4), "<f4").tobytes())
    assert sweep_of(measurement).ring is None


@pytest.mark.usefixtures("stand_in")
def test_no_server_is_one_line_at_once(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    assert main(["--host", "127.0.0.1", "--port", str(port), "--out", str(tmp_path / "r")]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith(f"record_carla: no CARLA server answers at 127.0.0.1:{port} within 5 s; start one with")
    assert not (tmp_path / "r").exists()


def test_the_missing_client_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "carla", None)
    with pytest.raises(ImportError, match="recording needs CARLA's client: pip install carla"):
        connect()
    assert main(["--out", str(tmp_path / "r")]) == 2
    assert capsys.readouterr().err == "record_carla: recording needs CARLA's client: pip install carla\n"


def test_without_arguments_it_says_how_to_use_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    words = capsys.readouterr().out
    assert "python examples/record_carla.py --out town03" in words
    assert "THIS SCRIPT WAS NEVER RUN AGAINST A CARLA SERVER" in words


def test_the_command_records(
    stand_in: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        assert main(["--host", "127.0.0.1", "--port", str(server.getsockname()[1]), "--agents", "1",
                     "--roadside", "0", "--ticks", "2", "--out", str(tmp_path / "r")]) == 0  # fmt: skip
    assert "2 ticks of 1 vehicle(s) and 0 mast(s)" in capsys.readouterr().out
    assert len(open_source(tmp_path / "r").refs("r")) == 2


def test_the_stand_in_has_only_names_that_the_real_client_has() -> None:
    carla = pytest.importorskip("carla", reason="CARLA's client is not installed: names are not compared")
    pairs = {
        Client: ("Client", "TrafficManager"), Measurement: ("LidarMeasurement",), Blueprint: ("ActorBlueprint",),
        World: ("World", "Map", "BlueprintLibrary", "ActorList", "Waypoint", "WorldSnapshot", "Timestamp"),
        Actor: ("Vehicle", "Sensor"), Settings: ("WorldSettings",), Transform: ("Transform",), Box: ("BoundingBox",),
        Vector: ("Location",), Rotation: ("Rotation",),
    }  # fmt: skip
    own = {"sensor_transform", "matrix", "attributes", "wheels", "world"}
    for ours, theirs in pairs.items():
        known = {name for kind in theirs for name in dir(getattr(carla, kind))}
        fields = getattr(ours, "__dataclass_fields__", {})
        used = {name for name in [*vars(ours), *fields] if not name.startswith("_")} - own
        assert used <= known, ours.__name__


def test_frames_agree_with_the_real_client() -> None:
    carla = pytest.importorskip("carla", reason="CARLA's client is not installed: frames are not compared")
    from viewshed.recordings.read.carla import rigid_of_carla

    rng = np.random.default_rng(3)
    for roll, pitch, yaw in rng.uniform(-80, 80, (20, 3)):
        theirs = carla.Transform(carla.Location(3.0, -5.0, 2.0), carla.Rotation(pitch=pitch, yaw=yaw, roll=roll))
        point = theirs.transform(carla.Location(4.0, 1.5, -0.7))
        ours = rigid_of_carla((3.0, -5.0, 2.0), roll, pitch, yaw) @ np.array([4.0, -1.5, -0.7])
        np.testing.assert_allclose(ours, [point.x, -point.y, point.z], atol=1e-4)
