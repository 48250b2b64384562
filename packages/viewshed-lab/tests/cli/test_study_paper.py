"""``viewshed study paper`` and ``robustness``: what they refuse once their folder is begun, each in one line."""

import re
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from tests.cli.commands import run

from viewshed_lab.studies.paper.plan import PaperPlan
from viewshed_lab.studies.store import ResultStore

pytestmark = pytest.mark.slow

REFUSED = {
    "paper --preset small --workers 0": "workers must be at least 1, got 0",
    "paper --preset tiny --only pairs": "the other steps need the step data",
    "paper --preset tiny --only pages": "must hold pairs of the paper protocol, got none; run step pairs",
    "paper --preset tiny --only pairs --device cuda": "device cuda needs 1 graphics card",
    "paper --preset tiny --only models": r"pip install 'viewshed-lab\[train\]'",
}
"""Command line → what its line must say."""


@pytest.mark.parametrize("words", REFUSED)
def test_what_cannot_be_run_is_one_line(words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if "cuda" in words:
        torch = pytest.importorskip("torch", reason="torch is not installed: training is not tested")
        if torch.cuda.is_available():
            pytest.skip("there is a graphics card")
    if "models" in words:
        for package in ("torch", "lightning"):
            monkeypatch.setitem(sys.modules, package, None)
    code, _, complaint = run("study", *words.split(), "--out", tmp_path / "study")
    assert (code, complaint.count("\n")) == (2, 1)
    assert re.search(REFUSED[words], complaint)


@pytest.mark.parametrize("study", ["paper", "robustness"])
def test_a_place_of_something_else_is_refused(study: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way", "utf-8")
    ResultStore.open(tmp_path / "other", replace(PaperPlan.load("tiny"), passes=7))
    words = ("study", study, "--preset", "tiny", "--out")
    for place, said in (("file/study", ""), ("other", "; choose another folder")):
        code, _, complaint = run(*words, tmp_path / place)
        assert (code, complaint.count("\n")) == (2, 1)
        assert said in complaint
