"""``viewshed monitor``: fits on benign sweeps, alarms on others, and refuses what does not fit in one line."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.cli.commands import run
from tests.networks.made import card, nearby

from viewshed import Sweep, open_recording, write_sweep
from viewshed.cli import main
from viewshed.cli._verdicts import stream_monitor
from viewshed.cli.monitor import _Drives, _suspicious_sweeps
from viewshed.monitor import Calibration, load_calibration, load_monitor
from viewshed.monitor.evidence import EVIDENCE, SECTORS
from viewshed_lab.training.onnx_export import export_onnx
from viewshed_lab.training.unet_torch import Stage, UNet


def _network() -> UNet:
    """A network that is certain near a return, and whose masks matter where there is none."""
    module = nearby()
    first = module.encoder[0]
    assert isinstance(first, Stage)
    with torch.no_grad():
        first.conv1.weight[1:] *= 100.0
    return module


def _sweep(seed: int, reach_m: float = 15.5) -> Sweep:
    """Returns everywhere within reach."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-reach_m, reach_m, (600, 2)), np.full(600, -1.0)])
    return Sweep(points, sensor_height_m=1.0, attitude=np.array([1.0, 0.0, 0.0, 0.0]))


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a network, benign sweeps and a monitor fitted on them."""
    folder = tmp_path_factory.mktemp("monitor")
    export_onnx(folder / "net.onnx", card(), _network())
    for seed in range(20):
        write_sweep(_sweep(seed), folder / f"benign{seed:02}.npz")
    write_sweep(_sweep(99), folder / "calm.npz")
    write_sweep(_sweep(99, 4.0), folder / "cut.npz")
    write_sweep(Sweep(np.zeros((0, 3), np.float32)), folder / "empty.npz")
    with pytest.raises(SystemExit) as stop:
        main(_fit(folder, "--out", str(folder / "monitor.npz")))
    assert not stop.value.code
    return folder


def _fit(folder: Path, *more: str) -> list[str]:
    files = map(str, sorted(folder.glob("benign*.npz")))
    net = ["--weights", str(folder / "net.onnx"), "--grid", "32x16", "--passes", "5", "--false-alarm-rate", "0.1"]
    return ["monitor", "fit", *files, *net, *more]


def _check(folder: Path, *files: str) -> list[str]:
    named = [str(folder / file) for file in files]
    fitted = ["--monitor-file", str(folder / "monitor.npz"), "--weights", str(folder / "net.onnx")]
    return ["monitor", "check", *named, *fitted]


def test_fit_says_what_it_did(place: Path, tmp_path: Path) -> None:
    code, said, err = run(*_fit(place, "--out", str(tmp_path / "again.npz")))
    assert (code, err) == (0, "")
    assert re.search(r"fitted on 10 sweeps, calibrated on 10; alarms above a score of \d\.\d{4}, .* 10\.0% false", said)
    assert (tmp_path / "again.npz").read_bytes() == (place / "monitor.npz").read_bytes()
    monitor = load_monitor(place / "monitor.npz")
    assert (monitor.facts["passes"], monitor.facts["target"], monitor.grid.cells) == ("5", "car", 32)


def test_an_own_vehicle_is_calibrated_from_a_minute_and_fewer_alarms_need_more(tmp_path: Path) -> None:
    """The minute is that of 12 sweeps, one in five seconds."""
    drive, out, bag = tmp_path / "drive", tmp_path / "made.npz", tmp_path / "drive.mcap"
    drive.mkdir()
    words = ("record", "sim", "--preset", "ugv", "--agents", 1, "--seconds", 1.2, "--seed", 4, "--to", bag)
    assert run(*words)[0] == 0
    for number, sweep in enumerate(open_recording(bag)):
        write_sweep(sweep.replace(t_ns=5 * number * 10**9), drive / f"{number:02}.npz")
    write_sweep(Sweep(np.zeros((0, 3), np.float32), t_ns=32 * 10**9 + 5 * 10**8), drive / "06_covered.npz")
    code, said, err = run("monitor", "calibrate", drive, "--out", out)
    assert (code, err) == (0, "")
    assert "calibrated on 12 sweeps of 1 drives" in said
    assert "left out as impossible: 06_covered.npz" in said
    assert load_calibration(out).hours * 60 == pytest.approx(1.0, abs=0.02)
    assert stream_monitor(out).limit == load_calibration(out).limit(stream_monitor(out).per_hour)
    code, _, err = run("monitor", "calibrate", drive, "--out", out, "--per-hour", 1)
    assert code == 2
    assert "1 false alarms an hour need 60 minutes of benign driving, got 1.0" in err


def test_files_without_times_are_one_stream_with_poses_and_each_alone_without(tmp_path: Path) -> None:
    drive, out = tmp_path / "drive", tmp_path / "made.npz"
    drive.mkdir()
    for number in range(13):
        write_sweep(_sweep(number), drive / f"{number:02}.npz")
    poses = drive / "poses.txt"
    poses.write_text("\n".join(f"1 0 0 {number} 0 1 0 0 0 0 1 0" for number in range(13)))
    (drive / "times.txt").write_text("\n".join(str(5.0 * number) for number in range(13)))
    code, _, err = run("monitor", "calibrate", drive, "--out", out)
    assert code == 2
    assert "note: the files have no times, so each is judged alone; give --poses" in err
    assert "got 0 besides 13 sweeps in streams of 5 or fewer, which are too short; give more" in err
    code, said, _ = run("monitor", "calibrate", drive, "--out", out, "--poses", poses)
    assert (code, "calibrated on 13 sweeps of 1 drives" in said) == (0, True)
    code, said, _ = run(
        "monitor", "explain", drive, "--poses", poses, "--number", 6, "--grid", "32x16", "--out", tmp_path / "x.png"
    )
    assert (code, "cannot tell" in said) == (0, False)
    estimate = ("estimate", "--monitor", "--results", "npz", "--out", tmp_path / "out")
    for command in (("monitor", "check"), estimate, ("view", "--monitor", "--html", tmp_path / "x.html")):
        code, said, err = run(*command, drive)
        assert (code, said.count("one sweep alone cannot"), err.count("have no times")) == (0, 13, 1)
    objects = tmp_path / "kitti" / "training" / "velodyne"  # as KITTI's object set, a recording without times
    objects.mkdir(parents=True)
    for number in range(7):
        np.column_stack([_sweep(number).points, np.zeros(600)]).astype(np.float32).tofile(objects / f"{number:06}.bin")
    code, said, err = run("monitor", "check", tmp_path / "kitti")
    assert (said.count("one sweep alone cannot"), err.count("have no times")) == (7, 1)


def test_check_takes_a_rate_and_says_what_it_rests_on(place: Path) -> None:
    code, said, err = run("monitor", "check", place / "calm.npz", "--per-hour", "0.1")
    assert (code, said.count("\n")) == (0, 2)
    assert re.search(r"score above \d\.\d+: 0\.1 false alarms an hour, .* by 210 minutes .*, an extrapolation", err)
    code, _, err = run(*_check(place, "calm.npz"), "--per-hour", "1")
    assert (code, "--per-hour is for a monitor of viewshed monitor calibrate" in err) == (2, True)


@pytest.mark.slow
def test_attacked_drives_and_those_of_another_sensor_are_named() -> None:
    rng = np.random.default_rng(5)
    drawn = rng.exponential(1.0, (7, 150, len(EVIDENCE), SECTORS)).astype(np.float32)
    base = Calibration.fit(list(drawn[:5]), 2.5)
    names = [[f"{drive}/{number}" for number in range(150)] for drive in (5, 6)]
    for every, word in (
        (50, r"left out as attacked, .* at one alarm an hour, the base monitor flags \d+ sweeps: 5/20"),
        (6, r"limit is \d+\.\d+, that of the base monitor \d\.\d+: the drives were attacked, or .* and \d+ more"),
    ):
        attacked = drawn[5:].copy()
        attacked[:, 20::every] *= 1000.0
        drives = _Drives(list(attacked), names, 2.5, [])
        (line,) = _suspicious_sweeps(drives, Calibration.fit(drives.streams, 2.5, base=base), base, 30.0)
        assert re.search(word, line), line


def test_an_empty_sweep_is_an_alarm_and_no_error(place: Path) -> None:
    code, said, err = run("monitor", "check", place / "empty.npz")
    assert (code, err) == (0, "")
    assert said.startswith("empty.npz: INCONSISTENT")
    assert "the sweep has 0 usable returns" in said


def test_one_sweep_says_that_it_cannot_tell(place: Path) -> None:
    code, said, _ = run("monitor", "check", place / "calm.npz")
    assert code == 0
    assert said.startswith("calm.npz: nothing found; one sweep alone cannot reveal")


def test_check_alarms_where_returns_are_gone(place: Path) -> None:
    code, said, err = run(*_check(place, "calm.npz", "cut.npz"))
    assert (code, err) == (0, "")
    calm, cut, total = said.splitlines()
    assert re.fullmatch(r"calm\.npz: score 0\.\d{4}, limit 0\.\d{4}, no alarm", calm)
    assert re.fullmatch(r"cut\.npz: score 0\.\d{4}, limit 0\.\d{4}, ALARM, \d+ m² suspect", cut)
    assert total == "2 sweeps, 1 alarm"


def test_a_page_shows_what_the_monitor_says(place: Path, tmp_path: Path) -> None:
    page, net = tmp_path / "run.html", ["--weights", str(place / "net.onnx")]
    words = ["view", str(place / "calm.npz"), str(place / "cut.npz"), "--html", str(page), *net]
    code, said, err = run(*words, "--monitor-file", str(place / "monitor.npz"))
    assert (code, err) == (0, "")
    assert ["ALARM" in line for line in said.splitlines()] == [False, True, False]
    calm, cut = map(json.loads, re.findall(r'class="about">(.*?)</script>', page.read_text(encoding="utf-8")))
    assert calm["score"] <= calm["limit"] == cut["limit"] < cut["score"]
    assert [len(about["alarms"]) for about in (calm, cut)] == [0, 1]
    code, _, err = run(*words, "--monitor-file", str(place / "monitor.npz"), "--method", "shadow_map")
    assert code == 2
    assert "--monitor-file was fitted on mc_dropout, got --method shadow_map" in err


def test_pictures_and_suspect_cells_on_demand(place: Path, tmp_path: Path) -> None:
    code, said, _ = run(*_check(place, "cut.npz"), "--out", str(tmp_path / "found"))
    assert code == 0
    area = re.search(r"ALARM, (\d+) m² suspect → (\S+)", said)
    assert Path(area[2]).read_bytes().startswith(b"\x89PNG")
    feature = json.loads((tmp_path / "found" / "cut.geojson").read_text())
    assert feature["properties"]["alarm"] is True
    rings = [np.array(ring) for polygon in feature["geometry"]["coordinates"] for ring in polygon]
    signed = [0.5 * np.sum(r[:-1, 0] * r[1:, 1] - r[1:, 0] * r[:-1, 1]) for r in rings]
    assert abs(sum(signed)) == pytest.approx(float(area[1]), abs=0.6), "holes run the other way round"


def test_one_bad_sweep_does_not_stop_the_others(place: Path) -> None:
    code, said, err = run(*_check(place, "empty.npz", "none.npz", "calm.npz"))
    assert code == 2
    assert said.splitlines()[-1] == "1 sweeps, 0 alarms"
    empty, none = err.splitlines()
    assert "empty.npz: estimate must have a standard deviation" in empty
    assert "none.npz" in none


def test_what_does_not_fit_is_one_line(place: Path, tmp_path: Path) -> None:
    few = ["monitor", "fit", *map(str, sorted(place.glob("benign*.npz"))[:10])]
    net = ["--weights", str(place / "net.onnx"), "--grid", "32x16", "--out", str(tmp_path / "no.npz")]
    code, _, err = run(*few, *net)
    assert (code, err) == (2, "viewshed: a false-alarm rate of 0.05 needs at least 19 benign sweeps, got 5\n")
    other = card(threshold=0.7)
    export_onnx(tmp_path / "other.onnx", other, _network())
    words = _check(place, "calm.npz")[:-1]
    code, _, err = run(*words, str(tmp_path / "other.onnx"))
    assert code == 2
    assert re.fullmatch(r"viewshed: weights must be those of the monitor, made \w{12}, got made \w{12}; .*\n", err)
    code, _, err = run(*_fit(place, "--out", str(place / "benign00.npz")))
    assert code == 2
    assert "is an input and would be replaced" in err
