"""Furniture: legs that beams pass between, groups that fit together, footprints computed by hand."""

import numpy as np
import pytest

from viewshed import LidarModel
from viewshed.geometry import Rigid
from viewshed_lab.sim.assets import furniture
from viewshed_lab.sim.assets import furniture as fittings
from viewshed_lab.sim.assets import warehouse as stock
from viewshed_lab.sim.assets.furniture import Group, Maker, bounds, footprint, place_group
from viewshed_lab.sim.assets.shapes import Box
from viewshed_lab.sim.raycast.caster import cast_world
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import Thing, World

MAKERS: tuple[Maker, ...] = (
    furniture.table, furniture.low_table, furniture.chair, furniture.office_chair, furniture.desk, furniture.monitor,
    furniture.dining, furniture.meeting, furniture.shelf, furniture.cabinet, furniture.sofa, furniture.bed,
    furniture.counter, furniture.bath, furniture.basin, furniture.toilet, furniture.plant, furniture.bin_,
    furniture.boxes, fittings.whiteboard, fittings.mirror, fittings.radiator, fittings.extinguisher, fittings.locker,
    fittings.bench, fittings.standing, fittings.sitting, fittings.talking, stock.pallet, stock.stack, stock.forklift,
    stock.cart, stock.cage, stock.bollard, stock.conveyor, stock.seats, stock.double_seats, stock.stall,
    stock.reception, stock.totem, stock.queue, stock.planter, stock.bistro, stock.trailer,
)  # fmt: skip


def depth_along_x(group: Group, heights_m: list[float], y_m: float = 0.0) -> list[float]:
    """Depth of level beams that start 5 m before a group."""
    world = World("test", Terrain.plane(40.0), group)
    model = LidarModel("level", np.array([0.0]), azimuth_columns=4, azimuth_offset=np.array([np.pi / 4]))
    starts = [Rigid(np.eye(3), np.array([-5.0, y_m, z])) for z in heights_m]
    forward = int(np.argmin(np.abs(-np.pi + (np.arange(4) + 0.5) * np.pi / 2 + np.pi / 4)))
    return [float(cast_world(world.snapshot(0.0), model, pose).depth_m[forward, 0]) for pose in starts]


@pytest.mark.parametrize("maker", MAKERS, ids=lambda maker: maker.__name__)
def test_things_stand_on_the_floor_and_fit_through_a_gate(maker: Maker) -> None:
    for seed in range(5):
        rows = bounds(maker(np.random.default_rng(seed)))
        assert rows[:, 4].min() >= -0.2
        assert 0.1 < rows[:, 5].max() < 4.0
        assert max(np.ptp(rows[:, [0, 2]]), np.ptp(rows[:, [1, 3]])) < 8.5


def test_a_beam_passes_under_a_table_and_stops_at_its_top() -> None:
    under, edge, over = depth_along_x(furniture.table(np.random.default_rng(0)), [0.4, 0.72, 0.8])
    assert under == np.inf
    assert 4.4 < edge < 4.7
    assert over == np.inf


def test_a_group_turns_about_its_origin() -> None:
    parts = (Box(1.0, 0.0, 2.0, 0.5, 1.0),)
    assert footprint(place_group((Thing("plank", parts),), 10.0, 20.0, np.pi / 2)) == pytest.approx(
        (9.75, 20.0, 10.25, 22.0)
    )
    askew = footprint((Thing("plank", (Box(0.0, 0.0, 2.0, 1.0, 1.0, yaw=np.pi / 6),)),))
    half_x = np.cos(np.pi / 6) + 0.5 * np.sin(np.pi / 6)
    half_y = np.sin(np.pi / 6) + 0.5 * np.cos(np.pi / 6)
    assert askew == pytest.approx((-half_x, -half_y, half_x, half_y))


def test_a_door_swings_counter_clockwise_about_its_hinge() -> None:
    corners = footprint(fittings.door(0.9, np.pi / 2))
    assert corners == pytest.approx((-0.02, 0.0, 0.02, 0.9))
