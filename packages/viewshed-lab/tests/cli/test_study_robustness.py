"""``viewshed study robustness``: it runs, goes on, writes its pages, and refuses with one line."""

import re
from pathlib import Path

import pytest
from tests.cli.commands import run

from viewshed.cli import main

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("report") / "study"
    with pytest.raises(SystemExit) as stop:
        main(["study", "robustness", "--preset", "tiny", "--out", str(out), "--workers", "1"])
    assert not stop.value.code
    return out


def test_it_writes_a_page_with_its_figures(made: Path) -> None:
    page = (made / "robustness.md").read_text("utf-8")
    figures = re.findall(r"!\[[^]]+\]\(([^)]+)\)", page)
    assert len(figures) == 6
    assert all((made / figure).read_bytes().startswith(b"\x89PNG") for figure in figures)
    assert "- jobs: 9 of 9" in page
    assert "Not finished" not in page


def test_a_finished_study_is_only_written_again(made: Path, tmp_path: Path) -> None:
    before = sorted((made / "jobs").iterdir())
    page = tmp_path / "page.md"
    words = ("--preset", "tiny", "--out", made, "--workers", "1", "--page", page)
    code, said, progress = run("study", "robustness", *words)
    assert code == 0
    assert f"Look at {page}" in said
    assert "9 of 9" in progress
    assert sorted((made / "jobs").iterdir()) == before
    assert (tmp_path / "robustness_scenes.png").exists()
