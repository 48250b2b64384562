"""The measured table: laws over what is shipped, and counts by hand."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from viewshed.detections import ObjectKind
from viewshed.objects.detection_table import RANGE_M, RETURNS, DetectionTable, detection_table

CAR = np.array([ObjectKind.CAR], np.uint8)


def empty(sweeps: int = 10) -> DetectionTable:
    kinds, ranges = len(ObjectKind), len(RANGE_M) - 1
    counts = np.zeros((kinds, len(RETURNS), ranges), np.int64)
    by_range = np.zeros((kinds, ranges), np.int64)
    return DetectionTable(counts, counts, by_range, by_range, sweeps, {})


@given(st.floats(0, 1e5), st.floats(0, 1e5), st.floats(0, 200), st.sampled_from(list(ObjectKind)))
def test_more_expected_returns_are_never_found_more_rarely(
    one: float, other: float, range_m: float, kind: ObjectKind
) -> None:
    returns = np.sort([one, other])
    prob = detection_table().prob(returns, np.full(2, range_m), np.full(2, kind, np.uint8))
    assert 0.0 <= prob[0] <= prob[1] + 1e-12 <= 1.0 + 1e-12


def test_the_shipped_table_knows_what_a_detector_can_do() -> None:
    table = detection_table()
    none, few, many = table.prob(np.array([0, 8, 150]), np.full(3, 25.0), np.full(3, ObjectKind.CAR, np.uint8))
    assert none < 0.05
    assert 0.1 < few < 0.7
    assert many > 0.85


def test_many_counts_are_their_share_and_few_lean_on_the_rest() -> None:
    table = empty()
    found, total = table.found.copy(), table.total.copy()
    found[ObjectKind.CAR, 8, 2], total[ObjectKind.CAR, 8, 2] = 30_000, 40_000
    counted = replace(table, found=found, total=total)
    middle = np.array([47.0]), np.array([25.0])
    assert counted.prob(*middle, CAR) == pytest.approx([0.75], abs=0.01)
    # A pedestrian was never counted: what is known of a car with as many returns is said of it.
    assert counted.prob(*middle, np.array([ObjectKind.PEDESTRIAN], np.uint8)) == pytest.approx([0.75], abs=0.01)


def test_odds_of_false_detections_are_their_counts_and_lean_on_their_kind() -> None:
    """Three false for seven right; ranges without counts lean on their kind, kinds without counts on all."""
    table = empty()
    false, matched = table.false.copy(), table.matched.copy()
    false[ObjectKind.CAR, 1], matched[ObjectKind.CAR, 1] = 300_000, 700_000
    counted = replace(table, false=false, matched=matched)
    middles, cars = np.array([15.0, 47.5]), np.full(2, ObjectKind.CAR, np.uint8)
    assert counted.false_odds(middles, cars) == pytest.approx([3 / 7] * 2, rel=1e-3)
    assert counted.false_odds(middles, np.full(2, ObjectKind.TRUCK, np.uint8)) == pytest.approx([3 / 7] * 2, rel=1e-3)
    assert (detection_table().false_odds(np.array([1.0, 30.0, 1e6]), np.full(3, ObjectKind.CAR, np.uint8)) > 0.01).all()


def test_tables_that_contradict_themselves_are_refused() -> None:
    table = empty()
    with pytest.raises(ValueError, match="no more objects found than there are"):
        replace(table, found=table.found + 1)
    with pytest.raises(ValueError, match="must have classes"):
        replace(table, found=table.found[:2])
