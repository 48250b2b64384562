"""Laws that geometric estimators obey on any scene."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import shapely
from concave_hull import concave_hull_indexes
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from viewshed import _core
from viewshed.estimators.concave_hull import ConcaveHull, thinned
from viewshed.estimators.delaunay import Delaunay
from viewshed.estimators.first_blocker import FirstBlocker
from viewshed.estimators.ray_trace import ContinuousRayTrace, QuantizedRayTrace, TrimmedRayTrace
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.fov.visibility import CAR
from viewshed.grid import BevGrid
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.sweep import Sweep

GRID = BevGrid(64, 16.0)
BINS = 180
"""Four times an odd number: no cell's center and no axis lies on a bin's border."""
POLAR: Mapping[str, Any] = {
    "continuous": ContinuousRayTrace(GRID, window=0.02),
    "quantized": QuantizedRayTrace(GRID, azimuth_bins=BINS),
    "quantized_ranges": QuantizedRayTrace(GRID, azimuth_bins=BINS, range_bins=50, max_range_m=20.0),
    "trimmed": TrimmedRayTrace(GRID, azimuth_bins=BINS),
    "first_blocker": FirstBlocker(GRID, azimuth_bins=BINS),
    "second_blocker": FirstBlocker(GRID, azimuth_bins=BINS, rank=2, limit_farthest=False),
    "median_blocker": FirstBlocker(GRID, azimuth_bins=BINS, median_bins=5),
}
MakeLevel = Callable[..., LeveledSweep]
seeds = st.integers(0, 2**32 - 1)


def _points(seed: int, count: int = 3000) -> NDArray[np.float32]:
    """Returns in 36 lumps of azimuth (so that bins differ), off the borders of the bins."""
    rng = np.random.default_rng(seed)
    azimuth = 2 * np.pi * (rng.integers(0, BINS, count) + rng.uniform(0.2, 0.8, count)) / BINS - np.pi
    reach = np.repeat(rng.uniform(4, 18, 36), 5)[((azimuth + np.pi) / (2 * np.pi) * BINS).astype(int)]
    range_m = reach * np.sqrt(rng.random(count))
    z = np.where(rng.random(count) < 0.1, rng.uniform(0.5, 2.5, count), 0.0)
    return np.stack([range_m * np.cos(azimuth), range_m * np.sin(azimuth), z], axis=1).astype(np.float32)


@pytest.mark.parametrize("name", POLAR)
@settings(max_examples=10)
@given(seed=seeds)
def test_turns_with_the_scene(make_level: MakeLevel, name: str, seed: int) -> None:
    points = _points(seed)
    turned = points[:, [1, 0, 2]] * np.array([-1, 1, 1], np.float32)
    before, after = (POLAR[name].estimate(make_level(p)) for p in (points, turned))
    assert before.visible().any()
    assert (np.rot90(before.visible_prob) != after.visible_prob).mean() <= 0.002  # a range may equal a cell's
    assert (np.rot90(before.state) != after.state).mean() <= (0.05 if name == "continuous" else 0.002)


@pytest.mark.slow
@pytest.mark.parametrize(
    "estimator", [ConcaveHull(GRID), Delaunay(GRID), ShadowMap(GRID)], ids=lambda e: type(e).__name__
)
@settings(max_examples=5)
@given(seed=seeds)
def test_turns_with_the_scene_but_for_slivers(make_level: MakeLevel, estimator: Any, seed: int) -> None:
    points = _points(seed, 20_000)
    turned = points[:, [1, 0, 2]] * np.array([-1, 1, 1], np.float32)
    before, after = (estimator.estimate(make_level(p)).visible() for p in (points, turned))
    assert before.any()
    assert (np.rot90(before) != after).mean() < 0.02


@pytest.mark.parametrize("name", ["continuous", "quantized", "quantized_ranges", "trimmed"])
@settings(max_examples=20)
@given(seed=seeds, more=st.integers(1, 400))
def test_more_returns_never_remove_visibility_of_farthest(
    make_level: MakeLevel, name: str, seed: int, more: int
) -> None:
    points = _points(seed)
    fewer, all_ = (POLAR[name].estimate(make_level(p)).visible() for p in (points[:-more], points))
    assert not (fewer & ~all_).any()
    assert fewer.any()


def _with_occluder(leveled: LeveledSweep, seed: int) -> LeveledSweep:
    """Halve the depth of the returns of one sector that lie beyond some range; beams keep their directions."""
    rng = np.random.default_rng(seed)
    middle, width, beyond = rng.uniform(-np.pi, np.pi), rng.uniform(0.05, 0.8), rng.uniform(3, 10)
    away = np.abs(np.angle(np.exp(1j * (leveled.azimuth.astype(np.float64) - middle))))
    blocked = (away < width) & (leveled.range_m > beyond)
    scale = np.where(blocked, np.float32(0.5), np.float32(1.0))
    sensor = np.array([0, 0, leveled.sensor_height_m], np.float32)
    points = ((leveled.points - sensor) * scale[:, None] + sensor).astype(np.float32)
    return replace(leveled, points=points, range_m=leveled.range_m * scale, height_m=points[:, 2].copy())


@pytest.mark.parametrize(
    "estimator",
    [POLAR["first_blocker"], POLAR["second_blocker"], POLAR["median_blocker"], ShadowMap(GRID)],
    ids=["first", "second", "median", "shadow_map"],
)
@settings(max_examples=20)
@given(seed=seeds)
def test_more_occluders_never_add_visibility(make_level: MakeLevel, street: Sweep, estimator: Any, seed: int) -> None:
    points = street.points + np.array([0, 0, 1.8], np.float32)
    before = make_level(points)
    after = _with_occluder(before, seed)
    open_, blocked = (estimator.estimate(leveled).visible() for leveled in (before, after))
    assert not (blocked & ~open_).any()
    assert open_.any()


@pytest.mark.parametrize("name", POLAR)
@settings(max_examples=10)
@given(seed=seeds)
def test_an_azimuth_without_returns_is_unknown(make_level: MakeLevel, name: str, seed: int) -> None:
    points = _points(seed)
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    empty = (azimuth > 0.5) & (azimuth < 1.5)
    estimate: FovEstimate = POLAR[name].estimate(make_level(points[~empty]))
    x, y = GRID.centers[..., 0], GRID.centers[..., 1]
    away = np.abs(np.arctan2(y, x) - 1.0)
    assert (estimate.visible_prob[away < 0.44] == 0).all()
    assert not np.isin(estimate.state[away < 0.44], [CellState.FREE, CellState.SURFACE]).any()
    # Beams beside the gap aim at a target as wide as a car that reaches out of it, to within two sectors of 2.8°.
    half = np.arctan2(CAR.width_m / 2, np.hypot(x, y) - GRID.cell_m)
    inside = away + half < 0.5 - 2 * 2 * np.pi / _core.GROUND_SECTORS
    assert inside.sum() > 50
    assert (estimate.state[inside] == CellState.UNKNOWN).all()


@settings(max_examples=10)
@given(seed=seeds, window=st.sampled_from([0.004, 0.05, 0.3, 1.5]))
def test_continuous_agrees_with_its_definition_cell_by_cell(make_level: MakeLevel, seed: int, window: float) -> None:
    points, grid = _points(seed, 200).astype(np.float64), BevGrid(16, 12.0, (1.0, -2.0))
    got = ContinuousRayTrace(grid, window=window, margin_m=0.0).estimate(make_level(points)).visible()
    x, y = grid.centers[..., 0, None], grid.centers[..., 1, None]
    away = np.abs(np.angle(np.exp(1j * (np.arctan2(points[:, 1], points[:, 0]) - np.arctan2(y, x)))))
    farther = np.hypot(points[:, 0], points[:, 1]) - np.hypot(x, y)
    sure = np.asarray(((np.abs(away - window) > 1e-5) & (np.abs(farther) > 1e-4)).all(axis=-1))
    want = np.asarray(((away <= window) & (farther >= 0)).any(axis=-1))
    assert np.array_equal(got[sure], want[sure])
    assert sure.mean() > 0.9


@settings(max_examples=20)
@given(seed=seeds, concavity=st.floats(0.5, 4.0), length_m=st.floats(0.0, 6.0))
def test_hull_is_concavemans(make_level: MakeLevel, seed: int, concavity: float, length_m: float) -> None:
    leveled, hull = make_level(_points(seed, 900)), ConcaveHull(GRID, concavity=concavity, length_threshold_m=length_m)
    points, _ = thinned(leveled, GRID)
    ring = concave_hull_indexes(points, concavity=concavity, length_threshold=length_m)
    want = shapely.contains_xy(shapely.Polygon(points[ring]), GRID.centers[..., 0], GRID.centers[..., 1])
    assert np.array_equal(hull.estimate(leveled).visible(), want)


@settings(max_examples=10)
@given(seed=seeds)
def test_polygon_masks_agree_with_shapely(make_level: MakeLevel, seed: int) -> None:
    leveled, fit = make_level(_points(seed, 400)), Delaunay(GRID)
    triangles = shapely.polygons(fit._edges(thinned(leveled, GRID)[0]).reshape(-1, 3, 4)[..., :2])
    want = shapely.contains_xy(shapely.union_all(triangles), GRID.centers[..., 0], GRID.centers[..., 1])
    assert np.array_equal(fit.estimate(leveled).visible(), want)


@settings(max_examples=10)
@given(seed=seeds, rank=st.integers(1, 4))
def test_first_blocker_is_the_nearest_of_rank(make_level: MakeLevel, seed: int, rank: int) -> None:
    points = _points(seed)
    leveled = make_level(points)
    got = FirstBlocker(GRID, azimuth_bins=BINS, rank=rank).estimate(leveled)
    bins = np.floor((np.arctan2(points[:, 1], points[:, 0]) + np.pi) / (2 * np.pi) * BINS).astype(int)
    x, y = GRID.centers[..., 0], GRID.centers[..., 1]
    of_cell = np.floor((np.arctan2(y, x) + np.pi) / (2 * np.pi) * BINS).astype(int)
    for b in range(0, BINS, 7):
        ranges = np.sort(np.hypot(points[:, 0], points[:, 1])[(bins == b) & (points[:, 2] > 0.3)])
        every = np.hypot(points[:, 0], points[:, 1])[bins == b]
        limit = -9.0 if not len(every) else ranges[rank - 1] if len(ranges) >= rank else every.max()
        r = np.hypot(x, y)[of_cell == b]
        sure = np.abs(r - limit - GRID.cell_m) > 1e-4
        assert np.array_equal(got.visible()[of_cell == b][sure], (r <= limit + GRID.cell_m)[sure])
