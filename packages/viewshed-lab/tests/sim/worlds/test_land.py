"""Land at random: it is as varied as it must be, whoever drives has room, and sweeps of it make sense."""

import numpy as np
import pytest
from tests.sim.worlds.test_every_world import in_the_way, made

from viewshed_lab.sim.worlds.land import Land, Noise

SEEDS = range(40)


def test_noise_goes_through_its_values_and_is_as_steep_as_its_octaves() -> None:
    noise = Noise((56.0,), (np.arange(36.0).reshape(6, 6),))
    nodes = np.arange(5) * 56.0 - 112.0
    x, y = np.meshgrid(nodes[:4], nodes[:4], indexing="ij")
    np.testing.assert_allclose(noise.at(x, y), np.arange(36.0).reshape(6, 6)[:4, :4])
    assert noise.at(np.array(-84.0), np.array(-112.0)) == pytest.approx(3.0)  # halfway from 0 to 6


def test_a_road_lies_above_below_and_level_with_the_land_and_some_land_drops_steeply() -> None:
    rises, steps, kinds, reliefs = [], [], set[str](), []
    for seed in SEEDS:
        land = Land.drawn(np.random.default_rng(seed))
        rises.append(land.rise_m)
        steps += [drop.deep_m for drop in land.drops]
        world = made("land", seed)
        kinds |= {thing.kind for thing in world.things}
        reliefs.append(np.ptp(world.terrain.heights_m))
    assert min(rises) < -2.0
    assert max(rises) > 2.0
    assert 0.0 in rises
    assert min(steps) < -3.0  # a platform
    assert max(steps) > 3.0  # a pit
    assert {"deck", "roof", "stairs", "wall"} <= kinds
    assert min(reliefs) < 2.0
    assert max(reliefs) > 20.0


def test_the_way_of_a_vehicle_is_free() -> None:
    for seed in SEEDS:
        assert list(in_the_way(made("land", seed), np.linspace(0.0, 10.0, 11))) == [], seed
