"""Simulated data sets: the same bytes however they are made, stopped runs go on, refusals are one line."""

import json
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from viewshed_lab._jobs import Done, J, LocalEngine, R
from viewshed_lab.data import Archive, Storage
from viewshed_lab.data import simulated as simulation
from viewshed_lab.data.presets import Preset, preset_named

pytestmark = pytest.mark.slow

SMALL = ["nuscenes-small", "--sweeps", "100", "--grid", "32x32"]
"""Five shards: four scenes to train on and one to test with, of 20 sweeps each."""

COMMAND = "from viewshed.cli import main; main()"


def _small() -> Preset:
    return replace(preset_named("nuscenes-small").scaled(100), grid_cells=32, grid_half_extent_m=32.0)


def _files(folder: Path) -> dict[str, bytes]:
    """All bytes by name; commits are left out, so that committing while the tests run does no harm."""
    files = {path.name: path.read_bytes() for path in folder.iterdir()}
    if "manifest.json" in files:
        files["manifest.json"] = re.sub(rb'"commits": \[[^]]*\]', b"", files["manifest.json"])
    return files


def _command(out: Path, *more: str) -> list[str]:
    return [sys.executable, "-c", COMMAND, "simulate", *SMALL, "--out", str(out), *more]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small data set, made in one go by this process."""
    folder = tmp_path_factory.mktemp("whole") / "a"
    simulation.simulate(_small(), Storage.of(folder), LocalEngine(1))
    return folder


def test_the_archive_holds_what_the_preset_says(whole: Path) -> None:
    archive, preset = Archive.open(whole), _small()
    assert len(archive) == 100
    assert [len(archive.split(name)) for name in ("train", "test")] == [80, 20]
    assert [len(archive.split(name).scenes) for name in ("train", "test")] == list(preset.scenes)
    sample = archive[85]
    assert sample.split == "test"
    assert sample.scene.startswith("test-0000-")
    assert sample.truth.grid == preset.grid
    assert set(sample.truth.expected_returns) == {"car", "pedestrian"}
    assert sample.sweep.model.name == "HDL-32E"
    assert len(sample.sweep) > 5000
    table = json.loads((whole / "manifest.json").read_text("utf-8"))
    assert table["recipe"]["seed"] == 0
    assert table["recipe"]["config"]["interval_s"] == preset.interval_s
    assert table["recipe"]["targets"]["pedestrian"]["min_returns"] == 3
    assert table["schema_version"] == 1
    assert set(_files(whole)) == {"manifest.json", *(shard["name"] for shard in table["shards"])}


def test_a_run_that_is_killed_goes_on_with_other_workers(whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "killed"
    process = subprocess.Popen(_command(out, "--workers", "1"), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    end_s = time.monotonic() + 120
    while not _listed(out) and time.monotonic() < end_s:
        assert process.poll() is None, "it finished before it could be killed"
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    process.wait()
    finished = {name: (out / name).stat().st_mtime_ns for name in _listed(out)}
    assert 1 <= len(finished) < 5
    with pytest.raises(ValueError, match="is not finished; run again the command"):
        Archive.open(out)
    (out / ".train-0002-000.parquet.0123456789ab.part").write_bytes(b"half")
    (out / "test-0000-000.parquet").write_bytes((whole / "test-0000-000.parquet").read_bytes()[:5000])
    subprocess.run(_command(out, "--workers", "2"), check=True, capture_output=True)
    assert _files(out) == _files(whole)
    assert {name: (out / name).stat().st_mtime_ns for name in finished} == finished


def _listed(out: Path) -> list[str]:
    """Return the names of the shards that a manifest lists so far."""
    place = out / "manifest.json"
    return [shard["name"] for shard in json.loads(place.read_text("utf-8"))["shards"]] if place.exists() else []


@pytest.mark.parametrize("damage", ["flip", "remove", "manifest"])
def test_what_is_damaged_is_made_anew_and_nothing_else(whole: Path, tmp_path: Path, damage: str) -> None:
    out = Path(shutil.copytree(whole, tmp_path / "b"))
    victim = out / "train-0001-000.parquet"
    raw = victim.read_bytes()
    if damage == "flip":
        victim.write_bytes(raw[:9000] + bytes([raw[9000] ^ 1]) + raw[9001:])
    elif damage == "remove":
        victim.unlink()
    else:
        table = json.loads((out / "manifest.json").read_text("utf-8"))
        (out / "manifest.json").write_text(json.dumps(table | {"shards": [], "frames": 0, "complete": False}), "utf-8")
    made: list[str] = []

    class Recorded:
        def run(self, work: Callable[[J], R], jobs: Sequence[J]) -> Generator[Done[R], None, None]:
            made.extend(getattr(job, "name") for job in jobs)  # noqa: B009 - of any job
            return LocalEngine(1).run(work, jobs)

    simulation.simulate(_small(), Storage.of(out), Recorded())
    assert _files(out) == _files(whole)
    assert (made == ["train-0001-000.parquet"]) == (damage != "manifest")


@pytest.mark.parametrize(("change", "message"), [
    ({"seed": 5}, "holds seed 0, not 5"),
    ({"name": "other"}, "holds preset nuscenes-small, not other"),
    ({"interval_s": 0.25}, "holds nuscenes-small with different interval_s"),
    ({"frames": (79, 20)}, "holds nuscenes-small with different frames"),
])  # fmt: skip
def test_a_place_that_holds_another_data_set_is_refused(whole: Path, change: dict[str, object], message: str) -> None:
    before = _files(whole)
    with pytest.raises(ValueError, match=f"{message}; choose another place"):
        simulation.simulate(replace(_small(), **change), Storage.of(whole), LocalEngine(1))  # type: ignore[arg-type]
    assert _files(whole) == before


def test_another_version_does_not_go_on(whole: Path, tmp_path: Path) -> None:
    text = (whole / "manifest.json").read_text("utf-8").replace('"version": "', '"version": "9', 1)
    (tmp_path / "manifest.json").write_text(text, "utf-8")
    with pytest.raises(ValueError, match=r"was begun with viewshed 9.*; finish it with that version"):
        simulation.simulate(_small(), Storage.of(tmp_path), LocalEngine(1))
