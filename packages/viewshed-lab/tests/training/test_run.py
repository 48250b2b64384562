"""``train``: the same weights again, after a kill as well; what it refuses, and what it leaves when it fails."""

import csv
import multiprocessing
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.cli.commands import run
from torch.nn import functional

from viewshed.networks.runtime import load_runner
from viewshed_lab.training import TrainConfig, Trained, train
from viewshed_lab.training.cross_validation import toml_of
from viewshed_lab.training.data import prepare
from viewshed_lab.training.fit import read_checkpoint
from viewshed_lab.training.log import TIMES, Epoch, Step, is_finished, scores_of
from viewshed_lab.training.module import Learner
from viewshed_lab.training.unet_torch import load_weights

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def trained(archive: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[TrainConfig], Trained]:
    """Trains a config once, uninterrupted."""
    done: dict[TrainConfig, Trained] = {}

    def once(config: TrainConfig) -> Trained:
        if config not in done:
            done[config] = train(config, tmp_path_factory.mktemp("trained") / "out")
        return done[config]

    return once


def _repeatable(history: Sequence[Epoch]) -> list[tuple[float, ...]]:
    return [tuple(v for k, v in _values(epoch).items() if k not in TIMES) for epoch in history]


def _values(epoch: Epoch) -> dict[str, float]:
    return {name: getattr(epoch, name) for name in Epoch.__dataclass_fields__}


def _same_weights(one: Trained, two: Trained) -> bool:
    states = [load_weights(done.weights.with_name("network.pt"))[1].state_dict() for done in (one, two)]
    return all(torch.equal(states[0][name], states[1][name]) for name in states[0])


def test_training_learns_and_leaves_what_it_says(
    config: TrainConfig, trained: Callable[[TrainConfig], Trained]
) -> None:
    done = trained(config)
    out = done.weights.parent
    assert {path.name for path in out.iterdir()} == {
        "network.onnx", "network.pt", "last.ckpt", "history.csv", "curves.png",
    }  # fmt: skip
    assert [epoch.number for epoch in done.history] == [1, 2, 3]
    losses = [(epoch.train_loss, epoch.validation_loss) for epoch in done.history]
    assert losses[-1] < losses[0]
    # normalization knows from the first batch on how small counts / 1000 are: better than a coin, whose loss is .69
    assert max(validation for _, validation in losses) < 0.6
    rows = list(csv.DictReader((out / "history.csv").read_text().splitlines()))
    assert [float(row["validation_loss"]) for row in rows] == [epoch.validation_loss for epoch in done.history]
    assert (out / "curves.png").read_bytes().startswith(b"\x89PNG")
    assert 0 < done.network_share <= 1
    assert done.frames_per_s > 0


def test_scores_are_those_of_the_weights_that_are_kept(
    config: TrainConfig, trained: Callable[[TrainConfig], Trained], tmp_path: Path
) -> None:
    """The exported network, run by the engine on the validation frames, has the best epoch's scores."""
    done, frames = trained(config), prepare(config, tmp_path).validation
    runner = load_runner(done.weights)
    arrays = [frames[0, index] for index in range(len(frames))]
    inputs = np.stack([one["inputs"] for one in arrays])
    ones = np.ones((1, len(arrays[0]["masks"])), np.float32)
    prob = np.concatenate([runner.run(one[None], ones) for one in inputs])
    truth, known = (np.stack([one[name] for one in arrays]) > 0 for name in ("visible", "known"))
    called = prob >= config.threshold
    hits = (called & truth & known).sum()
    assert done.best.precision == pytest.approx(hits / (called & known).sum(), abs=2e-3)
    assert done.best.recall == pytest.approx(hits / (truth & known).sum(), abs=2e-3)
    p = np.clip(prob.astype(np.float64), 1e-7, 1 - 1e-7)
    loss = -(np.where(truth, np.log(p), np.log(1 - p)) * known).sum() / known.sum()
    assert done.best.validation_loss == pytest.approx(loss, rel=1e-3)
    assert runner.card.trained["best_epoch"] == str(done.best.number)


def test_the_same_config_gives_the_same_weights_with_and_without_workers(
    config: TrainConfig, trained: Callable[[TrainConfig], Trained], tmp_path: Path
) -> None:
    again = train(replace(config, workers=1), tmp_path / "again")
    assert _repeatable(again.history) == _repeatable(trained(config).history)
    assert _same_weights(again, trained(config))
    other = train(replace(config, seed=1, epochs=1), tmp_path / "other")
    assert other.history[0].train_loss != again.history[0].train_loss


_KILLED = """
import os, signal, sys
import torch
from viewshed_lab.training import read_config, train
def kill(step):
    if step.epoch == 3 and step.stage == "validate":
        os.kill(os.getpid(), signal.SIGKILL)
torch.set_num_threads(1)
train(read_config(sys.argv[1]), sys.argv[2], on_progress=kill)
"""


def test_a_killed_training_ends_like_one_that_was_not(
    config: TrainConfig, trained: Callable[[TrainConfig], Trained], tmp_path: Path
) -> None:
    (tmp_path / "tiny.toml").write_text(toml_of(config))
    words = [sys.executable, "-c", _KILLED, str(tmp_path / "tiny.toml"), str(tmp_path / "out")]
    killed = subprocess.run(words, check=False, capture_output=True, text=True)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    assert len(read_checkpoint(tmp_path / "out" / "last.ckpt")["viewshed"]["history"]) == 2
    assert not (tmp_path / "out" / "network.onnx").exists()
    seen: list[Step] = []
    done = train(config, tmp_path / "out", on_progress=seen.append)
    assert {step.epoch for step in seen} == {3}
    assert _repeatable(done.history) == _repeatable(trained(config).history)
    assert _same_weights(done, trained(config))


def test_a_finished_training_is_not_repeated(config: TrainConfig, trained: Callable[[TrainConfig], Trained]) -> None:
    done = trained(config)
    before = done.weights.stat().st_mtime_ns
    seen: list[Step] = []
    assert train(config, done.weights.parent, on_progress=seen.append) == done
    assert (seen, done.weights.stat().st_mtime_ns) == ([], before)


def test_a_training_begun_again_in_a_folder_leaves_its_own_weights(
    config: TrainConfig, trained: Callable[[TrainConfig], Trained], tmp_path: Path
) -> None:
    shutil.copytree(trained(config).weights.parent, tmp_path / "out")
    (tmp_path / "out" / "last.ckpt").unlink()
    assert load_runner(train(replace(config, epochs=1), tmp_path / "out").weights).card.trained["epochs"] == "1"


def test_what_a_worker_meets_is_one_line(config: TrainConfig, archive: Path, tmp_path: Path) -> None:
    shutil.copytree(archive, tmp_path / "damaged")
    for shard in (tmp_path / "damaged").glob("train-*.parquet"):
        content = bytearray(shard.read_bytes())
        content[1000:3000] = bytes(2000)
        shard.write_bytes(content)
    damaged = replace(config, data=(str(tmp_path / "damaged"),), workers=1)
    with pytest.raises(
        ValueError, match=r"^\S+/train-\S+.parquet is damaged: [^\n]*run again the command that made the"
    ):
        train(damaged, tmp_path / "out")
    with pytest.raises(OSError, match="a worker ended early; it may have run out of memory: use fewer workers"):
        train(replace(config, workers=1), tmp_path / "killed", on_progress=_end_workers)


def _end_workers(step: Step) -> None:
    for worker in multiprocessing.active_children():
        worker.kill()
        worker.join()


def _refused(config: TrainConfig, out: Path, message: str) -> None:
    before = sorted((path.name, path.read_bytes()) for path in out.iterdir())
    with pytest.raises(ValueError, match=message):
        train(config, out)
    assert sorted((path.name, path.read_bytes()) for path in out.iterdir()) == before


def test_a_checkpoint_of_something_else_is_refused(
    config: TrainConfig, trained: Callable[[TrainConfig], Trained], tmp_path: Path
) -> None:
    content = torch.load(trained(config).checkpoint, weights_only=True)
    last = tmp_path / "last.ckpt"
    torch.save(content, last)
    _refused(
        replace(config, epochs=5, width=8),
        tmp_path,
        r"last.ckpt belongs to a training with different epochs, width; choose",
    )
    torch.save(content | {"viewshed": content["viewshed"] | {"version": "0.0.1"}}, last)
    _refused(config, tmp_path, r"was begun with viewshed 0.0.1, this is .*; finish it with that version, or choose")
    torch.save(content | {"viewshed": {"format": 99}}, last)
    _refused(config, tmp_path, r"last.ckpt must have format 1, got 99; delete it")
    torch.save({"state_dict": {}}, last)
    _refused(config, tmp_path, r"must be a checkpoint of viewshed train, got another; delete it, and training begins")
    last.write_bytes(trained(config).checkpoint.read_bytes()[:-1000])
    _refused(config, tmp_path, r"last.ckpt is damaged or not a checkpoint; delete it, and training begins again")


def test_two_processes_train_together(config: TrainConfig, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "tiny.toml").write_text(toml_of(replace(config, batch=2, epochs=2)))
    done = run("train", tmp_path / "tiny.toml", "--out", tmp_path / "out", "--devices", 2)
    assert done.returncode == 0, done.stderr
    assert "best epoch" in done.stdout
    assert "Initializing distributed" not in capfd.readouterr().err
    history = [Epoch(**row) for row in read_checkpoint(tmp_path / "out" / "last.ckpt")["viewshed"]["history"]]
    assert len(history) == 2
    assert history[1].train_loss < history[0].train_loss


@pytest.mark.parametrize("loss", ["bce", "bce_dice"])
def test_the_loss_counts_known_cells_alone(config: TrainConfig, loss: str) -> None:
    learner = Learner(replace(config, loss=loss), 1)
    rng = torch.Generator().manual_seed(0)
    logits = torch.randn(2, 1, 8, 8, generator=rng)
    visible, known = ((torch.rand(2, 8, 8, generator=rng) > 0.4).float() for _ in range(2))
    batch = {"visible": visible, "known": known}
    prob, truth = torch.sigmoid(logits[:, 0])[known > 0], visible[known > 0]
    wanted = functional.binary_cross_entropy(prob, truth)
    if loss == "bce_dice":
        wanted = wanted + 1 - (2 * (prob * truth).sum() + 1) / (prob.sum() + truth.sum() + 1)
    assert float(learner.loss(logits, batch)) == pytest.approx(float(wanted), rel=1e-5)
    poisoned = batch | {"visible": torch.where(known > 0, visible, 1 - visible)}
    assert float(learner.loss(logits, poisoned)) == float(learner.loss(logits, batch))


def test_training_is_over_after_its_epochs_or_its_patience(config: TrainConfig) -> None:
    def history(*losses: float) -> list[Epoch]:
        return [Epoch(k, 0, loss, 0, 0, 0, 0, 0, 0, 1, 1, 1) for k, loss in enumerate(losses, 1)]

    patient = replace(config, epochs=9, patience=2)
    assert not is_finished([], patient)
    assert not is_finished(history(3, 2, 2.5), patient)
    assert is_finished(history(3, 2, 2.5, 2), patient)
    assert is_finished(history(*range(9, 0, -1)), patient)
    assert scores_of([0, 0, 0, 0])["f1"] == 0.0
