"""``viewshed study robustness``: it runs and writes its page."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
from tests.cli.commands import run

from viewshed_lab.studies.robustness.plan import RobustnessPlan

pytestmark = pytest.mark.slow


def test_it_writes_a_page_with_its_figures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = replace(
        RobustnessPlan.load("tiny"), samples=(1,), attacks=("uniform", "far_wall"), budgets=("0", "150"),
        adaptive=("adaptive_over_claim",), adaptive_queries=4,
    )  # fmt: skip
    monkeypatch.setattr(RobustnessPlan, "load", lambda name: plan)
    page = tmp_path / "page" / "main.md"
    words = ("--preset", "tiny", "--out", tmp_path / "study", "--workers", 1, "--page", page)
    code, said, progress = run("study", "robustness", *words)
    assert (code, said) == (0, f"Look at {page}\n")
    assert "5 of 5" in progress
    text = page.read_text("utf-8")
    figures = re.findall(r"!\[[^]]+\]\(([^)]+)\)", text)
    assert len(figures) == 6
    assert all((page.parent / figure).read_bytes().startswith(b"\x89PNG") for figure in figures)
    assert "- jobs: 5 of 5" in text
    assert "Not finished" not in text
