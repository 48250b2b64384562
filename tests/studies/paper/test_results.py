"""From lines to figures: pooled rates by hand, intervals over scenes, the paper's layout."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from viewshed.metrics import Scores
from viewshed.studies.cases import BENIGN as UNTOUCHED
from viewshed.studies.cases import Case
from viewshed.studies.paper import tables
from viewshed.studies.paper import tables as strict_tables
from viewshed.studies.paper.data import Measured
from viewshed.studies.paper.plan import plan_named
from viewshed.studies.paper.results import (
    ADVERSARIAL,
    LEFT_OUT,
    MEASURES,
    PairKey,
    Results,
    StrictKey,
    accuracy,
    interval,
    targets_of,
)
from viewshed.studies.paper.results import BENIGN_TABLE as BENIGN
from viewshed.studies.paper.store import JobStore
from viewshed.studies.robustness.results import f1, precision

DOMAINS = ("carla", "nuscenes", "ugv")
GOOD, BAD = [96, 4, 4, 96], [50, 50, 50, 50]
"""Both, over, under, neither: F1 of .96 and of .5."""


def _told(counts: list[int]) -> dict[str, Any]:
    return {"frames": [[*counts, 0.9]] * 2, "scores": Scores().to_json()}


def _results(folder: Path) -> Results:
    """Every model is good where it was trained and on ugv, and bad elsewhere; benign-trained ones when attacked."""
    store = JobStore.open(folder, plan_named("tiny"))
    for variant in ("mle", "mcd"):
        for mixture in ("benign", "adversarial"):
            for train in DOMAINS:
                for test in DOMAINS:
                    name = f"{variant}-{mixture}-{train}"
                    fine = _told(GOOD if test in (train, "ugv") else BAD)
                    both = {"benign": fine, "adversarial": fine if mixture == "adversarial" else _told(BAD)}
                    found = {"scenes": ["a", "b"], "attacks": ["x", "y"], "scores": {name: both}}
                    store.append(("pairs", "paper", name, test), found)
    return Results.read(store)


def test_rates_are_those_of_all_cells_together(tmp_path: Path) -> None:
    found = _results(tmp_path)
    key = PairKey("paper", "mle-benign-carla", "benign", "carla")
    assert {word: found.pooled(key, measure) for word, measure in MEASURES.items()} == pytest.approx(
        {"precision": 0.96, "recall": 0.96, "accuracy": 0.96, "F1": 0.96}
    )
    assert np.isnan(found.pooled(PairKey("strict", "mle-benign-carla", "benign", "carla"), f1))


def test_rows_are_test_sets_and_columns_training_sets(tmp_path: Path) -> None:
    table = tables.pair_table(_results(tmp_path), "paper", BENIGN)
    rows = {row[0]: list(row[1:]) for row in table.rows}
    assert list(table.header) == ["tested on \\ trained on", *DOMAINS]
    assert rows["ugv"] == [".96 .96 .96 .960"] * 3
    assert rows["carla"] == [".96 .96 .96 .960", ".50 .50 .50 .500", ".50 .50 .50 .500"]
    assert list(table.rows[2]) == ["*the paper*", ".95 .90 .97 .92", ".91 .92 .96 .91", ".95 .83 .95 .88"]


def test_the_table_that_the_paper_left_out_shows_what_attacks_do(tmp_path: Path) -> None:
    table = tables.pair_table(_results(tmp_path), "paper", LEFT_OUT)
    assert [row[1] for row in table.rows] == [".50 .50 .50 .500", ".500 to .500"] * 3


def test_targets_say_what_is_met_and_what_is_missed(tmp_path: Path) -> None:
    targets = {target.what: target for target in targets_of(_results(tmp_path))}
    assert len(targets) == 11
    assert targets["in-domain F1, benign, nuscenes"].verdict == "met"
    assert targets["in-domain F1, adversarial, MCD, ugv"].published == 0.86
    assert (targets["worst transfer F1, benign"].published, targets["worst transfer F1, benign"].verdict) == (
        0.80,
        "missed",
    )
    assert targets["worst transfer F1, adversarial"].published == 0.69
    empty = Results(JobStore(tmp_path, plan_named("tiny")))
    assert {target.verdict for target in targets_of(empty)} == {"not measured"}


def test_the_papers_figures_are_in_their_places() -> None:
    """Spot checks against the table in the paper: tested on nuScenes, trained on UGV, adversarial."""
    assert ADVERSARIAL.published["nuscenes", "ugv"] == (0.97, 0.55, 0.89, 0.69)
    assert BENIGN.published["ugv", "carla"] == (0.92, 0.80, 0.95, 0.85)


def test_intervals_draw_scenes_not_sweeps() -> None:
    """Three sweeps of one scene are one draw: precision is that of scene a, of b, or of both."""
    counts = np.array([[1.0, 1, 0, 0], [1, 1, 0, 0], [2, 2, 0, 0], [4, 0, 0, 0]])
    low, high = interval(counts, ["a", "a", "a", "b"], precision)
    assert (low, high) == pytest.approx((0.5, 1.0))
    assert interval(counts, ["a"] * 4, precision) == pytest.approx((8 / 12, 8 / 12))
    assert all(np.isnan(interval(np.empty((0, 4)), [], precision)))


def test_accuracy_of_nothing_is_not_a_number() -> None:
    assert np.isnan(accuracy(np.zeros(4)))


def test_measured_survives_its_plain_values() -> None:
    measured = Measured()
    prob, visible = np.array([[0.9, 0.2]], np.float32), np.array([[True, False]])
    measured.add((prob, None), 0.5, visible, np.array([[True, True]]))
    measured.add((prob, None), 0.5, visible, np.array([[False, True]]))
    again = Measured.from_json(measured.to_json())
    assert again.counts.tolist() == [[1, 0, 0, 1], [0, 0, 0, 1]]
    assert again.areas[0] == 1.0
    assert np.isnan(again.areas[1])
    assert (again.scores.f1(), again.scores.cells) == (1.0, 3)


def _strict(folder: Path) -> Results:
    """A vote that a far wall does not move, and a network that claims all of its wedge."""
    store, calm = JobStore.open(folder, plan_named("tiny")), [8, 2, 2, 8]
    benign = {name: [80, 20, 20, 80, 0, 0, 0, 0, 0.8, 0, 0, 0, 0] for name in ("mle-benign", "majority_vote")}
    walled = {
        "mle-benign": [82, 28, 18, 72, 10, 10, 0, 0, 0.7, *calm],
        "majority_vote": [80, 20, 20, 80, *calm, 0.8, *calm],
    }
    cases = [{"case": ["benign", "", ""], "scores": benign},
             {"case": ["attack", "far_wall", "default"], "scores": walled},
             {"case": ["attack", "replay", "default"], "refused": "replay needs an earlier sweep"}]  # fmt: skip
    for number in range(2):
        store.append(("strict", "ugv", str(number)), {"scene": f"s{number}", "cases": cases})
    return Results.read(store)


def test_the_wedge_stands_above_itself_untouched(tmp_path: Path) -> None:
    found = _strict(tmp_path)
    table = strict_tables.wedge_table(found, "ugv")
    assert list(table.header) == ["attack (family)", "mle-benign", "majority_vote"]
    assert [list(row) for row in table.rows] == [
        ["far_wall (7)", ".500 / 1.000 / .667", "**.800 / .800 / .800**"],
        ["*untouched*", "**.800 / .800 / .800**", "**.800 / .800 / .800**"],
    ]
    assert found.refused == {("ugv", Case("attack", "replay", "default"), "replay needs an earlier sweep"): 2}


def test_the_winner_is_whoever_wins(tmp_path: Path) -> None:
    found = _strict(tmp_path)
    rows = [list(row) for row in strict_tables.winner_table(found, "ugv").rows]
    assert rows[0] == ["*benign*", "view", "**.800**", "**.800**", "mle-benign", "majority_vote", ".800"]
    assert rows[2] == ["far_wall (7)", "wedge", ".667", "**.800**", "mle-benign", "majority_vote", ".800"]
    assert strict_tables.view_table(found, "ugv").rows[0] == ["*benign*", "**.800 ±.000**", "**.800 ±.000**"]
    assert found.under(StrictKey("ugv", UNTOUCHED, "majority_vote"), f1) == pytest.approx(0.8)
