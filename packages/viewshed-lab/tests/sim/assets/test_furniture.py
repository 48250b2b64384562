"""Furniture: legs that beams pass between, groups that fit together, footprints computed by hand."""

from itertools import combinations

import numpy as np
import pytest
import shapely
import shapely.affinity

from viewshed import LidarModel
from viewshed.geometry import Rigid
from viewshed_lab.sim.assets import furniture
from viewshed_lab.sim.assets import furniture as fittings
from viewshed_lab.sim.assets import warehouse as stock
from viewshed_lab.sim.assets.furniture import Group, Maker, bounds, footprint, place_group
from viewshed_lab.sim.assets.shapes import MATERIALS, Box, Shape
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


@pytest.mark.parametrize("maker", MAKERS, ids=lambda maker: maker.__name__)
def test_things_of_a_group_are_not_in_each_other(maker: Maker) -> None:
    for seed in range(6):
        group = maker(np.random.default_rng(seed))
        solids = [(k, _outline(one, part), part) for k, one in enumerate(group) for part in one.parts]
        for (i, a, part_a), (j, b, part_b) in combinations(solids, 2):
            deep = min(part_a.top_m, part_b.top_m) - max(part_a.bottom_m, part_b.bottom_m)
            if i != j and deep > 0.02 and {group[i].kind, group[j].kind} != {"chair", "pedestrian"}:
                assert a.intersection(b).area < 0.004, (group[i].kind, group[j].kind, seed)


def _outline(one: Thing, part: Shape) -> shapely.Polygon:
    a, b, _ = part.half_sizes_m
    if isinstance(part, Box):
        local = shapely.box(-a, -b, a, b)
    else:
        local = shapely.affinity.scale(shapely.Point(0, 0).buffer(1.0), a, b)
    turned = shapely.affinity.rotate(local, part.yaw, origin=(0, 0), use_radians=True)
    there = shapely.affinity.translate(turned, part.x_m, part.y_m)
    heading = shapely.affinity.rotate(there, one.yaw, origin=(0, 0), use_radians=True)
    return shapely.Polygon(shapely.affinity.translate(heading, one.x_m, one.y_m))


def test_a_beam_passes_under_a_table_and_stops_at_its_top() -> None:
    under, edge, over = depth_along_x(furniture.table(np.random.default_rng(0)), [0.4, 0.72, 0.8])
    assert under == np.inf
    assert 4.4 < edge < 4.7
    assert over == np.inf


def test_the_front_of_a_shelf_is_open_and_its_back_is_not() -> None:
    group = furniture.shelf(np.random.default_rng(1))
    low, _, high, _ = footprint(group)
    between = 0.5 * (0.5 * group[0].parts[0].top_m + group[0].parts[0].top_m) + 0.2
    behind = depth_along_x(group, [between])[0]
    before = depth_along_x(place_group(group, 0.0, 0.0, np.pi), [between])[0]
    assert behind == pytest.approx(5.0 + low, abs=1e-3)
    assert before > 5.0 - high + 0.25


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


def test_a_pillar_reaches_the_ceiling() -> None:
    for seed in range(4):
        rows = bounds(fittings.pillar(np.random.default_rng(seed), 6.5, 0.5))
        assert rows[0] == pytest.approx([-0.25, -0.25, 0.25, 0.25, -1.0, 6.5])


def test_mirrors_and_screens_give_no_return() -> None:
    reflectivity = {one.name: one.reflectivity for one in MATERIALS}
    mirror = fittings.mirror(np.random.default_rng(0))[0]
    assert [reflectivity[part.material] for part in mirror.parts] == [0.0]


def test_goods_lie_on_the_beams_of_their_rack() -> None:
    for seed in range(4):
        frame, goods = stock.rack(np.random.default_rng(seed), 4, 2)
        beams = {round(part.top_m, 3) for part in frame.parts if isinstance(part, Box) and part.width_m > 5.0}
        assert len(beams) == 2
        assert footprint((frame,))[3] - footprint((frame,))[1] == pytest.approx(4 * 2.9 + 0.09)
        for part in goods.parts:
            assert part.bottom_m < 0.2 or any(abs(part.bottom_m - top) < 0.01 for top in beams)


def test_stairs_climb_to_the_gallery_by_steps_of_a_foot() -> None:
    rows = bounds(stock.stairs(np.random.default_rng(0), 3.1))
    order = rows[np.argsort(rows[:, 1])]
    assert order[-1, 5] == pytest.approx(3.1)
    assert np.diff(order[:, 5]) == pytest.approx(np.full(len(rows) - 1, 3.1 / len(rows)))
    assert 0.15 < order[0, 5] < 0.22
