"""Rows are pooled in any order, and intervals depend on scenes."""

from collections.abc import Iterable

import numpy as np
import pytest
from tests.studies.by_hand import refused, rows

from viewshed.metrics import ConfusionCounts, Scores
from viewshed_lab.studies.records import BENIGN, PAPER, SEVERAL, WEDGE, Case, Results, Row, Series, pool, row_of
from viewshed_lab.studies.statistics import bootstrap, f1, precision

WALL = Case("attack", "ghost_wall", "full")
KEY = Series("ugv", "vote", WALL)


def _results(more: Iterable[Row] = ()) -> Results[None]:
    """Two sweeps: one without average precision, and one that comes first though its number is larger."""
    found = [*rows("ugv", 2, WALL, {"vote": [[3, 1, 1, 5], [1, 0, 1, 0]]}, {"vote": 0.5}),
             *rows("ugv", 0, WALL, {"vote": [[1, 1, 3, 5], [0, 0, 1, 1]]})]  # fmt: skip
    for number in (2, 0):
        found += rows("ugv", number, BENIGN, {"vote": [[8, 0, 0, 2]]}, {"vote": 1.0})
        found.append(refused("ugv", number, Case("attack", "replay", "full"), "no earlier sweep"))
    return Results.of(None, [*found, *more])


def test_sweeps_are_pooled_whatever_their_order() -> None:
    found = _results()
    assert found.counts(KEY) == ConfusionCounts(4, 2, 4, 10, 5.0, 2)
    assert found.counts(KEY).over_m2 == 0.25
    assert found.counts(KEY.of(WEDGE)).recall == pytest.approx(1 / 3)
    assert found.each(KEY, precision).tolist() == pytest.approx([0.5, 0.75])
    assert found.numbers(KEY, "auprc").tolist() == [0.5]
    assert (found.sweeps("ugv"), found.sweeps("ugv", PAPER), found.scenes(KEY)) == (2, 0, ["s0", "s2"])
    assert found.refused == {("ugv", Case("attack", "replay", "full"), "no earlier sweep"): 2}
    nobody = Series("ugv", "nobody", WALL)
    assert np.isnan([found.counts(nobody).f1, *found.interval([nobody], f1)]).all()


def test_only_sweeps_that_met_a_kind_of_case_are_compared() -> None:
    found = _results(rows("ugv", 2, Case("adaptive", "a", "150"), {"vote": [[1, 0, 0, 9]]}))
    met = found.met("ugv", "adaptive")
    assert met.counts(KEY) == ConfusionCounts(3, 1, 1, 5, 2.5, 1)
    assert met.numbers(KEY, "auprc").tolist() == [0.5]
    assert found.met("ugv", "unaware").series() == []


def test_an_interval_spans_what_redrawn_scenes_give() -> None:
    """Two scenes with F1 of 1/3 and 3/4: redrawn, one of them alone has a chance of 1/4 each."""
    found = _results()
    assert found.interval([KEY], f1) == pytest.approx((1 / 3, 3 / 4))
    benign = KEY.under(BENIGN)
    assert found.interval([benign], f1) == (1.0, 1.0)
    assert found.interval([KEY, benign], f1) == pytest.approx((2 / 3, 7 / 8))


def test_intervals_draw_scenes_not_sweeps() -> None:
    """Three sweeps of one scene are one draw: precision is that of scene a, of b, or of both."""
    counts = np.array([[1.0, 1, 0, 0], [1, 1, 0, 0], [2, 2, 0, 0], [4, 0, 0, 0]])
    assert bootstrap([(counts, ["a", "a", "a", "b"])], precision) == pytest.approx((0.5, 1.0))
    # One scene cannot differ from others: it has no interval, alone or beside a case of two.
    assert np.isnan(bootstrap([(counts, ["a"] * 4)], precision)).all()
    assert np.isnan(bootstrap([(counts, ["a"] * 4), (counts, ["a", "a", "a", "b"])], precision)).all()
    assert np.isnan(bootstrap([(np.empty((0, 4)), [])], precision)).all()


def _scores(prob: float, visible: bool) -> Scores:
    scores = Scores()
    scores.add([prob], [visible], [0.1])
    return scores


def test_pooled_rows_are_the_sums() -> None:
    """Probabilities of .7 and .2, of which only the first is visible."""
    both = [row_of(KEY, "s", n, ConfusionCounts(n, 1, 0, 0), _scores(p, v), auprc=1.0)
            for n, p, v in ((0, 0.7, True), (1, 0.2, False))]  # fmt: skip
    [found] = pool(both)
    assert (found["sweep"], found["scene"], "auprc" in found) == (SEVERAL, "", False)
    results = Results.of(None, [found])
    assert results.counts(KEY) == ConfusionCounts(1, 2, 0, 0, 0.0, 2)
    assert results.scores([KEY]).counts() == (1, 0, 0, 1)
