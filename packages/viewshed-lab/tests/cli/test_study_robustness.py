"""``viewshed study robustness``: it runs and writes its page."""

import re
from pathlib import Path

import pytest
from tests.cli.commands import run

pytestmark = pytest.mark.slow


def test_it_writes_a_page_with_its_figures(tmp_path: Path) -> None:
    page = tmp_path / "page" / "main.md"
    words = ("--preset", "tiny", "--out", tmp_path / "study", "--workers", 1, "--page", page)
    code, said, progress = run("study", "robustness", *words)
    assert (code, said) == (0, f"Look at {page}\n")
    assert "9 of 9" in progress
    text = page.read_text("utf-8")
    figures = re.findall(r"!\[[^]]+\]\(([^)]+)\)", text)
    assert len(figures) == 6
    assert all((page.parent / figure).read_bytes().startswith(b"\x89PNG") for figure in figures)
    assert "- jobs: 9 of 9" in text
    assert "Not finished" not in text
