"""What the network of the ground is given, what its outputs stand for, and the ground that it learns from."""

import dataclasses

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.grid import GRIDS
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sweep import Sweep
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.training.ground_prior import (
    CHANNELS,
    PROBABILITIES,
    UNIT_M,
    GroundNet,
    exact_ground,
    guessed,
    loss_of,
    network_inputs,
    on_ground,
    quantiles_of,
)

GRID = GRIDS["road"]
RING_M = np.array([(r * np.cos(a), r * np.sin(a), -1.8) for r in range(4, 40, 2) for a in np.linspace(0, 6.28, 180)])


@pytest.fixture(scope="module")
def leveled() -> LeveledSweep:
    """Flat ground 1.8 m below the sensor."""
    return level(Sweep(RING_M.astype(np.float32)), GRID)


def with_points(leveled: LeveledSweep, points: list[tuple[float, float, float]]) -> LeveledSweep:
    xyz = np.array(points, np.float32)
    azimuth, range_m = np.arctan2(xyz[:, 1], xyz[:, 0]), np.hypot(xyz[:, 0], xyz[:, 1])
    return dataclasses.replace(leveled, points=xyz, azimuth=azimuth, range_m=range_m)


def test_inputs_of_a_node_are_its_returns_and_the_lowest_beam_that_passes_over_it(leveled: LeveledSweep) -> None:
    assert leveled.sensor_height_m == pytest.approx(1.8, abs=0.01)
    points = [(10.2, 3.3, 0.5), (10.4, 3.6, 0.1), (10.7, 3.2, 2.0), (40.5, -0.5, 0.0), (40.5, -0.5, 1.0)]
    maps = network_inputs(with_points(leveled, points))
    assert maps.shape == (CHANNELS, 128, 128)
    np.testing.assert_allclose(maps[:5, 74, 67], [1.0, 0.5, 0.1, 2.0, np.log(4.0) / 3], atol=0.02)
    np.testing.assert_allclose(maps[:5, 104, 63], [1.0, 1.0, 0.0, 1.0, np.log(3.0) / 3], atol=0.02)
    assert not maps[:5, 20, 20].any()
    # The beam to z = 0 at 40.5 m passes over x = 20.5 m at half of its way; over nothing behind its end.
    assert maps[5, 84, 63] == pytest.approx(1.8 * (1 - 20.5 / 40.5), abs=0.03)
    assert maps[6, 84, 63] == 1.0
    assert not maps[6, 103:, 63].any()
    assert maps[6, 84, 40] == 0.0
    assert np.array_equal(maps[7] > 0, leveled.ground.seen)
    np.testing.assert_allclose(maps[9:12, 84, 63], [20.5 / 64, 0.9, 1.0], atol=0.01)
    np.testing.assert_allclose(maps[12], leveled.ground.std_m)
    # A return alone is the second-lowest as well.
    alone = network_inputs(with_points(leveled, points[:1]))
    np.testing.assert_allclose(alone[1:4, 74, 67], 0.5, atol=0.02)


def test_the_guess_is_below_beams_and_as_found_where_returns_show_the_ground(leveled: LeveledSweep) -> None:
    torch.manual_seed(1)
    net = GroundNet((8, 12, 16, 16)).eval()
    final = net.unfold[0]
    assert isinstance(final, torch.nn.Conv2d)
    assert final.bias is not None
    torch.nn.init.normal_(final.weight, std=3.0)
    torch.nn.init.constant_(final.bias, 1.5)
    maps, seen = network_inputs(leveled), leveled.ground.seen
    with torch.no_grad():
        below, median, above = net(torch.tensor(maps)[None])[0].double().clamp(-4, 4).numpy()
    low_m, median_m, high_m = (
        0.3 * np.sinh(u) for u in (median - np.log1p(np.exp(below)), median, median + np.log1p(np.exp(above)))
    )
    ground = guessed(leveled, net).ground
    over_m = maps[5] + 0.1
    passed = (maps[6] > 0) & ~seen
    assert (median_m > over_m)[passed].any()
    free = ~seen & ~passed
    above_m = ground.heights_m - leveled.ground.heights_m
    np.testing.assert_allclose(above_m[free], median_m[free], atol=1e-4)
    np.testing.assert_allclose(above_m[passed], np.minimum(median_m, over_m)[passed], atol=1e-4)
    np.testing.assert_allclose(ground.std_m[~seen], ((high_m - low_m) / 2.0728)[~seen], rtol=1e-3)
    np.testing.assert_array_equal(ground.heights_m[seen], leveled.ground.heights_m[seen])
    np.testing.assert_array_equal(ground.std_m[seen], leveled.ground.std_m[seen])


def test_the_loss_is_least_at_the_quantiles() -> None:
    rng = np.random.default_rng(0)
    ground_m = torch.tensor(rng.exponential(1.0, (1, 64, 64)).astype(np.float32))
    inputs, half_m = torch.ones(1, CHANNELS, 64, 64), torch.tensor([0.0])
    exact = np.arcsinh(np.quantile(ground_m.numpy(), PROBABILITIES) / UNIT_M)

    def loss_at(quantiles: NDArray[np.float64]) -> float:
        gaps = np.log(np.expm1(np.diff(quantiles)))  # the inverse of softplus
        outputs = torch.tensor([gaps[0], quantiles[1], gaps[1]]).reshape(1, 3, 1, 1).expand(1, 3, 64, 64)
        np.testing.assert_allclose([float(q[0, 0, 0]) for q in quantiles_of(outputs)], quantiles, atol=1e-6)
        return float(loss_of(outputs, inputs, ground_m, half_m))

    least = loss_at(exact)
    for shift in np.concatenate([0.1 * np.eye(3), -0.1 * np.eye(3)]):
        assert loss_at(exact + shift) > least + 1e-4


@pytest.mark.parametrize("nodes", [64, 128])
def test_the_network_answers_for_every_node_and_learns(leveled: LeveledSweep, nodes: int) -> None:
    torch.manual_seed(0)
    net = GroundNet((8, 12, 16, 16))
    half_m = torch.tensor([nodes / 2])
    inputs = torch.tensor(network_inputs(leveled))[None, :, :nodes, :nodes]
    assert inputs.shape == (1, CHANNELS, nodes, nodes)
    assert torch.isfinite(inputs).all()
    ground = torch.full((1, nodes, nodes), 0.7)
    ground[:, : nodes // 2] = torch.nan  # not known: counts for nothing
    optimizer = torch.optim.Adam(net.parameters(), 1e-2)
    losses = []
    for _ in range(12):
        loss = loss_of(net(inputs), inputs, ground, half_m)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert np.isfinite(losses).all()
    assert losses[-1] < 0.7 * losses[0]
    assert net(inputs).shape == (1, 3, nodes, nodes)


def test_the_exact_ground_is_that_of_the_frame_that_was_estimated(leveled: LeveledSweep) -> None:
    """On a slope of 10 % across, a sensor that stands upright on it sees level ground."""
    terrain = Terrain.plane(200.0, (0.0, 0.1))
    tilt = np.arctan(0.1)
    turn = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    pose = Rigid(turn, 1.8 * turn[:, 2])
    ground_m, known = exact_ground(leveled, pose, terrain)
    assert known.all()
    np.testing.assert_allclose(ground_m, 0.0, atol=0.02)
    upright, _ = exact_ground(leveled, Rigid(np.eye(3), np.array([0.0, 0.0, 1.8])), terrain)
    np.testing.assert_allclose(upright[:, 10], 0.1 * (10.5 - 64.0), atol=0.02)


def test_heights_of_points_follow_the_ground_that_is_given(leveled: LeveledSweep) -> None:
    raised = on_ground(leveled, np.full((128, 128), 0.4), np.zeros((128, 128)))
    np.testing.assert_allclose(raised.height_m, leveled.points[:, 2] - 0.4, atol=1e-6)
    assert raised.ground.seen.shape == (128, 128)
