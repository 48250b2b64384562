"""What was aimed at, met or missed."""

import numpy as np
from tests.studies.ablation.by_hand import Claims, setting_results

from viewshed.metrics import ConfusionCounts, Scores
from viewshed_lab.studies.ablation.evaluate import CASES, UNTOUCHED, queried
from viewshed_lab.studies.ablation.plan import WHOLE
from viewshed_lab.studies.ablation.results import OURS, RIVAL, SEVERAL, Sure, targets_elsewhere, targets_of
from viewshed_lab.studies.ablation.tables import SURE, chosen_table, sure_table
from viewshed_lab.studies.cases import DEFAULT
from viewshed_lab.studies.records import BENIGN, Case
from viewshed_lab.studies.samples import CLEAR
from viewshed_lab.training.config import read_config

RELAY, JAMMING = Case("attack", "relay", DEFAULT), Case("attack", "jamming", DEFAULT)
NONE = setting_results({})


def _every(right: int, wrong: int) -> dict[Case, Claims]:
    return dict.fromkeys(CASES, (right, wrong))


def test_targets_are_met_or_missed_by_what_was_found() -> None:
    """A network that is right in 99 of 100 claims meets the first; one attack below the vote is named."""
    ours, vote = _every(99, 1) | {RELAY: (80, 20)}, _every(90, 10)
    methods = {OURS: ours, RIVAL: vote, SEVERAL: vote}
    whole = setting_results({WHOLE: ours})
    found = {target.what: target for target in targets_of(whole, setting_results(methods), NONE)}
    assert found["F1, benign"].met
    assert found["F1, benign"].found == "0.995"
    assert found["the same less that of the vote"].met
    least = found["least lead over the vote under any attack"]
    assert (least.met, least.found.split()[1]) == (False, "(relay)")
    assert found["precision / recall in opened wedges after abstention, trained on"].met
    assert found["Brier score of one pass beside that of 20, benign"].met
    assert not found["ECE, benign"].met
    assert not any("sensor" in what or CLEAR in what for what in found)
    parts = {
        (method, BENIGN, part): ConfusionCounts(*cells)
        for method in (OURS, RIVAL)
        for part, cells in ((CLEAR, (99, 1, 1, 0)), ("sensor A", (9, 1, 1, 0)), ("sensor B", (90, 0, 0, 0)))
    }
    found = {target.what: target for target in targets_of(whole, setting_results(methods, parts=parts), NONE)}
    assert found[f"F1, benign, cells {CLEAR}"].met
    least = found["least F1 of any sensor, benign"]
    assert (least.met, least.found) == (False, "0.900 (A)")
    assert targets_of(NONE, setting_results({RIVAL: vote}), NONE) == []


def test_each_number_of_questions_has_a_target_and_the_untouched_sweep_none() -> None:
    test = setting_results({name: _every(9, 1) for name in (OURS, RIVAL)})
    met: dict[Case, Claims] = {UNTOUCHED: (1, 9), queried(200): (95, 5), queried(1000): (85, 15)}
    chosen = setting_results({OURS: met, RIVAL: met}, wedges={(OURS, queried(1000)): (1, 3)})
    found = {target.what: target for target in targets_of(NONE, test, chosen)}
    few, many = (found[f"precision against 150 points chosen with {count} queries"] for count in (200, 1000))
    assert (few.met, many.met, many.found) == (True, False, "0.850 (wedge 0.250)")
    assert sum("chosen" in what for what in found) == 2
    table = chosen_table(setting_results({OURS: {queried(200): (95, 5)}}, sweeps=2))
    assert table.rows == [[OURS, "200", "2", ".950 / 1.000", ".950 / 1.000", f"{5 * 0.25 / 2:.0f}"]]


def test_other_settings_have_targets_of_their_own() -> None:
    good = _every(99, 1)
    level = good | {BENIGN: (90, 10)}
    found = targets_elsewhere(setting_results({OURS: level, RIVAL: good}, "viewnet_indoor"))
    assert [(target.what, target.wanted, target.met) for target in found] == [
        ("F1, benign", "≥ 0.94", True),
        ("mean F1 over the attacks, jamming apart", "≥ 0.93", True),
        ("least lead over the vote, benign and under any attack", "≥ 0", False),
    ]
    assert found[-1].found.endswith("(benign)")
    parts = {(OURS, BENIGN, CLEAR): ConfusionCounts(99, 0, 1, 0)}
    for_cars = targets_elsewhere(setting_results({OURS: level, RIVAL: good}, "viewnet_indoor_car", parts=parts))
    assert [(target.what, target.wanted, target.met) for target in for_cars[:2]] == [
        ("F1, benign", "≥ 0.96", False),
        (f"F1, benign, cells {CLEAR}", "≥ 0.98", True),
    ]
    assert for_cars[2:] == found[1:]
    assert targets_elsewhere(setting_results({}, "viewnet_indoor")) == []
    assert setting_results({}, "viewnet_indoor").attacks == read_config("viewnet_indoor").attacks


def test_what_is_sure_is_decided_and_nothing_else() -> None:
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


def test_what_is_sure_is_decided_by_group_in_view_and_in_wedges() -> None:
    results = setting_results({OURS: _every(99, 1) | {JAMMING: (1, 3), RELAY: (1, 1)}})
    view, wedge = (sure_table(results, wedge=wedge) for wedge in (False, True))
    assert view.header == ["sure", "benign", "trained", "unseen", "jamming"]
    assert list(view.rows[4]) == ["0.9", "1.000 / .990 / –", "1.000 / .990 / –", "1.000 / .989 / –", "1.000 / .250 / –"]
    assert list(view.rows[5][1:]) == [".000 / – / –"] * 4
    assert wedge.header[1:] == ["trained", "unseen", "jamming", "trained, opening a view", "unseen, opening a view"]
    assert [row[3] for row in wedge.rows][:5] == ["1.000 / .250 / –"] * 5
    assert wedge.rows[0][5] == f"1.000 / {(2 * 99 + 1) / 202:.3f} / –".replace("0.", ".")
