"""A recording labeled from start to end: the same bytes however it is made, and nothing of the truth in it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from viewshed.fov.truth import Truth
from viewshed_lab._jobs import LocalEngine
from viewshed_lab.data import Archive, Sample, Storage, write_archive
from viewshed_lab.data.archive.archive import ArchiveSource
from viewshed_lab.data.labeling import LabelRules, Origin, label
from viewshed_lab.data.labeling.run import opened, recipe_of
from viewshed_lab.data.presets import preset_named
from viewshed_lab.data.simulated import simulate
from viewshed_lab.sim.lidar.stored_sweep import StoredSweep

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes, twelve sweeps, on a coarse grid."""
    folder = tmp_path_factory.mktemp("recording") / "drive"
    preset = replace(preset_named("nuscenes-small").scaled(12), grid_cells=48, grid_half_extent_m=48.0)
    simulate(replace(preset, conditions=("clear",), condition_weights=(1.0,)), Storage.of(folder), LocalEngine(1))
    return folder


@pytest.fixture(scope="module")
def rules(recording: Path) -> LabelRules:
    return LabelRules(Archive.open(recording).manifest.layout.grid)


@pytest.fixture(scope="module")
def labeled(recording: Path, rules: LabelRules, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("labeled") / "a"
    label(Origin(str(recording)), rules, Storage.of(out), LocalEngine(1))
    return out


def _shards(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.parquet"))}


def test_labels_are_near_the_truth_and_keep_the_sweeps(recording: Path, labeled: Path) -> None:
    true, found = Archive.open(recording), Archive.open(labeled)
    assert len(found) == len(true) == 12
    assert (found.scenes, found.splits) == (true.scenes, true.splits)
    agree = []
    for one, other in zip(true, found, strict=True):
        assert (one.sweep.points == other.sweep.points).all()
        assert one.sweep.t_ns == other.sweep.t_ns
        assert isinstance(other.measured, StoredSweep)
        among = one.known & other.known
        agree.append((one.truth.visible("car") == other.truth.visible("car"))[among].mean())
        assert set(other.truth.definitions) == {"farthest", "first_blocker"}
    assert np.mean(agree) > 0.98
    assert np.mean([sample.known.mean() for sample in found]) > 0.8


def test_the_same_bytes_in_other_processes(recording: Path, rules: LabelRules, labeled: Path, tmp_path: Path) -> None:
    label(Origin(str(recording)), rules, Storage.of(tmp_path / "c"), LocalEngine(2))
    assert _shards(tmp_path / "c") == _shards(labeled)


def test_the_truth_of_an_archive_is_not_looked_at(
    recording: Path, rules: LabelRules, labeled: Path, tmp_path: Path
) -> None:
    write_archive(tmp_path / "wrong" / "drive", map(_scrambled, Archive.open(recording)), {"command": "test"})
    wrong = Origin(str(tmp_path / "wrong" / "drive"))
    out = label(wrong, rules, Storage.of(tmp_path / "b"), LocalEngine(1))
    for one, other in zip(Archive.open(labeled), out, strict=True):
        assert (one.truth.expected_returns["car"] == other.truth.expected_returns["car"]).all()
        assert (one.known == other.known).all()
    with pytest.raises(ValueError, match="a holds drive with different sweeps; choose another place"):
        label(wrong, rules, Storage.of(labeled), LocalEngine(1))
    assert recipe_of(Origin("s3://id:word@bucket/drive?region=eu-central-1"), rules, [])["source"] == "drive"


def _scrambled(sample: Sample) -> Sample:
    truth = sample.truth
    wrong = {name: 255 - count for name, count in truth.expected_returns.items()}
    masks = {name: ~mask for name, mask in truth.definitions.items()}
    return replace(sample, truth=Truth(truth.grid, wrong, truth.state, masks), known=~sample.known)


def test_an_archive_as_a_source_gives_its_sweeps_in_time_order(recording: Path) -> None:
    archive, source = Archive.open(recording), ArchiveSource.open(recording)
    assert source.scenes() == archive.scenes
    refs = source.refs(archive.scenes[0])
    times = [ref.t_ns for ref in refs]
    assert times == sorted(times, key=lambda t_ns: t_ns or 0)
    wanted = list(archive.of_scenes([archive.scenes[0]]))
    assert [source.read(ref).t_ns for ref in refs] == [sample.sweep.t_ns for sample in wanted]
    assert (source.read(refs[2]).points == wanted[2].sweep.points).all()
    assert (source.sample(refs[2]).known == wanted[2].known).all()
    assert source.boxes(refs[0]) is None
    assert source.split(archive.scenes[0]) == wanted[0].split
    with pytest.raises(ValueError, match="scene must be one of the 2 of the archive, got 'none'"):
        source.refs("none")
    with pytest.raises(ValueError, match="ref must be one of"):
        source.read(replace(refs[0], key="other.parquet:0"))


def test_real_drives_are_labeled(real_data: Path, tmp_path: Path) -> None:
    origin = Origin(str(real_data / "index.json"), "index")
    source = opened(origin)
    drive = next(scene for scene in source.scenes() if scene.startswith("kitti-odometry-00"))
    refs = source.refs(drive)
    assert [ref.t_ns for ref in refs][:4] == [0, 100_000_000, 200_000_000, 300_000_000]
    assert len(source.read(refs[0])) == 124_668
    assert source.damage() == ()
    with pytest.raises(ValueError, match=r"ref must be one of .*index\.json, got x"):
        source.read(replace(refs[0], file="x"))
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.bin").write_bytes(b"x")
    (tmp_path / "in" / "index.json").symlink_to(tmp_path / "index.json")
    (tmp_path / "index.json").write_text('[{"file": "a.bin", "sensor": "x", "stats": {"points": 1}}]', encoding="utf-8")
    assert Origin(str(tmp_path / "in" / "index.json"), "index").open().scenes() == ("a.bin",)
    (tmp_path / "index.json").write_text("[]", encoding="utf-8")
    with pytest.raises(ValueError, match="must list at least one sweep, got none"):
        Origin(str(tmp_path / "index.json"), "index").open()
