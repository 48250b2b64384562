"""The ground's functions of the native core: what they find by hand, and odd points."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.test_core_arrays import NODES, call, street_points

from viewshed import _core


def found(points: NDArray[np.float32], height_m: float | None = None) -> Any:
    """Heights and deviations of the ground, its support, and the height of the sensor above it."""
    _, _, above_m, (heights, std, *_, support), _ = call("level_sweep", points=points, ring=None, height_m=height_m)
    return heights, std, support, above_m


def held(**named: Any) -> Any:
    return call("held_ground", **named)


def test_level_ground_is_found_where_it_lies() -> None:
    heights, seen, plane, support, level = call("ground_of_lows")
    assert np.allclose(heights, -1.8, atol=1e-5)
    assert seen.all()
    assert plane == pytest.approx((0.0, 0.0, -1.8), abs=1e-6)
    assert support == 1.0
    assert np.isnan(level)


def test_held_ground_is_taken_where_only_the_earlier_sweep_saw_it() -> None:
    heights, std, seen = held()
    assert np.allclose(heights, -1.8, atol=1e-5)
    assert np.allclose(std[~seen], 1.0)
    # Bilinear heights need the next node, so that the last row and column stay as they were.
    assert seen[:-1, : NODES // 2].all()
    assert std[5, 5] == pytest.approx(np.hypot(np.sqrt(0.1**2 + 0.0025), 0.002 * np.hypot(26.5, 26.5)))
    assert held(before_seen=np.zeros((NODES, NODES), np.bool_)) is None
    assert held(before_heights_m=np.full((NODES, NODES), 1.0, np.float32)) is None


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30, -1e30, 1e-40])
def test_points_that_are_no_place_are_no_ground(value: float) -> None:
    points = street_points()
    points[::5, 2] = value
    points[1::5, 0] = value
    heights, std, *_ = found(points)
    assert np.isfinite(heights).all()
    assert np.isfinite(std).all()
    assert np.isnan(_core.free_plane(points)[1]) or _core.free_plane(points)[1] <= 1.0


def test_points_at_the_sensor_are_no_plane() -> None:
    assert _core.free_plane(np.zeros((60, 3), np.float32))[1] == 0.0


@pytest.mark.parametrize("far_m", [120.0, 1e4, 1e20])
def test_what_lies_out_of_range_does_not_hide_that_the_sensor_is_tilted(far_m: float) -> None:
    points = np.column_stack([np.random.default_rng(0).uniform(-20, 20, (4000, 2)), np.full(4000, -1.8)])
    points[:, 2] += 0.5 * points[:, 0]
    points[:10] = far_m, 0.0, 0.0
    rotation = call("level_sweep", points=points.astype(np.float32), ring=None)[1]
    assert rotation[2] == pytest.approx(np.array([-0.5, 0.0, 1.0]) / np.hypot(0.5, 1.0), abs=1e-3)


# Maps of returns in polar bins, and the ground predicted from them.

RETURNS, LOWEST, SECOND_LOWEST, HIGHEST, SEEN, SEEN_HEIGHT, PASSING, AIMED = range(8)


def mapped(points: list[list[float]], seen_m: float | None = None) -> Any:
    """Maps of level points (M, 3), the sensor 2 m above the ground; ground at this height is seen all around."""
    array = np.array(points, np.float32).reshape(-1, 3)
    azimuth, range_m = np.arctan2(array[:, 1], array[:, 0]), np.hypot(array[:, 0], array[:, 1])
    seen = np.full((NODES, NODES), seen_m is not None)
    heights_m = np.full((NODES, NODES), seen_m or 0.0, np.float32)
    return _core.map_returns(array, azimuth, range_m, 2.0, heights_m, seen, 32.0)


def bin_of(x_m: float, y_m: float = 0.01) -> tuple[int, int]:
    """Bins of azimuth and range: 128 a turn, and 16 for each doubling from 1.5 m on."""
    return int((np.arctan2(y_m, x_m) / np.pi + 1) * 64), int(16 * np.log2(np.hypot(x_m, y_m) / 1.5))


def test_returns_are_counted_in_their_bins() -> None:
    maps = mapped([[6.0, 0.01, 0.5], [6.01, 0.01, 0.1], [6.02, 0.01, 0.3], [-30.0, 0.01, -1.0], [0.5, 0.0, 0.0]])
    assert maps.shape == (8, 128, 96)
    at = bin_of(6.0)
    assert [float(maps[which][at]) for which in (RETURNS, LOWEST, SECOND_LOWEST, HIGHEST)] == pytest.approx(
        [3, 0.1, 0.3, 0.5]
    )
    behind = bin_of(-30.0)
    assert [float(maps[which][behind]) for which in (RETURNS, LOWEST, SECOND_LOWEST, HIGHEST)] == [1, -1, -1, -1]
    assert maps[RETURNS].sum() == 4
    assert maps[SEEN].sum() == 0


def test_the_lowest_beam_passes_over_the_bins_before_its_return() -> None:
    maps = mapped([[20.0, 0.01, 0.0], [10.0, 0.01, 1.5]])
    a, end = bin_of(20.0)
    middle_m = 1.5 * 2 ** ((np.arange(96) + 0.5) / 16)
    assert np.allclose(maps[PASSING][a, :end], 2.0 - 0.1 * middle_m[:end], atol=1e-4)
    assert np.isinf(maps[PASSING][a, end:]).all()
    assert np.isinf(maps[PASSING][a + 5]).all()
    # It falls by .1 a meter, and would meet level ground at 20 m; the other one at 40 m.
    assert maps[AIMED][bin_of(20.0)] == 1
    assert maps[AIMED][bin_of(40.0)] == 1


def test_seen_ground_is_mapped_and_what_lies_below_it_is_left_out() -> None:
    maps = mapped([[12.0, 0.01, 0.0], [15.0, 0.01, -2.5]], seen_m=0.0)
    a, k = bin_of(12.0)
    assert maps[SEEN][a, :k].all()
    assert not maps[SEEN_HEIGHT].any()
    assert maps[RETURNS][a].sum() == 1
    assert maps[RETURNS][bin_of(12.0)] == 1
    # Without seen ground before it, it may be a pit.
    assert mapped([[12.0, 0.01, 0.0], [15.0, 0.01, -2.5]])[RETURNS][a].sum() == 2


def test_predicted_ground_continues_seen_ground() -> None:
    rng = np.random.default_rng(4)
    azimuth = rng.uniform(-np.pi, np.pi, 6000)
    range_m = rng.choice([4.0, 6.0, 9.0, 14.0, 22.0], 6000)
    points = np.stack([np.cos(azimuth) * range_m, np.sin(azimuth) * range_m, np.zeros(6000)], 1).astype(np.float32)
    nodes_m = np.arange(NODES) + 0.5 - NODES / 2
    node_m = np.hypot(nodes_m[:, None], nodes_m[None])
    seen = np.abs(node_m[..., None] - [4.0, 6.0, 9.0, 14.0, 22.0]).min(-1) < 0.5
    heights_m, std_m = (np.where(seen, value, np.float32(99.0)).astype(np.float32) for value in (0.0, 0.05))
    of = {"points": points, "azimuth": azimuth.astype(np.float32), "range_m": range_m.astype(np.float32),
          "rows": np.arange(6000, dtype=np.int32), "sensor_height_m": 2.0}  # fmt: skip
    found_m, found_std_m = call("complete_ground", heights_m=heights_m, std_m=std_m, seen=seen, **of)
    near = node_m < 22.0
    assert np.abs(found_m[near]).max() < 0.15
    assert (found_m[seen] == 0.0).all()
    assert (found_std_m[seen] == np.float32(0.05)).all()
    assert (found_std_m[~seen] >= 0.0).all()
    # Points that are left out show nothing.
    none = call("complete_ground", heights_m=heights_m, std_m=std_m, seen=seen, left_out=np.ones(6000, np.bool_), **of)
    assert not np.array_equal(none[1], found_std_m)
