"""``viewshed label``: what it says, and one line for what it refuses."""

import re
import shutil
from pathlib import Path

import pytest
from tests.cli.commands import run

from viewshed_lab.data import Archive

pytestmark = pytest.mark.slow


def test_it_labels_a_data_set_on_its_own_grid(made: Path, tmp_path: Path) -> None:
    out = tmp_path / "labels"
    code, said, _ = run("label", str(made), "--out", str(out), "--workers", "1")
    assert code == 0
    assert re.fullmatch(rf"{re.escape(str(out))}: 6 labels in 2 scene\(s\), 2 shards, \d\.\d MB\n", said)
    labels, truths = Archive.open(out), Archive.open(made)
    assert labels.manifest.layout.grid == truths.manifest.layout.grid
    same = [
        (a.truth.visible("car") == b.truth.visible("car"))[a.known & b.known].mean()
        for a, b in zip(labels, truths, strict=True)
    ]
    assert sum(same) / 6 > 0.97


def test_a_damaged_shard_is_one_line_and_exit_code_2(made: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(made, tmp_path / "cut"))
    victim = sorted(folder.glob("*.parquet"))[0]
    victim.write_bytes(b"PAR1" + victim.read_bytes()[4:-99])
    out = tmp_path / "labels"
    code, said, complaint = run("label", str(folder), "--out", str(out), "--workers", "1", "--grid", "24x8")
    assert code == 2
    assert len([line for line in complaint.splitlines() if line.startswith("viewshed: ")]) == 1
    assert f"{victim.name} is damaged" in complaint
    assert "in 1 scene(s)" in said
