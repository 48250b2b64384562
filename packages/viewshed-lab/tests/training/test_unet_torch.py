from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as f
from tests.networks.made import SMALL, card, drawn, inputs
from tests.networks.older import older_card
from torch import Tensor

from viewshed.networks.architecture import UNetShape
from viewshed.networks.card import FORMAT_VERSION
from viewshed.networks.mc_dropout import mean_and_deviation, mean_and_std
from viewshed_lab.training.unet_torch import TorchRunner, UNet, load_weights, save_weights


def _by_the_book(module: UNet, x: Tensor, dropped: set[tuple[int, int]]) -> Tensor:
    """The paper's network in functions, width 4 and depth 2; ``dropped`` are (stage, channel), p = 0.1 here."""
    w = module.state_dict()

    def stage(name: str, x: Tensor) -> Tensor:
        for k in (1, 2):
            x = f.conv2d(x, w[f"{name}.conv{k}.weight"], padding=1)
            n = f"{name}.norm{k}"
            x = f.batch_norm(x, w[f"{n}.running_mean"], w[f"{n}.running_var"], w[f"{n}.weight"], w[f"{n}.bias"])
            x = f.relu(x)
        return x

    def drop(number: int, x: Tensor) -> Tensor:
        x = x / 0.9 if dropped else x.clone()
        for of, channel in dropped:
            if of == number:
                x[:, channel] = 0.0
        return x

    def up(i: int, x: Tensor) -> Tensor:
        return f.conv_transpose2d(x, w[f"up.{i}.weight"], w[f"up.{i}.bias"], stride=2)

    one = stage("encoder.0", x)
    two = drop(0, stage("encoder.1", f.max_pool2d(one, 2)))
    deep = drop(1, stage("encoder.2", f.max_pool2d(two, 2)))
    x = drop(2, stage("decoder.0", torch.cat([up(0, deep), two], 1)))
    x = stage("decoder.1", torch.cat([up(1, x), one], 1))
    return torch.sigmoid(f.conv2d(x, w["head.weight"], w["head.bias"]))[:, 0]


@pytest.mark.parametrize("dropped", [set(), {(0, 3), (1, 0), (1, 15), (2, 7)}], ids=["mle", "mcd"])
def test_the_network_is_the_papers(dropped: set[tuple[int, int]]) -> None:
    module, x = drawn(), inputs(2)
    masks = SMALL.no_masks(2) / np.float32(0.9 if dropped else 1.0)
    for stage, channel in dropped:
        masks[:, sum(SMALL.masked_channels[:stage]) + channel] = 0.0
    expected = _by_the_book(module, torch.from_numpy(x), dropped).numpy()
    np.testing.assert_allclose(TorchRunner(card(), module).run(x, masks), expected, atol=1e-5)


def test_passes_of_mcd_differ_and_those_of_mle_do_not() -> None:
    runner, x = TorchRunner(card(), drawn()), inputs(1)[0]
    mean, std = mean_and_std(runner, x, 8, np.random.default_rng(0))
    once = runner.run(x[None], SMALL.no_masks(1))[0]
    several = runner.run(x[None], SMALL.no_masks(4))
    passes = runner.run(x[None], SMALL.masks(8, np.random.default_rng(0)))
    assert all(np.abs(passes[a] - passes[b]).max() > 1e-3 for a in range(8) for b in range(a))
    assert (std > 0).mean() > 0.99
    np.testing.assert_allclose(several, np.stack([once] * 4), atol=1e-6)
    np.testing.assert_allclose(mean_and_deviation(several)[1], 0.0, atol=1e-6)
    assert np.abs(mean - once).max() > 1e-3
    again, _ = mean_and_std(runner, x, 8, np.random.default_rng(0))
    assert np.array_equal(mean, again)


def test_moments_are_numpys() -> None:
    values = np.random.default_rng(0).random((20, 70, 65)).astype(np.float32)
    mean, std = mean_and_deviation(values)
    np.testing.assert_allclose(mean, values.astype(np.float64).mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(std, values.astype(np.float64).std(axis=0), atol=1e-6)
    assert not mean_and_deviation(np.full((5, 3, 3), 0.1, np.float32))[1].any()


def test_older_checkpoints_with_a_second_head_give_their_probability(tmp_path: Path) -> None:
    module = drawn()
    head = {"doubt.first.weight": torch.ones(4, 4, 3, 3), "doubt.last.bias": torch.ones(1)}
    torch.save({"card": older_card(card().to_json()), "state": module.state_dict() | head}, tmp_path / "a.pt")
    found, again = load_weights(tmp_path / "a.pt")
    assert found == card()
    x, masks = inputs(2), SMALL.masks(2, np.random.default_rng(0))
    assert np.array_equal(TorchRunner(card(), module).run(x, masks), TorchRunner(found, again).run(x, masks))


def test_damaged_and_other_checkpoints_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.pt"
    save_weights(path, card(), drawn())
    whole = path.read_bytes()
    for content in (whole[: len(whole) // 2], b"", b"words"):
        path.write_bytes(content)
        with pytest.raises(
            ValueError, match=r"a\.pt must be a checkpoint of weights, got a damaged file or another kind"
        ):
            load_weights(path)
    torch.save({"epoch": 3}, path)
    with pytest.raises(ValueError, match=r"a\.pt must be a checkpoint that viewshed saved, got another; give the one"):
        load_weights(path)
    state = drawn(UNetShape(8, 2)).state_dict()
    torch.save({"card": card().to_json(), "state": state}, path)
    with pytest.raises(ValueError, match=r"a\.pt must hold the weights of UNetShape\(width=4.*; train again"):
        load_weights(path)
    torch.save({"card": card().to_json().replace(f'"version": {FORMAT_VERSION}', '"version": 0'), "state": {}}, path)
    with pytest.raises(ValueError, match=f"network must have format version {FORMAT_VERSION}, got 0; train it again"):
        load_weights(path)


def test_a_module_of_another_shape_is_refused() -> None:
    with pytest.raises(ValueError, match=r"module must have the card's shape UNetShape\(width=4"):
        TorchRunner(card(), drawn(UNetShape(8, 2)))
