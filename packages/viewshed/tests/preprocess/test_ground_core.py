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
    heights, std, seen, plane, support, level = call("ground_of_lows")
    assert np.allclose(heights, -1.8, atol=1e-5)
    assert np.allclose(std, 0.05)
    assert seen.all()
    assert plane == pytest.approx((0.0, 0.0, -1.8), abs=1e-6)
    assert support == 1.0
    assert np.isnan(level)


def test_held_ground_is_taken_where_only_the_earlier_sweep_saw_it() -> None:
    heights, std, seen = held()
    assert np.allclose(heights, -1.8, atol=1e-5)
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


def test_an_odd_lattice_has_ground_below_the_sensor_as_well() -> None:
    walked = np.full((9, 9), -1.8, np.float32)
    assert np.allclose(call("fill_ground", walked_m=walked, accepted=walked < 0, half_m=4.5)[0], -1.8)


@pytest.mark.parametrize("far_m", [120.0, 1e4, 1e20])
def test_what_lies_out_of_range_does_not_hide_that_the_sensor_is_tilted(far_m: float) -> None:
    points = np.column_stack([np.random.default_rng(0).uniform(-20, 20, (4000, 2)), np.full(4000, -1.8)])
    points[:, 2] += 0.5 * points[:, 0]
    points[:10] = far_m, 0.0, 0.0
    rotation = call("level_sweep", points=points.astype(np.float32), ring=None)[1]
    assert rotation[2] == pytest.approx(np.array([-0.5, 0.0, 1.0]) / np.hypot(0.5, 1.0), abs=1e-3)
