"""Wedges that are aimed: by what the sweep shows, and so that they open more than wedges at random."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from tests.threats.attacks.conftest import FlatScene
from tests.threats.attacks.drawn import broken, generator
from tests.threats.attacks.oracle import Scene

from viewshed import ESTIMATORS, BevGrid
from viewshed_lab.threats.attacks import ATTACKS, BlackBox, Knowledge, OverClaim, Spoofer
from viewshed_lab.threats.attacks.ghosts import FarWall
from viewshed_lab.threats.attacks.wedge_attack import (
    BINS,
    HiddenGround,
    azimuth_of_bin,
    hidden_ground_of,
    placed_azimuth,
)

AIMED = ("behind_nearest_obstacle", "largest_hidden_area")
SURE = Spoofer(1.0, 0.0, 0.0)


def _attack(name: str, scene: Scene, **changes: Any) -> Any:
    attack: Any = ATTACKS[name](None, Knowledge((scene.earlier,), half_extent_m=scene.half_extent_m))
    return replace(attack, **changes)


WEDGES = [
    name for name, make in ATTACKS.items()
    if name != "replay" and "placement" in {field.name for field in fields(make())}  # type: ignore[arg-type]
]  # fmt: skip


def test_the_attacks_on_wedges_have_a_placement() -> None:
    assert {"far_wall", "removal", "high_frequency_removal", "relay", "jamming", "removal_and_far_wall"} <= set(WEDGES)
    aimed = {name for name in WEDGES if name.endswith("_aimed")}
    assert aimed == {"far_wall_aimed", "removal_aimed", "removal_and_far_wall_aimed"}
    for name in aimed:
        attack: Any = ATTACKS[name](150)
        assert replace(attack, placement="random") == ATTACKS[name.removesuffix("_aimed")](150)


@pytest.mark.parametrize("placement", AIMED)
@pytest.mark.parametrize("name", WEDGES)
def test_an_aimed_attack_keeps_the_rules_of_the_beams(name: str, placement: str, simulated: list[Scene]) -> None:
    for number in (0, 3):
        scene = simulated[number]
        attack = _attack(name, scene, placement=placement, budget=200)
        assert broken(name, scene, attack, 200, number)[0] == []


def test_one_van_by_hand(flat_scene: FlatScene) -> None:
    """A van 8 m ahead, from 1 m to 3 m on the left, 2.5 m high: all ground behind it is hidden."""
    van = flat_scene(8.0, wall_y_m=(1.0, 3.0))
    near, far = np.arctan2(1.0, 8.0), np.arctan2(3.0, 8.0)
    hidden = hidden_ground_of(van, 25.0, 50.0)
    # The integral of (50² - (8 / cos a)²) / 2 over the azimuths of the van.
    by_hand = 0.5 * 50.0**2 * (far - near) - 32.0 * (np.tan(far) - np.tan(near))
    assert hidden.area_m2.sum() == pytest.approx(by_hand, rel=0.06)
    assert hidden.nearest_m.min() == pytest.approx(8.0 / np.cos(near), rel=0.01)
    middle = azimuth_of_bin(np.arange(BINS))
    assert (hidden.area_m2[(middle < near - 0.02) | (middle > far + 0.02)] == 0).all()
    # A wedge of 30° holds all of the van; it is centered on the van in either way.
    for placement in AIMED:
        wedge = FarWall(placement=placement, spoofer=SURE).apply(van, generator(0)).wedge  # type: ignore[arg-type]
        assert wedge.holds(np.array([near, far])).all()
    # Out of the attacker's reach, or too far to be removed, nothing can be opened: the wedge is left to chance.
    assert placed_azimuth("largest_hidden_area", van, 30.0, None, 5.0, 50.0) is None
    assert placed_azimuth("largest_hidden_area", van, 30.0, None, 25.0, 7.0) is None


def test_of_two_obstacles_the_nearest_and_the_one_that_hides_most() -> None:
    """Bins drawn by hand: a post at 5 m that hides little, a wall at 12 m that hides much and takes many beams."""
    area_m2, nearest_m, beams = np.zeros(BINS), np.full(BINS, np.inf), np.zeros(BINS, np.int64)
    area_m2[40:43], nearest_m[40:43], beams[40:43] = (3.0, 5.0, 4.0), 5.0, 10
    area_m2[200:240], nearest_m[200:240], beams[200:240] = 20.0, 12.0, 50
    hidden = HiddenGround(area_m2, nearest_m, beams)
    assert hidden.behind_nearest() == 41
    opened = hidden.opened_m2(11.0)
    assert opened.max() == 11 * 20.0
    assert set(np.flatnonzero(opened == opened.max())) == set(range(205, 235))
    # 30 beams open the post; of the wall they open 30 of the 50 beams of one bin.
    few = hidden.opened_m2(11.0, 30)
    assert few[41] == 12.0
    assert few[220] == 12.0
    assert hidden.opened_m2(360.0).tolist() == [pytest.approx(812.0)] * BINS


@pytest.mark.parametrize("placement", AIMED)
def test_attackers_who_adapt_are_aimed_as_a_far_wall(placement: Any, flat_scene: FlatScene) -> None:
    van = flat_scene(8.0, wall_y_m=(1.0, 3.0))
    expected = FarWall(150, placement=placement).aim(van, generator(0))
    victim = ESTIMATORS["first_blocker"](BevGrid(32, 32.0))
    attack = BlackBox(OverClaim(victim), queries=3, placement=placement)
    assert attack.apply(van, generator(1)).wedge == expected
