"""The core of sensor identification: odd points and few."""

import numpy as np
import pytest
from tests.test_core_arrays import SENSOR_CALLS, STREET

from viewshed import _core


@pytest.mark.parametrize("name", SENSOR_CALLS)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30, 1e-40, 0.0])
@pytest.mark.parametrize("share", [1.0, 0.1])
def test_points_that_are_no_place_have_an_answer(name: str, value: float, share: float) -> None:
    points = STREET.points[:6000].copy()
    points[np.random.default_rng(0).random(points.shape) < share] = value
    SENSOR_CALLS[name](points)


@pytest.mark.parametrize("name", SENSOR_CALLS)
@pytest.mark.parametrize("count", [0, 1, 2, 255, 256, 257])
def test_few_points_have_an_answer(name: str, count: int) -> None:
    SENSOR_CALLS[name](STREET.points[:count].copy())


def test_the_returns_that_are_looked_at_are_those_that_numpy_draws() -> None:
    points = np.random.default_rng(3).permutation(STREET.points)
    rows = np.random.default_rng(0).integers(len(points), size=4096)
    moved = points.copy()
    moved[np.setdiff1d(np.arange(len(points)), rows)] = 0.0
    assert _core.find_motion(moved) == _core.find_motion(points)
