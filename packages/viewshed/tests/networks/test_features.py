"""The channels on sampled sweeps: each says what its name says, and turns with the sensor."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed import _core
from viewshed.estimators import ESTIMATORS
from viewshed.fov.height_map import HeightMap
from viewshed.fov.visibility import CAR, expected_returns
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid, polar_of_cells
from viewshed.networks.architecture import UNetShape
from viewshed.networks.card import NetworkCard
from viewshed.networks.features import FEATURES, FeatureContext, feature_maps, fold_maps
from viewshed.preprocess.azimuth_bins import bins_of_cells
from viewshed.preprocess.evidence import beam_evidence
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.preprocess.no_return import beams_by_evidence
from viewshed.sweep import Sweep
from viewshed_lab.data.presets import preset_named
from viewshed_lab.data.sample import Sample
from viewshed_lab.data.simulated import ScenePlan, simulate_frame

GRID = BevGrid(64, 64.0)
FARTHEST_M, MOST_RETURNS = 100.0, 127
Maps = dict[str, NDArray[np.uint8]]


@pytest.fixture(scope="module")
def frame() -> Sample:
    return simulate_frame(ScenePlan(preset_named("nuscenes-small"), 0, 1), 0)


def shown(leveled: LeveledSweep) -> FeatureContext:
    return FeatureContext(leveled, GRID, CAR, GRID.count(leveled.points).clip(0, 255).astype(np.uint8))


def middles() -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """x of the rows and y of the columns of cells."""
    x_m: NDArray[np.float32] = GRID.centers[:, 0, 0].astype(np.float32)
    return x_m, x_m


def coded(coding: str, *arrays: NDArray[Any]) -> NDArray[np.uint8]:
    """The map of a feature that is coded in a certain way."""
    bins = bins_of_cells(GRID, len(arrays[0]) if coding == "beyond" else 1)
    [codes] = _core.feature_maps([(coding, arrays)], polar_of_cells(GRID)[0], bins, *middles(), 64.0, 0)
    return np.asarray(codes)


def returns_code(returns: NDArray[np.float32]) -> NDArray[np.uint8]:
    """The code of expected returns in steps of a sixteenth: 0 of none, 94 of 5, 255 from 127 on."""
    steps = np.floor(np.minimum(returns, MOST_RETURNS) * 16) / 16
    codes: NDArray[np.uint8] = np.round(255.0 * np.log1p(steps) / np.log1p(MOST_RETURNS)).astype(np.uint8)
    return codes


def away_code(away_m: NDArray[np.float32]) -> NDArray[np.uint8]:
    """128.5, more or less the logarithm of distances, cut to whole numbers: 109 of -1 m, 128 of 0, 147 of 1 m."""
    size = np.log1p(np.minimum(np.abs(away_m), np.float32(FARTHEST_M))) * np.float32(127.0 / np.log1p(FARTHEST_M))
    codes: NDArray[np.uint8] = (np.float32(128.5) + np.copysign(size, away_m)).astype(np.uint8)
    return codes


def maps(sweep: Sweep) -> Maps:
    return dict(zip(FEATURES, feature_maps(tuple(FEATURES), shown(level(sweep, GRID))), strict=True))


def test_expected_returns_are_the_shadow_maps(frame: Sample) -> None:
    found, leveled = maps(frame.sweep), level(frame.sweep, GRID)
    beams = beams_by_evidence(leveled, CAR.height_m)
    returns, _ = expected_returns(beams.measured + beams.inferred, leveled.sensor_height_m, leveled.ground, GRID, CAR)
    assert np.array_equal(found["expected"], returns_code(returns))
    # The shadow map claims no cell of fewer; of more it claims those that the doubt of the ground leaves likely.
    claimed = ESTIMATORS["shadow_map"](GRID).estimate(leveled).visible()
    threshold = returns_code(np.array([CAR.min_returns], np.float32))[0]
    clear = np.abs(found["expected"].astype(int) - threshold) > 2
    assert clear.mean() > 0.9
    # Five returns or more are as likely as not from a mean of 4.67 on.
    assert not claimed[found["expected"] < returns_code(np.array([4.6], np.float32))[0]].any()
    sure = clear & (replace(leveled.ground, heights_m=leveled.ground.std_m).at(GRID.centers) < 0.1)
    sure &= beam_evidence(leveled, GRID, CAR).within_reach
    assert sure.mean() > 0.05
    assert np.array_equal(claimed[sure], found["expected"][sure] > threshold)
    assert (found["measured"] <= found["expected"]).all()
    assert (found["measured"] < found["expected"]).any()


def test_unresolved_returns_are_those_that_late_ends_add(frame: Sample) -> None:
    leveled = level(frame.sweep, GRID)
    beams = beams_by_evidence(leveled, CAR.height_m)
    likely, late = (
        expected_returns(kind, leveled.sensor_height_m, leveled.ground, GRID, CAR)[0]
        for kind in (beams.inferred, beams.late)
    )
    found = maps(frame.sweep)["unresolved"]
    assert np.array_equal(found, returns_code(np.maximum(late - likely, 0)))
    assert found.any()


def test_codes_ascend_with_the_returns() -> None:
    returns = np.zeros(GRID.shape, np.float32)
    returns.reshape(-1)[:] = np.linspace(0, 2 * MOST_RETURNS, returns.size)
    returns[0, :10] = np.arange(2, 12)
    codes = coded("returns", returns)
    assert np.array_equal(codes, returns_code(returns))
    assert (np.diff(codes.astype(int).reshape(-1)[10:]) >= 0).all()
    assert (np.diff(codes[0, :10].astype(int)) >= 4).all()
    assert codes[-1, -1] == 255
    assert np.array_equal(coded("returns", returns, returns), returns_code(2 * returns))


def test_the_code_of_a_limit_is_that_of_its_distance() -> None:
    """Tables give what the logarithm does, cell by cell, also where one code ends and the next begins."""
    rng, count = np.random.default_rng(2), 360
    bins, range_m = bins_of_cells(GRID, count), polar_of_cells(GRID)[0]
    edges = np.expm1(np.arange(1, 254, 2) * np.log1p(FARTHEST_M) / 254)
    for limit_m in (
        rng.uniform(-1.0, 200.0, count),
        rng.choice([-1.0, np.inf], count),
        rng.choice(range_m.reshape(-1), count) + rng.choice(edges, count) * rng.choice([-1, 1], count),
    ):
        limit = limit_m.astype(np.float32)
        assert np.array_equal(coded("beyond", limit), away_code(limit[bins] - range_m))


def test_folded_features_are_their_maps_in_blocks(frame: Sample) -> None:
    context = shown(level(frame.sweep, GRID))
    found = feature_maps(tuple(FEATURES), context)
    for fold in (1, 2, 4, 8, 16):
        blocks = feature_maps(tuple(FEATURES), context, fold)
        assert np.array_equal(blocks, fold_maps(found, fold))
        side = GRID.cells // fold
        plain = found.reshape(len(FEATURES), side, fold, side, fold).transpose(1, 3, 0, 2, 4)
        assert np.array_equal(blocks, plain.reshape(side, side, -1))


def test_limits_are_where_their_code_crosses_the_middle() -> None:
    """A round wall at 20 m and ground at 40 m behind it: nearest obstacle and farthest return."""
    azimuth = np.linspace(-np.pi, np.pi, 3000, endpoint=False)
    parts = [
        np.stack([r * np.cos(azimuth), r * np.sin(azimuth), np.full(3000, z)], axis=1)
        for r, z in ((20.0, -0.8), (40.0, -1.8), (8.0, -1.8))
    ]
    leveled = np.array([1.0, 0.0, 0.0, 0.0])
    found = maps(Sweep(np.concatenate(parts).astype(np.float32), sensor_height_m=1.8, attitude=leveled))
    range_m = polar_of_cells(GRID)[0]
    for name, limit_m in (("blocker", 20.0), ("farthest", 40.0)):
        assert (found[name][range_m < limit_m - 0.5] > 128).all()
        assert (found[name][range_m > limit_m + 0.5] < 128).all()
    cells = (range_m > 19.5) & (found["highest"] > 0) & (range_m < 20.5)
    assert cells.any()
    height = (found["highest"][cells].astype(float) - 1) * 6 / 254 - 2
    assert np.abs(height - 1.0).max() < 0.1


def test_maps_turn_with_the_sensor(frame: Sample) -> None:
    sweep = frame.sweep.replace(attitude=np.array([1.0, 0.0, 0.0, 0.0]))
    turned = sweep.replace(points=(sweep.points @ Rigid.from_yaw(np.pi / 2).rotation.T).astype(np.float32))
    straight, left = maps(sweep), maps(turned)
    for name in set(FEATURES) - {"range", "confirmations"}:
        right, wrong = (
            (np.abs(each.astype(int) - left[name]) > 8).mean() for each in (np.rot90(straight[name]), straight[name])
        )
        beside_edges = 0.2 if name in ("blocker", "farthest") else 0.02  # a beam on the edge of a bin may change it
        assert right < beside_edges, name
        assert wrong > right + 0.04, name


def test_a_sweep_without_returns_is_shown_as_nothing() -> None:
    found = maps(Sweep(np.zeros((0, 3), np.float32)))
    for name in ("counts", "lowest", "highest", "measured", "expected", "unresolved"):
        assert not found[name].any()


def test_the_shadow_maps_probability_and_the_doubt_of_the_ground_are_shown(frame: Sample) -> None:
    leveled = level(frame.sweep, GRID)
    found = maps(frame.sweep)
    prob = beam_evidence(leveled, GRID, CAR).visible_prob
    assert np.array_equal(found["shadow_map"], np.floor(prob * np.float32(255.0)))
    assert np.array_equal(found["shadow_map"] >= 127.5, prob >= 128 / 255)
    # The code of the deviation is its logarithm: 255 · log(1 + 20 std) / log(101), 255 from five meters on.
    for std_m, code in ((0.0, 0), (0.05, 38), (0.5, 132), (50.0, 255)):
        unsure = replace(leveled, ground=HeightMap.flat(64.0, 0.0, std_m))
        assert (feature_maps(("ground_std",), shown(unsure)) == code).all()


def test_a_card_shows_its_channels_in_their_order(frame: Sample) -> None:
    names = ("range", "expected", "counts")
    card = NetworkCard("made", UNetShape(4, 2, channels=3), GRID, inputs=names, heights_m=(-10.0, 3.0), counts="log")
    found, every = card.input_of(frame.sweep), maps(frame.sweep)
    assert found.shape == (3, *GRID.shape)
    np.testing.assert_allclose(found[0], every["range"] / np.float32(255.0), rtol=1e-6)
    np.testing.assert_allclose(found[1], every["expected"] / np.float32(255.0), rtol=1e-6)
    alone = NetworkCard("made", UNetShape(4, 2), GRID, heights_m=(-10.0, 3.0), counts="log")
    assert np.array_equal(found[2], alone.input_of(frame.sweep)[0])
