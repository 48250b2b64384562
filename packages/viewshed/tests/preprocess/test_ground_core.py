"""The ground's functions of the native core: arrays that are not what they should be, and any number of threads."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed import _core

NODES, HALF_M = 64, 32.0
UPRIGHT = np.eye(3, dtype=np.float32)
LEVEL = np.array([0.0, 0.0, -1.8], np.float32)


@pytest.fixture(autouse=True)
def _threads() -> Iterator[None]:
    before = _core.threads()
    yield
    _core.set_threads(before)


def street(count: int = 60_000) -> NDArray[np.float32]:
    """Points of level ground 1.8 m below the sensor, with a step, and of things that stand on it."""
    rng = np.random.default_rng(1)
    points = rng.uniform(-40, 40, (count, 3))
    points[:, 2] = -1.8 + 0.2 * (points[:, 1] > 5) + rng.normal(0, 0.02, count)
    points[::7, 2] += rng.uniform(0, 2, len(points[::7]))
    return points.astype(np.float32)


def found(points: NDArray[np.float32], **named: Any) -> Any:
    given: dict[str, Any] = {
        "points": points,
        "isolated": np.zeros(len(points), np.bool_),
        "rotation": UPRIGHT,
        "near_m": 0.5,
        "far_m": 100.0,
        "heading": 0.0,
        "half_m": HALF_M,
        "nodes": NODES,
        "height_m": np.nan,
    }
    return _core.ground(**given | named)


def of_nine(**named: Any) -> Any:
    """Of nine points, or those that are named."""
    return found(**{"points": street(9), "isolated": np.zeros(9, np.bool_)} | named)


def lows() -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Level ground 1.8 m below the sensor in the middle of each node."""
    middles = np.arange(NODES, dtype=np.float32) + 0.5 - HALF_M
    x, y = np.meshgrid(middles, middles, indexing="ij")
    return np.stack([x, y, np.full_like(x, -1.8)], axis=-1), np.zeros((NODES, NODES), np.float32)


def held(**named: Any) -> Any:
    heights, std = np.full((NODES, NODES), -1.8, np.float32), np.full((NODES, NODES), 0.1, np.float32)
    seen = np.zeros((NODES, NODES), np.bool_)
    seen[:, NODES // 2 :] = True
    given: dict[str, Any] = {
        "heights_m": heights,
        "std_m": np.where(seen, std, np.float32(1.0)),
        "seen": seen,
        "half_m": HALF_M,
        "before_heights_m": heights,
        "before_std_m": std,
        "before_seen": np.ones_like(seen),
        "before_half_m": HALF_M,
        "before_from_now": np.eye(2, 4, dtype=np.float32),
        "now_from_before": np.array([0, 0, 1, 0], np.float32),
        "variance_m2": 0.0025,
        "plane": (0.0, 0.0, -1.8),
        "height_m": 0.0,
    }
    return _core.held_ground(**given | named)


def filled(**named: Any) -> Any:
    given: dict[str, Any] = {
        "walked_m": np.full((NODES, NODES), -1.8, np.float32),
        "accepted": np.ones((NODES, NODES), np.bool_),
        "plane": LEVEL,
        "half_m": HALF_M,
    }
    return _core.fill_ground(**given | named)


def of_lows(**named: Any) -> Any:
    points, rise = lows()
    given: dict[str, Any] = {"lows_m": points, "rise_m": rise, "half_m": HALF_M, "height_m": 1.8}
    return _core.ground_of_lows(**given | named)


def test_level_ground_is_found_where_it_lies() -> None:
    heights, std, seen, plane, support, level = of_lows()
    assert np.allclose(heights, -1.8, atol=1e-5)
    assert np.allclose(std, 0.05)
    assert seen.all()
    assert plane == pytest.approx((0.0, 0.0, -1.8), abs=1e-6)
    assert support == 1.0
    assert np.isnan(level)


def test_threads_do_not_change_the_ground() -> None:
    points = street()
    asks: list[Callable[[], Any]] = [lambda: found(points), of_lows, held, filled]
    for ask in asks:
        answers = []
        for count in (1, 2, 4):
            _core.set_threads(count)
            answers.append(ask())
        for other in answers[1:]:
            for one, two in zip(answers[0], other, strict=True):
                assert np.array_equal(one, two, equal_nan=True)


@pytest.mark.parametrize("count", [0, 1, 5])
def test_without_enough_points_level_ground_is_assumed(count: int) -> None:
    *_, support, level = found(street(1000)[:count])
    assert support == 0.0
    assert level == -1.8
    *_, level = found(street(1000)[:count], height_m=0.7)
    assert level == -0.7


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
    points = street()
    points[::5, 2] = value
    points[1::5, 0] = value
    heights, std, *_ = found(points)
    assert np.isfinite(heights).all()
    assert np.isfinite(std).all()
    assert np.isnan(_core.free_plane(points)[1]) or _core.free_plane(points)[1] <= 1.0


SQUARE, MASK = np.zeros((NODES, NODES), np.float32), np.zeros((NODES, NODES), np.bool_)


@pytest.mark.parametrize(
    ("ask", "named", "message"),
    [
        (of_nine, {"isolated": np.zeros(8, np.bool_)}, "isolated must have one row"),
        (of_nine, {"rotation": UPRIGHT[:2]}, r"rotation must be \(3, 3\)"),
        (of_nine, {"rotation": UPRIGHT * np.float32(np.nan)}, "rotation must be finite"),
        (of_nine, {"far_m": np.inf}, "far_m must be at most"),
        (of_nine, {"far_m": np.nan}, "far_m must be at most"),
        (of_nine, {"nodes": 1}, "a lattice must have 2 to 1024 nodes"),
        (of_nine, {"nodes": 100_000}, "a lattice must have 2 to 1024 nodes"),
        (of_nine, {"half_m": 0.0}, "half_m must lie in"),
        (of_nine, {"half_m": np.nan}, "half_m must lie in"),
        (of_lows, {"lows_m": lows()[0][:5]}, r"lows_m must be \(n, n, 3\)"),
        (of_lows, {"lows_m": lows()[0] * np.float32(3.0)}, "lows_m must lie on the lattice"),
        (of_lows, {"rise_m": SQUARE[:5]}, r"rise_m must be \(n, n\)"),
        (filled, {"accepted": MASK[:5]}, r"walked_m and accepted must be \(n, n\)"),
        (filled, {"walked_m": SQUARE * np.float32(np.nan)}, "walked_m must be finite"),
        (filled, {"plane": LEVEL[:2]}, "plane must be"),
        (filled, {"plane": LEVEL + np.float32(np.inf)}, "plane must be finite"),
        (held, {"std_m": SQUARE[:5]}, r"std_m and seen must be \(n, n\)"),
        (held, {"before_seen": MASK[:5]}, r"std_m and seen must be \(n, n\)"),
        (held, {"before_heights_m": SQUARE * np.float32(np.nan)}, "heights_m must be finite"),
        (held, {"before_from_now": SQUARE}, r"before_from_now must be \(2, 4\)"),
        (held, {"height_m": np.nan}, "height_m must be finite"),
    ],
)
def test_values_out_of_range_are_a_value_error(ask: Callable[..., Any], named: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ask(**named)


@pytest.mark.parametrize(
    ("ask", "named"),
    [
        (of_nine, {"points": np.zeros((9, 3))}),
        (of_nine, {"points": np.zeros((9, 4), np.float32)}),
        (of_nine, {"isolated": np.zeros(9, np.uint8)}),
        (of_lows, {"lows_m": lows()[0].astype(np.float64)}),
        (filled, {"walked_m": SQUARE.T[::2]}),
        (held, {"plane": (0.0, 0.0)}),
    ],
)
def test_arrays_of_another_kind_are_a_type_error(ask: Callable[..., Any], named: dict[str, Any]) -> None:
    with pytest.raises(TypeError, match="incompatible function arguments"):
        ask(**named)
