"""Points chosen against their victim."""

import numpy as np
import pytest
from tests.studies.by_hand import plain

from viewshed.estimators import Estimator
from viewshed.estimators.ray_trace import ContinuousRayTrace
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.fov.visibility import CAR
from viewshed.grid import BevGrid
from viewshed_lab.studies.ablation.evaluate import UNTOUCHED, attack_on, evaluate_chosen, evaluation_of, queried
from viewshed_lab.studies.records import VIEW, WEDGE, Results, Series
from viewshed_lab.studies.samples import StudySample

pytestmark = pytest.mark.slow

GRID = BevGrid(32, 64.0)
QUESTIONS = {"shadow_map": (12, 6), "continuous": (12,)}


def test_points_are_chosen_in_one_wedge_and_make_their_victim_claim_more(sample: StudySample) -> None:
    victims: dict[str, Estimator] = {"shadow_map": ShadowMap(GRID), "continuous": ContinuousRayTrace(GRID)}
    evaluation = evaluation_of(sample, victims, "roads", 0, 5, CAR)
    rows = list(evaluate_chosen(evaluation, QUESTIONS, 5))
    results = Results.of(None, rows)
    cases = {name: list(dict.fromkeys(s.case for s in results.series() if s.method == name)) for name in victims}
    assert cases == {"shadow_map": [UNTOUCHED, queried(12), queried(6)], "continuous": [UNTOUCHED, queried(12)]}
    for name, victim in victims.items():
        untouched, chosen = (Series("roads", name, case) for case in (UNTOUCHED, queried(12)))
        clean = victim.estimate(sample.sweep).visible()[sample.known]
        assert sum(results.scores([untouched]).counts()[:2]) == clean.sum()
        before, now = (results.counts(series.of(WEDGE)) for series in (untouched, chosen))
        assert now.both + now.over > before.both + before.over
        assert before.samples == 1
    cells = {results.counts(series).cells for series in results.series() if series.region == WEDGE}
    assert len(cells) == 1
    assert 0 < cells.pop() < 0.2 * sample.known.sum()
    assert {series.region for series in results.series()} == {VIEW, WEDGE}
    again = evaluate_chosen(evaluation_of(sample, victims, "roads", 0, 5, CAR), QUESTIONS, 5)
    assert plain(again) == plain(rows)


def test_at_most_150_points_are_added_and_no_return_is_lost(sample: StudySample) -> None:
    found = attack_on(ShadowMap(GRID), 5).search(sample.sweep, np.random.default_rng(1))
    assert found.queries == 5
    assert 100 < found.tampered.added.sum() <= 150
    assert not found.tampered.removed.any()
