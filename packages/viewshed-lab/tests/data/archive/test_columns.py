"""Attacked sweeps come back bit for bit from the range image that they were made from and what an attacker made."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from viewshed import Archive, Rigid, Sweep
from viewshed_lab._jobs import LocalEngine
from viewshed_lab.data.archive.columns import added_rows, merge_rows, row_of_sample, sample_of_row
from viewshed_lab.data.archive.schema import Footer, Layout, Sensors
from viewshed_lab.data.archive.storage import Storage
from viewshed_lab.data.presets import preset_named
from viewshed_lab.data.sample import Sample
from viewshed_lab.data.simulated import simulate
from viewshed_lab.data.tampered import AttackPlan, sweeps_of_archive, tamper
from viewshed_lab.threats.attacks import ATTACKS, FULL_WEDGE
from viewshed_lab.threats.attacks.base import Tampered

ONE = LocalEngine(1)
COLUMNS = ("points", "intensity", "ring", "azimuth", "time_s")


def bits(sweep: Sweep) -> list[bytes | None]:
    columns = [getattr(sweep, name) for name in COLUMNS]
    return [None if column is None else column.dtype.str.encode() + column.tobytes() for column in columns]


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Archive:
    preset = replace(preset_named("carla-small").scaled(4), grid_cells=16)
    return simulate(preset, Storage.of(tmp_path_factory.mktemp("clean")), ONE)


def _size(archive: Archive) -> int:
    return sum(shard.bytes for shard in archive.shards)


@pytest.mark.parametrize(("attack", "budget", "times"), [
    ("far_wall", 150, 1.1), ("uniform", 150, 1.1), ("pose_spoof", None, 1.1), ("removal_and_far_wall", FULL_WEDGE, 1.5),
])  # fmt: skip
def test_every_attack_is_read_as_it_was_made_and_takes_little_room(
    attack: str, budget: int | None, times: float, clean: Archive, tmp_path: Path
) -> None:
    made = tamper(sweeps_of_archive(clean), AttackPlan(attack, budget), Storage.of(tmp_path), ONE, seed=7)
    scenes = [sample.scene for sample in clean]
    for index, scene in enumerate(scenes):
        within = index - scenes.index(scene)
        rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence([7, clean.scenes.index(scene), within])))
        wanted = ATTACKS[attack](budget).apply(clean[index].sweep, rng).sweep
        found = made[index].sweep
        assert bits(found) == bits(wanted)
        assert found.world_from_sensor.as_matrix().tobytes() == wanted.world_from_sensor.as_matrix().tobytes()
        assert (found.t_ns, found.agent, found.sensor_height_m) == (wanted.t_ns, wanted.agent, wanted.sensor_height_m)
    assert _size(made) < times * _size(clean)


def test_an_attacked_archive_can_be_attacked_again(clean: Archive, tmp_path: Path) -> None:
    once = tamper(sweeps_of_archive(clean), AttackPlan("ghost_car", 60), Storage.of(tmp_path / "once"), ONE, seed=1)
    twice = tamper(sweeps_of_archive(once), AttackPlan("uniform", 10), Storage.of(tmp_path / "twice"), ONE, seed=2)
    none = tamper(sweeps_of_archive(once), AttackPlan("uniform", 0), Storage.of(tmp_path / "none"), ONE, seed=2)
    for index in range(len(once)):
        rows = twice[index].tampered
        assert bits(twice[index].sweep.select(~rows.added)) == bits(once[index].sweep)
        assert bits(none[index].sweep) == bits(once[index].sweep)


def _sweep(rng: np.random.Generator, count: int, columns: int) -> Sweep:
    points = rng.normal(0, 20, (count, 3)).astype(np.float32)
    points[rng.random((count, 3)) < 0.1] = -0.0
    rest: dict[str, Any] = {
        "intensity": rng.random(count),
        "ring": rng.integers(0, 64, count),
        "time_s": rng.random(count),
    }
    return Sweep(points, **{name: value for k, (name, value) in enumerate(rest.items()) if columns >> k & 1})


@given(seed=st.integers(0, 2**32), kept=st.integers(0, 30), gone=st.integers(0, 30), made=st.integers(0, 30))
def test_rows_come_back_in_any_order(seed: int, kept: int, gone: int, made: int) -> None:
    rng = np.random.default_rng(seed)
    columns = int(rng.integers(0, 8))
    before = _sweep(rng, kept + gone, columns)
    removed = rng.permutation(kept + gone) < gone
    added = rng.permutation(kept + made) < made
    both = [before.select(~removed), _sweep(rng, made, columns)]
    source = np.empty(kept + made, np.intp)
    source[~added], source[added] = np.arange(kept), kept + np.arange(made)
    merged = {
        name: None if getattr(before, name) is None else np.concatenate([getattr(s, name) for s in both])[source]
        for name in COLUMNS
    }
    after = before.replace(**merged, agent="other", world_from_sensor=Rigid.from_yaw(0.3, (1.0, 2.0, 3.0)))
    rows = added_rows(before, Tampered(after, added, removed))
    if made > kept:
        assert rows is None
        return
    assert len(rows) == made
    again = merge_rows(before, rows, added, removed)
    assert bits(again) == bits(after)
    assert again.agent == "other"


def test_a_bit_that_changed_in_another_row_is_not_lost(make_sample: Callable[..., Sample]) -> None:
    sample = make_sample(3)
    before = sample.sweep
    points = before.points.copy()
    points[5, 1] = np.nextafter(points[5, 1], np.float32(99))
    after = before.replace(points=points)
    none = np.zeros(len(before), np.bool_)
    assert added_rows(before, Tampered(after, none, none)) is None
    zero = before.replace(points=np.where(np.arange(len(before))[:, None] == 5, np.float32(0), before.points))
    minus = zero.replace(points=np.where(zero.points == 0, np.float32(-0.0), zero.points))
    assert added_rows(zero, Tampered(minus, none, none)) is None
    assert added_rows(before.replace(time_s=None), Tampered(before, none, none)) is None
    sensors = Sensors()
    row = row_of_sample(sample.attacked(Tampered(after, none, none)), Layout.of(sample.truth), sensors)
    assert row[1] is None  # no ranges
    assert bits(sample_of_row(row, Footer("", "", Layout.of(sample.truth), sensors)).sweep) == bits(after)
