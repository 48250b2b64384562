"""From a config to frames: scenes are divided, presets simulated once, and what does not fit is refused."""

from dataclasses import replace
from pathlib import Path
from typing import cast

import pytest

from viewshed import Archive
from viewshed.cli import main
from viewshed_lab.training import Fold, TrainConfig
from viewshed_lab.training.data import TrainingData, prepare
from viewshed_lab.training.samples import ArchivedSamples

pytestmark = pytest.mark.slow


def _scenes(frames: TrainingData) -> tuple[set[str], set[str]]:
    sources = (cast(ArchivedSamples, part.source) for part in (frames.train, frames.validation))
    train, validation = ({scene for archive in source.archives for scene in archive.scenes} for source in sources)
    return train, validation


def test_scenes_are_divided_and_the_test_split_is_not_read(config: TrainConfig, archive: Path, tmp_path: Path) -> None:
    train, validation = _scenes(prepare(config, tmp_path))
    assert len(validation) == 2
    assert not train & validation
    assert train | validation == set(Archive.open(archive).split("train").scenes)
    assert not list(tmp_path.iterdir())


def test_every_scene_is_held_out_by_one_fold(config: TrainConfig, archive: Path, tmp_path: Path) -> None:
    parts = [_scenes(prepare(config, tmp_path, Fold(number, 3))) for number in range(3)]
    assert all(not train & held for train, held in parts)
    assert sorted(scene for _, held in parts for scene in held) == sorted(Archive.open(archive).split("train").scenes)
    with pytest.raises(ValueError, match="must have a scene for each of 7 folds, got 6; ask for fewer folds"):
        prepare(config, tmp_path, Fold(0, 7))
    with pytest.raises(ValueError, match="fold must be one of at least 2, got 2 of 2"):
        Fold(2, 2)


def _refused(config: TrainConfig, tmp_path: Path, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        prepare(config, tmp_path / "cache")
    assert not (tmp_path / "cache").exists()


def test_archives_that_do_not_fit_are_refused(config: TrainConfig, archive: Path, tmp_path: Path) -> None:
    _refused(replace(config, cells=64), tmp_path, r"truth on 32 cells, ±32 m; cells and half_extent_m must be those, "
             "got 64 and 32")  # fmt: skip
    _refused(replace(config, data=(str(tmp_path / "none"),)), tmp_path, "data must name presets or archives, got")
    _refused(replace(config, train_split="all"), tmp_path, "train_split must be one of train, test of .* got 'all'")
    _refused(
        replace(config, train_split="test"), tmp_path, r"has 1 scene\(s\) in split 'test'; validation is split by scene"
    )


def test_tampered_sweeps_have_no_label(config: TrainConfig, archive: Path, tmp_path: Path) -> None:
    out = tmp_path / "attacked"
    with pytest.raises(SystemExit):
        main(["attack", str(archive), "--attack", "uniform", "--workers", "1", "--out", str(out)])
    wanted = replace(config, data=(str(out),), truth="paper_label")
    _refused(wanted, tmp_path, "holds tampered sweeps, but paper_label needs clean ones; train on its source")
