"""``viewshed label``: what it says, and one line for what it refuses."""

import re
import shutil
from pathlib import Path

import pytest
from tests.cli.commands import run

from viewshed.cli import main
from viewshed_lab.data import Archive

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("recording") / "a"
    with pytest.raises(SystemExit):
        main(["simulate", "ugv-small", "--sweeps", "6", "--grid", "24x8", "--workers", "1", "--out", str(out)])
    return out


def test_it_labels_a_data_set_on_its_own_grid(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "labels"
    code, said, _ = run("label", str(recording), "--out", str(out), "--workers", "1")
    assert code == 0
    assert re.fullmatch(rf"{re.escape(str(out))}: 6 labels in 2 scene\(s\), 2 shards, \d\.\d MB\n", said)
    labels, truths = Archive.open(out), Archive.open(recording)
    assert labels.manifest.layout.grid == truths.manifest.layout.grid
    same = [
        (a.truth.visible("car") == b.truth.visible("car"))[a.known & b.known].mean()
        for a, b in zip(labels, truths, strict=True)
    ]
    assert sum(same) / 6 > 0.97


def test_a_damaged_shard_is_one_line_and_exit_code_2(recording: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(recording, tmp_path / "cut"))
    victim = sorted(folder.glob("*.parquet"))[0]
    victim.write_bytes(b"PAR1" + victim.read_bytes()[4:-99])
    out = tmp_path / "labels"
    code, said, complaint = run("label", str(folder), "--out", str(out), "--workers", "1", "--grid", "24x8")
    assert code == 2
    assert len([line for line in complaint.splitlines() if line.startswith("viewshed: ")]) == 1
    assert f"{victim.name} is damaged" in complaint
    assert "in 1 scene(s)" in said


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "viewshed: name a recording SRC or an --index, one of them\n"),
        (("nowhere",), "nowhere: no such file or folder\n"),
        (("RECORDING", "--definition", "best"), "definition must be one of probe, farthest, first_blocker, got 'best'"),
        (("RECORDING", "--target", "tree"), "target must be one of car, pedestrian, got 'tree'"),
        (("RECORDING", "--grid", "big"), "grid must be one of road"),
        (("RECORDING", "--kind", "lost"), "kind must be auto or one of"),
        (("RECORDING", "--engine", "steam"), "engine must be one of local, ray, got 'steam'"),
    ],
)
def test_what_is_refused(words: tuple[str, ...], message: str, recording: Path, tmp_path: Path) -> None:
    named = [str(recording) if word == "RECORDING" else word for word in words]
    code, _, complaint = run("label", *named, "--out", str(tmp_path / "out"))
    assert code == 2
    assert message in complaint
    assert not (tmp_path / "out").exists()
