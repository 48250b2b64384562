"""The caster against brute force: every kind of surface, tilted and moving sensors, all kinds of beam tables."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.sim.oracle import opaque_depth, rays_of, solid_interval

from viewshed.geometry import Rigid
from viewshed.sensors import LidarModel, lidar_model
from viewshed_lab.sim.assets.shapes import PER_M, Box, Cylinder, Ellipsoid, Shape, material_index
from viewshed_lab.sim.raycast.caster import cast_world
from viewshed_lab.sim.raycast.scan import STILL, ExactScan, Motion
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import AgentPlan, Snapshot, Thing, Track, World
from viewshed_lab.sim.worlds import WORLDS

pytestmark = pytest.mark.slow

TOLERANCE_M = 1e-3
SILHOUETTE_M = 2e-3
MIN_RAYS = 600_000


@dataclass(frozen=True)
class View:
    """One cast that is checked beam by beam."""

    model: LidarModel
    yaw: float
    pitch: float
    at_m: tuple[float, float, float]
    motion: Motion = STILL


ODD = LidarModel(
    "odd", np.deg2rad(np.linspace(-38.0, 21.0, 37)), 700,
    azimuth_offset=np.deg2rad(np.linspace(-4.0, 3.0, 37)), origin_m=np.linspace(0.25, -0.1, 37),
)  # fmt: skip
DRIVING = Motion((11.0, -4.0, 0.3), yaw_rate=0.5, period_s=0.1)
VIEWS = (
    View(lidar_model("hdl32e"), 0.4, 0.0, (1.0, 2.0, 2.1)),
    View(lidar_model("hdl64e"), -2.0, 0.0, (-14.0, 9.0, 1.9)),
    View(lidar_model("vlp16"), 1.0, 0.03, (6.0, -12.0, 1.2), DRIVING),
    View(lidar_model("roadside"), 2.6, 0.35, (18.0, 15.0, 7.0)),
    View(ODD, -0.7, -0.15, (-20.0, -18.0, 2.6)),
    View(ODD, 3.1, 0.1, (3.0, 17.0, 3.0), DRIVING),
    View(lidar_model("os1_128"), 0.0, 0.0, (0.0, 0.0, 2.2), DRIVING),
    View(lidar_model("carla256"), 0.9, 0.0, (25.0, -6.0, 2.0)),
)  # fmt: skip


def _terrain() -> Terrain:
    """Hills, a crown and two curbs: bent quads, and near-vertical ones of 3 cm."""
    lines = np.unique(np.concatenate([np.linspace(-70.0, 70.0, 9), [-5.0, -4.97, 5.0, 5.03]]))

    def height(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        return 0.03 * x + 0.8 * np.sin(x / 17.0) * np.cos(y / 23.0) + 0.15 * (np.abs(y) > 4.99)

    return Terrain.of(lines, lines, height)


def _shape(rng: np.random.Generator, material: str) -> Shape:
    kind = rng.integers(3)
    size = rng.uniform(0.2, 6.0, 2)
    top, bottom = rng.uniform(0.5, 5.0), rng.uniform(-0.5, 0.4)
    if kind == 0:
        return Box(0.3, -0.2, size[0], size[1], top, bottom, rng.uniform(0, 6), material)
    if kind == 1:
        return Cylinder(0.1, 0.4, size[0] / 3, top, bottom, material)
    return Ellipsoid(-0.2, 0.1, size[0], size[1], top, bottom, rng.uniform(0, 6), material)


def _world(materials: tuple[str, ...], count: int, seed: int) -> World:
    rng = np.random.default_rng(seed)
    things = []
    for k in range(count):
        x, y, yaw = rng.uniform(-45, 45), rng.uniform(-45, 45), rng.uniform(0, 6)
        track = None
        if k % 4 == 0:
            ends = np.array([[x, y], [x + rng.uniform(-30, 30), y + rng.uniform(-30, 30)]])
            track = Track(np.array([-1.0, 2.0]), ends, np.array([yaw, yaw]))
        shape = _shape(rng, materials[k % len(materials)])
        things.append(Thing("solid", (shape,), x, y, yaw, track, tilts=k % 3 == 0))
    return World("random", _terrain(), tuple(things))


def _cast(view: View, snapshot: Snapshot, seed: int = 0) -> ExactScan:
    c, s = np.cos(view.pitch), np.sin(view.pitch)
    pitch = Rigid(np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]), np.zeros(3))
    return cast_world(snapshot, view.model, Rigid.from_yaw(view.yaw, view.at_m) @ pitch, view.motion, seed)


def test_beams_stop_where_brute_force_says() -> None:
    """Within 1 mm; only a beam that passes an edge within 2 mm may be told otherwise, and hardly any does."""
    snapshot = _world(("paint", "absorber"), 60, 3).snapshot(0.4)
    rays, otherwise = 0, 0
    met: set[int] = set()
    for view in VIEWS:
        scan = _cast(view, snapshot)
        depth, winner = opaque_depth(snapshot, rays_of(scan), view.model.max_range_m)
        got = scan.depth_m.ravel().astype(np.float64)
        same = np.isclose(got, depth, rtol=0.0, atol=TOLERANCE_M)
        rays, otherwise = rays + got.size, otherwise + int((~same).sum())
        expected = np.where(winner >= 0, snapshot.thing[np.maximum(winner, 0)], winner)
        assert (scan.thing.ravel() == expected)[same & np.isfinite(got)].mean() > 0.9999
        met |= set(np.unique(snapshot.kind[winner[winner >= 0]])) | set(np.unique(winner[winner < 0]) * 10)
        assert _all_graze(snapshot, scan, ~same)
    assert rays >= MIN_RAYS
    assert met == {0, 1, 2, -10, -20}
    assert otherwise <= 1e-5 * rays


def _all_graze(snapshot: Snapshot, scan: ExactScan, which: NDArray[np.bool_]) -> bool:
    """Whether turning each of these beams by a hair (2 mm at 60 m) makes brute force agree with the caster."""
    rng = np.random.default_rng(0)
    origin, direction, times = (array[which] for array in rays_of(scan))
    got, agreed = scan.depth_m.ravel()[which], np.zeros(which.sum(), bool)
    for _ in range(200):
        hair = rng.normal(0.0, SILHOUETTE_M / 60.0, direction.shape)
        turned, _ = opaque_depth(snapshot, (origin, direction + hair, times), scan.model.max_range_m)
        agreed |= np.isclose(turned, got, rtol=1e-3, atol=0.1)
    return bool(agreed.all())


@pytest.mark.parametrize("view", [VIEWS[1], VIEWS[5]], ids=["still", "driving"])
def test_beams_stop_in_volumes_with_beers_law(view: View) -> None:
    """Share of beams that pass a volume of depth d is exp(-d per_m), and those that stop do so inside it."""
    world = _world(("leaves", "mesh", "hedge"), 24, 5)
    empty = World("ground", world.terrain).snapshot(0.0)
    ground, _ = opaque_depth(empty, rays_of(_cast(view, empty)), view.model.max_range_m)
    passed, expected, stops = 0.0, 0.0, 0
    for index in range(len(world.things)):
        alone = World("one", world.terrain, (world.things[index],)).snapshot(0.0)
        for seed in range(3):
            scan = _cast(view, alone, seed)
            near, far = (_cut(t) for t in solid_interval(alone, 0, *rays_of(scan)))
            crossed = (near > 0) & (far < ground) & (far < view.model.max_range_m)
            depth = scan.depth_m.ravel()
            stopped = crossed & (scan.thing.ravel() == 0)
            assert ((depth >= near - 1e-3) & (depth <= far + 1e-3))[stopped].all()
            chance = np.exp(-(far - near) * PER_M[alone.material[0]])[crossed]
            passed, expected, stops = passed + (~stopped)[crossed].sum(), expected + chance.sum(), stops + stopped.sum()
    assert stops > 500
    assert passed == pytest.approx(expected, rel=0.03)


def _cut(t: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.nan_to_num(t, nan=-1.0)


def test_incidence_by_hand() -> None:
    """45° down on level ground, and level on a wall turned by 30°."""
    fan = LidarModel("fan", np.deg2rad([-45.0, 0.0]), 8, azimuth_offset=np.full(2, np.pi / 8))
    wall = Thing("wall", (Box(0.0, 0.0, 0.5, 8.0, 5.0),), 10.0, 0.0, np.deg2rad(30.0))
    scan = cast_world(World("w", Terrain.plane(50.0), (wall,)).snapshot(0.0), fan, Rigid.from_yaw(0.0, (0, 0, 2.0)))
    front = int(np.argmax(scan.direction[:, 1, 0]))
    assert scan.cos_incidence[front, 0] == pytest.approx(np.sqrt(0.5), abs=1e-6)
    assert scan.cos_incidence[front, 1] == pytest.approx(np.cos(np.deg2rad(30.0)), abs=1e-6)
    assert scan.thing[front].tolist() == [-1, 0]


@pytest.mark.parametrize("kind", ["pit", "bridge", "slope_town", "garage", "tunnel"])
def test_beams_stop_where_brute_force_says_at_upright_ground_and_under_ceilings(kind: str) -> None:
    """Worlds with faces of some centimeters, decks and slabs: their solids that beams do not pass, and their ground."""
    model = LidarModel("few", np.deg2rad(np.linspace(-40.0, 40.0, 24)), 30, max_range_m=100.0)
    whole = WORLDS[kind](np.random.default_rng(6), AgentPlan(sensor_height_m=1.2))
    solid = {row for row, per_m in enumerate(PER_M) if np.isinf(per_m)}
    things = [
        replace(one, parts=tuple(part for part in one.parts if material_index(part.material) in solid))
        for one in whole.things
    ]
    world = replace(whole, things=tuple(things))
    snapshot = world.snapshot(3.0)
    for motion in (STILL, DRIVING):
        scan = cast_world(snapshot, model, world.world_from_sensor(world.agents[0], 3.0), motion)
        depth, _ = opaque_depth(snapshot, rays_of(scan), model.max_range_m)
        same = np.isclose(scan.depth_m.ravel(), depth, rtol=0.0, atol=TOLERANCE_M)
        assert same.mean() > 0.999
        assert same.all() or _all_graze(snapshot, scan, ~same)
