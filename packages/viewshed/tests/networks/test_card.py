import json
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from tests.networks.made import card
from tests.networks.older import older_card
from torch.utils.flop_counter import FlopCounterMode

from viewshed.grid import BevGrid
from viewshed.networks.architecture import UNetShape
from viewshed.networks.card import FORMAT_VERSION, NetworkCard
from viewshed.sweep import Sweep
from viewshed_lab.training.unet_torch import UNet

SHAPES = [UNetShape(8, 4), UNetShape(4, 3), UNetShape(16, 5), UNetShape(1, 1)]


def test_the_papers_network_has_half_a_million_parameters_and_352_masked_channels() -> None:
    shape = UNetShape(width=8, depth=4)
    assert round(shape.parameters / 1e6, 2) == 0.49
    assert shape.masked_channels == (16, 32, 64, 128, 64, 32, 16)
    assert shape.masks(3, np.random.default_rng(0)).shape == (3, 352)


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_parameters_and_flops_are_what_torch_counts(shape: UNetShape) -> None:
    module = UNet(shape).eval()
    cells = 2 * (1 << shape.depth)
    with FlopCounterMode(display=False) as counter, torch.no_grad():
        module(torch.zeros(1, 1, cells, cells), torch.ones(1, sum(shape.masked_channels)))
    assert shape.parameters == sum(each.numel() for each in module.parameters())
    assert shape.flops(cells) == counter.get_total_flops()


@pytest.mark.parametrize("dropout", [0.05, 0.1, 0.5])
def test_masks_drop_their_share_and_keep_the_mean(dropout: float) -> None:
    masks = UNetShape(8, 4, dropout).masks(2000, np.random.default_rng(1))
    kept = np.float32(1 / (1 - dropout))
    assert set(np.unique(masks)) == {np.float32(0.0), kept}
    assert (masks == 0).mean() == pytest.approx(dropout, abs=0.003)
    assert masks.mean() == pytest.approx(1.0, abs=0.005)
    assert (masks == 0).any(axis=0).all()


@pytest.mark.parametrize("passes", [1, 5, 10, 20, 25])
def test_masks_of_several_passes_drop_each_channel_equally_often(passes: int) -> None:
    dropped = UNetShape(8, 4, 0.1).masks(passes, np.random.default_rng(2)) == 0
    often = dropped.sum(axis=0)
    assert set(often) <= {passes // 10, -(-passes // 10)}
    assert often.mean() == pytest.approx(passes / 10, rel=0.25)
    # Which passes drop a channel differs from channel to channel.
    if passes > 1:
        assert len({tuple(column) for column in dropped.T}) > passes // 2


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"width": 0}, r"width must be a whole number in \[1, 256\], got 0"),
        ({"depth": 9}, r"depth must be a whole number in \[1, 8\], got 9"),
        ({"depth": 2.0}, r"depth must be a whole number in \[1, 8\], got 2.0"),
        ({"dropout": 1.0}, r"dropout must lie in \[0, 1\), got 1.0"),
    ],
)
def test_shapes_outside_their_range_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        UNetShape(**changes)


def test_a_card_comes_back_from_json_as_it_was() -> None:
    made = NetworkCard(
        "road", UNetShape(4, 2, 0.05), BevGrid(64, 20.0, (3.0, -1.0)), "pedestrian", "paper_label", 70.0,
        (-2.0, 4.0), 100, 10.0, "log", 0.7, {"seed": "3", "epochs": "30"},
    )  # fmt: skip
    assert NetworkCard.from_json(made.to_json()) == made


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": FORMAT_VERSION + 1}, "must have format version 3, got 4; train it again with this version"),
        ({"layout": "other"}, "card must be a viewshed network's; export the network with viewshed train"),
        ({"more": 1}, "card must have the fields clip, .*, got clip, .*more"),
        ({"grid": 3}, r"card must be whole, got one that is damaged \(.*\); export the network again"),
        ({"shape": 3}, r"card must be whole, got one that is damaged \(.*\); export the network again"),
        ({"shape": {"width": 8}}, r"cells must divide by 16|must be whole|cells"),
        ({"target": "tram"}, "target must be one of car, pedestrian, got 'tram'"),
        ({"truth": "guess"}, "truth must be one of probe, paper_label, got 'guess'"),
        ({"counts": "root"}, "counts must be one of linear, log, got 'root'"),
        ({"clip": 0}, r"clip must be in \[1, 255\], got 0"),
        ({"divisor": 0.0}, "divisor must be positive, got 0.0"),
        (
            {"inputs": ["counts", "range"]},
            r"network must take only counts as input, .*inputs \['counts', 'range'\] and fo",
        ),
        ({"shape": {"width": 8, "depth": 2, "dropout": 0.0, "channels": 2}}, "take only counts as input"),
        ({"shape": {"width": 8, "depth": 2, "dropout": 0.0, "channels": 1, "fold": 4}}, "and fold 4; use shadow_map"),
        ({"heights_m": [3.0, -3.0]}, r"heights_m must be \(low, high\) with low < high, got \(3.0, -3.0\)"),
        ({"heights_m": ["a", "b"]}, r"card must be whole, got one that is damaged"),
        ({"clip": 100.5}, r"card must be whole, got one that is damaged"),
        ({"trained": None}, r"card must be whole, got one that is damaged"),
        ({"name": "a\x1b[2J"}, r"card must be whole, got one that is damaged \(name\)"),
        ({"threshold": 0.0}, r"threshold must lie in \(0, 1\], got 0.0"),
    ],
)
def test_a_card_that_is_not_ours_is_refused(change: dict[str, object], message: str) -> None:
    text = json.dumps({**json.loads(card(grid=BevGrid(36, 16.0)).to_json()), **change})
    with pytest.raises(ValueError, match=message):
        NetworkCard.from_json(text)


def test_a_card_of_version_0_3_says_what_else_it_might_have_been_shown() -> None:
    assert NetworkCard.from_json(older_card(card().to_json())) == card()


def test_cells_must_divide_by_the_poolings() -> None:
    with pytest.raises(ValueError, match="cells must divide by 16 for depth 4, got 100"):
        NetworkCard("made", UNetShape(8, 4), BevGrid(100, 16.0))


def _points(count: int = 4000) -> NDArray[np.float32]:
    rng = np.random.default_rng(2)
    return rng.uniform((-20, -14, -5), (18, 20, 5), (count, 3)).astype(np.float32)


def test_the_input_is_the_count_of_what_is_near_and_low_enough() -> None:
    points = _points()
    made = NetworkCard("made", UNetShape(4, 2), BevGrid(32, 16.0), max_range_m=15.0, heights_m=(-3.0, 1.0), clip=3)
    x, y, z = points.astype(np.float64).T
    keep = (np.hypot(x, y) <= 15.0) & (z >= -3.0) & (z <= 1.0)
    expected, _, _ = np.histogram2d(x[keep], y[keep], bins=32, range=[[-16, 16], [-16, 16]])
    found = made.input_of(Sweep(points, attitude=np.array([1.0, 0.0, 0.0, 0.0]), sensor_height_m=1.8))
    assert found.shape == (1, 32, 32)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found[0], np.minimum(expected, 3) / 1000, atol=1e-7)
    assert expected.max() > 3


def test_counts_may_be_shown_by_their_logarithm() -> None:
    points = np.repeat(np.array([[1.0, 1.0, 0.0], [-3.0, 5.0, 0.0]], np.float32), [7, 500], axis=0)
    made = NetworkCard("made", UNetShape(4, 2), BevGrid(32, 16.0), clip=100, counts="log")
    found = made.input_of(Sweep(points, attitude=np.array([1.0, 0.0, 0.0, 0.0]), sensor_height_m=1.8))[0]
    assert found[17, 17] == pytest.approx(np.log(8) / np.log(101))
    assert found[13, 21] == 1.0
    assert np.count_nonzero(found) == 2


def test_the_input_is_turned_level_by_the_attitude() -> None:
    """A sensor pitched down by 30° about y: what it has straight ahead lies ahead and below, at z = -5 in level."""
    half = np.deg2rad(30.0) / 2
    sweep = Sweep(np.array([[10.0, 2.0, 0.0]]), attitude=np.array([np.cos(half), 0.0, np.sin(half), 0.0]))
    grid = BevGrid(32, 16.0)
    seen = NetworkCard("made", UNetShape(4, 2), grid, heights_m=(-5.1, -4.9)).input_of(sweep)[0]
    assert np.argwhere(seen).tolist() == [[int(16 + 10 * np.cos(np.deg2rad(30))), 18]]
    assert not NetworkCard("made", UNetShape(4, 2), grid, heights_m=(-3.0, 3.0)).input_of(sweep).any()


def test_null_returns_are_not_counted_and_a_missing_attitude_is_estimated() -> None:
    null = np.random.default_rng(0).uniform(-0.28, 0.28, (500, 3))
    beside = np.array([[0.4, 0.4, 0.0]])
    made = NetworkCard("made", UNetShape(4, 2), BevGrid(32, 16.0))
    found = made.input_of(Sweep(np.concatenate([null, beside, [[9.0, -3.5, -1.0]]]).astype(np.float32)))[0]
    assert np.argwhere(found).tolist() == [[16, 16], [25, 12]]
    np.testing.assert_allclose(found[[16, 25], [16, 12]], 0.001)
