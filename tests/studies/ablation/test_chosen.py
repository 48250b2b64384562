"""Points chosen against their victim."""

import numpy as np
import pytest

from viewshed.estimators import Estimator
from viewshed.estimators.ray_trace import ContinuousRayTrace
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.grid import BevGrid
from viewshed.studies.ablation.contest import UNTOUCHED, Said, attack_on, duels
from viewshed.studies.suite import Subject

pytestmark = pytest.mark.slow

GRID = BevGrid(32, 64.0)


def test_points_are_chosen_in_one_wedge_and_make_their_victim_claim_more(subject: Subject) -> None:
    victims: dict[str, Estimator] = {"shadow_map": ShadowMap(GRID), "continuous": ContinuousRayTrace(GRID)}
    told = duels(subject, victims, {"shadow_map": (12, 6), "continuous": (12,)}, (5, 0))
    said = {name: {case: Said.from_json(each) for case, each in cases.items()} for name, cases in told.items()}
    assert [list(cases) for cases in said.values()] == [[UNTOUCHED, "12", "6"], [UNTOUCHED, "12"]]
    for name, cases in said.items():
        clean = victims[name].estimate(subject.sample.sweep).visible()[subject.sample.known]
        assert sum(cases[UNTOUCHED].view.counts()[:2]) == clean.sum()
        assert sum(cases["12"].wedge.counts()[:2]) > sum(cases[UNTOUCHED].wedge.counts()[:2])
        assert len(cases[UNTOUCHED].sweeps) == 1
    cells = {each.wedge.cells for cases in said.values() for each in cases.values()}
    assert len(cells) == 1
    assert 0 < cells.pop() < 0.2 * subject.sample.known.sum()
    assert told == duels(subject, victims, {"shadow_map": (12, 6), "continuous": (12,)}, (5, 0))


def test_at_most_150_points_are_added_and_no_return_is_lost(subject: Subject) -> None:
    found = attack_on(ShadowMap(GRID), 5).search(subject.sample.sweep, np.random.default_rng(1))
    assert found.queries == 5
    assert 100 < found.tampered.added.sum() <= 150
    assert not found.tampered.removed.any()
