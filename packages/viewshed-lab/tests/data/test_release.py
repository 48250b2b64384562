"""The published data set: the same bytes from the same seed, a data card, and a loader that takes nothing else."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from viewshed.cli import main
from viewshed_lab._jobs import LocalEngine
from viewshed_lab.data import Archive, open_release, release
from viewshed_lab.data.archive.storage import Storage
from viewshed_lab.data.presets import preset_named
from viewshed_lab.data.simulated import jobs_of, simulate

TINY = "f6fba37835f4c1a1c4ea9368f67e690d2dea54f1bac867e10cd789a66fb18ce2"
"""SHA-256 over the shards of six sweeps of the preset, on a small grid, as recorded with the versions named there."""


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Archive:
    preset = replace(preset_named("release").scaled(6), grid_cells=64, grid_half_extent_m=32.0)
    return simulate(preset, Storage.of(tmp_path_factory.mktemp("release")), LocalEngine(1))


def _published_as(monkeypatch: pytest.MonkeyPatch, archive: Archive) -> None:
    shards = {shard.name: shard.sha256 for shard in archive.shards}
    monkeypatch.setattr(release, "published", lambda: release.Published(shards, {"pyarrow": "1"}))


def test_the_same_seed_gives_the_recorded_bytes(tiny: Archive) -> None:
    import pyarrow as pa

    if pa.__version__ != release.published().made_with["pyarrow"]:
        pytest.skip("another pyarrow packs the same numbers into other bytes")
    assert release.digest_of(tiny.shards) == TINY


def test_every_shard_of_the_preset_has_a_recorded_hash() -> None:
    jobs = jobs_of(preset_named("release"))
    assert {job.name for job in jobs} == set(release.published().shards)
    assert all(len(digest) == 64 for digest in release.published().shards.values())


def test_the_loader_refuses_another_data_set_and_a_damaged_one(
    tiny: Archive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ValueError, match="must be the published data set, got"):
        open_release(tiny.store.place)
    _published_as(monkeypatch, tiny)
    copy = tmp_path / "copy"
    shutil.copytree(str(tiny.store.folder), copy)
    shard = next(copy.glob("*.parquet"))
    content = bytearray(shard.read_bytes())
    content[len(content) // 2] ^= 1
    shard.write_bytes(content)
    with pytest.raises(ValueError, match="is damaged"):
        open_release(copy)
    with pytest.raises(ValueError, match="must be a data set of viewshed, but has no manifest"):
        open_release(tmp_path / "nowhere")


def test_the_card_says_what_is_in_the_data_set(tiny: Archive) -> None:
    card = release.card(tiny)
    assert "6 simulated LiDAR sweeps in 3 scenes" in card
    for split in ("train", "validation", "test"):
        assert f"| {split} | 1 |" in card
    assert release.digest_of(tiny.shards) in card
    assert "{" not in card.replace("{}", "")


def test_the_command_writes_the_card_and_compares(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    small = replace(preset_named("release").scaled(6), grid_cells=64, grid_half_extent_m=32.0)
    monkeypatch.setattr("viewshed_lab.data.presets.preset_named", lambda name: small)
    place = tmp_path / "data"
    with pytest.raises(SystemExit) as other:
        main(["simulate", "release", "--workers", "1", "--out", str(place)])
    assert other.value.code == 2
    assert "shards differ from the published ones, which were made with pyarrow" in capsys.readouterr().err
    assert (place / release.CARD).read_text("utf-8") == release.card(Archive.open(place))
    _published_as(monkeypatch, Archive.open(place))
    with pytest.raises(SystemExit) as same:
        main(["simulate", "release", "--workers", "1", "--out", str(place)])
    assert same.value.code in (0, None)
    assert "all 3 shards are identical to the published ones" in capsys.readouterr().out
    assert json.loads((place / "manifest.json").read_text("utf-8"))["complete"]
