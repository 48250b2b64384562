"""Cross-validation: folds of whole scenes, the best mean, and what is finished stays."""

import json
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
    with (tmp_path / "folds.jsonl").open("ab") as file:
        file.write(b'{"setting": "w4-p0')  # half a line, as a kill would leave it
    found = crossval(short, tmp_path, search=SMALL)
    assert len(ran) == 5
    assert ran[2] == ran[3]
    lines = [json.loads(line) for line in (tmp_path / "folds.jsonl").read_text().splitlines()[1:]]
    assert sorted((line["setting"], line["fold"]) for line in lines) == sorted(
        (name, fold) for name in ("w2-p0.10-lr1e-02", "w4-p0.10-lr1e-02") for fold in (0, 1)
    )
    means = {name: np.mean([line["f1"] for line in lines if line["setting"] == name]) for name in
             ("w2-p0.10-lr1e-02", "w4-p0.10-lr1e-02")}  # fmt: skip
    assert found.chosen.name == max(means, key=lambda name: means[name])
    page = (tmp_path / "crossval.md").read_text()
    assert f"Chosen: **{found.chosen.name}**" in page
    assert f"| {max(means.values()):.4f} |" in page
    assert tomllib.loads((tmp_path / "chosen.toml").read_text())["width"] == found.chosen.width
    assert (tmp_path / "crossval.png").read_bytes().startswith(b"\x89PNG")


def test_optuna_asks_again_for_what_it_asked_before(short: TrainConfig, tmp_path: Path) -> None:
    search = replace(SMALL, sampler="optuna", trials=2)
    found = crossval(short, tmp_path, search=search)
    before = (tmp_path / "folds.jsonl").read_bytes()
    again = crossval(short, tmp_path, search=search)
    assert again == found
    assert (tmp_path / "folds.jsonl").read_bytes() == before


def test_another_search_is_refused(short: TrainConfig, tmp_path: Path) -> None:
    crossval(short, tmp_path / "out", search=replace(SMALL, trials=1))
    with pytest.raises(ValueError, match=r"folds.jsonl is of a cross-validation with other batch; choose another"):
        crossval(replace(short, batch=3), tmp_path / "out", search=SMALL)
    with pytest.raises(ValueError, match="with other folds; choose another"):
        crossval(short, tmp_path / "out", search=replace(SMALL, folds=3))
    with pytest.raises(ValueError, match="must have a scene for each of 7 folds, got 6; ask for fewer folds"):
        crossval(short, tmp_path / "new", search=replace(SMALL, folds=7))
    assert not (tmp_path / "new").exists()
