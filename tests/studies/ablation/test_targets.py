"""What was aimed at, met or missed."""

from dataclasses import replace

import numpy as np
import pytest

from viewshed.metrics import Scores
from viewshed.studies.ablation.contest import BENIGN, CASES, CLEAR, UNTOUCHED, Said
from viewshed.studies.ablation.plan import WHOLE, ablation_named
from viewshed.studies.ablation.results import OURS, RIVAL, SEVERAL, Results, Sure, targets_elsewhere, targets_of
from viewshed.studies.ablation.tables import SURE, chosen_table, sure_table
from viewshed.training.config import read_config


def _said(right: int, wrong: int) -> Said:
    scores = Scores()
    scores.add(np.full(right + wrong, 0.9, np.float32), np.arange(right + wrong) < right)
    return Said(scores, scores, [])


@pytest.mark.slow
def test_targets_are_met_or_missed_by_what_was_said() -> None:
    """A network that is right in 99 of 100 claims meets the first; one attack below the vote is named."""
    plan, every = ablation_named("small"), dict.fromkeys(CASES)
    ours = {case: _said(99, 1) for case in every} | {"relay": _said(80, 20)}
    vote = {case: _said(90, 10) for case in every}
    test, none = Results(plan, plan.config, {OURS: ours, RIVAL: vote, SEVERAL: vote}), Results(plan, plan.config, {})
    found = {each.what: each for each in targets_of(Results(plan, plan.config, {WHOLE: ours}), test, none)}
    assert found["F1, benign"].met
    assert found["F1, benign"].found == "0.995"
    assert found["the same less that of the vote"].met
    least = found["least lead over the vote under any attack"]
    assert (least.met, least.found.split()[1]) == (False, "(relay)")
    assert found["precision / recall in opened wedges after abstention, trained on"].met
    assert found["Brier score of one pass beside that of 20, benign"].met
    assert not found["ECE, benign"].met
    assert not any("sensor" in what or CLEAR in what for what in found)
    for case in (ours, vote):
        case[BENIGN].parts = {CLEAR: [2, 99, 1, 1, 0], "sensor A": [1, 9, 1, 1, 0], "sensor B": [1, 90, 0, 0, 0]}
    found = {each.what: each for each in targets_of(Results(plan, plan.config, {WHOLE: ours}), test, none)}
    assert found[f"F1, benign, cells {CLEAR}"].met
    least = found["least F1 of any sensor, benign"]
    assert (least.met, least.found) == (False, "0.900 (A)")
    assert targets_of(none, Results(plan, plan.config, {RIVAL: vote}), none) == []


def test_each_number_of_questions_has_a_target_and_the_untouched_sweep_none() -> None:
    plan = ablation_named("small")
    test = Results(plan, plan.config, {name: {case: _said(9, 1) for case in CASES} for name in (OURS, RIVAL)})
    met = {UNTOUCHED: _said(1, 9), "200": _said(95, 5), "1000": replace(_said(85, 15), wedge=_said(1, 3).view)}
    chosen = Results(plan, plan.config, {OURS: met, RIVAL: met})
    found = {each.what: each for each in targets_of(Results(plan, plan.config, {}), test, chosen)}
    few, many = (found[f"precision against 150 points chosen with {asked} questions"] for asked in (200, 1000))
    assert (few.met, many.met, many.found) == (True, False, "0.850 (wedge 0.250)")
    assert sum("chosen" in what for what in found) == 2
    twice = replace(met["200"], sweeps=[[95, 5, 0, 0], [0, 0, 0, 0]])
    table = chosen_table(Results(plan, plan.config, {OURS: {"200": twice}}))
    assert table.rows == [[OURS, "200", "2", ".950 / 1.000", ".950 / 1.000", f"{5 * 0.25 / 2:.0f}"]]


def test_other_settings_have_targets_of_their_own() -> None:
    plan = ablation_named("small")
    good = {case: _said(99, 1) for case in CASES}
    level = good | {BENIGN: _said(90, 10)}
    found = targets_elsewhere(Results(plan, "viewnet_indoor", {OURS: level, RIVAL: good}))
    assert [(each.what, each.wanted, each.met) for each in found] == [
        ("F1, benign", "≥ 0.94", True),
        ("mean F1 over the attacks, jamming apart", "≥ 0.93", True),
        ("least lead over the vote, benign and under any attack", "≥ 0", False),
    ]
    assert found[-1].found.endswith("(benign)")
    level[BENIGN].parts = {CLEAR: [1, 99, 0, 1, 0]}
    for_cars = targets_elsewhere(Results(plan, "viewnet_indoor_car", {OURS: level, RIVAL: good}))
    assert [(each.what, each.wanted, each.met) for each in for_cars[:2]] == [
        ("F1, benign", "≥ 0.96", False),
        (f"F1, benign, cells {CLEAR}", "≥ 0.98", True),
    ]
    assert for_cars[2:] == found[1:]
    assert targets_elsewhere(Results(plan, "viewnet_indoor", {})) == []
    assert Results(plan, "viewnet_indoor", {}).attacks == read_config("viewnet_indoor").attacks


def test_what_is_sure_is_told_and_nothing_else() -> None:
    rng = np.random.default_rng(3)
    prob = rng.random(5000).astype(np.float32)
    prob[:3] = 0.9, 0.1, np.nextafter(np.float32(0.1), np.float32(0))
    visible = rng.random(5000) < prob
    scores = Scores()
    scores.add(prob, visible)
    for sure in SURE:
        claimed, denied = prob >= np.float32(sure), prob < np.float32(1 - sure)
        found = Sure.of(scores, sure)
        assert found.share == (claimed | denied).mean()
        assert found.claims == visible[claimed].mean()
        assert found.denials == (~visible[denied]).mean()
    assert Sure.of(scores, 0.5).share == 1.0
    assert np.isnan([Sure.of(Scores(), 0.9).share, Sure.of(Scores(), 0.9).claims, Sure.of(Scores(), 0.9).denials]).all()


def test_what_is_sure_is_told_by_group_in_view_and_in_wedges() -> None:
    plan = ablation_named("small")
    said = {case: _said(99, 1) for case in CASES} | {"jamming": _said(1, 3), "relay": _said(1, 1)}
    view, wedge = (sure_table(Results(plan, plan.config, {OURS: said}), wedge=wedge) for wedge in (False, True))
    assert view.header == ["sure", "benign", "trained", "unseen", "jamming"]
    assert list(view.rows[4]) == ["0.9", "1.000 / .990 / –", "1.000 / .990 / –", "1.000 / .988 / –", "1.000 / .250 / –"]
    assert list(view.rows[5][1:]) == [".000 / – / –"] * 4
    assert wedge.header[1:] == ["trained", "unseen", "jamming", "trained, opening a view", "unseen, opening a view"]
    assert [row[3] for row in wedge.rows][:5] == ["1.000 / .250 / –"] * 5
    assert wedge.rows[0][5] == f"1.000 / {(2 * 99 + 1) / 202:.3f} / –".replace("0.", ".")
