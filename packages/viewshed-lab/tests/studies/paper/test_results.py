"""From records to figures: pooled rates by hand, the paper's layout, winners and wedges."""

from pathlib import Path

from tests.studies.by_hand import refused, rows

from viewshed_lab.studies.cases import DEFAULT
from viewshed_lab.studies.paper import tables
from viewshed_lab.studies.paper.jobs import ATTACKED
from viewshed_lab.studies.paper.page import provenance
from viewshed_lab.studies.paper.plan import PaperPlan
from viewshed_lab.studies.paper.published import ADVERSARIAL, PaperResults, targets_of
from viewshed_lab.studies.paper.published import BENIGN_TABLE as PUBLISHED
from viewshed_lab.studies.records import BENIGN, PAPER, Case, Domain, Row
from viewshed_lab.studies.store import JobResult, ResultStore

DOMAINS = ("carla", "nuscenes", "ugv")
GOOD, BAD = [96, 4, 4, 96], [50, 50, 50, 50]
"""Both, over, under, neither: F1 of .96 and of .5."""


def _twice(domain: str, case: Case, name: str, cells: list[int]) -> list[Row]:
    """The same counts on two sweeps, each of a scene of its own."""
    return [r for n in (0, 1) for r in rows(domain, n, case, {name: [cells]}, {name: 0.9}, PAPER)]


def _results(folder: Path) -> PaperResults:
    """Every model is good where it was trained and on ugv, and bad elsewhere; benign-trained ones when attacked."""
    store = ResultStore.open(folder, PaperPlan.load("tiny"))
    for variant in ("mle", "mcd"):
        for mixture in ("benign", "adversarial"):
            for train in DOMAINS:
                for test in DOMAINS:
                    name, fine = f"{variant}-{mixture}-{train}", GOOD if test in (train, "ugv") else BAD
                    attacked = fine if mixture == "adversarial" else BAD
                    found = [*_twice(test, BENIGN, name, fine), *_twice(test, ATTACKED, name, attacked)]
                    store.append(("pairs", PAPER, name, test, "0"), JobResult(found))
    return PaperResults.read(store)


def test_rows_are_test_sets_and_columns_training_sets(tmp_path: Path) -> None:
    table = tables.pair_table(_results(tmp_path), PAPER, PUBLISHED)
    rows = {row[0]: list(row[1:]) for row in table.rows}
    assert list(table.header) == ["tested on \\ trained on", *DOMAINS]
    assert rows["ugv"] == [".96 .96 .96 .960"] * 3
    assert rows["carla"] == [".96 .96 .96 .960", ".50 .50 .50 .500", ".50 .50 .50 .500"]
    assert list(table.rows[2]) == ["*the paper*", ".95 .90 .97 .92", ".91 .92 .96 .91", ".95 .83 .95 .88"]


def test_targets_say_what_is_met_and_what_is_missed(tmp_path: Path) -> None:
    targets = {target.what: target for target in targets_of(_results(tmp_path))}
    assert len(targets) == 8
    assert targets["in-domain F1, benign, nuscenes"].verdict == "met"
    assert [target.least for target in targets.values()] == [0.93, 0.92, 0.91, 0.93, 0.91, 0.90, 0.89, 0.87]
    worst = targets["worst transfer F1, benign"]
    assert (worst.published, worst.verdict) == (0.80, "missed")
    assert targets["worst transfer F1, adversarial"].published == 0.69
    empty = PaperResults.read(ResultStore.open(tmp_path / "empty", PaperPlan.load("tiny")))
    assert {target.verdict for target in targets_of(empty)} == {"not measured"}


def test_the_page_says_what_cross_validation_chose_how_long_jobs_took_and_what_dropout_is_scored_on(
    tmp_path: Path,
) -> None:
    results = _results(tmp_path)
    plan, store = results.plan, results.store
    planned = provenance(results, PAPER)
    assert "dropout 0.1;" in planned["network"]
    assert "Adam 0.01 (cosine)" in planned["training"]
    assert planned["held-out sweeps"] == "carla 2 of 2 scenes, nuscenes 2 of 2 scenes, ugv 2 of 2 scenes"
    assert "hours of the jobs, added up" not in planned
    for key in plan.job_keys_of("crossval"):
        epoch = {"number": 1, "f1": 0.9 if key[2] == "0.001" else 0.5, "iou": 0.5, "validation_loss": 1.0}
        store.append(key, JobResult(facts={"history": [epoch], "best": 1, "seconds": 900.0}))
    third = rows("ugv", 2, BENIGN, {"mle-benign-ugv": [GOOD]}, {}, PAPER, "s1")
    store.append(("pairs", PAPER, "mle-benign-ugv", "ugv", "1"), JobResult(list(third), {"seconds": 360.0}))
    chosen = provenance(PaperResults.read(store), PAPER)
    assert "dropout 0.1, chosen by cross-validation;" in chosen["network"]
    assert "Adam 0.001, chosen by cross-validation (cosine)" in chosen["training"]
    assert chosen["hours of the jobs, added up"] == "folds 1.00, pairs 0.10"
    assert chosen["held-out sweeps"].endswith("ugv 3 of 2 scenes (MCD 2 of 2 scenes)")


def test_the_papers_figures_are_in_their_places() -> None:
    """Spot checks against the table in the paper: tested on nuScenes, trained on UGV, adversarial."""
    assert ADVERSARIAL.published("nuscenes", "ugv") == [0.97, 0.55, 0.89, 0.69]
    assert PUBLISHED.published("ugv", "carla") == [0.92, 0.80, 0.95, 0.85]


WALL = Case("attack", "far_wall", DEFAULT)


def _strict(folder: Path) -> PaperResults:
    """A vote that a far wall does not move, and a network that claims all of its wedge."""
    store, clean, calm = ResultStore.open(folder, PaperPlan.load("tiny")), [80, 20, 20, 80], [8, 2, 2, 8]
    walled = {"mle-benign": [[82, 28, 18, 72], [10, 10, 0, 0], calm], "majority_vote": [clean, calm, calm]}
    for n in range(2):
        found = [
            *rows("ugv", n, BENIGN, {"mle-benign": [clean], "majority_vote": [clean]}),
            *rows("ugv", n, WALL, walled),
            refused("ugv", n, Case("attack", "replay", DEFAULT), "replay needs an earlier sweep"),
        ]
        store.append(("strict", "ugv", str(n)), JobResult(found))
    return PaperResults.read(store)


def test_the_wedge_stands_above_itself_untouched(tmp_path: Path) -> None:
    found = _strict(tmp_path)
    table = tables.wedge_table(Domain(found.strict, "ugv"))
    assert list(table.header) == ["attack (family)", "mle-benign", "majority_vote"]
    assert [list(row) for row in table.rows] == [
        ["far_wall (7)", ".500 / 1.000 / .667", "**.800 / .800 / .800**"],
        ["*untouched*", "**.800 / .800 / .800**", "**.800 / .800 / .800**"],
    ]
    replay = Case("attack", "replay", DEFAULT)
    assert found.strict.refused == {("ugv", replay, "replay needs an earlier sweep"): 2}


def test_the_winner_is_whoever_wins(tmp_path: Path) -> None:
    found = Domain(_strict(tmp_path).strict, "ugv")
    rows = [list(row) for row in tables.winner_table(found).rows]
    assert rows[0] == ["*benign*", "view", "**.800**", "**.800**", "mle-benign", "majority_vote", ".800"]
    assert rows[2] == ["far_wall (7)", "wedge", ".667", "**.800**", "mle-benign", "majority_vote", ".800"]
    assert tables.view_table(found).rows[0] == ["*benign*", "**.800 ±.000**", "**.800 ±.000**"]
