"""Results survive a crash, and belong to one plan."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from tests.studies.by_hand import records

from viewshed_lab.studies.paper.plan import PaperPlan
from viewshed_lab.studies.records import BENIGN, Series
from viewshed_lab.studies.robustness.plan import RobustnessPlan
from viewshed_lab.studies.store import FILE, JobResult, ResultStore

TINY = RobustnessPlan.load("tiny")
KEY = ("paper", "ugv", "0")
FOUND = JobResult(list(records("ugv", 0, BENIGN, {"vote": [[1, 2, 3, 4]]})), {"limit": 0.5})


def test_finished_jobs_are_there_when_it_is_opened_again(tmp_path: Path) -> None:
    ResultStore.open(tmp_path, TINY).append(KEY, FOUND, ["abc"])
    again = ResultStore.open(tmp_path, TINY)
    again.append(("attacks", "ugv", "1"), JobResult(), ["def"])
    assert again.keys() == {KEY, ("attacks", "ugv", "1")}
    results = again.results()
    assert (results.facts[KEY], results.commits) == ({"limit": 0.5}, {"abc", "def"})
    assert results.counts(Series("ugv", "vote")).over == 2
    assert again.results("attacks").series() == []


def test_a_line_cut_in_half_is_dropped_and_the_rest_kept(tmp_path: Path) -> None:
    store = ResultStore.open(tmp_path, TINY)
    store.append(KEY, FOUND)
    whole = (tmp_path / FILE).read_bytes()
    with (tmp_path / FILE).open("ab") as file:
        file.write(b'{"job":["attacks","ugv","1"],"fa')
    assert ResultStore.open(tmp_path, TINY).keys() == {KEY}
    assert (tmp_path / FILE).read_bytes() == whole


def test_a_first_line_cut_in_half_begins_anew(tmp_path: Path) -> None:
    (tmp_path / FILE).write_bytes(b'{"format":3')
    assert ResultStore.open(tmp_path, TINY).keys() == set()
    assert json.loads((tmp_path / FILE).read_text("utf-8"))["plan"]["seed"] == TINY.seed


@pytest.mark.parametrize("other", [replace(TINY, seed=1), replace(TINY, budgets=("0", "50")), PaperPlan.load("tiny")])
def test_another_plan_is_refused(tmp_path: Path, other: RobustnessPlan | PaperPlan) -> None:
    ResultStore.open(tmp_path, TINY)
    with pytest.raises(ValueError, match="must hold results of this plan and version, got another plan; choose"):
        ResultStore.open(tmp_path, other)


@pytest.mark.parametrize(
    ("head", "complaint"),
    [
        ({"format": 2, "version": "0.3.0", "study": TINY.to_json()}, "got those of an older version of the study"),
        ({"format": 1, "version": "0.3.0", "plan": TINY.to_json()}, "got those of an older version of the study"),
        ({"format": 3, "version": "0.0.1", "plan": TINY.to_json()}, "got another version; choose another folder"),
        (7, "got something else; choose another folder"),
    ],
)
def test_files_of_other_versions_are_refused_and_left_alone(tmp_path: Path, head: object, complaint: str) -> None:
    line = json.dumps(head) + "\n"
    (tmp_path / FILE).write_text(line, "utf-8")
    with pytest.raises(ValueError, match=complaint):
        ResultStore.open(tmp_path, TINY)
    assert (tmp_path / FILE).read_text("utf-8") == line


_EMPTY = '"commits":[],"facts":{},"records":{"same":{},"columns":[],"rows":[]}'


@pytest.mark.parametrize(
    "line",
    [
        "7", "[1]", '{"job":3}', '{"job":["paper","ugv",0],' + _EMPTY + "}", "nonsense",
        '{"job":["paper","moon","0"],' + _EMPTY + "}", '{"job":["paper","ugv","2"],' + _EMPTY + "}",
        '{"job":["attacks","ugv","0"],"commits":[],"facts":{}}',
        '{"job":["attacks","ugv","0"],"commits":[],"facts":{},"records":{"same":{},"columns":["sweep"],"rows":[[1]]}}',
    ],
)  # fmt: skip
def test_a_line_that_no_job_wrote_is_named(tmp_path: Path, line: str) -> None:
    store = ResultStore.open(tmp_path, TINY)
    store.append(KEY, FOUND)
    with (tmp_path / FILE).open("a") as file:
        file.write(line + "\n")
    with pytest.raises(ValueError, match="line 3 is damaged; delete that line, its job is done again"):
        ResultStore.open(tmp_path, TINY).results()


def test_a_first_line_that_is_no_text_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / FILE).write_bytes(b"\xff\n")
    with pytest.raises(ValueError, match="line 1 is damaged; choose another folder"):
        ResultStore.open(tmp_path, TINY)
    assert (tmp_path / FILE).read_bytes() == b"\xff\n"
