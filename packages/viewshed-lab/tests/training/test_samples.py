"""TrainingFrames: inputs against a count by hand, truth against the archive, attacks and dropout by their seeds."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from viewshed import Archive, BevGrid, Sample
from viewshed.estimators import PAPER_ESTIMATORS
from viewshed_lab._jobs import LocalEngine
from viewshed_lab.data.archive.storage import Storage
from viewshed_lab.data.presets import preset_named
from viewshed_lab.data.simulated import simulate
from viewshed_lab.training import TrainConfig
from viewshed_lab.training.data import prepare
from viewshed_lab.training.samples import BLANK, ArchivedSamples, Share, TrainingFrames, TrainingOrder, ValidationOrder

pytestmark = pytest.mark.slow


def _samples(archive: Path, frames: TrainingFrames) -> list[Sample]:
    """The samples behind the frames, found by their truth."""
    every = list(Archive.open(archive).split("train"))
    found = []
    for index in range(len(frames)):
        visible = frames[0, index]["visible"] > 0
        found.append(next(sample for sample in every if (sample.truth.visible("car") == visible).all()))
    return found


def _counted(sample: Sample) -> NDArray[np.float64]:
    """Returns of each cell, by numpy: forward is the first axis, left the second."""
    pose = sample.sweep.world_from_sensor
    yaw = np.arctan2(pose.rotation[1, 0], pose.rotation[0, 0])
    unturned = np.array([[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    level = sample.sweep.points.astype(np.float64) @ (unturned @ pose.rotation).T
    used = level[(np.abs(level[:, 2]) <= 3) & (np.hypot(level[:, 0], level[:, 1]) <= 100)]
    counts: NDArray[np.float64] = np.histogram2d(used[:, 0], used[:, 1], bins=32, range=[[-32, 32], [-32, 32]])[0]
    return counts


def test_inputs_are_counts_and_truth_is_the_archives(config: TrainConfig, archive: Path, tmp_path: Path) -> None:
    frames = prepare(replace(config, attacks=(), attack_share=0.0, counts="linear"), tmp_path).train
    for index, sample in enumerate(_samples(archive, frames)[:6]):
        arrays = frames[1, index]
        wrong = np.abs(arrays["inputs"][0] * 1000 - np.minimum(_counted(sample), 255))
        assert arrays["inputs"].shape == (1, 32, 32)
        assert wrong.sum() <= 0.002 * len(sample.sweep)  # float32 at the edges of cells
        assert ((arrays["known"] > 0) == sample.known).all()
        assert {str(array.dtype) for array in arrays.values()} == {"float32"}


def test_half_of_the_frames_are_attacked_and_no_truth_moves(config: TrainConfig, tmp_path: Path) -> None:
    clean = prepare(replace(config, attacks=(), attack_share=0.0), tmp_path).train
    frames = prepare(replace(config, attacks=("ghost_wall",)), tmp_path).train
    changed = 0
    for epoch in range(1, 5):
        for index in range(len(frames)):
            before, after = clean[epoch, index], frames[epoch, index]
            changed += bool((before["inputs"] != after["inputs"]).any())
            assert (before["visible"] == after["visible"]).all()
    assert 0.35 < changed / (4 * len(frames)) < 0.65


def test_all_that_is_random_follows_from_seed_epoch_and_number(config: TrainConfig, tmp_path: Path) -> None:
    attacked = replace(config, attack_share=1.0, attacks=("uniform",))
    one, two = prepare(attacked, tmp_path).train, prepare(attacked, tmp_path).train
    other = prepare(replace(attacked, seed=0, name="other"), tmp_path).train
    for name in ("inputs", "masks"):
        assert (one[1, 3][name] == two[1, 3][name]).all()
        assert (one[1, 3][name] == other[1, 3][name]).all()
        assert (one[1, 3][name] != one[2, 3][name]).any()
    seeded = replace(one, config=replace(attacked, seed=5))
    assert (one[1, 3]["inputs"] != seeded[1, 3]["inputs"]).any()


def test_dropout_drops_its_share_of_channels_and_mle_none(config: TrainConfig, tmp_path: Path) -> None:
    frames = prepare(replace(config, width=16, dropout=0.25), tmp_path).train
    masks = np.concatenate([frames[epoch, 0]["masks"] for epoch in range(1, 60)])
    assert np.unique(masks).tolist() == pytest.approx([0.0, 4 / 3])
    assert abs((masks == 0).mean() - 0.25) < 0.02
    plain = prepare(replace(config, variant="mle"), tmp_path).train
    assert (plain[1, 0]["masks"] == 1).all()


def test_the_papers_label_is_of_the_clean_sweep(config: TrainConfig, archive: Path, tmp_path: Path) -> None:
    wanted = replace(config, truth="paper_label", cells=64, attack_share=1.0, attacks=("paper",))
    frames = prepare(wanted, tmp_path).train
    estimator = PAPER_ESTIMATORS["paper_label"](BevGrid(64, 32.0))
    labels = [estimator.estimate(sample.sweep).visible() for sample in Archive.open(archive).split("train")]
    for index in range(0, len(frames), 5):
        arrays = frames[2, index]
        assert any(((arrays["visible"] > 0) == label).all() for label in labels)
        assert (arrays["known"] == 1).all()
    assert len(list((tmp_path / "labels").iterdir())) == 6
    with pytest.raises(IndexError, match="index must be below"):
        _ = frames[1, len(frames)]


def test_an_attack_that_a_sweep_refuses_leaves_it(config: TrainConfig, tmp_path: Path) -> None:
    clean = prepare(replace(config, attacks=(), attack_share=0.0), tmp_path).train
    replayed = prepare(replace(config, attacks=("replay",), attack_share=1.0), tmp_path).train
    same = [(clean[1, k]["inputs"] == replayed[1, k]["inputs"]).all() for k in range(len(clean))]
    assert sum(same) * 4 == len(same)  # the first sweep of each scene of four has none before it


@given(st.integers(1, 40), st.integers(1, 5), st.integers(0, 3))
def test_processes_share_an_epoch(frames: int, world: int, epoch: int) -> None:
    shares = [Share(rank, world) for rank in range(world)]
    orders = [TrainingOrder(frames, frames, 3, share, epoch) for share in shares]
    keys = [list(order) for order in orders]
    assert {len(part) for part in keys} == {len(orders[0])}
    assert {number for part in keys for _, number in part} == set(range(frames))
    assert {shown for part in keys for shown, _ in part} == {epoch + 1}
    held = [number for share in shares for _, number in ValidationOrder(frames, share)]
    assert sorted(number for number in held if number != BLANK) == list(range(frames))
    assert len(held) == len(ValidationOrder(frames, shares[0])) * world


def _equal(one: dict[str, NDArray[np.float32]], two: dict[str, NDArray[np.float32]]) -> bool:
    return all((one[name] == two[name]).all() for name in one)


@pytest.mark.parametrize("truth", ["probe", "paper_label"])
def test_kept_frames_are_those_that_would_be_made(config: TrainConfig, tmp_path: Path, truth: str) -> None:
    wanted = replace(config, truth=truth, attacks=("uniform",), attack_share=1.0)
    made, kept = prepare(wanted, tmp_path), prepare(replace(wanted, versions=2), tmp_path)
    for index in range(len(made.train)):
        assert _equal(made.train[1, index], kept.train[1, index])
        assert _equal(made.train[2, index], kept.train[2, index])
        assert (kept.train[3, index]["inputs"] == made.train[1, index]["inputs"]).all()
        assert (kept.train[1, index]["inputs"] != kept.train[2, index]["inputs"]).any()
    for index in range(len(made.validation)):
        assert _equal(made.validation[0, index], kept.validation[0, index])
    with pytest.raises(IndexError, match="index must be below"):
        _ = kept.train[1, len(kept.train)]


def test_what_decides_kept_frames_decides_where_they_are(config: TrainConfig, tmp_path: Path) -> None:
    wanted = replace(config, attacks=("uniform",), attack_share=1.0, versions=1)
    prepare(wanted, tmp_path)
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "frames").rglob("*.npy")}
    prepare(replace(wanted, name="other", variant="mle", width=8, learning_rate=0.1, counts="linear"), tmp_path)
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "frames").rglob("*.npy")} == before
    for change in ({"seed": 9}, {"attack_share": 0.5}, {"truth": "paper_label"}, {"max_range_m": 50.0}):
        known = set((tmp_path / "frames").iterdir())
        prepare(replace(wanted, **change), tmp_path)
        assert len(set((tmp_path / "frames").iterdir()) - known) == 2


def test_the_earlier_sweep_is_the_last_of_the_sensor(config: TrainConfig, tmp_path: Path) -> None:
    pair = replace(
        preset_named("nuscenes-small"), grid_cells=32, grid_half_extent_m=32.0, splits=("train",), scenes=(1,),
        frames=(8,), moving=2, sensors=("vlp16",), conditions=("clear",), condition_weights=(1.0,),
    )  # fmt: skip
    simulate(pair, Storage.of(tmp_path / "pair"), LocalEngine(1))
    source = ArchivedSamples((Archive.open(tmp_path / "pair"),), config)
    before: dict[str, int | None] = {}
    for index in range(len(source)):
        now, earlier = source.clean(index).sweep, source.earlier(index)
        assert [(sweep.agent, sweep.t_ns) for sweep in earlier] == (
            [(now.agent, before[now.agent])] if now.agent in before else []
        )
        before[now.agent] = now.t_ns
    assert len(before) == 2


def _turned(array: NDArray[np.float32], quarters: int, mirrored: bool) -> NDArray[np.float32]:
    """Cells of a square grid, moved one by one: (x, y) to (y, x), then a quarter turn to the left at a time."""
    last = len(array) - 1
    found = np.empty_like(array)
    for (x, y), value in np.ndenumerate(array):
        at = (y, x) if mirrored else (x, y)
        for _ in range(quarters):
            at = (last - at[1], at[0])
        found[at] = value
    return found


def test_mirrored_frames_are_turned_alike_in_all_their_parts(config: TrainConfig, tmp_path: Path) -> None:
    plain = prepare(replace(config, attacks=(), attack_share=0.0), tmp_path).train
    frames = replace(plain, mirrored=True)
    seen = set()
    for epoch in range(1, 40):
        before, after = plain[epoch, 2], frames[epoch, 2]
        fitting = [
            (quarters, mirrored)
            for quarters in range(4)
            for mirrored in (False, True)
            if (after["inputs"][0] == _turned(before["inputs"][0], quarters, mirrored)).all()
        ]
        assert len(fitting) == 1
        for name in ("visible", "known"):
            assert (after[name] == _turned(before[name], *fitting[0])).all()
        seen |= set(fitting)
    assert len(seen) == 8


def test_a_blank_frame_counts_nowhere(config: TrainConfig, tmp_path: Path) -> None:
    frames = prepare(config, tmp_path).validation
    blank, real = frames[0, BLANK], frames[0, 0]
    assert {name: array.shape for name, array in blank.items()} == {name: array.shape for name, array in real.items()}
    assert not blank["known"].any()
