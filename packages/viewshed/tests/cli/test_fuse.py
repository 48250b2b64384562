"""``viewshed fuse``: what several agents see together, as a stranger types it."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from tests.cli.commands import run

from viewshed import BevGrid, Sweep, load_estimator, open_recording, read_sweep, write_sweep
from viewshed.agents.registration import UNSTATED, PoseStd
from viewshed.agents.report import AgentReport
from viewshed.agents.rounds import Round, Rounds
from viewshed.cli._record import Center
from viewshed.cli.fuse import parse_pose_std, report_of
from viewshed.estimators import Estimator
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.estimators.temporal import SweepBuffer, TemporalEstimator
from viewshed.geometry import Rigid
from viewshed.io.export import read_npz
from viewshed.io.samples import junction_path
from viewshed.objects.object_stream import ObjectStream
from viewshed.preprocess.leveling import level

pytest.importorskip("rosbags", reason="rosbags is not installed: bags are not written")
pytest.importorskip("mcap", reason="mcap is not installed: bags are not written")


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated drive of two vehicles."""
    place = tmp_path_factory.mktemp("drive") / "junction.mcap"
    words = ("--world", "junction", "--preset", "ugv", "--agents", 2, "--seconds", 2, "--hz", 2, "--to", place)
    code, _, err = run("record", "sim", *words)
    assert (code, err) == (0, "")
    return place


def test_agents_of_a_recording_are_put_together(drive: Path, tmp_path: Path) -> None:
    code, out, err = run("fuse", drive, "--out", tmp_path / "fused")
    assert (code, err) == (0, "")
    *lines, last = out.splitlines()
    assert len(lines) == 4
    assert last == f"4 times → {tmp_path / 'fused'}"
    assert "ACCUSED" not in out
    rows = [json.loads(line) for line in (tmp_path / "fused" / "fused.jsonl").read_text().splitlines()]
    assert [len(row["agents"]) for row in rows] == [2] * 4
    assert len(rows[-1]["objects"]) > 3
    assert any(len(one["reported_by"]) == 2 for one in rows[-1]["objects"])
    with Image.open(tmp_path / "fused" / "fused_0003.png") as picture:
        assert len(np.unique(np.asarray(picture.convert("L")))) > 10
    page = (tmp_path / "fused" / "fused.html").read_text()
    assert page.count("<polyline") == 2  # the trust in each agent
    assert "http" not in page.replace("http-equiv", "")  # one file, no network


def test_what_each_agent_saw_before_helps_where_a_history_is_asked_for(drive: Path, tmp_path: Path) -> None:
    words, grid = ("estimate", drive, "--grid", "64x32", "--results", "npz", "--out"), BevGrid(64, 32.0)
    assert run(*words, tmp_path / "past", "--history", 3)[0] == 0
    assert run(*words, tmp_path / "alone")[0] == 0
    estimators: list[Estimator] = [TemporalEstimator(ShadowMap(grid), SweepBuffer(3)), ShadowMap(grid)]
    fewer = 0
    for number, sweep in enumerate(open_recording(drive)):
        past, alone = (read_npz(next((tmp_path / name).glob(f"*_{number:03}.npz"))) for name in ("past", "alone"))
        for found, estimator in zip((past, alone), estimators, strict=True):
            np.testing.assert_allclose(found.visible_prob, estimator.estimate(sweep).visible_prob, atol=0.01)
        fewer += int(past.visible().sum() < alone.visible().sum())
    assert number == 7
    assert fewer >= 2


def test_deviations_of_poses_that_are_none_are_refused(drive: Path, tmp_path: Path) -> None:
    words = ("fuse", drive, "--results", "jsonl", "--out", tmp_path / "poses")
    for wrong in ("0.2", "-1,0", "a,b", "nan,1"):
        code, _, err = run(*words, "--pose-std", wrong)
        assert code == 2
        assert f"--pose-std must be METERS,DEGREES, both 0 or more, got '{wrong}'; as 0.2,0.5" in err


def posed_file(path: Path, agent: str, x_m: float) -> Path:
    """Write the sample as a sweep of an agent that stands at x."""
    sweep = read_sweep(junction_path()).replace(
        agent=agent, t_ns=0, world_from_sensor=Rigid.from_yaw(0.0, (x_m, 0.0, 2.0))
    )
    write_sweep(sweep, path)
    return path


def test_an_agent_that_nobody_can_contradict_is_noted_once(tmp_path: Path) -> None:
    one, other = (posed_file(tmp_path / f"{name}.npz", name, x_m) for name, x_m in (("car", 0.0), ("mast", 500.0)))
    words = ("--results", "jsonl", "--out", tmp_path / "fused")
    for files, note in (
        ((one,), "car alone is heard: nobody contradicts it"),
        ((one, other), "car0, mast1: farther than 100 m from all others, so that nobody contradicts it"),
    ):
        code, _, err = run("fuse", *files, *words)
        assert (code, err) == (0, f"viewshed: note: {note}\n")
        [row] = map(json.loads, (tmp_path / "fused" / "fused.jsonl").read_text().splitlines())
        assert row["notes"] == [note]


def test_a_sweep_that_cannot_be_taken_costs_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def of_one(sweep: Sweep, *others: Any) -> AgentReport:
        if sweep.agent == "car0":
            raise ValueError("points must be in meters")
        return report_of(sweep, *others)

    monkeypatch.setattr(sys.modules["viewshed.cli.fuse"], "report_of", of_one)
    files = [posed_file(tmp_path / f"{name}.npz", name, 0.0) for name in ("car", "mast")]
    code, out, err = run("fuse", *files, "--results", "jsonl", "--out", tmp_path / "fused")
    assert code == 2
    assert "viewshed: car0, 0.00 s: points must be in meters\n" in err
    assert out.endswith(f"1 times → {tmp_path / 'fused'}\n")


def test_deviations_of_poses_that_are_larger_than_what_counts_are_noted(capsys: pytest.CaptureFixture[str]) -> None:
    assert parse_pose_std("5,20") == PoseStd(5.0, np.radians(20.0))
    note = "viewshed: note: --pose-std 5,20: reduced to the maximum, 0.25 m and 0.6°\n"
    assert capsys.readouterr().err == note
    parse_pose_std("0.25,0.6")
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("deviation", [None, 0.5])
def test_a_center_takes_a_pose_to_be_as_certain_as_its_sweep_states(
    deviation: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = list[PoseStd]()

    def add(self: Rounds, t_s: float, report: AgentReport) -> list[Round]:
        seen.append(report.pose_std)
        return []

    monkeypatch.setattr(Rounds, "add", add)
    sweep = read_sweep(junction_path()).replace(
        t_ns=1, world_from_sensor=Rigid.identity(),
        pose_covariance=None if deviation is None else deviation**2 * np.eye(6),
    )  # fmt: skip
    estimator = load_estimator("shadow_map")
    leveled = level(sweep, estimator.grid)
    estimate = estimator.estimate(leveled)
    Center().add(sweep, estimate, ObjectStream().follow(leveled, estimate))
    assert seen == [UNSTATED if deviation is None else PoseStd(0.5, 0.5)]


def test_a_replay_puts_agents_together_and_names_who_was_forged(drive: Path, tmp_path: Path) -> None:
    words = ("--fuse", "--attack", "fabricate_static", "--attacked", "vehicle_0,nobody", "--attack-from", "0.5")
    code, out, err = run("replay", drive, "--as-fast", *words, "--to", tmp_path / "fused.mcap")
    assert code == 0
    assert err == "viewshed: note: --attacked nobody: no agent has this name, nothing of it was forged\n"
    lines = [line for line in out.splitlines() if line.startswith("center: ")]
    assert len(lines) == 4
    assert all(" objects believed" in line for line in lines)
    assert "; objects p50 " in out


def test_a_page_of_many_agents_has_rounds_with_trust(drive: Path, tmp_path: Path) -> None:
    code, _, err = run("view", drive, "--html", tmp_path / "run.html", "--fuse", "--attack", "over_claim")
    assert (code, err) == (0, "")
    page = (tmp_path / "run.html").read_text(encoding="utf-8")
    abouts = [json.loads(text) for text in re.findall(r'json" class="about">(.*?)</script>', page)]
    assert [about["name"][:8] for about in abouts] == ["2 agents"] * 4
    assert [row[0] for row in abouts[-1]["trust"]] == ["vehicle_0/lidar/data", "vehicle_1/lidar/data"]
    assert all(row[4] for row in abouts[-1]["trust"])
    assert len(abouts[-1]["tracks"]) > 3


def test_a_sweep_without_time_and_pose_is_put_together_with_none(tmp_path: Path) -> None:
    write_sweep(read_sweep(junction_path()).select(np.arange(0, 30000, 10)), tmp_path / "alone.ply")
    code, _, err = run("replay", tmp_path / "alone.ply", "--as-fast", "--fuse")
    assert code == 2
    assert "--fuse needs a time and a pose of each sweep, ego has a sweep without them" in err


def test_agents_of_one_name_in_two_files_are_two_agents(drive: Path, tmp_path: Path) -> None:
    words = ("--pose-std", "0.2,0.5", "--results", "jsonl", "--out", tmp_path / "twice")
    code, _, err = run("fuse", drive, drive, *words)
    assert (code, err) == (0, "")
    rows = [json.loads(line) for line in (tmp_path / "twice" / "fused.jsonl").read_text().splitlines()]
    assert [len(row["agents"]) for row in rows] == [4] * 4
