"""What the network of the ground is given, what its outputs stand for, and the ground that it learns from."""

import dataclasses

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from viewshed import _core
from viewshed.geometry import Rigid
from viewshed.grid import GRIDS
from viewshed.networks.runtime import values_of
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sweep import Sweep
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.training.ground_prior import (
    BASE,
    BASE_UNIT_M,
    CHANNELS,
    FOLD,
    GroundNet,
    Modes,
    exact_ground,
    exported,
    guessed,
    loss_of,
    network_inputs,
    on_ground,
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


def unfolded(inputs: NDArray[np.float32]) -> NDArray[np.float32]:
    return torch.pixel_shuffle(torch.tensor(inputs), FOLD)[0].numpy()


def test_inputs_of_a_node_are_its_returns_and_the_lowest_beam_that_passes_over_it(leveled: LeveledSweep) -> None:
    assert leveled.sensor_height_m == pytest.approx(1.8, abs=0.01)
    points = [(10.2, 3.3, 0.5), (10.4, 3.6, 0.1), (10.7, 3.2, 2.0), (40.5, -0.5, 0.0), (40.5, -0.5, 1.0)]
    maps = unfolded(network_inputs(with_points(leveled, points)))
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
    np.testing.assert_allclose(maps[9:, 84, 63], [20.5 / 64, 0.9, 1.0], atol=0.01)
    # A return alone is the second-lowest as well.
    alone = unfolded(network_inputs(with_points(leveled, points[:1])))
    np.testing.assert_allclose(alone[1:4, 74, 67], 0.5, atol=0.02)


def test_the_base_goes_on_with_the_slope_of_what_is_seen_and_levels_off() -> None:
    """Seen on rings of 4 to 30 m to one side: a slope along x and y, with a mound of one meter to the left."""
    middles = np.arange(128) - 63.5
    x_m, y_m = np.meshgrid(middles, middles, indexing="ij")
    range_m, plane_m = np.hypot(x_m, y_m), 0.05 * x_m - 0.03 * y_m
    seen = (np.sin(range_m) > 0.4) & (range_m > 4) & (range_m < 30) & (x_m + 0.5 * y_m > -8.0)
    heights_m = (plane_m + np.exp(-(x_m**2 + (y_m - 20.0) ** 2) / 50.0)).astype(np.float32)
    none = np.zeros(0, np.float32)
    folded = _core.guess_inputs(np.zeros((0, 3), np.float32), none, none, heights_m, seen, 64.0, 1.8)
    base_m = BASE_UNIT_M * unfolded(folded)[BASE]
    np.testing.assert_allclose(base_m[seen], heights_m[seen], atol=1e-5)
    beyond = (range_m > 5) & (range_m < 58) & (y_m < -5.0)
    assert np.abs(base_m - plane_m)[beyond].max() < 0.15
    # The slope fades beyond 60 m: at the corner 90 m away a part of the way is left out.
    assert base_m[127, 0] < 0.93 * plane_m[127, 0]


def test_what_runs_without_torch_gives_the_quantiles_of_the_modes(leveled: LeveledSweep) -> None:
    torch.manual_seed(1)
    net = GroundNet(FOLD, (8, 12, 16, 16)).eval()
    final = net.unfold[0]
    assert isinstance(final, torch.nn.Conv2d)
    torch.nn.init.normal_(final.weight, std=0.5)
    for norm in (module for module in net.modules() if isinstance(module, torch.nn.BatchNorm2d)):
        torch.nn.init.uniform_(norm.running_mean, -0.3, 0.3)
        torch.nn.init.uniform_(norm.running_var, 0.5, 2.0)
    maps = torch.tensor(unfolded(network_inputs(leveled)))[None]
    with torch.no_grad():
        modes = Modes.of(net(maps))
    low_m, median_m, high_m = (modes.quantile(share)[0].numpy() for share in (0.16, 0.5, 0.84))
    assert median_m.std() > 0.2
    ground, seen = guessed(leveled, values_of(exported(net))).ground, leveled.ground.seen
    base_m, over_m = BASE_UNIT_M * maps[0, BASE].numpy(), maps[0, 5].numpy() + 0.1
    passed = (maps[0, 6].numpy() > 0) & ~seen
    expected = base_m + np.where(passed, np.minimum(median_m, over_m), median_m)
    np.testing.assert_allclose(ground.heights_m[~seen], expected[~seen], atol=0.02)
    assert (median_m > over_m)[passed].any()
    np.testing.assert_allclose(ground.std_m[~seen], ((high_m - low_m) / 2)[~seen], atol=0.05)
    np.testing.assert_array_equal(ground.heights_m[seen], leveled.ground.heights_m[seen])
    np.testing.assert_allclose(ground.std_m[seen], 0.05)


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
    half_m = torch.tensor([nodes / 2])
    inputs = torch.tensor(unfolded(network_inputs(leveled)))[None, :, :nodes, :nodes]
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
