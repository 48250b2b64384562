"""The commands of the sets in the wild, as a user types them."""

from pathlib import Path

from tests.cli.commands import run

from viewshed_lab.data import Archive


def test_the_sealed_set_asks_for_a_reason_and_writes_nothing_without(tmp_path: Path) -> None:
    log = tmp_path / "log.md"
    code, _, complaint = run("study", "wild", "--preset", "sealed", "--out", str(tmp_path / "s"), "--log", str(log))
    assert code == 2
    assert "which is logged, with --open-sealed" in complaint
    assert not log.exists()


def test_a_set_is_made_as_an_archive(tmp_path: Path) -> None:
    place = tmp_path / "set"
    words = ("--out", str(place), "--scenes", "1", "--workers", "1", "--known", "rings")
    assert run("dataset", "wild", "development", "road", *words)[0] == 0
    archive = Archive.open(str(place))
    assert (archive.splits, len(archive)) == (("development",), 1)
    code, _, complaint = run("dataset", "wild", "sealed", "road", *words)
    assert code == 2
    assert "must not be sealed" in complaint
