"""What evidence of earlier sweeps has in common: when it abstains, and sweeps that are not what they should be."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.monitor.evidence.drives import YARD, leveled, look, measure

from viewshed import _core
from viewshed.monitor.evidence import EVIDENCE, MonitoredSweep
from viewshed.monitor.evidence.history import view_of

OF_POSES = ("arrival", "departure", "registration", "frame_noise")
OF_EARLIER = (*OF_POSES, "same_noise")


@pytest.mark.parametrize("name", OF_EARLIER)
def test_a_sweep_alone_says_nothing(name: str) -> None:
    assert np.isnan(measure(name, look(YARD))).all()


@pytest.mark.parametrize("name", OF_POSES)
def test_without_poses_it_abstains(name: str) -> None:
    sweeps = [look(YARD, number).replace(world_from_sensor=None) for number in range(3)]
    assert np.isnan(measure(name, *sweeps)).all()


@pytest.mark.parametrize("name", OF_POSES)
@pytest.mark.parametrize("times", [(5, 4, 3), (3, 3, 3), (0, 50, 100)], ids=["back", "standing still", "too far apart"])
def test_times_that_do_not_go_on_are_not_compared(name: str, times: tuple[int, ...]) -> None:
    assert np.isnan(measure(name, *(look(YARD, number) for number in times))).all()


@pytest.mark.parametrize("name", OF_EARLIER)
def test_a_world_that_stands_still_is_no_cause_for_worry(name: str) -> None:
    rng = np.random.default_rng(4)
    values = measure(name, *(look(YARD, number, 0.8 * number, rng) for number in range(6)))
    most = {"arrival": 5.0, "departure": 5.0, "registration": 1.0}
    assert np.nanmax(values) < most.get(name, 0.15)


def test_the_same_sweep_after_others_is_compared_anew() -> None:
    now, empty = leveled(look(YARD, 1)), leveled(look(YARD, 0))
    other = leveled(look(YARD[:4], 0))
    before = EVIDENCE["arrival"].measure(MonitoredSweep(now, (empty,)))
    after = EVIDENCE["arrival"].measure(MonitoredSweep(now, (other,)))
    assert before.max() < 8.0 < after.max()


def test_views_of_arrays_that_do_not_fit_are_refused() -> None:
    def arrays() -> dict[str, Any]:
        return {
            "squared_m2": np.full((2, 16), 9.0, np.float32),
            "phase": np.zeros(2, np.float32),
            "elevation": np.array([-0.1, 0.1], np.float32),
            "origin_m": np.zeros(2, np.float32),
            "points": np.ones((3, 3), np.float32),
            "height_m": np.ones(3, np.float32),
            "range_m": np.ones(3, np.float32),
            "azimuth": np.zeros(3, np.float32),
            "isolated": np.zeros(3, np.bool_),
            "sensor_from_level": np.eye(3, 4, dtype=np.float32),
        }

    view = _core.SweepView(**arrays())
    assert view.obstacles == 3
    wrong: list[tuple[str, NDArray[Any], str]] = [
        ("squared_m2", np.zeros((0, 16), np.float32), "1 to 4096 rings"),
        ("squared_m2", np.zeros((2, 3), np.float32), "8 to 65536 columns"),
        ("phase", np.zeros(3, np.float32), "for each ring"),
        ("phase", np.full(2, np.nan, np.float32), "phase must lie"),
        ("elevation", np.full(2, np.inf, np.float32), "must be finite"),
        ("height_m", np.ones(2, np.float32), "must be as long"),
        ("sensor_from_level", np.eye(4, dtype=np.float32), "shape"),
        ("sensor_from_level", np.full((3, 4), np.nan, np.float32), "finite"),
    ]
    for name, array, message in wrong:
        with pytest.raises(ValueError, match=message):
            _core.SweepView(**(arrays() | {name: array}))
    with pytest.raises(TypeError):
        _core.SweepView(**(arrays() | {"azimuth": np.zeros(3)}))
    odd = arrays() | {"azimuth": np.full(3, np.nan, np.float32), "range_m": np.full(3, np.inf, np.float32)}
    odd["points"] = np.full((3, 3), np.nan, np.float32)
    transforms, gaps_s = np.eye(3, 4, dtype=np.float32)[None], np.full(1, 0.1, np.float32)
    assert np.isfinite(_core.SweepView(**odd).follow([view], transforms, gaps_s, view, transforms[0], 72)[0]).all()
    with pytest.raises(ValueError, match="one for each view"):
        view.follow([view, view], transforms, gaps_s, view, transforms[0], 72)
    with pytest.raises(ValueError, match="gaps_s must be positive"):
        view.follow([view], transforms, -gaps_s, view, transforms[0], 72)
    with pytest.raises(ValueError, match="sectors"):
        view.repeats([view], 0)
    with pytest.raises(ValueError, match="two views"):
        view.jumps([view], transforms, gaps_s, 72)
    with pytest.raises(ValueError, match="same rings"):
        view.repeats([_core.SweepView(**(arrays() | {"squared_m2": np.ones((2, 20), np.float32)}))], 72)
    assert view.register_on([], np.zeros((0, 3, 4), np.float32))[0].shape == (0, 3)


def test_a_view_is_made_once() -> None:
    sweep = leveled(look(YARD))
    assert view_of(sweep) is view_of(sweep)
