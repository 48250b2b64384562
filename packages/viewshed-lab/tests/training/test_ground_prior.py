"""What the network of the ground is given, what its outputs stand for, and the ground that it learns from."""

import dataclasses

import numpy as np
import pytest
import torch

from viewshed.geometry import Rigid
from viewshed.grid import GRIDS
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sweep import Sweep
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.training.ground_prior import (
    CHANNELS,
    GroundNet,
    Modes,
    exact_ground,
    inputs_of,
    lattice_features,
    loss_of,
    on_ground,
)

GRID = GRIDS["road"]
RING_M = np.array([(r * np.cos(a), r * np.sin(a), -1.8) for r in range(4, 40, 2) for a in np.linspace(0, 6.28, 180)])


@pytest.fixture(scope="module")
def leveled() -> LeveledSweep:
    """Flat ground 1.8 m below the sensor."""
    return level(Sweep(RING_M.astype(np.float32)), GRID)


def with_points(leveled: LeveledSweep, points: list[tuple[float, float, float]]) -> LeveledSweep:
    return dataclasses.replace(leveled, points=np.array(points, np.float32))


def test_features_of_a_node_are_its_returns_and_the_lowest_beam_that_passes_over_it(leveled: LeveledSweep) -> None:
    assert leveled.sensor_height_m == pytest.approx(1.8, abs=0.01)
    points = [(10.2, 3.3, 0.5), (10.4, 3.6, 0.1), (10.7, 3.2, 2.0), (40.5, -0.5, 0.0), (40.5, -0.5, 1.0)]
    features = lattice_features(with_points(leveled, points))
    assert features.shape == (7, 128, 128)
    assert np.array_equal(features[5] > 0, leveled.ground.seen)
    assert np.array_equal(features[6], leveled.ground.heights_m)
    np.testing.assert_allclose(features[:4, 74, 67], [3.0, 0.5, 0.1, 2.0])
    np.testing.assert_allclose(features[:4, 104, 63], [2.0, 1.0, 0.0, 1.0])
    # The beam to z = 0 at 40.5 m passes over x = 20.5 m at half of its way; over nothing behind its end.
    assert features[4, 84, 63] == pytest.approx(1.8 * (1 - 20.5 / 40.5), abs=0.02)
    assert np.isinf(features[4, 103:, 63]).all()
    assert np.isinf(features[4, 84, 40])
    # A return alone is the second-lowest as well.
    alone = lattice_features(with_points(leveled, points[:1]))
    np.testing.assert_allclose(alone[:4, 74, 67], [1.0, 0.5, 0.5, 0.5])


def test_modes_are_a_distribution() -> None:
    outputs = torch.tensor([0.5, 0.3, -1.0, 0.2, 0.4]).reshape(1, 5, 1, 1)
    modes = Modes.of(outputs)
    assert float(modes.second_m) < float(modes.first_m) == 0.5
    heights = torch.linspace(-60.0, 60.0, 240_001, dtype=torch.float64)
    density = torch.exp(modes.log_likelihood(heights.reshape(-1, 1, 1))).reshape(-1).numpy()
    step = 120.0 / 240_000
    assert density.sum() * step == pytest.approx(1.0, abs=1e-4)
    mean = float((heights.numpy() * density).sum() * step)
    assert float(modes.std()) == pytest.approx(
        np.sqrt(((heights.numpy() - mean) ** 2 * density).sum() * step), rel=1e-3
    )
    for share in (0.1, 0.5, 0.9):
        below = density[heights.numpy() < float(modes.quantile(share))].sum() * step
        assert below == pytest.approx(share, abs=1e-3)


@pytest.mark.parametrize("nodes", [64, 128])
def test_the_network_answers_for_every_node_and_learns(leveled: LeveledSweep, nodes: int) -> None:
    torch.manual_seed(0)
    net = GroundNet(4, (8, 12, 16, 16))
    features = torch.tensor(lattice_features(leveled))[None, :, :nodes, :nodes]
    half_m = torch.tensor([nodes / 2])
    inputs = inputs_of(features, torch.tensor([1.8]), half_m)
    assert inputs.shape == (1, CHANNELS, nodes, nodes)
    assert torch.isfinite(inputs).all()
    ground = torch.full((1, nodes, nodes), 0.7)
    ground[:, : nodes // 2] = torch.nan  # not known: counts for nothing
    optimizer = torch.optim.Adam(net.parameters(), 1e-2)
    losses = []
    for _ in range(12):
        loss = loss_of(net(inputs), ground, half_m)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert np.isfinite(losses).all()
    assert losses[-1] < losses[0] - 0.3
    assert net(inputs).shape == (1, 5, nodes, nodes)


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
