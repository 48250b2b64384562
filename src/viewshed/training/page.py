"""The page of a cross-validation, and a config as TOML."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np

from viewshed.report import facts, page, table
from viewshed.training.config import TrainConfig

if TYPE_CHECKING:
    from viewshed.training.crossval import Validated


def page_of(config: TrainConfig, found: Validated) -> str:
    """Return the page of a cross-validation: the setting chosen and the scores of all, as Markdown."""
    rows = []
    for setting in sorted(found.scores, key=lambda key: -np.mean([score.f1 for score in found.scores[key]])):
        f1 = np.array([score.f1 for score in found.scores[setting]])
        iou = np.mean([score.iou for score in found.scores[setting]])
        name = f"**{setting.name}**" if setting == found.chosen else setting.name
        rows.append([name, f"{f1.mean():.4f}", f"{f1.std():.4f}", f"{f1.min():.4f}", f"{f1.max():.4f}", f"{iou:.4f}"])
    count = len(found.scores[found.chosen])
    about = facts(config=config.name, data=", ".join(config.data), truth=config.truth, seed=str(config.seed))
    text = (
        f"Chosen: **{found.chosen.name}** (width {found.chosen.width}, dropout {found.chosen.dropout:g}, learning rate "
        f"{found.chosen.learning_rate:g}), by the mean F1 over {count} folds of whole scenes. No scene is on both "
        "sides of a fold, and the test split is never read."
    )
    header = ["setting", "mean F1", "deviation", "lowest", "highest", "mean IoU"]
    return page("Cross-validation", about, text, "![F1 of every fold](crossval.png)", table(header, rows))


def toml_of(config: TrainConfig) -> str:
    """Return a config as TOML, without its name, which is the file's.

    A string in JSON is a string in TOML, and so are the lists of strings and numbers here.
    """
    return "".join(f"{key} = {_value(value)}\n" for key, value in config.to_json().items() if key != "name")


def _value(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)
