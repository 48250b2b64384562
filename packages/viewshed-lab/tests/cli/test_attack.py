"""``viewshed attack`` and ``viewshed corrupt``: what they say, what they leave out, what they refuse in one line."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from tests.cli.commands import run

from viewshed import Archive, Sweep, read_sweep, write_sweep
from viewshed.cli import main
from viewshed.estimators.ray_trace import ContinuousRayTrace

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("attack") / "clean"
    with pytest.raises(SystemExit) as stop:
        main(["simulate", "ugv-small", "--sweeps", "5", "--grid", "24x8", "--workers", "1", "--out", str(out)])
    assert not stop.value.code
    return out


def test_attack_says_what_was_made(clean: Path, tmp_path: Path) -> None:
    out = tmp_path / "attacked"
    words = ["attack", str(clean), "--attack", "ghost_wall", "--budget", "full", "--workers", "1", "--out", str(out)]
    code, said, progress = run(*words)
    assert code == 0
    assert re.fullmatch(rf"{re.escape(str(out))}: 5 of 5 sweeps, 2 shards, \d\.\d MB\n", said)
    assert "5/5" in progress
    assert [sample.scene for sample in Archive.open(out)] == [sample.scene for sample in Archive.open(clean)]
    _, said, _ = run("dataset", "info", str(out))
    assert "made by: command attack, name ghost_wall, seed 0" in said


def test_corrupt_drops_and_moves_returns(clean: Path, tmp_path: Path) -> None:
    words = ["corrupt", str(clean), "--corruption", "dropped_beams", "--severity", "5", "--split", "test"]
    code, _, _ = run(*words, "--workers", "1", "--out", str(tmp_path / "out"))
    made, before = Archive.open(tmp_path / "out"), Archive.open(clean).split("test")
    assert code == 0
    assert len(made) == len(before)
    assert 0.2 < len(made[0].sweep) / len(before[0].sweep) < 0.4


def test_one_file_becomes_one_file_with_its_record(tmp_path: Path) -> None:
    clean = Sweep(np.random.default_rng(1).normal(0, 12, (400, 3)).astype(np.float32))
    write_sweep(clean, tmp_path / "a.npz")
    words = ["attack", str(tmp_path / "a.npz"), "--attack", "uniform", "--budget", "30"]
    code, said, _ = run(*words, "--out", str(tmp_path / "b.npz"))
    assert (code, said) == (0, f"{tmp_path}/b.npz: 430 returns; what was touched is in b.npz.touched.json\n")
    record = json.loads((tmp_path / "b.npz.touched.json").read_text())
    attacked = read_sweep(tmp_path / "b.npz")
    kept = np.setdiff1d(np.arange(len(attacked)), record["added_rows"])
    assert len(record["added_rows"]) == 30
    assert attacked.points[kept].tobytes() == clean.points.tobytes()
    code, _, complaint = run(*words, "--out", str(tmp_path / "a.npz"))
    assert (code, complaint) == (
        2,
        f"viewshed: {tmp_path}/a.npz is an input and would be replaced; choose another place\n",
    )


def test_a_cloud_without_rings_is_left_out_and_the_rest_goes_on(clean: Path, tmp_path: Path) -> None:
    write_sweep(Sweep(np.random.default_rng(1).normal(0, 12, (400, 3)).astype(np.float32)), tmp_path / "bare.bin")
    write_sweep(Archive.open(clean)[0].sweep, tmp_path / "rings.npz")
    files = [str(tmp_path / "bare.bin"), str(tmp_path / "rings.npz")]
    words = ["--attack", "ghost_wall", "--workers", "1", "--out", str(tmp_path / "out")]
    code, said, complaint = run("attack", *files, *words)
    assert code == 2
    assert "1 of 2 sweeps" in said
    assert (
        "viewshed: bare.bin, sweep 0: the beams of this sweep must be known, got 400 points without rings" in complaint
    )


def test_an_attacker_who_adapts_asks_the_victim(clean: Path, tmp_path: Path) -> None:
    words = ["attack", str(clean), "--split", "test", "--attack", "adaptive_over_claim", "--victim", "continuous"]
    code, _, _ = run(*words, "--budget", "40", "--workers", "1", "--out", str(tmp_path / "out"))
    made = Archive.open(tmp_path / "out")
    victim = ContinuousRayTrace(made[0].truth.grid)
    before = victim.estimate(Archive.open(clean).split("test")[0].sweep).area_m2()
    assert code == 0
    assert victim.estimate(made[0].sweep).area_m2() > before
    assert made.manifest.recipe["config"]["victim"] == "continuous"


@pytest.mark.parametrize(("words", "message"), [
    (["--attack", "far_wal"], "attack must be one of uniform, .*, paper, got 'far_wal'"),
    (["--attack", "uniform", "--budget", "full"], "budget must be a number for uniform"),
    (["--attack", "relay", "--budget", "ten"], "budget must be a whole number of returns or full, got 'ten'"),
    (["--attack", "relay", "--mode", "free_form"], "leave mode out"),
    (["--attack", "ghost_wall", "--placement", "random"], "leave placement out"),
    (["--attack", "relay", "--placement", "best"], "placement must be one of random, behind_nearest_obstacle, largest"),
    (["--attack", "relay", "--victim", "shadow_map"], "--victim goes with adaptive_over_claim"),
    (["--attack", "adaptive_over_claim", "--victim", "oracle"], "method must be one of continuous, .*, got 'oracle'"),
    (["--attack", "adaptive_over_claim_free", "--budget", "full"], "for free points, got 1000000000"),
    (["--attack", "relay", "--split", "val"], "split must be one of train, test, got 'val'"),
    (["--attack", "relay", "--seed", "-1"], "seed must not be negative, got -1"),
    (["--attack", "relay", "--engine", "slurm"], "engine must be one of local, ray"),
])  # fmt: skip
def test_what_cannot_be_done_is_one_line(clean: Path, words: list[str], message: str, tmp_path: Path) -> None:
    code, said, complaint = run("attack", str(clean), *words, "--out", str(tmp_path / "none"))
    assert (code, said, complaint.count("\n")) == (2, "", 1)
    assert re.search(message, complaint)
    assert not (tmp_path / "none").exists()


def test_sources_that_are_not_there(tmp_path: Path) -> None:
    words = ["--attack", "relay", "--out", str(tmp_path / "none")]
    code, _, complaint = run("attack", str(tmp_path / "nothing.bin"), *words)
    assert (code, complaint.count("\n")) == (2, 1)
    assert "no such file; name one data set, one recording, or files" in complaint
    code, _, complaint = run("attack", str(tmp_path), *words)
    assert (code, complaint.count("\n")) == (2, 1)
    assert "no recording found here" in complaint
