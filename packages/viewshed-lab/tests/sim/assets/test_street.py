"""Makers of things: sizes that a tape measure would give, materials, what lies low and what hangs."""

from collections.abc import Callable

import numpy as np
import pytest

from viewshed_lab.sim.assets.shapes import MATERIALS, material_index
from viewshed_lab.sim.assets.street import (
    bench,
    bin_,
    bus_shelter,
    bush,
    cabinet,
    concrete_barrier,
    cone,
    conifer,
    extent,
    fence,
    footprint,
    gantry,
    group,
    guard_rail,
    hedge,
    lamp_post,
    person,
    place_at,
    pole,
    sign,
    sound_wall,
    traffic_light,
    tree,
    wall,
    work_barrier,
)
from viewshed_lab.sim.assets.vehicles import bus, car, cyclist, motorcycle, semi_truck, sensor_car, truck, van
from viewshed_lab.sim.world import Thing

Maker = Callable[[np.random.Generator], Thing]
SIZES: list[tuple[Maker, tuple[float, float], tuple[float, float], tuple[float, float]]] = [
    (car, (3.5, 5.4), (1.6, 2.05), (1.35, 1.9)),
    (van, (4.8, 6.3), (1.85, 2.1), (1.9, 2.75)),
    (truck, (6.9, 10.1), (2.3, 2.55), (3.0, 4.0)),
    (semi_truck, (13.9, 16.6), (2.3, 2.55), (3.6, 4.05)),
    (bus, (9.9, 12.6), (2.4, 2.55), (2.9, 3.25)),
    (cyclist, (1.5, 2.0), (0.4, 0.7), (1.5, 1.95)),
    (motorcycle, (1.9, 2.3), (0.6, 0.9), (1.4, 1.7)),
    (person, (0.15, 0.5), (0.2, 0.65), (1.05, 2.0)),
    (lambda rng: person(rng, True), (0.2, 0.9), (0.2, 0.65), (1.05, 2.0)),
    (lambda rng: bench(), (1.7, 1.9), (0.4, 0.6), (0.8, 0.95)),
    (lambda rng: bus_shelter(), (3.4, 4.0), (1.2, 1.6), (2.3, 2.6)),
    (bin_, (0.35, 0.75), (0.35, 0.7), (0.7, 1.15)),
    (cabinet, (0.5, 1.5), (0.35, 0.45), (0.85, 1.45)),
    (lambda rng: guard_rail(12.0), (12.0, 12.2), (0.1, 0.2), (0.7, 0.8)),
    (lambda rng: concrete_barrier(6.0), (6.0, 6.1), (0.5, 0.7), (0.8, 0.9)),
    (lambda rng: sound_wall(8.0, 4.0), (8.0, 8.5), (0.1, 0.5), (3.9, 4.2)),
    (lambda rng: fence(7.0, 1.5), (7.0, 7.1), (0.03, 0.1), (1.45, 1.6)),
    (lambda rng: wall(5.0, 1.1), (4.9, 5.1), (0.2, 0.3), (1.0, 1.2)),
    (lambda rng: work_barrier(), (1.9, 2.1), (0.4, 0.6), (0.95, 1.1)),
    (lambda rng: cone(), (0.3, 0.4), (0.3, 0.4), (0.7, 0.8)),
    (lambda rng: hedge(rng, 9.0, 1.5), (8.9, 9.1), (0.6, 0.8), (1.3, 1.6)),
    (lambda rng: bush(rng, 1.4), (0.7, 1.5), (0.7, 1.5), (0.7, 1.6)),
    (lambda rng: pole(3.0), (0.1, 0.2), (0.1, 0.2), (2.9, 3.1)),
]


def top(thing: Thing) -> float:
    return max(part.top_m for part in thing.parts)


@pytest.mark.parametrize(("maker", "length", "width", "height"), SIZES)
def test_sizes_are_those_of_the_real_thing(
    maker: Maker, length: tuple[float, float], width: tuple[float, float], height: tuple[float, float]
) -> None:
    for seed in range(30):
        thing = maker(np.random.default_rng(seed))
        rear, front, right, left = extent(thing)
        assert length[0] <= front - rear <= length[1]
        assert width[0] <= left - right <= width[1]
        assert height[0] <= top(thing) <= height[1]


@pytest.mark.parametrize("maker", [car, van, truck, semi_truck, bus])
def test_beams_pass_below_vehicles_between_wheels_that_touch_the_ground(maker: Maker) -> None:
    thing = maker(np.random.default_rng(3))
    low = [part for part in thing.parts if part.bottom_m < 0.15]
    assert {part.material for part in low} == {"rubber"}
    assert all(part.bottom_m == 0.0 for part in low)
    assert thing.tilts


def test_about_one_car_in_twenty_returns_no_light_and_some_are_dark() -> None:
    rng = np.random.default_rng(1)
    paints = [car(rng).parts[0].material for _ in range(1500)]
    assert 0.03 < paints.count("absorber") / 1500 < 0.08
    assert 0.15 < paints.count("dark_paint") / 1500 < 0.3


@pytest.mark.parametrize("high", [0.5, 1.0, 1.4, 1.73, 1.84, 2.2])
def test_a_sensor_stands_free_above_its_car(high: float) -> None:
    for seed in range(10):
        thing, ahead = sensor_car(np.random.default_rng(seed), high)
        assert -0.36 < ahead <= 0.0
        assert top(thing) <= high - 0.09
        assert thing.kind == ("robot" if high < 1.35 else "car")


def test_crowns_hang_and_may_be_passed_while_trunks_stand() -> None:
    for maker in (lambda rng: tree(rng, 2.3, 5.0), conifer):
        thing = maker(np.random.default_rng(4))
        trunk, *crown = thing.parts
        assert trunk.material == "bark"
        assert {part.material for part in crown} == {"leaves"}
        assert np.isfinite(MATERIALS[material_index("leaves")].per_m)
    broad = tree(np.random.default_rng(5), 2.3, 5.0)
    assert min(part.bottom_m for part in broad.parts[1:]) >= 2.3
    assert max(abs(edge) for edge in extent(broad, below_m=20.0)) < 2.6


def test_signs_face_against_the_heading_and_lamps_reach_ahead() -> None:
    rng = np.random.default_rng(2)
    plate = sign(rng).parts[1]
    assert plate.material == "sign"
    assert plate.x_m < 0.0
    assert extent(lamp_post(rng, 2.0), below_m=20.0)[1] == pytest.approx(2.0)
    assert extent(traffic_light(rng, 4.5), below_m=20.0)[1] > 4.0
    assert extent(gantry(rng, 15.0))[2:] == pytest.approx((-0.2, 15.2))


def test_a_group_faces_its_middle() -> None:
    for one in group(np.random.default_rng(6), 10.0, -4.0):
        x, y, yaw = one.pose_at(0.0)
        toward = np.array([10.0 - x, -4.0 - y])
        assert 0.5 < np.hypot(*toward) < 0.7
        assert toward @ (np.cos(yaw), np.sin(yaw)) > 0.5


def test_a_footprint_is_turned_and_moved() -> None:
    corners = footprint(place_at(wall(4.0, 1.0, thick_m=1.0), 10.0, 5.0, np.pi / 2))
    assert corners == pytest.approx(np.array([[10.5, 3.0], [10.5, 7.0], [9.5, 7.0], [9.5, 3.0]]))
