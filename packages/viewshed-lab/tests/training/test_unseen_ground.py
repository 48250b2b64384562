"""The network of the ground without returns: its samples, its base, and that the core answers as it does."""

import re
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

import viewshed
from viewshed import GRIDS, Rigid, _core
from viewshed.preprocess.leveling import level
from viewshed_lab.data.wild import wild_scenes
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.training.unseen_ground import (
    AZIMUTH,
    MODES,
    PASSING,
    RANGE_M,
    RETURNS,
    SEEN,
    SEEN_HEIGHT,
    GroundNet,
    Samples,
    augmented,
    base_of,
    exact_ground,
    inputs_of,
    log_density,
    loss_of,
    maps_of,
    quantiles_of,
    source_of_network,
)

UNIT_M = 0.25 + 0.04 * RANGE_M
SHIPPED = Path(viewshed.__file__).parent.parent / "core" / "ground_network.inc"


def layers_of(source: str) -> list[tuple[Tensor, Tensor]]:
    """Return the weights and biases that ``source_of_network`` wrote."""
    arrays = {name: text.replace("f", "").split(",") for name, text in re.findall(r"(\w+)\[\] = \{([^}]*)\}", source)}
    table = [tuple(map(int, sizes)) for sizes in re.findall(r"\{(\d+), (\d+), (\d+), WEIGHT", source)]
    layers = []
    for number, (size, inputs, outputs) in enumerate(table):
        weight = torch.tensor([float(value) for value in arrays[f"WEIGHT_{number}"]])
        scale, bias = (
            torch.tensor([float(value) for value in arrays[f"{name}_{number}"]]) for name in ("SCALE", "BIAS")
        )
        layers.append(((weight.reshape(size, size, inputs, outputs) * scale).permute(3, 2, 0, 1), bias))
    return layers


def network_of(layers: list[tuple[Tensor, Tensor]]) -> GroundNet:
    """Return the network with these convolutions; its normalizations do nothing but add the bias."""
    net = GroundNet([len(layers[k][1]) for k in (1, 3, 5, 7)])
    blocks = [layer for block in (*net.down, *net.up) for layer in block]
    with torch.no_grad():
        for convolution, norm, (weight, bias) in zip(
            [net.first, *(block.convolution for block in blocks)], [net.norm, *(block.norm for block in blocks)],
            layers[:-1], strict=True,
        ):  # fmt: skip
            convolution.weight.copy_(weight)
            norm.bias.copy_(bias)
            norm.running_var.fill_(1.0 - norm.eps)
        assert net.last.bias is not None
        net.last.weight[MODES * 4 :] = layers[-1][0]
        net.last.bias[MODES * 4 :] = layers[-1][1]
    return net.eval()


@pytest.mark.parametrize(("set_name", "domain", "given"), [("training", "road", "rings"), ("own", "indoor", "nothing")])
def test_the_core_answers_as_the_network_does(set_name: str, domain: str, given: str) -> None:
    seen = wild_scenes(set_name, domain)[3].observe(0)
    leveled = level(seen.given(given), seen.truth.grid)
    maps, net = maps_of(leveled), network_of(layers_of(SHIPPED.read_text("ascii")))
    samples = Samples(
        torch.tensor(maps)[None], torch.zeros(1, *maps.shape[1:]), torch.tensor([leveled.sensor_height_m])
    )
    with torch.no_grad():
        inputs, base = inputs_of(samples)
        quantiles = quantiles_of(net(inputs))
    most = maps[PASSING] + 0.1
    for found, units in zip(_core.predict_ground(maps, leveled.sensor_height_m), quantiles, strict=True):
        assert np.abs(found - np.minimum(base[0].numpy() + UNIT_M * units[0].numpy(), most)).max() < 0.005
    low, median, high = _core.predict_ground(maps, leveled.sensor_height_m)
    assert (low <= median).all()
    assert (median <= high).all()


def test_the_source_holds_the_network() -> None:
    torch.manual_seed(2)
    layers = GroundNet((8, 8, 16, 16)).convolutions()
    for (weight, bias), (found, found_bias) in zip(layers, layers_of(source_of_network(layers)), strict=True):
        assert torch.allclose(found_bias, bias, atol=1e-6)
        assert (found - weight).abs().max() <= weight.abs().max() / 254 + 1e-6


def test_the_base_keeps_what_is_seen_and_continues_it() -> None:
    rng = np.random.default_rng(1)
    seen = torch.tensor((rng.random((2, 128, 96)) < 0.1).astype(np.float32))
    height_m = torch.tensor(rng.normal(0, 1, (2, 128, 96)).astype(np.float32))
    base = base_of(seen, height_m)
    assert torch.equal(base[seen > 0], height_m[seen > 0])
    assert base.min() >= height_m[seen > 0].min()
    assert base.max() <= height_m[seen > 0].max()
    assert torch.allclose(base_of(seen, torch.full_like(seen, -1.5)), torch.tensor(-1.5))
    assert torch.equal(base_of(torch.zeros_like(seen), height_m), torch.zeros_like(seen))
    # Azimuths wrap around: a turn of the scene turns the base, as far as the coarser bins turn.
    assert torch.allclose(base_of(seen.roll(64, 1), height_m.roll(64, 1)), base.roll(64, 1), atol=1e-5)


def test_exact_ground_is_in_the_frame_of_the_sweep() -> None:
    seen = wild_scenes("own", "road")[0].observe(0)
    leveled = level(seen.given("table"), GRIDS["road"])
    plane = Terrain.plane(40.0, (0.1, 0.0))
    pose = Rigid(leveled.level_from_sensor.rotation, np.array([2.0, 1.0, 5.0]))
    ground = exact_ground(leveled, pose, plane)
    x, y = np.cos(AZIMUTH)[:, None] * RANGE_M + 2.0, np.sin(AZIMUTH)[:, None] * RANGE_M + 1.0
    inside = (np.abs(x) < 39.9) & (np.abs(y) < 39.9)
    # The sensor is 5 m above z = 0 of the world.
    assert np.allclose(ground[inside], (0.1 * x - 5.0 + leveled.sensor_height_m)[inside], atol=1e-3)
    assert np.isnan(ground[(np.abs(x) > 40.1) | (np.abs(y) > 40.1)]).all()


def flat_samples(count: int, height_m: float = 1.8) -> Samples:
    """Sweeps of level ground, seen everywhere; from 20 m on the lowest beam comes from 60 m."""
    maps = torch.zeros(count, 8, 128, 96)
    maps[:, RETURNS] = maps[:, SEEN] = 1.0
    maps[:, PASSING] = torch.tensor(np.where(RANGE_M > 20, height_m * (1 - RANGE_M / 60), np.inf).astype(np.float32))
    return Samples(maps, torch.zeros(count, 128, 96), torch.full((count,), height_m))


def test_augmented_beams_are_beams() -> None:
    samples = augmented(flat_samples(24), np.random.default_rng(5))
    known = torch.isfinite(samples.ground_m)
    assert known.float().mean() > 0.85
    seen = samples.maps[:, SEEN] > 0
    assert seen[known].all()
    assert torch.allclose(samples.maps[:, SEEN_HEIGHT][known & seen], samples.ground_m[known & seen], atol=1e-4)
    # The beam is straight from the sensor over the sloped ground.
    over_m = samples.maps[:, PASSING] - samples.ground_m
    slope = (over_m - samples.height_m[:, None, None]) / torch.tensor(RANGE_M)
    for one, valid in zip(slope, torch.isfinite(over_m), strict=True):
        assert one[valid].std() < 1e-3
    assert samples.height_m.std() > 0.1


def test_earlier_sweeps_show_some_of_the_ground_of_some_samples() -> None:
    samples, rng = flat_samples(64), np.random.default_rng(6)
    samples.maps[:, SEEN] = 0.0
    after = augmented(samples, rng)
    seen = after.maps[:, SEEN] > 0
    shares = seen.float().mean((1, 2))
    assert 0.2 < (shares > 0).float().mean() < 0.6
    assert shares.max() > 0.5
    off_m = (after.maps[:, SEEN_HEIGHT] - after.ground_m)[seen]
    assert 0.02 < off_m.std() < 0.15
    assert off_m.abs().max() < 0.5
    assert (after.maps[:, SEEN_HEIGHT][~seen] == 0).all()


def test_the_loss_is_least_at_the_quantiles() -> None:
    rng = np.random.default_rng(7)
    samples = flat_samples(8)
    samples.maps[:, SEEN] = 0.0
    units = torch.tensor(rng.laplace(0, 1, (8, 128, 96)).astype(np.float32))
    samples = samples._replace(ground_m=units * torch.tensor(UNIT_M))
    base = torch.zeros_like(units)
    # softplus(x) of the distance between quantiles .15 and .5 of the distribution.
    apart = torch.tensor(-np.log(0.3))
    right = torch.log(torch.expm1(apart)) + 1.0

    def loss(median: float, spread: float) -> float:
        values = (*[0.0] * MODES, median, spread, spread)
        outputs = torch.stack([torch.full_like(units, value) for value in values], 1)
        return float(loss_of(outputs, samples, base))

    best = loss(0.0, float(right))
    assert best < min(
        loss(0.2, float(right)), loss(-0.2, float(right)), loss(0.0, float(right) + 0.7), loss(0.0, float(right) - 0.7)
    )


def test_the_modes_are_a_distribution() -> None:
    rng = np.random.default_rng(3)
    outputs = torch.tensor(rng.normal(0, 1, (5, MODES + 3, 1, 1)).astype(np.float32))
    units = torch.linspace(-120, 120, 60_001)
    density = torch.exp(log_density(outputs, units[None, :, None].expand(5, -1, 1)))
    assert torch.allclose(torch.trapezoid(density[..., 0], units), torch.ones(5), atol=2e-3)
