"""Archives give back what was put in, and say clearly what is wrong with a file."""

import json
import multiprocessing
import pickle
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import viewshed
from viewshed_lab.data import Archive, Sample, Storage, write_archive, write_shard
from viewshed_lab.data.archive import schema
from viewshed_lab.data.archive.shard import Shard

MakeSample = Callable[..., Sample]


def _equal(one: Any, other: Any) -> bool:
    """Bit by bit, whatever it is; written for the tests, on the values' own attributes."""
    if isinstance(one, np.ndarray):
        return isinstance(other, np.ndarray) and one.dtype == other.dtype and one.tobytes() == other.tobytes()
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(_equal(one[key], other[key]) for key in one)
    if hasattr(one, "__dataclass_fields__"):
        return type(one) is type(other) and all(
            _equal(getattr(one, f.name), getattr(other, f.name)) for f in fields(one)
        )
    return type(one) is type(other) and one == other


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 10_000), image=st.booleans(), cells=st.integers(1, 40))
def test_every_sample_comes_back_as_it_was(
    seed: int, image: bool, cells: int, make_sample: MakeSample, tmp_path: Path
) -> None:
    store = Storage.of(tmp_path / "one")
    sample = make_sample(seed, image=image, cells=cells, scene="Straße 7", split="train")
    facts = write_shard(store, "a.parquet", [sample])
    back = Shard(store, "a.parquet").sample(0)
    assert (facts.scene, facts.split, facts.frames) == (sample.scene, sample.split, 1)
    assert _equal(back, sample)


@pytest.fixture
def archive(make_sample: MakeSample, tmp_path: Path) -> Archive:
    """Six scenes, the last two for the test; 4 + number frames each; shards of at most 3 frames."""
    samples = (
        make_sample(10 * scene + frame, scene=f"s{scene}", split="test" if scene > 3 else "train")
        for scene in range(6)
        for frame in range(4 + scene)
    )
    return write_archive(tmp_path / "a", samples, {"command": "test"}, frames_per_shard=3)


def test_indices_lead_to_the_frames_in_order(archive: Archive) -> None:
    agents = [f"agent {10 * scene + frame}" for scene in range(6) for frame in range(4 + scene)]
    assert len(archive) == len(agents) == 39
    assert [archive[k].sweep.agent for k in range(39)] == agents
    assert [sample.sweep.agent for sample in archive] == agents
    assert archive[-1].sweep.agent == agents[-1]
    for index in (39, -40):
        with pytest.raises(IndexError, match=r"index must lie in \[-39, 39\)"):
            archive[index]


def test_splits_and_folds_never_cut_a_scene(archive: Archive) -> None:
    assert archive.split("train").scenes == ("s0", "s1", "s2", "s3")
    assert len(archive.split("test")) == 8 + 9
    with pytest.raises(ValueError, match="split must be one of train, test, got 'val'"):
        archive.split("val")
    held = [part.scenes for rest, part in archive.folds(4) if not set(rest.scenes) & set(part.scenes)]
    assert sorted(scene for scenes in held for scene in scenes) == list(archive.scenes)
    with pytest.raises(ValueError, match=r"count must lie in \[2, 6\]"):
        list(archive.folds(7))


def _agent(archive: Archive) -> str:
    return archive[20].sweep.agent


def test_other_processes_read_it_at_the_same_time(archive: Archive) -> None:
    expected = archive[20].sweep.agent
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        assert pool.map(_agent, [archive] * 6) == [expected] * 6
    assert pickle.loads(pickle.dumps(archive))[20].sweep.agent == expected  # noqa: S301 - our own


def _damaged(path: Path, where: float) -> None:
    raw = bytearray(path.read_bytes())
    raw[int(where * len(raw))] ^= 0x55
    path.write_bytes(raw)


@pytest.mark.parametrize("where", [0.2, 0.99])
def test_a_flipped_byte_is_named_and_the_rest_is_read(archive: Archive, tmp_path: Path, where: float) -> None:
    shard = archive.shards[2]
    _damaged(tmp_path / "a" / shard.name, where)
    opened, told = Archive.open(tmp_path / "a"), []
    [(facts, problem)] = [(facts, problem) for facts, problem in opened.verify() if problem]
    assert facts == shard
    assert f"{shard.name} is damaged: its checksum" in problem
    assert "again" in problem
    agents = [sample.sweep.agent for sample in opened.samples(lambda facts, why: told.append((facts.name, why)))]
    assert len(agents) >= 39 - shard.frames
    assert all(name == shard.name and "is damaged" in why and "\n" not in why for name, why in told)
    assert told


@pytest.mark.parametrize("length", [0, -1])
def test_a_cut_shard_is_named_and_the_rest_is_read(archive: Archive, tmp_path: Path, length: int) -> None:
    shard, told = archive.shards[0], []
    path = tmp_path / "a" / shard.name
    path.write_bytes(path.read_bytes()[:length])
    opened = Archive.open(tmp_path / "a")
    with pytest.raises(ValueError, match=f"{shard.name} is damaged: .*again"):
        opened[0]
    assert len(list(opened.samples(lambda facts, why: told.append(facts)))) == 39 - shard.frames
    assert told == [shard]
    [problem] = [problem for _, problem in opened.verify() if problem]
    assert "bytes" in problem


@pytest.mark.parametrize(("before", "after", "message"), [
    ('"schema_version": 1', '"schema_version": 2', "schema_version must be 1, got 2; read it with the version"),
    ('"complete": true', '"complete": false', "is not finished; run again the command"),
    ('"kind": "viewshed archive"', '"kind": "x"', "manifest.json is damaged"),
    ('"cells": 33', '"cells": 90000', "manifest.json is damaged: cells must lie"),
    ("{", "", "manifest.json is damaged"),
    ("{", "[" * 100_000, "manifest.json is damaged"),
    ('"shards": [', '"shards": 5, "_": [', "manifest.json is damaged"),
])  # fmt: skip
def test_a_bad_manifest_is_one_line(archive: Archive, tmp_path: Path, before: str, after: str, message: str) -> None:
    path = tmp_path / "a" / "manifest.json"
    assert before in path.read_text("utf-8")
    path.write_text(path.read_text("utf-8").replace(before, after, 1), "utf-8")
    with pytest.raises(ValueError, match=message) as caught:
        Archive.open(tmp_path / "a")
    assert "\n" not in str(caught.value)


def _edited(folder: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    """Change a manifest as whoever has an editor can: checksums are still those of the files."""
    path = folder / "manifest.json"
    table = json.loads(path.read_text("utf-8"))
    change(table)
    path.write_text(json.dumps(table), "utf-8")
    return folder


@pytest.mark.parametrize(("change", "message"), [
    (lambda table: table["shards"][1].update(frames=-1), "frames must be at least 1, got -1"),
    (lambda table: table["shards"].append(table["shards"][1] | {"split": "test"}), "lists a-00001.parquet twice"),
    (lambda table: table.update(frames=40), "frames must be 39, those of all shards, got 40"),
])  # fmt: skip
def test_a_manifest_that_contradicts_itself_is_refused(
    archive: Archive, tmp_path: Path, change: Callable[[dict[str, Any]], object], message: str
) -> None:
    with pytest.raises(ValueError, match=message.replace("a-0", "shard-0")) as caught:
        Archive.open(_edited(tmp_path / "a", change))
    assert "manifest.json is damaged" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("change", "message"), [
    (lambda table: table["shards"][1].update(split="test"), "split must be 'test', as in the manifest, got 'train'"),
    (lambda table: table["shards"][1].update(scene="s9"), "scene must be 's9', as in the manifest, got 's0'"),
    (lambda table: (table["shards"][1].update(frames=2), table.update(frames=40)), "frames must be 2, as in the man"),
    (lambda table: table["layout"].update(targets=["car"]), "layout must be .*, as in the manifest, got"),
])  # fmt: skip
def test_a_manifest_that_contradicts_a_shard_is_noticed(
    archive: Archive, tmp_path: Path, change: Callable[[dict[str, Any]], object], message: str
) -> None:
    opened = Archive.open(_edited(tmp_path / "a", change))
    problems = {facts.name: problem for facts, problem in opened.verify()}
    assert message.partition(" must")[0] in str(problems["shard-00001.parquet"])
    with pytest.raises(ValueError, match=message) as caught:
        opened[3]
    assert "shard-00001.parquet is damaged" in str(caught.value)
    assert str(caught.value) == problems["shard-00001.parquet"]


def test_a_package_near_the_root_knows_no_commit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(schema, "__file__", "/app/viewshed_lab/schema.py")
    assert schema.code_version() == {"version": viewshed.__version__, "commits": []}


def test_a_shard_of_another_schema_is_refused(make_sample: MakeSample, tmp_path: Path) -> None:
    store = Storage.of(tmp_path)
    write_shard(store, "a.parquet", [make_sample(0)])
    table = pq.read_table(tmp_path / "a.parquet")
    for version, message in (
        (2, "schema_version must be 1, got 2"), (None, "not a shard of an archive"),
    ):  # fmt: skip
        metadata = {} if version is None else {"viewshed": json.dumps({"schema_version": version})}
        pq.write_table(table.replace_schema_metadata(metadata), tmp_path / "b.parquet")
        with pytest.raises(ValueError, match=message):
            Shard(store, "b.parquet")


def test_a_writer_refuses_what_does_not_fit(make_sample: MakeSample, tmp_path: Path) -> None:
    store = Storage.of(tmp_path / "shards")
    with pytest.raises(ValueError, match="one scene, got train/b after train/s0"):
        write_shard(store, "a.parquet", [make_sample(0), make_sample(1, scene="b")])
    with pytest.raises(ValueError, match="at least one frame"):
        write_shard(store, "a.parquet", [])
    with pytest.raises(ValueError, match="layout of the archive"):
        write_shard(store, "a.parquet", [make_sample(0), make_sample(1, cells=20)])
    assert store.names() == []
    with pytest.raises(ValueError, match="at least one sample"):
        write_archive(tmp_path / "empty", [], {})
    with pytest.raises(ValueError, match="truth must have the layout of the archive"):
        write_archive(tmp_path / "odd", [make_sample(0), make_sample(1, cells=20, scene="b")], {})
    with pytest.raises(ValueError, match="a scene must be in one split, got 's0' in 'train' and 'test'"):
        write_archive(tmp_path / "cut", [make_sample(0), make_sample(1, split="test")], {})
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").write_text("x")
    with pytest.raises(ValueError, match="must be empty"):
        write_archive(tmp_path / "full", [make_sample(0)], {})
    with pytest.raises(ValueError, match="frames_per_shard must be at least 1, got 0"):
        write_archive(tmp_path / "small", [make_sample(0)], {}, frames_per_shard=0)


def test_the_same_samples_give_the_same_bytes(make_sample: MakeSample, tmp_path: Path) -> None:
    for place in ("a", "b"):
        write_archive(tmp_path / place, [make_sample(k) for k in range(3)], {"seed": 1})
    for path in sorted((tmp_path / "a").iterdir()):
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()
