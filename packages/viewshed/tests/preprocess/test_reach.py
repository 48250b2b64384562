"""Reach: how far a sensor sees, and what a few returns can do to it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from viewshed import BevGrid, _core
from viewshed.arrays import F32
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.preprocess.leveling import level
from viewshed.preprocess.reach import returns_beyond, sensing_reach
from viewshed.sensors import LidarModel, lidar_model, sensor_names
from viewshed_lab.sim import Box, Scene, cast, junction

LEAST_REACH_M, USUAL_REACH_M = 20.0, 85.0
"""Of a sensor without a table: where its returns show nothing, and else the least."""


def open_street(seed: int) -> tuple[F32, NDArray[np.bool_]]:
    """Return ranges and isolated returns (35,000) of a street: ground with 1 / r², house fronts, and a far end."""
    rng = np.random.default_rng(seed)
    ground = 3.0 / rng.uniform(3.0 / 70.0, 3.0 / 4.0, 22_000)
    fronts = rng.uniform(8.0, 45.0, 12_500)
    far = rng.uniform(40.0, 80.0, 500)
    return np.concatenate([ground, fronts, far]).astype(np.float32), np.zeros(35_000, np.bool_)


@pytest.mark.parametrize("name", sensor_names())
def test_a_table_tells_its_reach_and_who_says_so(name: str) -> None:
    model = lidar_model(name)
    assert model.min_range_m < model.reach_m <= model.max_range_m
    assert len(model.reach_source) > 10
    assert sensing_reach(np.full(10, 300.0), np.zeros(10, np.bool_), model) == model.reach_m


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("at_m", [60.0, 100.0, 200.0])
def test_150_returns_more_move_it_by_no_more_than_5_percent(seed: int, at_m: float) -> None:
    range_m, isolated = open_street(seed)
    reach_m = sensing_reach(range_m, isolated)
    more = np.append(range_m, np.full(150, at_m, np.float32))
    assert sensing_reach(more, np.append(isolated, np.zeros(150, np.bool_))) == pytest.approx(reach_m, rel=0.05)


def test_isolated_returns_do_not_count() -> None:
    range_m, isolated = open_street(0)
    far, alone = np.full(5000, 190.0, np.float32), np.ones(5000, np.bool_)
    assert sensing_reach(np.append(range_m, far), np.append(isolated, alone)) == sensing_reach(range_m, isolated)


def of_field(points: F32, field_deg: float) -> F32:
    """Return the points (N, 3) of a sensor that looks ahead alone."""
    ahead: NDArray[np.bool_] = np.abs(np.rad2deg(np.arctan2(points[:, 1], points[:, 0]))) < field_deg / 2
    return points[ahead]


def range_after(points: F32, azimuth_deg: NDArray[np.float64], at_m: float) -> F32:
    """Return the ranges of the points and of one more return at ``at_m`` in each of the azimuths."""
    azimuth = np.deg2rad(azimuth_deg)
    more = at_m * np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], -1)
    range_m: F32 = np.linalg.norm(np.concatenate([points, more]), axis=1).astype(np.float32)
    return range_m


def reach_of(range_m: F32) -> float:
    return sensing_reach(range_m, np.zeros(len(range_m), np.bool_))


@pytest.mark.parametrize(("field_deg", "most"), [(360.0, 0.02), (120.0, 0.05), (60.0, 0.05), (30.0, 0.1)])
@pytest.mark.parametrize(("wedge_deg", "at_m"), [(2.0, 200.0), (30.0, 60.0), (360.0, 200.0)])
def test_a_far_wall_of_150_returns_in_a_narrow_field_does_not_decide_on_its_reach(
    field_deg: float, most: float, wedge_deg: float, at_m: float
) -> None:
    model = LidarModel("nobody's", np.deg2rad(np.linspace(-24.0, 8.0, 36)), azimuth_columns=1080, max_range_m=80.0)
    points = of_field(cast(model, junction(), 1.8).points, field_deg)
    # The narrower the field, the fewer the returns: 150 are up to 6 % of them here.
    assert len(points) > 80 * field_deg
    before_m = np.linalg.norm(points, axis=1).astype(np.float32)
    azimuth_deg = np.linspace(-0.5, 0.5, 150) * min(wedge_deg, field_deg)
    assert reach_of(range_after(points, azimuth_deg, at_m)) == pytest.approx(reach_of(before_m), rel=most)
    # The farthest ones removed, in the wedge and in all directions.
    inside = np.flatnonzero(np.abs(np.rad2deg(np.arctan2(points[:, 1], points[:, 0]))) < wedge_deg / 2)
    kept = np.delete(before_m, inside[np.argsort(-before_m[inside])][:150])
    assert reach_of(kept) == pytest.approx(reach_of(before_m), rel=most)


def test_what_is_usual_is_the_median_of_the_tables() -> None:
    assert np.median([lidar_model(name).reach_m for name in sensor_names()]) == USUAL_REACH_M


def test_a_table_without_a_reach_bounds_the_measured_one() -> None:
    model = LidarModel("mine", np.deg2rad([-10.0, 0.0]), 900, max_range_m=30.0)
    range_m = np.linspace(1.0, 90.0, 10_000)
    assert sensing_reach(range_m, np.zeros(10_000, np.bool_), model) == 30.0
    assert sensing_reach(np.zeros(0), np.zeros(0, np.bool_), model) == LEAST_REACH_M


def test_returns_beyond_the_maximum_are_counted() -> None:
    points = np.array([[99.0, 0, 0], [0, 101.0, 0], [80.0, 80.0, 0]], np.float32)
    assert returns_beyond(points, lidar_model("vlp16")) == 2
    assert returns_beyond(points, None) == 0


def test_what_lies_beyond_the_maximum_of_a_known_sensor_proves_nothing() -> None:
    model = lidar_model("os0_128")
    wall = Scene((Box(25.0, 0.0, 0.2, 60.0, 8.0),))
    honest = cast(model, wall, 1.8)
    ahead = np.abs(np.arctan2(honest.points[:, 1], honest.points[:, 0])) < np.deg2rad(8)
    moved = honest.points.copy()
    moved[ahead] *= (200.0 / np.linalg.norm(moved[ahead], axis=1))[:, None]
    grid = BevGrid(128, 64.0)
    removed, spoofed = honest.select(~ahead), honest.replace(points=moved)
    assert level(spoofed, grid).points.shape == level(removed, grid).points.shape
    claimed = ShadowMap(grid).estimate(spoofed).visible() & ~ShadowMap(grid).estimate(removed).visible()
    assert claimed.sum() == 0


@given(st.lists(st.floats(0.0, 300.0, width=32), max_size=60), st.integers(0, 9), st.sampled_from([150.0, np.inf]))
def test_what_returns_show_rests_on_the_quantile_of_numpy(ranges: list[float], out_of_ten: int, most_m: float) -> None:
    """Also of equal ranges, of those at most_m, and by rows."""
    range_m = np.array(ranges, np.float32)
    left_out = np.random.default_rng(len(ranges)).integers(0, 10, 100) < out_of_ten
    rows = np.arange(len(ranges), dtype=np.int32)[::-1].copy()
    supported = range_m[~left_out[rows] & (range_m <= most_m)].astype(np.float64)
    wanted = LEAST_REACH_M
    if len(supported):
        wanted = max(USUAL_REACH_M, np.cbrt(2.5 * np.quantile(supported, 0.9) * USUAL_REACH_M**2))
    reach_m = _core.sensing_reach(range_m, left_out, rows, most_m)
    assert reach_m == pytest.approx(min(wanted, most_m), rel=1e-9)
    alone = _core.sensing_reach(range_m[::-1].copy(), left_out[: len(range_m)].copy(), None, most_m)
    assert alone == reach_m
