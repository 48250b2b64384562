"""Data sets under attack: what is kept, what is recorded, the same bytes however they are made, and damage."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from viewshed import GRIDS, Archive, Sweep
from viewshed.io import read_sweeps
from viewshed_lab._jobs import LocalEngine
from viewshed_lab.data.archive.build import ShardResult
from viewshed_lab.data.archive.storage import Storage
from viewshed_lab.data.labeling import LabelRules, Origin, label
from viewshed_lab.data.presets import preset_named
from viewshed_lab.data.simulated import simulate
from viewshed_lab.data.tampered import (
    AttackPlan,
    sweeps_of_archive,
    sweeps_of_files,
    sweeps_of_recording,
    tamper,
    tampered_sweep,
)

pytestmark = pytest.mark.slow

ONE = LocalEngine(1)


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Archive:
    """Scenes of ten agents each in three splits, with coarse truth."""
    preset = replace(preset_named("carla-small").scaled(40), grid_cells=16)
    return simulate(preset, Storage.of(tmp_path_factory.mktemp("clean")), ONE)


def test_truth_stays_and_the_record_explains_every_row(clean: Archive, tmp_path: Path) -> None:
    made = tamper(sweeps_of_archive(clean), AttackPlan("far_wall", 40), Storage.of(tmp_path), ONE, seed=3)
    assert [(shard.name, shard.scene, shard.split, shard.frames) for shard in made.shards] == [
        (shard.name, shard.scene, shard.split, shard.frames) for shard in clean.shards
    ]
    places = {}
    for index, (before, after) in enumerate(zip(clean, Archive.open(tmp_path), strict=True)):
        touched = made[index].tampered
        assert touched.added.sum() <= 40
        assert before.sweep.points[~touched.removed].tobytes() == after.sweep.points[~touched.added].tobytes()
        new = after.sweep.points[touched.added]
        assert touched.wedge.holds(np.arctan2(new[:, 1], new[:, 0])).all()
        assert before.known.tobytes() == after.known.tobytes()
        for target in before.truth.expected_returns:
            assert (before.truth.expected_returns[target] == after.truth.expected_returns[target]).all()
        places[index] = int(touched.added.sum())
    assert max(places.values()) == 40


def test_a_replay_plays_the_sweep_before_of_the_same_agent(clean: Archive, tmp_path: Path) -> None:
    made = tamper(sweeps_of_archive(clean), AttackPlan("replay", mode="free_form"), Storage.of(tmp_path), ONE)
    last: dict[tuple[str, str], Sweep] = {}
    for before, after in zip(clean, made, strict=True):
        key = before.scene, before.sweep.agent
        wanted = last.get(key, before.sweep)
        assert after.sweep.points.tobytes() == wanted.points.tobytes()
        assert after.sweep.t_ns == before.sweep.t_ns
        last[key] = before.sweep
    assert len(last) < len(clean)


def test_damage_costs_the_damaged_sweeps_alone(clean: Archive, tmp_path: Path) -> None:
    folder = tmp_path / "clean"
    assert clean.store.folder is not None
    shutil.copytree(clean.store.folder, folder)
    victim = clean.shards[0]
    (folder / victim.name).write_bytes(b"PAR1 nothing of use PAR1")
    told: list[ShardResult] = []
    made = tamper(
        sweeps_of_archive(Archive.open(folder)),
        AttackPlan("jamming"),
        Storage.of(tmp_path / "out"),
        ONE,
        0,
        told.append,
    )
    problems = [problem for one in told for problem in one.problems]
    assert len(problems) == 1
    assert problems[0].startswith(
        f"{victim.scene}, {victim.frames} sweeps from 0 on: {folder}/{victim.name} is damaged"
    )
    assert len(made) == len(clean) - victim.frames


def test_a_place_that_holds_another_attack_is_refused(clean: Archive, tmp_path: Path) -> None:
    sweeps, store = sweeps_of_archive(clean, "test"), Storage.of(tmp_path)
    tamper(sweeps, AttackPlan("far_wall", 10), store, ONE)
    with pytest.raises(ValueError, match="holds far_wall with different budget; choose another place"):
        tamper(sweeps, AttackPlan("far_wall", 11), store, ONE)
    with pytest.raises(ValueError, match="holds name far_wall, not relay"):
        tamper(sweeps, AttackPlan("relay"), store, ONE)
    with pytest.raises(ValueError, match="seed must not be negative, got -1"):
        tamper(sweeps, AttackPlan("relay"), store, ONE, -1)


def test_recordings_and_files_have_no_truth(recording: Path, tmp_path: Path) -> None:
    told: list[ShardResult] = []
    sweeps = sweeps_of_recording(str(recording), GRIDS["indoor"])
    made = tamper(sweeps, AttackPlan("uniform", 5), Storage.of(tmp_path / "out"), ONE, 0, told.append)
    assert [len(sample.sweep) for sample in made] == [45, 47, 45, 46, 47]
    assert not made[0].known.any()
    with pytest.raises(ValueError, match="out must be benign, got one under attack"):
        label(Origin(str(tmp_path / "out")), LabelRules(GRIDS["indoor"]), Storage.of(tmp_path / "labels"), ONE)
    problem = next(problem for one in told for problem in one.problems)
    assert problem.count("000001.bin") == 1
    folder = recording / "sequences" / "07" / "velodyne"
    files = sweeps_of_files(sorted(folder.iterdir()), read_sweeps, GRIDS["indoor"])
    assert files.count == 2
    assert len(files.problems) == 1
    sweep, record = tampered_sweep(files, AttackPlan("uniform", 7))
    assert len(sweep) == 47
    assert record.count('"removed_rows": []') == 1
