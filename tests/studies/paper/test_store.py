"""The file of finished jobs: nothing is lost, nothing foreign is taken."""

from dataclasses import replace
from pathlib import Path

import pytest

from viewshed.studies.paper.plan import plan_named
from viewshed.studies.paper.store import JobStore

TINY = plan_named("tiny")


def test_finished_jobs_are_there_when_it_is_opened_again(tmp_path: Path) -> None:
    JobStore.open(tmp_path, TINY).append(("pairs", "paper", "a", "ugv"), {"found": [1, 2]})
    again = JobStore.open(tmp_path, TINY)
    again.append(("strict", "ugv", "0"), {})
    assert again.keys() == {("pairs", "paper", "a", "ugv"), ("strict", "ugv", "0")}
    assert [line["found"] for line in again.jobs("pairs")] == [[1, 2]]


def test_half_a_line_is_cut_off(tmp_path: Path) -> None:
    store = JobStore.open(tmp_path, TINY)
    store.append(("strict", "ugv", "0"), {})
    whole = store.path.read_bytes()
    store.path.write_bytes(whole + b'{"job":["strict","ug')
    assert JobStore.open(tmp_path, TINY).keys() == {("strict", "ugv", "0")}
    assert store.path.read_bytes() == whole


def test_results_of_another_plan_are_refused(tmp_path: Path) -> None:
    JobStore.open(tmp_path, TINY)
    with pytest.raises(
        ValueError, match="must hold results of this plan and version, got another plan; choose another"
    ):
        JobStore.open(tmp_path, replace(TINY, epochs=3))


def test_results_of_another_version_are_refused(tmp_path: Path) -> None:
    store = JobStore.open(tmp_path, TINY)
    store.path.write_text(store.path.read_text("utf-8").replace('"format":1', '"format":0'), "utf-8")
    with pytest.raises(ValueError, match="got another version"):
        JobStore.open(tmp_path, TINY)


def test_a_damaged_line_is_named(tmp_path: Path) -> None:
    store = JobStore.open(tmp_path, TINY)
    store.path.write_bytes(store.path.read_bytes() + b"nonsense\n")
    store.append(("strict", "ugv", "0"), {})
    with pytest.raises(ValueError, match="line 2 is damaged; delete that line, its job is done again"):
        list(store.jobs())
