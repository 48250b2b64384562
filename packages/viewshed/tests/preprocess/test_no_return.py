from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed import BevGrid, Sweep, _core
from viewshed.arrays import Mask
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.fov.visibility import Beams
from viewshed.preprocess.leveling import level
from viewshed.preprocess.no_return import beams_by_evidence, no_return_beams, no_return_groups
from viewshed.sensors import LidarModel
from viewshed_lab.sim import Box, Scene, cast

MODEL = LidarModel("test", np.deg2rad(np.linspace(-20, -2, 16)), azimuth_columns=360, max_range_m=200.0)
SWEEP = cast(MODEL, Scene((Box(15, 4, 1, 8, 3),)), 1.8)
GRID = BevGrid(64, 32.0)


def test_a_full_sweep_misses_nothing() -> None:
    assert len(no_return_beams(level(SWEEP, GRID), fill=False).azimuth) == 0


def test_the_beams_left_out_are_found_where_they_aimed() -> None:
    azimuth = np.arctan2(SWEEP.points[:, 1], SWEEP.points[:, 0])
    gone = (SWEEP.ring == 5) & (np.abs(azimuth - 1.0) < 0.05)
    missing = no_return_beams(level(SWEEP.select(~gone), GRID), fill=False)
    assert len(missing.azimuth) == gone.sum()
    assert np.allclose(np.sort(missing.azimuth), np.sort(azimuth[gone]), atol=np.deg2rad(1.0))
    assert np.allclose(missing.slope, np.tan(MODEL.elevation[5]), atol=2e-3)
    assert np.isinf(missing.depth_m).all()


@pytest.mark.parametrize("phase", [0.05, 0.45, 0.55, 0.95])
def test_each_firing_has_a_column_of_its_own_across_the_seam(phase: float) -> None:
    jitter = np.zeros(360)
    jitter[0], jitter[-1] = -0.3, 0.3
    azimuth = -np.pi + (np.arange(360) + phase + jitter) * (2 * np.pi / 360)
    points = np.column_stack([10 * np.cos(azimuth), 10 * np.sin(azimuth), np.zeros(360)]).astype(np.float32)
    column, counts, *_ = _core.range_image(points, np.zeros(360, np.int16), 360, 1, 0.5, 250.0)
    assert np.array_equal(column, np.arange(360))
    assert (counts == 1).all()


STREET = Scene((Box(15, 4, 1, 8, 3), Box(-25, -3, 1, 70, 9), Box(9, -12, 3, 2, 1.5), Box(58, 9, 1, 90, 9)))
"""A wall at x = 14.5, houses at x = -24.5 and x = 57.5, and something low at the right."""
FULL = cast(MODEL, STREET, 1.8)
LAST = 1.8 / -np.tan(MODEL.elevation[15])
"""Range at which the highest ring meets the ground: 51.5 m."""


def _azimuth(sweep: Sweep) -> NDArray[np.float32]:
    azimuth: NDArray[np.float32] = np.arctan2(sweep.points[:, 1], sweep.points[:, 0])
    return azimuth


def _explained(sweep: Sweep) -> Beams:
    return beams_by_evidence(level(sweep, GRID), 1.5).inferred


def _of(beams: Beams, ring: int) -> Mask:
    return np.asarray(np.abs(beams.slope - np.tan(MODEL.elevation[ring])) < 2e-3)


def _on_ground(sweep: Sweep) -> Mask:
    return np.asarray(sweep.points[:, 2] < -1.79)


def _grazing() -> Mask:
    """Which returns are kept where the ground of the highest ring hardly returns."""
    luck = np.random.default_rng(1).random(len(FULL))
    return np.asarray(~((FULL.ring == 15) & _on_ground(FULL) & (luck > 0.1)))


def test_beams_at_ground_that_hardly_returns_went_as_far_as_that_ground() -> None:
    lost = ~_grazing()
    beams = _explained(FULL.select(~lost))
    open_ = np.abs(beams.azimuth + 1.4) < 0.2
    assert _of(beams, 15).sum() > 0.8 * lost.sum()
    assert np.median(beams.depth_m[open_]) == pytest.approx(LAST, rel=0.05)


def test_early_ends_come_before_likely_ones_and_these_before_late_ones() -> None:
    split = beams_by_evidence(level(FULL.select(_grazing()), GRID), 1.5)
    assert (split.early.depth_m <= split.inferred.depth_m).all()
    assert (split.inferred.depth_m <= split.late.depth_m).all()
    assert (split.early.depth_m < split.late.depth_m).any()


@pytest.mark.parametrize("gone_share", [0.9, 1.0])
def test_nothing_is_claimed_behind_a_wall_that_swallows_light(gone_share: float) -> None:
    wall = (np.abs(FULL.points[:, 0] - 14.5) < 0.05) & (np.abs(FULL.points[:, 1] - 4) < 4.1)
    gone = wall & (np.random.default_rng(0).random(len(FULL)) < gone_share)
    estimate = ShadowMap(GRID).estimate(FULL.select(~gone))
    behind = GRID.centers[(GRID.centers[..., 0] > 17) & (np.abs(GRID.centers[..., 1] - 5) < 2)]
    assert (estimate.at(behind) >= 0.5).mean() < 0.05
    assert (ShadowMap(GRID, no_return="max_range").estimate(FULL.select(~gone)).at(behind) >= 0.5).mean() > 0.9


def test_the_core_answers_as_the_formulas_do() -> None:
    """The mixture of the network, computed once more from its arrays in another way: by the sum of its shares."""
    leveled = level(FULL.select(_grazing()), GRID)
    from viewshed_lab.training.no_return import arrays_of

    groups, split = no_return_groups(leveled, 1.5), beams_by_evidence(leveled, 1.5)
    arrays = arrays_of((Path(__file__).parents[2] / "src" / "core" / "no_return_network.inc").read_text("ascii"))
    x = np.clip((groups.feature - arrays["mean"]) * arrays["scale"], -6, 6).astype(np.float64)
    for layer in ("first", "second"):
        x = np.maximum(x @ arrays[layer] + arrays[f"{layer}_bias"], 0)
    outputs, stops = x @ arrays["third"] + arrays["third_bias"], groups.stop.shape[1]
    unseen = outputs[:, stops + 2, None] + np.exp(np.clip(outputs[:, stops + 3, None], -3, 1.5)) * [
        -1.609, -0.511, 0, 0.511, 1.609,
    ]  # fmt: skip
    centers = np.concatenate([groups.stop, unseen], axis=1)
    weights = np.exp(
        np.concatenate([np.where(groups.stop < 8, outputs[:, :stops], -np.inf),
                        np.repeat(outputs[:, stops + 1, None] - np.log(5), 5, axis=1)], axis=1)
    )  # fmt: skip
    total = weights.sum(axis=1) + np.exp(outputs[:, stops])
    farthest_m = max(kind.depth_m.max() for kind in (split.early, split.inferred, split.late))
    assert farthest_m == 1.5 * np.ceil(np.quantile(leveled.range_m, 0.999))
    # Of a group of one beam: the share that goes on beyond an end is at most what it stands for, before it more.
    alone = np.flatnonzero(groups.beams == 1)
    azimuth_apart = np.abs(split.inferred.azimuth[None] - groups.azimuth[alone, None])
    slope_apart = np.abs(split.inferred.slope[None] - groups.slope[alone, None])
    at = np.argmin(azimuth_apart + slope_apart, axis=1)
    for group, beam in zip(alone, at, strict=True):
        for ends, share in ((split.early, 0.8), (split.inferred, 0.5), (split.late, 0.2)):
            end = np.log2(ends.depth_m[beam])
            before = 1 - weights[group, centers[group] < end - 1e-3].sum() / total[group]
            beyond = 1 - weights[group, centers[group] <= end + 1e-3].sum() / total[group]
            assert beyond <= share + 1e-3 <= before + 2e-3 or (ends.depth_m[beam] == farthest_m and share < beyond)


@pytest.mark.parametrize("ring", [4, 9, 15])
def test_a_dead_ring_says_nothing(ring: int) -> None:
    beams = _explained(FULL.select(FULL.ring != ring))
    assert not _of(beams, ring).any()


def test_a_dropped_sector_says_nothing() -> None:
    beams = _explained(FULL.select(_grazing() & ~(np.abs(_azimuth(FULL) + 1.2) < 0.2)))
    assert _of(beams, 15).sum() > 100
    assert not (np.abs(beams.azimuth + 1.2) < 0.18).any()


def test_a_hole_in_a_wall_is_wall() -> None:
    hole = (np.abs(_azimuth(FULL) - 0.2) < 0.026) & (FULL.ring >= 11) & (FULL.ring <= 13)
    beams = _explained(FULL.select(~hole))
    at_wall = np.abs(beams.azimuth - 0.2) < 0.04
    assert at_wall.sum() == hole.sum() >= 8
    assert np.allclose(beams.depth_m[at_wall] * np.cos(beams.azimuth[at_wall]), 14.5, atol=0.5)


def test_without_rings_the_beam_table_tells_else_the_elevations_and_else_nothing() -> None:
    sweep = FULL.select(_grazing())
    shuffled = sweep.select(np.random.default_rng(1).permutation(len(sweep))).replace(ring=None)
    bare = shuffled.replace(model=None)
    aside = bare.replace(points=bare.points + np.array([0.4, 0.2, 0.0], np.float32))  # not seen from the sensor
    known, table, elevations, none = (_explained(s) for s in (sweep, shuffled, bare, aside))
    assert abs(len(table.depth_m) - len(known.depth_m)) < 0.05 * len(known.depth_m)
    assert 0 < len(elevations.depth_m) <= len(known.depth_m)
    assert len(none.depth_m) == 0


def test_over_unseen_ground_measured_beams_alone_count() -> None:
    """The walls of a closet end all beams above its floor; a height that is given makes up for that."""
    walls = (Box(2.1, 0, 1, 9, 3), Box(-2.4, 0, 1, 9, 3), Box(0, 1.8, 9, 1, 3), Box(0, -1.5, 9, 1, 3))
    closet = cast(MODEL, Scene(walls), 1.8)
    dark = closet.select((_azimuth(closet) > 0.3) | (np.random.default_rng(0).random(len(closet)) < 0.5))
    bare = dark.replace(sensor_height_m=None)
    assert level(bare, GRID).ground.support < 0.4
    split = beams_by_evidence(level(bare, GRID), 1.5)
    assert len(split.measured.depth_m) > 1000
    assert [len(kind.depth_m) for kind in (split.inferred, split.early, split.late)] == [0, 0, 0]
    assert len(_explained(dark).depth_m) > 100


@pytest.mark.parametrize("middle", np.deg2rad([0.5, 168.5, 179.5, -173.5]))
def test_a_gap_is_filled_from_both_sides_across_the_seam_as_elsewhere(middle: float) -> None:
    # 40 columns of a ring are empty: a neighbor fills up to 16 of them, and eight in the middle stay open.
    flat = cast(MODEL, Scene(()), 1.8)
    away = np.remainder(np.arctan2(flat.points[:, 1], flat.points[:, 0]) - middle + np.pi, 2 * np.pi) - np.pi
    gone = (flat.ring == 5) & (np.abs(away) < np.deg2rad(20))
    assert gone.sum() == 40
    filled = no_return_beams(level(flat.select(~gone), GRID), fill=True)
    from_middle = np.remainder(filled.azimuth - middle + np.pi, 2 * np.pi) - np.pi
    assert (from_middle > 0).sum() == (from_middle < 0).sum() == 16
    assert (np.abs(from_middle) > np.deg2rad(3.9)).all()
    assert np.allclose(filled.depth_m, 1.8 / -np.tan(MODEL.elevation[5]), rtol=0.02)


def test_a_table_that_does_not_explain_the_points_takes_nothing_from_what_they_show() -> None:
    bare = FULL.select(_grazing()).replace(ring=None, model=None)
    bare = bare.select(np.random.default_rng(1).permutation(len(bare)))
    wrong = LidarModel(
        "wrong", np.deg2rad(np.linspace(-19, 19, 70)), azimuth_columns=400, min_range_m=0.5, max_range_m=250.0
    )
    told = level(bare.replace(model=wrong), GRID)
    assert told.sensor_id.model is None
    shown, besides = beams_by_evidence(level(bare, GRID), 1.5).inferred, beams_by_evidence(told, 1.5).inferred
    assert len(shown.depth_m) > 100
    for one, other in zip(shown.arrays, besides.arrays, strict=True):
        assert np.array_equal(one, other)
    assert np.array_equal(ShadowMap(GRID).estimate(bare).state, ShadowMap(GRID).estimate(told).state)
