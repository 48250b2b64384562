"""Contestants that are told of the past: which, of what, and what becomes of them on the page."""

from dataclasses import replace

import numpy as np
import pytest

from viewshed.estimators import Estimator
from viewshed.estimators.first_blocker import FirstBlocker
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.grid import BevGrid
from viewshed.preprocess.leveling import level
from viewshed.studies.ablation.contest import (
    ALONE,
    ATTACKED,
    BARE,
    BENIGN,
    HONEST,
    WARY,
    Remembered,
    Said,
    score,
    shots_of,
)
from viewshed.studies.ablation.plan import ablation_named
from viewshed.studies.ablation.results import Results
from viewshed.studies.ablation.tables import ablation_table, views_table
from viewshed.studies.suite import Subject
from viewshed.threats.attacks import ATTACKS

pytestmark = pytest.mark.slow

GRID = BevGrid(32, 64.0)
SM = ShadowMap(GRID)


def test_up_to_five_sweeps_of_the_same_agent_come_before(subject: Subject) -> None:
    memory, now = Remembered.of(subject), subject.sample.sweep
    assert 2 <= len(memory.sweeps) <= 5
    times = [sweep.t_ns or 0 for sweep in (*memory.sweeps, now)]
    assert times == sorted(set(times))
    assert {sweep.agent for sweep in memory.sweeps} == {now.agent}
    assert np.allclose(np.diff(times), times[-1] - times[-2])
    recorded = replace(subject, frame=None)
    assert Remembered.of(recorded).sweeps == subject.earlier


def test_the_past_is_honest_or_attacked_as_well(subject: Subject) -> None:
    memory = Remembered.of(subject)
    for shot in shots_of(subject, 5, 1):
        leveled = level(shot.sweep, GRID)
        pasts = memory.pasts(leveled, shot.struck, (5, 1, shot.case))
        assert list(pasts) == [ALONE, HONEST, *([] if shot.case in (BENIGN, BARE) else [ATTACKED])]
        assert [kind for kind, past in pasts.items() if past is None] == [ALONE]
        if shot.case == "jamming":
            honest, attacked = pasts[HONEST], pasts[ATTACKED]
            assert honest is not None
            assert attacked is not None
            assert [len(each.points) for each in honest.earlier] != [len(each.points) for each in attacked.earlier]


def test_only_those_whom_the_past_helps_are_told_of_it(subject: Subject) -> None:
    estimators: dict[str, Estimator] = {"shadow_map": SM, "first_blocker": FirstBlocker(GRID)}
    found = score({1: subject}, estimators, 5, remembering=("shadow_map", "first_blocker", "nobody"))
    kinds = ALONE, HONEST, f"{WARY}{HONEST}", ATTACKED, f"{WARY}{ATTACKED}"
    assert list(found) == ["shadow_map", "first_blocker", *(f"shadow_map, {kind}" for kind in kinds)]
    assert found[f"shadow_map, {ALONE}"].keys() == found["shadow_map"].keys()
    assert {BENIGN, BARE} & set(found[f"shadow_map, {ATTACKED}"]) == set()
    assert set(found[f"shadow_map, {HONEST}"]) == set(found["shadow_map"])
    assert score({1: subject}, estimators, 5) == {name: found[name] for name in estimators}
    alone, told = (
        Said.from_json(found[name]["far_wall"]).wedge.counts() for name in ("shadow_map", "shadow_map, past")
    )
    assert told[0] <= alone[0]
    assert told[1] <= alone[1]
    wary = Said.from_json(found[f"shadow_map, {WARY}{HONEST}"]["far_wall"]).wedge.counts()
    assert wary[0] <= told[0]
    assert wary[1] <= told[1]


def test_sweeps_with_fewer_earlier_ones_have_no_part_in_it(subject: Subject) -> None:
    recorded = replace(subject, frame=None)
    assert len(Remembered.of(recorded).sweeps) == 2
    assert list(score({1: recorded}, {"shadow_map": SM}, 5, remembering=("shadow_map",))) == ["shadow_map"]


def test_the_page_has_them_apart_and_nothing_where_nothing_was_said() -> None:
    right = Said()
    right.view.add(np.array([0.9]), np.array([True]))
    cases = dict.fromkeys(ATTACKS, right)
    both = {BENIGN: right, BARE: right, **cases}
    said = {
        "whole": both,
        "viewnet": both,
        f"viewnet, {HONEST}": both,
        f"viewnet, {ATTACKED}": cases,
        "majority_vote": both,
    }
    results = Results(ablation_named("small"), "viewnet_road", said)
    assert results.alone == ["whole", "viewnet", "majority_vote"]
    names = results.remembering("viewnet")
    assert names == [f"viewnet, {HONEST}", f"viewnet, {ATTACKED}"]
    table = views_table(results, names)
    assert table.header == ["case", *names]
    assert table.rows[0][1:] == ["**1.000**", "–"]
    assert [row[0] for row in ablation_table(results).rows] == list(said)
