"""``viewshed simulate`` and ``viewshed dataset``: what they say, and one line for what they refuse."""

import re
import shutil
from pathlib import Path

import pytest
from tests.cli.commands import run
from tests.cli.conftest import SMALL


def test_it_says_what_was_made(made: Path, tmp_path: Path) -> None:
    out = tmp_path / "b"
    code, said, progress = run(*SMALL, out)
    assert code == 0
    assert re.fullmatch(rf"{re.escape(str(out))}: 6 sweeps in 2 scene\(s\), 2 shards, \d\.\d MB\n", said)
    assert "6/6" in progress
    for path in out.glob("*.parquet"):
        assert path.read_bytes() == (made / path.name).read_bytes()


def test_verify_finds_a_flipped_byte(made: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(made, tmp_path / "b"))
    assert run("dataset", "verify", str(folder))[:2] == (0, "2 shards, all checksums match\n")
    victim = folder / "train-0000-000.parquet"
    raw = bytearray(victim.read_bytes())
    raw[len(raw) // 2] ^= 4
    victim.write_bytes(raw)
    code, said, complaint = run("dataset", "verify", str(folder))
    assert code == 2
    assert "train-0000-000.parquet is damaged: its checksum is not the manifest's; run again the command" in said
    assert complaint == f"viewshed: 1 of 2 shards of {folder} are damaged\n"
    assert run(*SMALL, folder)[0] == 0
    assert run("dataset", "verify", str(folder))[0] == 0


def test_another_seed_into_the_same_place_is_one_line(made: Path) -> None:
    code, _, complaint = run(*SMALL, made, "--seed", 3)
    assert code == 2
    assert complaint.splitlines()[-1] == f"viewshed: {made} holds seed 0, not 3; choose another place"


def test_preview_writes_one_picture_and_no_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("viewshed_lab.studies.preview.preview_png", lambda name, seed: f"{name} {seed}".encode())
    code, said, _ = run("simulate", "carla", "--preview", "--seed", "4", "--out", str(tmp_path / "a.png"))
    assert (code, said) == (0, f"Look at {tmp_path / 'a.png'}\n")
    assert (tmp_path / "a.png").read_bytes() == b"carla 4"
    assert len(list(tmp_path.iterdir())) == 1
