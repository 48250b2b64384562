"""TrainConfig: what it takes, what it refuses, and the shipped ones."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from viewshed_lab.training import TrainConfig, config_names, read_config
from viewshed_lab.training.cross_validation import toml_of


def test_a_config_survives_toml(config: TrainConfig, tmp_path: Path) -> None:
    (tmp_path / "tiny.toml").write_text(toml_of(config))
    assert read_config(tmp_path / "tiny.toml") == config
    assert TrainConfig.from_json(config.to_json()) == config


def test_the_shipped_networks_are_the_papers_on_our_grids() -> None:
    assert config_names() == ("indoor", "road")
    for name, half_m, target in (("road", 64.0, "car"), ("indoor", 16.0, "pedestrian")):
        card = read_config(name).card()
        assert (card.grid.cells, card.grid.half_extent_m, card.target, card.truth) == (256, half_m, target, "probe")
        assert (card.shape.width, card.shape.depth, card.shape.dropout) == (8, 4, 0.1)


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"truth": "guess"}, r"truth must be one of probe, paper_label, got 'guess'"),
    ({"attacks": ("uniform", "laser")}, r"attacks must be among paper, uniform, .* got 'laser'"),
    ({"attacks": ()}, r"attacks and attack_share must both be given or both be empty, got \[\] and 0.5; benign"),
    ({"cells": 33}, r"cells must divide by 4 for depth 2, got 33"),
    ({"data": ()}, r"data must name different presets or archives, got \[\]"),
    ({"data": ("carla", "elsewhere")}, r"data must be presets or archives, not both"),
    ({"data": ("carla",), "train_split": "all"}, r"train_split must be one of train, test of carla, got 'all'"),
    ({"heights_m": (3.0, -3.0)}, r"heights_m must be \(low, high\)"),
]


@pytest.mark.parametrize(("change", "message"), WRONG, ids=[message[:30] for _, message in WRONG])
def test_wrong_values_are_refused(config: TrainConfig, change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(config, **change)


def test_wrong_files_are_refused(config: TrainConfig, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"config must be a TOML file or one of indoor, road, got 'nowhere'"):
        read_config("nowhere")
    text = toml_of(config)
    for wrong, message in (
        (text.replace("batch = 4\n", ""), r"wrong.toml: a training config must have .* missing or unknown: batch"),
        (text + "momentum = 0.9\n", r"missing or unknown: momentum"),
        (
            text + "fresh = true\n",
            r"wrong.toml: fresh must be False or omitted, as other values are no longer supported, got True",
        ),
        (
            text + 'inputs = ["counts", "range"]\n',
            r"inputs must be \['counts'\] or omitted, .* got \['counts', 'range'\]",
        ),
        (text + "fold = 4\n", "fold must be 1 or omitted"),
        (text.replace("batch = 4", 'batch = "4"'), r"batch must be int, got '4'"),
        (text.replace("heights_m = [-10.0, 3.0]", "heights_m = [1.0]"), r"heights_m must be two numbers, got \[1.0\]"),
        ("batch = = 4", r"wrong.toml: Invalid value"),
    ):
        (tmp_path / "wrong.toml").write_text(wrong)
        with pytest.raises(ValueError, match=message):
            read_config(tmp_path / "wrong.toml")
