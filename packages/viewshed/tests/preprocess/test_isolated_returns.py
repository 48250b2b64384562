"""Isolated returns: found where nothing around is similar, and no evidence of ground, of a depth, or of a reach."""

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed import BevGrid, Sweep, _core
from viewshed.arrays import Mask
from viewshed.estimators.shadow_map import NoReturn, ShadowMap
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.preprocess.range_image import RangeImage, pixels_of
from viewshed.preprocess.sensor_identification import identify_sensor
from viewshed.sensors import LidarModel
from viewshed_lab.sim import Box, Scene, cast

MODEL = LidarModel("sparse", np.deg2rad(np.linspace(-24, 8, 17)), azimuth_columns=720, max_range_m=100.0)
GRID = BevGrid(128, 32.0)
LIMITS_M = (0.5, 250.0)
STREET = cast(MODEL, Scene((Box(14, 6, 1, 20, 8), Box(-20, -3, 1, 60, 9), Box(6, -9, 4.2, 1.8, 1.5))), 1.8)


def spoofed(sweep: Sweep, share: float, factor: tuple[float, float], seed: int = 4) -> tuple[Sweep, Mask]:
    """Some of the returns, drawn at random, at another range on the same beam."""
    rng = np.random.default_rng(seed)
    lie = rng.random(len(sweep)) < share
    points = sweep.points.copy()
    points[lie] *= rng.uniform(*factor, (int(lie.sum()), 1)).astype(np.float32)
    return sweep.replace(points=points), np.asarray(lie)


def image_of(sweep: Sweep) -> RangeImage:
    pixels = pixels_of(identify_sensor(sweep))
    return pixels.image_of(sweep.points, LIMITS_M)


def isolated_in(sweep: Sweep) -> Mask:
    return image_of(sweep).isolated


def level_of(sweep: Sweep) -> LeveledSweep:
    return level(sweep, GRID)


def claimed(sweep: Sweep) -> Mask:
    return np.asarray(ShadowMap(GRID).estimate(sweep).visible())


def test_few_returns_of_a_street_are_isolated_and_most_of_those_moved_are() -> None:
    assert isolated_in(STREET).mean() < 0.005
    moved, lie = spoofed(STREET, 0.02, (1.5, 4.0))
    isolated = isolated_in(moved)
    assert isolated[lie].mean() > 0.85
    assert isolated[~lie].mean() < 0.01


def test_a_pole_and_sparse_ground_are_not_isolated() -> None:
    pole = cast(MODEL, Scene((Box(8, 3, 0.1, 0.1, 6),)), 1.8)
    on_pole = np.hypot(pole.points[:, 0] - 8, pole.points[:, 1] - 3) < 0.3
    assert on_pole.sum() >= 5
    assert not isolated_in(pole)[on_pole].any()
    grazing = (STREET.ring == 10) & (STREET.points[:, 2] < -1.79)
    sparse = STREET.select(~grazing | (np.random.default_rng(3).random(len(STREET)) < 0.2))
    left = (sparse.ring == 10) & (sparse.points[:, 2] < -1.79)
    assert left.sum() > 50
    assert isolated_in(sparse)[left].mean() < 0.05


@pytest.mark.parametrize("start", [300, 719, 0])
@pytest.mark.parametrize(("ring", "beside"), [(9, 0), (9, 1), (9, -1), (8, 1)])
def test_a_similar_return_confirms_another_one_across_the_seam_as_elsewhere(start: int, ring: int, beside: int) -> None:
    # All beams end at 10 m but two at 30 m, in neighboring pixels.
    rings, columns = np.arange(17), np.arange(720)
    range_m = np.full((17, 720), 10.0)
    range_m[8, start] = range_m[ring, (start + beside) % 720] = 30.0
    azimuth = (columns + 0.5) * (2 * np.pi / 720) - np.pi
    flat = np.cos(MODEL.elevation)[:, None]
    points = range_m[..., None] * np.stack(
        [flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(MODEL.elevation)[:, None] * np.ones(720)], axis=-1
    )
    of_ring = np.repeat(rings, 720).astype(np.int16)
    assert not isolated_in(of_model(points.reshape(-1, 3).astype(np.float32), of_ring)).any()


def of_model(points: NDArray[np.float32], ring: NDArray[np.int16]) -> Sweep:
    return Sweep(points, ring=ring, model=MODEL, sensor_height_m=1.8, attitude=np.array([1.0, 0, 0, 0]))


@pytest.mark.parametrize("share", [0.01, 0.04])
def test_ranges_spoofed_on_beams_do_not_move_the_ground(share: float) -> None:
    moved, _ = spoofed(STREET, share, (1.3, 3.0))
    xy = np.random.default_rng(7).uniform((-15, -20), (11, 20), (200, 2))
    assert np.abs(level_of(moved).ground.at(xy)).max() < 0.25


def test_ranges_spoofed_on_beams_open_no_corridors() -> None:
    clean = claimed(STREET)
    moved, _ = spoofed(STREET, 0.04, (1.3, 4.0))
    opened = claimed(moved) & ~clean
    assert opened.sum() < 0.03 * clean.sum()
    assert (clean & ~claimed(moved)).sum() < 0.05 * clean.sum()


def test_a_second_return_behind_a_wall_counts_for_no_rule() -> None:
    wall = (STREET.points[:, 0] > 13) & (np.abs(STREET.points[:, 1] - 6) < 9)
    again = np.flatnonzero(wall)[::7]
    points = np.concatenate([STREET.points, STREET.points[again] * np.float32(1.8)])
    both = STREET.replace(points=points, ring=np.concatenate([STREET.ring, STREET.ring[again]]), azimuth=None)
    rules: tuple[NoReturn, ...] = ("inferred", "unknown")
    for rule in rules:
        before = ShadowMap(GRID, no_return=rule).estimate(STREET).visible()
        after = ShadowMap(GRID, no_return=rule).estimate(both).visible()
        assert (after & ~before).sum() <= 5


def test_columns_with_a_few_returns_among_full_ones_are_silent() -> None:
    counts = np.zeros((8, 7), np.uint8)
    counts[:, :4] = 1  # four columns from all eight rings, one from four, one from three, one from none
    counts[2:6, 4] = 1
    counts[:3, 5] = 2
    assert _core.silent_columns(counts).tolist() == [False, False, False, False, False, True, True]
    assert _core.silent_columns(np.zeros((3, 2), np.uint8)).all()


def jammed(sweep: Sweep, share: float = 0.3, seed: int = 5) -> tuple[Sweep, Mask]:
    """Some of the beams, drawn at random, return at random ranges up to 100 m."""
    rng = np.random.default_rng(seed)
    lie = rng.random(len(sweep)) < share
    points, range_m = sweep.points.copy(), np.linalg.norm(sweep.points, axis=1)
    points[lie] *= (rng.uniform(0.5, 100.0, int(lie.sum())) / range_m[lie])[:, None].astype(np.float32)
    return sweep.replace(points=points), np.asarray(lie)


def test_a_clear_sweep_has_no_clutter_and_neither_has_one_with_few_lies() -> None:
    for sweep in (STREET, spoofed(STREET, 0.01, (1.5, 4.0))[0]):
        image = image_of(sweep)
        assert image.clutter is None
        within = np.linalg.norm(sweep.points, axis=1) <= MODEL.max_range_m
        assert np.array_equal(level_of(sweep).rows, np.flatnonzero(within))


def test_most_random_returns_of_a_jammed_sweep_are_clutter_and_few_true_ones() -> None:
    sweep, lie = jammed(STREET)
    image = image_of(sweep)
    moved = np.linalg.norm(sweep.points - STREET.points, axis=1) > 0.3 * np.linalg.norm(STREET.points, axis=1)
    assert image.clutter[lie & moved].mean() > 0.9
    assert image.clutter[~lie].mean() < 0.1
    assert image.isolated[image.clutter].all()
    assert (image.column[image.clutter] == -1).all()
    assert image.counts.sum() == (~image.clutter).sum()


def test_clutter_is_left_out_of_the_level_sweep_and_moves_neither_ground_nor_view() -> None:
    sweep, _ = jammed(STREET)
    leveled, clear = level_of(sweep), level_of(STREET)
    assert set(leveled.rows) == set(np.flatnonzero(~leveled.range_image.clutter))
    seen = leveled.ground.seen & clear.ground.seen
    assert seen.sum() > 0.9 * clear.ground.seen.sum()
    assert np.abs(leveled.ground.heights_m - clear.ground.heights_m)[seen].max() < 0.2
    assert (claimed(sweep) == claimed(STREET)).mean() > 0.96
