"""Results survive a crash, and belong to one plan."""

import json
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from tests.studies.by_hand import refused, rows

from viewshed.metrics import ConfusionCounts, Scores
from viewshed_lab.studies.paper.plan import PaperPlan
from viewshed_lab.studies.records import BENIGN, PAPER, Series, row_of
from viewshed_lab.studies.robustness.plan import RobustnessPlan
from viewshed_lab.studies.store import PLAN, JobResult, ResultStore

TINY = RobustnessPlan.load("tiny")
KEY = ("paper", "ugv", "0")
FOUND = JobResult(list(rows("ugv", 0, BENIGN, {"vote": [[1, 2, 3, 4]]})), {"limit": 0.5})


def test_finished_jobs_are_there_when_it_is_opened_again(tmp_path: Path) -> None:
    ResultStore.open(tmp_path, TINY).append(KEY, FOUND, ["abc"])
    again = ResultStore.open(tmp_path, TINY)
    again.append(("attacks", "ugv", "1"), JobResult(), ["def"])
    assert again.keys() == {KEY, ("attacks", "ugv", "1")}
    results = again.results()
    assert (results.facts[KEY], results.commits) == ({"limit": 0.5}, {"abc", "def"})
    assert results.counts(Series("ugv", "vote")).over == 2
    assert again.results("attacks").series() == []


@pytest.mark.parametrize("other", [replace(TINY, seed=1), replace(TINY, budgets=("0", "50")), PaperPlan.load("tiny")])
def test_another_plan_is_refused(tmp_path: Path, other: RobustnessPlan | PaperPlan) -> None:
    ResultStore.open(tmp_path, TINY)
    with pytest.raises(ValueError, match=r"of this plan and version, got another plan \(.*\); give another --out"):
        ResultStore.open(tmp_path, other)


HEAD = {"format": 4, "version": "0.3.0", "plan": TINY.to_json()}


@pytest.mark.parametrize(
    ("head", "complaint"),
    [
        (HEAD | {"format": 3}, "got another version; give another --out"),
        (HEAD | {"version": "0.0.1"}, "got another version; give another --out"),
        (7, "got something else; give another --out"),
        ("\xff", "got something else; give another --out"),
    ],
)
def test_files_of_other_versions_are_refused_and_left_alone(tmp_path: Path, head: object, complaint: str) -> None:
    content = head.encode("latin-1") if isinstance(head, str) else json.dumps(head).encode()
    (tmp_path / PLAN).write_bytes(content)
    with pytest.raises(ValueError, match=complaint):
        ResultStore.open(tmp_path, TINY)
    assert (tmp_path / PLAN).read_bytes() == content


def _without_facts() -> bytes:
    content: bytes = pd.DataFrame([{"sweep": 1}]).to_parquet(None)
    return content


@pytest.mark.parametrize("content", [b"", b"nonsense", _without_facts()])
def test_a_file_that_no_job_wrote_is_named(tmp_path: Path, content: bytes) -> None:
    store = ResultStore.open(tmp_path, TINY)
    store.path_of(KEY).write_bytes(content)
    with pytest.raises(ValueError, match=r"paper ugv 0.parquet must hold what a job found.* delete it and run again"):
        ResultStore.open(tmp_path, TINY).results()


def test_what_was_counted_comes_back(tmp_path: Path) -> None:
    scores = Scores()
    scores.add([0.7], [True], [0.1])
    store, series = ResultStore.open(tmp_path, TINY), Series("ugv", "a", protocol=PAPER)
    store.append(KEY, JobResult([*FOUND.rows, row_of(series, "s", 0, None, scores), refused("ugv", 1, BENIGN, "why")]))
    results = store.results()
    assert results.counts(Series("ugv", "vote")) == ConfusionCounts(1, 2, 3, 4, 2.5)
    assert results.scores([series]).to_json() == scores.to_json()
    assert results.refused == {("ugv", BENIGN, "why"): 1}
