"""Methods that are given earlier sweeps: which, of what, and what becomes of them on the page."""

from collections.abc import Iterable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from tests.studies.ablation.by_hand import setting_results
from tests.studies.by_hand import plain

from viewshed.estimators import Estimator
from viewshed.estimators.first_blocker import FirstBlocker
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.grid import BevGrid
from viewshed.preprocess.leveling import level
from viewshed_lab.studies.ablation.evaluate import (
    ALONE,
    ATTACKED,
    ATTACKS,
    CASES,
    CONFIRMED,
    HONEST,
    PriorSweeps,
    evaluate,
)
from viewshed_lab.studies.ablation.tables import ablation_table, views_table
from viewshed_lab.studies.cases import BARE, DEFAULT, apply, attack_of, generator
from viewshed_lab.studies.records import BENIGN, WEDGE, Case, Domain, Results, Row, Series
from viewshed_lab.studies.samples import StudySample
from viewshed_lab.training.samples import AttackedSweep

pytestmark = pytest.mark.slow

GRID = BevGrid(32, 64.0)
SM = ShadowMap(GRID)
WALL = Case("attack", "far_wall", DEFAULT)


def test_up_to_five_sweeps_of_the_same_agent_come_before(sample: StudySample) -> None:
    prior, now = PriorSweeps.of(sample), sample.sweep
    assert 2 <= len(prior.sweeps) <= 5
    times = [sweep.t_ns or 0 for sweep in (*prior.sweeps, now)]
    assert times == sorted(set(times))
    assert {sweep.agent for sweep in prior.sweeps} == {now.agent}
    assert np.allclose(np.diff(times), times[-1] - times[-2])
    recorded = replace(sample, frame=None)
    assert PriorSweeps.of(recorded).sweeps == sample.earlier


def test_a_history_is_honest_or_attacked_as_well(sample: StudySample) -> None:
    prior = PriorSweeps.of(sample)
    for case in CASES:
        tampered = apply(case, sample, generator(5, case.name))
        attack = attack_of(case, sample, 64.0) if case in ATTACKS else None
        attacked_sweep = None if case == BARE else AttackedSweep(tampered.sweep, attack, tampered.wedge)
        histories = prior.histories(level(tampered.sweep, GRID), attacked_sweep, generator(5, "past"))
        assert list(histories) == [ALONE, HONEST, *([ATTACKED] if case in ATTACKS else [])]
        assert [kind for kind, history in histories.items() if history is None] == [ALONE]
        if case.name == "jamming":
            honest, attacked = histories[HONEST], histories[ATTACKED]
            assert honest is not None
            assert attacked is not None
            assert [len(one.points) for one in honest.earlier] != [len(one.points) for one in attacked.earlier]


def _results(rows: Iterable[Row]) -> Results[None]:
    return Results.of(None, rows)


def test_only_those_whom_history_helps_are_given_one(sample: StudySample) -> None:
    estimators: dict[str, Estimator] = {"shadow_map": SM, "first_blocker": FirstBlocker(GRID)}
    run = partial(evaluate, {1: sample}, estimators, "roads", 5)
    records = run(with_history=("shadow_map", "first_blocker", "nobody"))
    found = _results(records)
    kinds = ALONE, HONEST, f"{CONFIRMED}{HONEST}", ATTACKED, f"{CONFIRMED}{ATTACKED}"
    assert Domain(found, "roads").methods == ["shadow_map", "first_blocker", *(f"shadow_map, {kind}" for kind in kinds)]

    def cases(method: str) -> set[Case]:
        return {series.case for series in found.series() if series.method == method}

    assert cases(f"shadow_map, {ALONE}") == cases(f"shadow_map, {HONEST}") == cases("shadow_map") == set(CASES)
    assert {BENIGN, BARE} & cases(f"shadow_map, {ATTACKED}") == set()
    alone = [row for row in records if row["method"] in estimators]
    assert plain(run()) == plain(alone)
    bare, helped, confirmed = (
        found.counts(Series("roads", name, WALL, WEDGE))
        for name in ("shadow_map", "shadow_map, past", f"shadow_map, {CONFIRMED}{HONEST}")
    )
    assert bare.both >= helped.both >= confirmed.both
    assert bare.over >= helped.over >= confirmed.over


def test_sweeps_with_fewer_earlier_ones_have_no_part_in_it(sample: StudySample) -> None:
    recorded = replace(sample, frame=None)
    assert len(PriorSweeps.of(recorded).sweeps) == 2
    found = _results(evaluate({1: recorded}, {"shadow_map": SM}, "roads", 5, with_history=("shadow_map",)))
    assert Domain(found, "roads").methods == ["shadow_map"]


def test_the_page_has_them_apart_and_nothing_where_nothing_was_found() -> None:
    cases = dict.fromkeys(ATTACKS, (1, 0))
    both = {BENIGN: (1, 0), BARE: (1, 0), **cases}
    found = {
        "whole": both, "viewnet": both, f"viewnet, {HONEST}": both, f"viewnet, {ATTACKED}": cases,
        "majority_vote": both,
    }  # fmt: skip
    results = setting_results(found)
    assert results.alone == ["whole", "viewnet", "majority_vote"]
    names = results.helped
    assert names == [f"viewnet, {HONEST}", f"viewnet, {ATTACKED}"]
    table = views_table(results, names)
    assert table.header == ["case", *names]
    assert table.rows[0][1:] == ["**1.000**", "–"]
    assert [row[0] for row in ablation_table(results).rows] == list(found)
