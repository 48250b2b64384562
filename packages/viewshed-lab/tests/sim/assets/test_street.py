"""Makers of things: sizes that a tape measure would give, materials, what lies low and what hangs."""

from collections.abc import Callable

import numpy as np
import pytest

from viewshed_lab.sim.assets.street import (
    extent,
    footprint,
    person,
    place_at,
    wall,
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


@pytest.mark.parametrize("high", [0.5, 1.0, 1.4, 1.73, 1.84, 2.2])
def test_a_sensor_stands_free_above_its_car(high: float) -> None:
    for seed in range(10):
        thing, ahead = sensor_car(np.random.default_rng(seed), high)
        assert -0.36 < ahead <= 0.0
        assert top(thing) <= high - 0.09
        assert thing.kind == ("robot" if high < 1.35 else "car")


def test_a_footprint_is_turned_and_moved() -> None:
    corners = footprint(place_at(wall(4.0, 1.0, thick_m=1.0), 10.0, 5.0, np.pi / 2))
    assert corners == pytest.approx(np.array([[10.5, 3.0], [10.5, 7.0], [9.5, 7.0], [9.5, 3.0]]))
