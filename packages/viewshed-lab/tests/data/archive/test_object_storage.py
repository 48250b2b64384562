"""A data set in an object store is the data set in a folder."""

import subprocess
import sys
from pathlib import Path

import pytest

from viewshed_lab.data import Archive, Storage

pytestmark = pytest.mark.slow

COMMAND = "from viewshed.cli import main; main()"
SMALL = ["nuscenes-small", "--sweeps", "60", "--grid", "32x32", "--workers", "2"]


def _run(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", COMMAND, *words], check=False, capture_output=True, text=True)


def test_simulate_into_a_bucket_and_read_back(s3: str, tmp_path: Path) -> None:
    place = f"s3://data/{tmp_path.name}/set"
    for out in (str(tmp_path / "set"), f"{place}?{s3}"):
        ended = _run("simulate", *SMALL, "--out", out)
        assert ended.returncode == 0, ended.stderr
    local, remote = Storage.of(tmp_path / "set"), Storage.of(f"{place}?{s3}")
    assert remote.names() == local.names()
    assert {name: remote.read(name) for name in remote.names()} == {name: local.read(name) for name in local.names()}
    here, there = Archive.open(tmp_path / "set"), Archive.open(f"{place}?{s3}")
    assert len(there) == len(here) == 60
    assert [problem for _, problem in there.verify()] == [None] * len(here.shards)
    for index in (59, 0, 33):
        assert there[index].sweep.points.tobytes() == here[index].sweep.points.tobytes()
        assert (there[index].known == here[index].known).all()


def test_a_bucket_that_is_not_there_is_one_line(s3: str) -> None:
    ended = _run("simulate", *SMALL, "--out", f"s3://nobody/x?{s3}")
    (line,) = [line for line in ended.stderr.splitlines() if line.startswith("viewshed: ")]
    assert ended.returncode == 2
    assert line.startswith("viewshed: s3://nobody/x/manifest.json: ")
    assert line.endswith("; create the bucket first")
