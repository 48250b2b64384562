"""Archives that are made in several runs: what had to be left out is told by every run, not only by the first."""

import contextlib
import json
from pathlib import Path

import pytest

from viewshed import GRIDS
from viewshed_lab._jobs import LocalEngine
from viewshed_lab.data.archive.build import ShardResult
from viewshed_lab.data.archive.storage import Storage
from viewshed_lab.data.tampered import AttackPlan, sweeps_of_recording, tamper

ONE = LocalEngine(1)
PLAN = AttackPlan("uniform", 5)


class _StoppedError(Exception):
    """As if the power went off."""


def run(recording: Path, out: Path, stop_after: int = 9) -> list[str]:
    """Return the lines that a run tells; it is stopped once this many shards are there."""
    told: list[ShardResult] = []

    def progress(made: ShardResult) -> None:
        told.append(made)
        if len(told) == stop_after:
            raise _StoppedError

    with contextlib.suppress(_StoppedError):
        tamper(sweeps_of_recording(str(recording), GRIDS["indoor"]), PLAN, Storage.of(out), ONE, 0, progress)
    return [line for made in told for line in made.problems]


def test_a_finished_archive_tells_its_lines_again_and_is_as_if_made_at_once(recording: Path, tmp_path: Path) -> None:
    whole = run(recording, tmp_path / "whole")
    run(recording, tmp_path / "parts", stop_after=1)
    run(recording, tmp_path / "parts")
    assert run(recording, tmp_path / "parts") == run(recording, tmp_path / "whole") == whole
    content = [{file.name: file.read_bytes() for file in (tmp_path / name).iterdir()} for name in ("whole", "parts")]
    assert content[0] == content[1]
    assert str(recording) not in content[0]["manifest.json"].decode()


def test_a_shard_that_is_made_anew_tells_only_what_is_wrong_now(recording: Path, tmp_path: Path) -> None:
    run(recording, tmp_path / "out")
    assert json.loads((tmp_path / "out" / "problems.json").read_text()).keys() == {"scene-00000-000.parquet"}
    (tmp_path / "out" / "scene-00000-000.parquet").unlink()
    whole = recording / "sequences" / "07" / "velodyne"
    (whole / "000001.bin").write_bytes((whole / "000002.bin").read_bytes())
    assert run(recording, tmp_path / "out") == []
    assert not (tmp_path / "out" / "problems.json").exists()


@pytest.mark.parametrize("content", ["[]", "\xff"])
def test_lines_that_cannot_be_read_cost_the_lines_alone(content: str, recording: Path, tmp_path: Path) -> None:
    run(recording, tmp_path / "out")
    (tmp_path / "out" / "problems.json").write_text(content, encoding="latin-1")
    assert run(recording, tmp_path / "out") == []
