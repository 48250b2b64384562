import datetime
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from stonesoup.metricgenerator.ospametric import GOSPAMetric, OSPAMetric
from stonesoup.types.state import State

from viewshed.arrays import F64
from viewshed.objects.metrics import IdSwitches, gospa, match_objects, ospa_m

POINTS = st.integers(0, 7).flatmap(lambda n: arrays(np.float64, (n, 2), elements=st.floats(-8, 8, width=32)))


def _states(points: F64) -> list[Any]:
    return [State(point[:, None], timestamp=datetime.datetime(2026, 1, 1)) for point in points]


@given(tracks=POINTS, truths=POINTS, cutoff=st.sampled_from([1.0, 4.0]), order=st.sampled_from([1.0, 2.0]))
def test_gospa_is_that_of_stone_soup(tracks: F64, truths: F64, cutoff: float, order: float) -> None:
    mine = gospa(tracks, truths, cutoff_m=cutoff, order=order)
    if not len(tracks) and not len(truths):
        assert mine.distance_m == 0.0
        return
    metric: Any = GOSPAMetric(p=order, c=cutoff)
    theirs = metric.compute_gospa_metric(_states(tracks), _states(truths))[0].value
    assert mine.distance_m == pytest.approx(theirs["distance"], abs=1e-9)
    assert mine.localization == pytest.approx(theirs["localisation"], abs=1e-9)
    assert (mine.missed, mine.false) == pytest.approx((theirs["missed"], theirs["false"]), abs=1e-9)
    # Heights do not count.
    raised = np.column_stack([tracks, np.arange(len(tracks))])
    assert gospa(raised, truths, cutoff_m=cutoff, order=order) == mine


@given(tracks=POINTS, truths=POINTS, cutoff=st.sampled_from([1.0, 4.0]))
def test_ospa_is_that_of_stone_soup(tracks: F64, truths: F64, cutoff: float) -> None:
    mine = ospa_m(tracks, truths, cutoff_m=cutoff)
    if not len(tracks) and not len(truths):
        assert mine == 0.0
        return
    metric: Any = OSPAMetric(p=1.0, c=cutoff)
    assert mine == pytest.approx(metric.compute_OSPA_distance(_states(tracks), _states(truths)).value, abs=1e-9)


def test_a_lost_object_that_is_found_by_a_new_track_is_one_switch() -> None:
    car = np.array([[5.0, 0.0]])
    other, none = np.array([7]), np.zeros(0, np.int64)
    times = [
        match_objects(car + 0.1, np.array([1]), car, other),
        match_objects(np.zeros((0, 2)), none, car, other),
        match_objects(car + 0.1, np.array([2]), car, other),
        match_objects(car + 0.1, np.array([2]), car, other),
    ]
    assert IdSwitches().add(*times) == 1
    assert IdSwitches().add(*times[2:]) == 0


def test_as_many_pairs_as_can_be_come_before_a_smaller_sum() -> None:
    truths = np.array([[0.0, 0.0], [1.9, 0.0]])
    tracks = np.array([[0.05, 0.0], [-1.9, 0.0]])  # the nearest pair alone would leave two without a partner
    found = match_objects(tracks, np.array([1, 2]), truths, np.array([1, 2]))
    assert found.truth_of_track.tolist() == [1, 0]


def test_bad_input_is_refused() -> None:
    point = np.zeros((1, 2))
    with pytest.raises(ValueError, match="points must be finite"):
        gospa(np.array([[np.nan, 0.0]]), point)
    with pytest.raises(ValueError, match=r"cutoff_m must be positive and finite, got 0\.0"):
        ospa_m(point, point, cutoff_m=0.0)
    with pytest.raises(ValueError, match=r"order must be at least 1 and finite, got 0\.5"):
        gospa(point, point, order=0.5)
