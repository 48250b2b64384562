"""A data set in an object store is the data set in a folder."""

from pathlib import Path

import pytest
from tests.cli.commands import run

from viewshed_lab.data import Archive, Storage

pytestmark = pytest.mark.slow

SMALL = ("simulate", "nuscenes-small", "--sweeps", 20, "--grid", "32x32", "--workers", 1, "--out")


def test_simulate_into_a_bucket_and_read_back(s3: str, tmp_path: Path) -> None:
    place = f"s3://data/{tmp_path.name}/set"
    for out in (str(tmp_path / "set"), f"{place}?{s3}"):
        ended = run(*SMALL, out)
        assert ended.returncode == 0, ended.stderr
    local, remote = Storage.of(tmp_path / "set"), Storage.of(f"{place}?{s3}")
    assert remote.names() == local.names()
    assert {name: remote.read(name) for name in remote.names()} == {name: local.read(name) for name in local.names()}
    here, there = Archive.open(tmp_path / "set"), Archive.open(f"{place}?{s3}")
    assert len(there) == len(here) == 20
    assert [problem for _, problem in there.verify()] == [None] * len(here.shards)
    for index in (19, 0, 11):
        assert there[index].sweep.points.tobytes() == here[index].sweep.points.tobytes()
        assert (there[index].known == here[index].known).all()


def test_a_bucket_that_is_not_there_is_one_line(s3: str) -> None:
    ended = run(*SMALL, f"s3://nobody/x?{s3}")
    (line,) = [line for line in ended.stderr.splitlines() if line.startswith("viewshed: ")]
    assert ended.returncode == 2
    assert line.startswith("viewshed: s3://nobody/x/manifest.json: ")
    assert line.endswith("; create the bucket first")
