"""Where things and sensors are over time."""

import numpy as np
import pytest

from viewshed.geometry import Rigid
from viewshed_lab.sim.assets.shapes import BOX, CYLINDER, MATERIALS, Box, Cylinder, Ellipsoid, Material, material_index
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import Agent, AgentPlan, Thing, Track, World

RISE = Terrain.plane(100.0, (0.1, 0.0))
DRIVE = Track(np.array([0.0, 10.0]), np.array([[0.0, 5.0], [20.0, 5.0]]), np.array([0.0, 0.0]))
CAR = Thing("car", (Box(1.0, 0.5, 4.0, 2.0, 1.5, 0.5),), track=DRIVE, tilts=True)
POST = Thing("post", (Cylinder(0.0, 0.0, 0.1, 3.0, 0.0),), -10.0, 2.0, yaw=0.5)
ROOF = Agent("vehicle_0", "vlp16", Rigid(np.eye(3), np.array([0.0, 0.0, 2.0])), carrier=0)
MAST = Agent("roadside_0", "roadside", Rigid.from_yaw(1.0, (3.0, -4.0, 6.0)))
WORLD = World("slope", RISE, (CAR, POST), (ROOF, MAST))


def test_solids_stand_on_the_ground_where_their_thing_is() -> None:
    snapshot = WORLD.snapshot(5.0)
    assert snapshot.kind.tolist() == [BOX, CYLINDER]
    assert snapshot.thing.tolist() == [0, 1]
    assert snapshot.center_m[1] == pytest.approx([-10.0, 2.0, -1.0 + 1.5])
    assert snapshot.half_m[0].tolist() == [2.0, 1.0, 0.5]


def test_a_vehicle_moves_along_its_track_and_along_the_slope() -> None:
    """At 5 s it is at x = 10, 1 m up; its box sits 1 m ahead, 0.5 m left, 1 m above, all along the slope."""
    snapshot = WORLD.snapshot(5.0)
    along, up = np.array([1.0, 0.0, 0.1]) / np.sqrt(1.01), np.array([-0.1, 0.0, 1.0]) / np.sqrt(1.01)
    assert snapshot.center_m[0] == pytest.approx(np.array([10.0, 5.0, 1.0]) + along + [0.0, 0.5, 0.0] + up)
    assert snapshot.rotation[0] == pytest.approx(np.column_stack([along, [0.0, 1.0, 0.0], up]))
    assert snapshot.velocity_mps[0] == pytest.approx([2.0, 0.0, 0.2])
    assert snapshot.velocity_mps[1].tolist() == [0.0, 0.0, 0.0]


def test_sensors_ride_on_their_carrier_or_stay() -> None:
    up = np.array([-0.1, 0.0, 1.0]) / np.sqrt(1.01)
    assert WORLD.world_from_sensor(ROOF, 5.0).translation == pytest.approx(np.array([10.0, 5.0, 1.0]) + 2.0 * up)
    assert WORLD.world_from_sensor(MAST, 5.0).translation.tolist() == [3.0, -4.0, 6.0]


def test_a_turn_passes_the_full_circle() -> None:
    turn = Track(np.array([0.0, 2.0]), np.zeros((2, 2)), np.array([3.0, 3.6]))
    assert turn.at(1.0) == pytest.approx((0.0, 0.0, 3.3))


def test_materials_are_found_by_name_and_checked() -> None:
    assert MATERIALS[material_index("leaves")].per_m < np.inf
    with pytest.raises(ValueError, match="material must be one of asphalt"):
        material_index("velvet")
    with pytest.raises(ValueError, match="odd: reflectivity and gloss must lie in"):
        Material("odd", -0.1)
    with pytest.raises(ValueError, match="material must be one of"):
        Ellipsoid(0.0, 0.0, 1.0, 1.0, 1.0, 0.0, material="velvet")


@pytest.mark.parametrize(
    ("moving", "roadside", "duration", "message"),
    [
        (0, 0, 5.0, "a plan needs at least one agent"),
        (-1, 3, 5.0, "a plan needs at least one agent"),
        (1, 0, 0.0, "duration_s and sensor_height_m must be positive"),
    ],
)
def test_a_plan_without_sense_is_refused(moving: int, roadside: int, duration: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        AgentPlan(moving, roadside, duration_s=duration)


def test_a_track_must_go_forward_in_time() -> None:
    with pytest.raises(ValueError, match="ascending t_s"):
        Track(np.array([1.0, 1.0]), np.zeros((2, 2)), np.zeros(2))


def test_it_stands_still_before_and_after_its_track() -> None:
    assert WORLD.snapshot(-3.0).velocity_mps[0].tolist() == [0.0, 0.0, 0.0]
    assert WORLD.snapshot(50.0).center_m[0] == pytest.approx(WORLD.snapshot(60.0).center_m[0])
