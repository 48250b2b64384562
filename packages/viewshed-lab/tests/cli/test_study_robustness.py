"""``viewshed study robustness``: it runs, goes on, writes its pages, and refuses with one line."""

import re
import shutil
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


def test_it_writes_one_html_file_and_a_page_with_its_figures(made: Path) -> None:
    page = (made / "robustness.md").read_text("utf-8")
    figures = re.findall(r"!\[[^]]+\]\(([^)]+)\)", page)
    assert len(figures) == 6
    assert all((made / figure).read_bytes().startswith(b"\x89PNG") for figure in figures)
    assert "- jobs: 9 of 9" in page
    whole = (made / "index.html").read_text("utf-8")
    assert whole.count("<img ") == len(figures)
    assert 'src="http' not in whole
    assert "Not finished" not in page


def test_attacks_of_the_tiny_study_hurt_whom_they_must(made: Path) -> None:
    """Far points stretch what the farthest return decides, and leave the nearest obstacle where it is."""
    page = (made / "robustness_tables.md").read_text("utf-8")
    table = page.split("### Who withstands what, up to a full wedge, ugv")[1].split("##")[0]
    header, uniform = (re.search(rf"^\| {word} ?\|.*$", table, re.MULTILINE) for word in ("", "uniform"))
    assert header is not None
    assert uniform is not None
    verdicts = dict(zip(*([cell.strip() for cell in row[0].split("|")] for row in (header, uniform)), strict=True))
    assert verdicts["quantized"].startswith("over")
    assert verdicts["first_blocker"] == "yes"


def test_a_finished_study_is_only_written_again(made: Path, tmp_path: Path) -> None:
    before = sorted((made / "jobs").iterdir())
    page = tmp_path / "page.md"
    words = ("--preset", "tiny", "--out", made, "--workers", "1", "--page", page)
    code, said, progress = run("study", "robustness", *words)
    assert code == 0
    assert f"Markdown in {page}" in said
    assert "9 of 9" in progress
    assert sorted((made / "jobs").iterdir()) == before
    assert (tmp_path / "robustness_scenes.png").exists()
    assert "### majority_vote behind each defense" in (tmp_path / "page_tables.md").read_text("utf-8")


def test_what_it_refuses_is_one_line(made: Path, tmp_path: Path) -> None:
    code, _, complaint = run("study", "robustness", "--preset", "small", "--out", str(made), "--no-run")
    assert code == 2
    assert "must hold results of this plan and version, got another plan (" in complaint
    damaged = tmp_path / "damaged"
    shutil.copytree(made, damaged)
    (damaged / "jobs" / "attacks ugv 0.parquet").write_bytes(b"PAR1")
    code, _, complaint = run("study", "robustness", "--preset", "tiny", "--out", str(damaged), "--no-run")
    assert (code, complaint.count("\n")) == (2, 1)
    assert "attacks ugv 0.parquet must hold what a job found, it is damaged; delete it and run again" in complaint
