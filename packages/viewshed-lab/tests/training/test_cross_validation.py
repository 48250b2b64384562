"""Cross-validation: folds of whole scenes, the best mean, and what is finished stays."""

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import viewshed_lab.training.cross_validation as crossval_module
from viewshed_lab.training import TrainConfig, train
from viewshed_lab.training.cross_validation import Search, crossval

pytestmark = pytest.mark.slow

SMALL = Search(folds=2, widths=(2, 4), dropouts=(0.1,), learning_rates=(1e-2,))


@pytest.fixture
def short(config: TrainConfig) -> TrainConfig:
    return replace(config, epochs=1)


def _weights(folder: Path) -> dict[str, int]:
    """The weights of the folds that are finished, with the times at which they were written."""
    return {path.parent.as_posix(): path.stat().st_mtime_ns for path in folder.glob("*/*/network.onnx")}


def test_a_stopped_search_goes_on_and_chooses_the_best_mean(
    short: TrainConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[str] = []

    def counted(config: TrainConfig, out: Path, **how: Any) -> Any:
        ran.append(f"{out.parent.name}/{out.name}")
        if len(ran) == 3:
            raise KeyboardInterrupt
        return train(config, out, **how)

    monkeypatch.setattr(crossval_module, "train", counted)
    with pytest.raises(KeyboardInterrupt):
        crossval(short, tmp_path, search=SMALL)
    finished = _weights(tmp_path)
    assert len(finished) == 2
    found = crossval(short, tmp_path, search=SMALL)
    assert _weights(tmp_path).items() > finished.items()
    assert len(_weights(tmp_path)) == 4
    means = {setting.name: np.mean([score.f1 for score in scores]) for setting, scores in found.scores.items()}
    assert set(means) == {"w2-p0.10-lr1e-02", "w4-p0.10-lr1e-02"}
    assert {(score.setting, score.fold) for scores in found.scores.values() for score in scores} == {
        (name, fold) for name in means for fold in (0, 1)
    }
    assert found.chosen.name == max(means, key=lambda name: means[name])
    page = (tmp_path / "crossval.md").read_text()
    assert f"Chosen: **{found.chosen.name}**" in page
    assert f"| {max(means.values()):.4f} |" in page
    assert tomllib.loads((tmp_path / "chosen.toml").read_text())["width"] == found.chosen.width
    assert (tmp_path / "crossval.png").read_bytes().startswith(b"\x89PNG")


def test_optuna_asks_again_for_what_it_asked_before(short: TrainConfig, tmp_path: Path) -> None:
    search = replace(SMALL, sampler="optuna", trials=2)
    found = crossval(short, tmp_path, search=search)
    before = _weights(tmp_path)
    again = crossval(short, tmp_path, search=search)
    assert again == found
    assert _weights(tmp_path) == before


def test_another_search_is_refused(short: TrainConfig, tmp_path: Path) -> None:
    crossval(short, tmp_path / "out", search=replace(SMALL, trials=1))
    with pytest.raises(ValueError, match=r"last.ckpt belongs to a training with different batch; choose another"):
        crossval(replace(short, batch=3), tmp_path / "out", search=SMALL)
    with pytest.raises(ValueError, match="must have a scene for each of 7 folds, got 6; ask for fewer folds"):
        crossval(short, tmp_path / "new", search=replace(SMALL, folds=7))
    assert not (tmp_path / "new").exists()
