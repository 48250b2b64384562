"""``viewshed attack`` and ``viewshed corrupt``: what they say, what they leave out, what they refuse in one line."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from tests.cli.commands import run

from viewshed import Archive, Sweep, read_sweep, write_sweep
from viewshed.estimators.ray_trace import ContinuousRayTrace

pytestmark = pytest.mark.slow


def test_attack_says_what_was_made(made: Path, tmp_path: Path) -> None:
    out = tmp_path / "attacked"
    words = ["attack", str(made), "--attack", "ghost_wall", "--budget", "full", "--workers", "1", "--out", str(out)]
    code, said, progress = run(*words)
    assert code == 0
    assert re.fullmatch(rf"{re.escape(str(out))}: 6 of 6 sweeps, 2 shards, \d\.\d MB\n", said)
    assert "6/6" in progress
    assert [sample.scene for sample in Archive.open(out)] == [sample.scene for sample in Archive.open(made)]
    _, said, _ = run("dataset", "info", str(out))
    assert "made by: command attack, name ghost_wall, seed 0" in said


def test_corrupt_drops_and_moves_returns(made: Path, tmp_path: Path) -> None:
    words = ["corrupt", str(made), "--corruption", "dropped_beams", "--severity", "5", "--split", "test"]
    code, _, _ = run(*words, "--workers", "1", "--out", str(tmp_path / "out"))
    found, before = Archive.open(tmp_path / "out"), Archive.open(made).split("test")
    assert code == 0
    assert len(found) == len(before)
    assert 0.2 < len(found[0].sweep) / len(before[0].sweep) < 0.4


def test_one_file_becomes_one_file_with_its_record(tmp_path: Path) -> None:
    clean = Sweep(np.random.default_rng(1).normal(0, 12, (400, 3)).astype(np.float32))
    write_sweep(clean, tmp_path / "a.npz")
    words = ["attack", str(tmp_path / "a.npz"), "--attack", "uniform", "--budget", "30"]
    code, said, _ = run(*words, "--out", str(tmp_path / "b.npz"))
    assert (code, said) == (0, f"{tmp_path}/b.npz: 430 returns; b.npz.touched.json records which changed\n")
    record = json.loads((tmp_path / "b.npz.touched.json").read_text())
    attacked = read_sweep(tmp_path / "b.npz")
    kept = np.setdiff1d(np.arange(len(attacked)), record["added_rows"])
    assert len(record["added_rows"]) == 30
    assert attacked.points[kept].tobytes() == clean.points.tobytes()
    code, _, complaint = run(*words[:2], "--attack", "replay", "--out", str(tmp_path / "c.npz"))
    assert (code, complaint.split(",")[0]) == (2, "viewshed: replay needs an earlier sweep")
    code, _, complaint = run(*words, "--out", str(tmp_path / "a.npz"))
    assert (code, complaint) == (
        2,
        f"viewshed: {tmp_path}/a.npz is an input and would be replaced; choose another place\n",
    )


def test_a_cloud_without_rings_is_left_out_and_the_rest_goes_on(made: Path, tmp_path: Path) -> None:
    write_sweep(Sweep(np.random.default_rng(1).normal(0, 12, (400, 3)).astype(np.float32)), tmp_path / "bare.bin")
    write_sweep(Archive.open(made)[0].sweep, tmp_path / "rings.npz")
    files = [str(tmp_path / "bare.bin"), str(tmp_path / "rings.npz")]
    words = ["--attack", "ghost_wall", "--workers", "1", "--out", str(tmp_path / "out")]
    code, said, complaint = run("attack", *files, *words)
    assert code == 2
    assert "1 of 2 sweeps" in said
    assert (
        "viewshed: bare.bin, sweep 0: the beams of this sweep must be known, got 400 points without rings" in complaint
    )


def test_an_attacker_who_adapts_asks_the_victim(made: Path, tmp_path: Path) -> None:
    words = ["attack", str(made), "--split", "test", "--attack", "adaptive_over_claim", "--victim", "continuous"]
    code, _, _ = run(*words, "--budget", "40", "--workers", "1", "--out", str(tmp_path / "out"))
    found = Archive.open(tmp_path / "out")
    victim = ContinuousRayTrace(found[0].truth.grid)
    before = victim.estimate(Archive.open(made).split("test")[0].sweep).area_m2()
    assert code == 0
    assert victim.estimate(found[0].sweep).area_m2() > before
    assert found.manifest.recipe["config"]["victim"] == "continuous"
