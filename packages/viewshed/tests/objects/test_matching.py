"""Matching against cases by hand."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from viewshed.objects.matching import match_boxes


def boxes_at(*middles: tuple[float, float]) -> np.ndarray:
    return np.array([[x, y, 1.0, 4.0, 2.0, 1.5, 0.0] for x, y in middles]).reshape(-1, 7)


def test_the_nearest_are_matched_first_and_each_once() -> None:
    true = boxes_at((5.0, 0.0), (8.0, 0.0))
    assert match_boxes(boxes_at((6.4, 0.0), (5.1, 0.0), (6.6, 0.0)), true).tolist() == [-1, 0, 1]
    assert match_boxes(boxes_at((6.4, 0.0)), true[:0]).tolist() == [-1]
    assert match_boxes(true[:0], true).tolist() == []


@given(st.integers(0, 2**31))
def test_no_true_box_is_matched_twice_and_none_too_far(seed: int) -> None:
    rng = np.random.default_rng(seed)
    found, true = (boxes_at(*rng.uniform(-5, 5, (rng.integers(0, 9), 2))) for _ in range(2))
    match = match_boxes(found, true)
    taken = match[match >= 0]
    assert len(set(taken.tolist())) == len(taken)
    assert (np.hypot(*(found[match >= 0, :2] - true[taken, :2]).T) <= 2.0).all()
