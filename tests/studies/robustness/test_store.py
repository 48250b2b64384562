"""Results survive a crash, and belong to one study."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from viewshed._jobs import engine_named
from viewshed.studies.robustness.jobs import run_study
from viewshed.studies.robustness.plan import Study, study_named
from viewshed.studies.robustness.store import FILE, ResultStore, key_of

pytestmark = pytest.mark.slow

SMALLEST = replace(
    study_named("tiny"), attacks=("uniform", "far_wall"), budgets=("0", "150"), corruptions=("fog",), severities=(2,),
    defenses=("radius",), defended=("quantized",), adaptive=("adaptive_over_claim",), adaptive_queries=4,
)  # fmt: skip
LINE = {"job": ["ugv", 0, "paper"], "about": {}, "cases": []}


def _lines(folder: Path) -> dict[object, object]:
    head, *jobs = [json.loads(line) for line in (folder / FILE).read_text("utf-8").splitlines()]
    assert head["study"]["name"] == "tiny"
    for job in jobs:
        job["about"].pop("commits", None)  # the code may be committed between two runs
    return {key_of(job): job for job in jobs}


def test_a_line_cut_in_half_is_dropped_and_the_rest_kept(tmp_path: Path) -> None:
    store = ResultStore.open(tmp_path, SMALLEST)
    store.append(LINE)
    whole = (tmp_path / FILE).read_bytes()
    with (tmp_path / FILE).open("ab") as file:
        file.write(b'{"job":["ugv",1,"pa')
    again = ResultStore.open(tmp_path, SMALLEST)
    assert again.keys() == {("ugv", 0, "paper")}
    assert (tmp_path / FILE).read_bytes() == whole


def test_a_first_line_cut_in_half_begins_anew(tmp_path: Path) -> None:
    (tmp_path / FILE).write_bytes(b'{"format":1')
    assert ResultStore.open(tmp_path, SMALLEST).keys() == set()
    assert json.loads((tmp_path / FILE).read_text("utf-8"))["study"]["seed"] == SMALLEST.seed


@pytest.mark.parametrize("other", [replace(SMALLEST, seed=1), replace(SMALLEST, budgets=("0", "50"))])
def test_another_study_is_refused(tmp_path: Path, other: Study) -> None:
    ResultStore.open(tmp_path, SMALLEST)
    with pytest.raises(ValueError, match="must hold this study, got results of another study; choose another folder"):
        ResultStore.open(tmp_path, other)


def test_a_damaged_line_is_named(tmp_path: Path) -> None:
    store = ResultStore.open(tmp_path, SMALLEST)
    with (tmp_path / FILE).open("ab") as file:
        file.write(b"{nonsense\n")
    store.append(LINE)
    with pytest.raises(ValueError, match="line 2 is damaged; delete that line"):
        store.keys()


@pytest.mark.parametrize(
    "line",
    [
        b"7", b"[1]", b'{"job":3}', b'{"job":["ugv",2,"paper"],"about":{},"cases":[]}',
        b'{"job":["moon",0,"paper"],"about":{},"cases":[]}', b'{"job":["ugv",0,"paper"],"cases":[]}',
        b'{"job":["ugv",0,"paper"],"about":{},"cases":[{"case":["benign"],"scores":{"majority_vote":[1]}}]}',
        b'{"job":["ugv",0,"paper"],"about":{},"cases":[{"case":["nonsense"]}]}', b"\xff\xfe",
    ],
)  # fmt: skip
def test_a_line_that_no_job_wrote_is_named(tmp_path: Path, line: bytes) -> None:
    store = ResultStore.open(tmp_path, SMALLEST)
    store.append(LINE)
    with (tmp_path / FILE).open("ab") as file:
        file.write(line + b"\n")
    with pytest.raises(ValueError, match="line 3 is damaged; delete that line, its job is done again"):
        ResultStore.open(tmp_path, SMALLEST).keys()


@pytest.mark.parametrize(
    ("line", "complaint"),
    [(b"7", "must hold this study, got something else; choose another folder"),
     (b"\xff", "line 1 is damaged; choose another folder")],
)  # fmt: skip
def test_a_file_that_is_something_else_is_left_alone(tmp_path: Path, line: bytes, complaint: str) -> None:
    (tmp_path / FILE).write_bytes(line + b"\n")
    with pytest.raises(ValueError, match=complaint):
        ResultStore.open(tmp_path, SMALLEST)
    assert (tmp_path / FILE).read_bytes() == line + b"\n"


def test_two_workers_and_one_find_the_same(tmp_path: Path) -> None:
    for workers in (1, 2):
        store = ResultStore.open(tmp_path / str(workers), SMALLEST)
        assert run_study(SMALLEST, store, engine_named("local", workers)) == []
    assert len(_lines(tmp_path / "1")) == 9
    assert _lines(tmp_path / "1") == _lines(tmp_path / "2")


def test_what_is_there_is_not_done_again(tmp_path: Path) -> None:
    store = ResultStore.open(tmp_path, SMALLEST)
    for job in SMALLEST.jobs():
        store.append(LINE | {"job": list(job.key)})
    before = (tmp_path / FILE).read_bytes()
    seen: list[object] = []
    assert run_study(SMALLEST, store, engine_named("local", 1), seen.append) == []
    assert (tmp_path / FILE).read_bytes() == before
    assert sorted(seen, key=str) == sorted((job.key for job in SMALLEST.jobs()), key=str)


def test_a_job_that_fails_is_named_and_the_rest_goes_on(tmp_path: Path) -> None:
    study = replace(SMALLEST, domains=("ugv", str(tmp_path / "nothing")), samples=(1, 1), adaptive_samples=(1, 0))
    failed = run_study(study, ResultStore.open(tmp_path, study), engine_named("local", 1))
    assert len(failed) == 4
    assert all("nothing 0" in line for line in failed)
    assert len(ResultStore.open(tmp_path, study).keys()) == 5


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
def test_a_run_that_is_killed_goes_on_to_the_same_results(tmp_path: Path) -> None:
    code = (
        "import sys; from tests.studies.robustness.test_store import *\n"
        "run_study(SMALLEST, ResultStore.open(sys.argv[1], SMALLEST), engine_named('local', 1))"
    )
    root = Path(__file__).resolve().parents[3]
    process = subprocess.Popen([sys.executable, "-c", code, str(tmp_path / "a")], cwd=root)
    path = tmp_path / "a" / FILE
    end_s = time.monotonic() + 120
    while time.monotonic() < end_s and (not path.exists() or path.read_bytes().count(b"\n") < 3):
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    store = ResultStore.open(tmp_path / "a", SMALLEST)
    assert 2 <= len(store.keys()) < 9
    for folder in ("a", "b"):
        run_study(SMALLEST, ResultStore.open(tmp_path / folder, SMALLEST), engine_named("local", 1))
    assert _lines(tmp_path / "a") == _lines(tmp_path / "b")
