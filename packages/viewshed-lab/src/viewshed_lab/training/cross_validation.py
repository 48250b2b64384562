"""Choose width, dropout and learning rate by cross-validation over scenes. An interrupted run resumes.

Each fold is a training in its own folder, which holds its scores. On a resume Optuna's seeded sampler starts again and
proposes the same settings.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from viewshed._extras import needed_for
from viewshed_lab._config import Between, Checked, OneOf
from viewshed_lab._page import facts, page, table
from viewshed_lab.training.config import TrainConfig
from viewshed_lab.training.data import Fold, check_data, check_folds
from viewshed_lab.training.log import Machines, Step, save
from viewshed_lab.training.run import require_torch, train


@dataclass(frozen=True, slots=True)
class FoldScore:
    """Scores of the best epoch of one fold on the held-out scenes."""

    setting: str  # name of the hyperparameters
    fold: int  # number of the fold
    f1: float
    iou: float
    loss: float
    epoch: int  # number of the best epoch


WIDTHS = (4, 8, 16, 32)
DROPOUTS = (0.05, 0.10, 0.15)
LEARNING_RATES = (1e-4, 1e-3, 1e-2)
"""The hyperparameter grid of arXiv 2503.07375."""

FIGURE, PAGE, CHOSEN = "crossval.png", "crossval.md", "chosen.toml"
"""Files that cross-validation writes to its folder, beside the trainings."""


@dataclass(frozen=True, slots=True, order=True)
class Hyperparameters:
    """Hyperparameters to choose: channels of the first stage, share of dropped channels, learning rate of Adam.

    >>> Hyperparameters(8, 0.1, 1e-3).name
    'w8-p0.10-lr1e-03'
    """

    width: int
    dropout: float
    learning_rate: float

    @property
    def name(self) -> str:
        """Short name, also the name of its folder."""
        return f"w{self.width}-p{self.dropout:.2f}-lr{self.learning_rate:.0e}"

    def of(self, config: TrainConfig) -> TrainConfig:
        """Return ``config`` with these hyperparameters."""
        return replace(config, width=self.width, dropout=self.dropout, learning_rate=self.learning_rate)


@dataclass(frozen=True, slots=True)
class Search(Checked):
    """Hyperparameters to try.

    Raises:
        ValueError: a name is unknown or a number is too small.
    """

    # ``grid`` tries the grid in random order, ``optuna`` what its TPE sampler proposes
    sampler: Annotated[str, OneOf(("grid", "optuna"))] = "grid"
    trials: Annotated[int | None, Between(1)] = None  # number of settings to try; None is the size of the grid
    folds: Annotated[int, Between(2)] = 5  # of the scenes
    widths: tuple[int, ...] = WIDTHS  # to choose from
    dropouts: tuple[float, ...] = DROPOUTS  # to choose from
    learning_rates: tuple[float, ...] = LEARNING_RATES  # to choose from

    @property
    def grid(self) -> list[Hyperparameters]:
        """All settings."""
        return [Hyperparameters(*values) for values in product(self.widths, self.dropouts, self.learning_rates)]


@dataclass(frozen=True, slots=True)
class CrossValidation:
    """Result of a cross-validation."""

    chosen: Hyperparameters  # highest mean F1; on ties the smaller network
    scores: dict[Hyperparameters, tuple[FoldScore, ...]]  # one score per fold, in the order of the trials


def crossval(
    config: TrainConfig,
    out: str | Path,
    *,
    search: Search | None = None,
    device: str = "cpu",
    on_progress: Callable[[str, Step], None] | None = None,
) -> CrossValidation:
    """Choose the best hyperparameters by folds of scenes; write figure, page and chosen config to ``out``.

    Finished folds are reused; an interrupted fold resumes after its last epoch.

    Args:
        config: settings of the trainings; its own width, dropout and learning rate are ignored.
        out: folder of this cross-validation only.
        search: hyperparameters to try; None is the full grid.
        device: ``cpu`` or ``cuda``.
        on_progress: called after every batch with the name of the fold.

    Raises:
        ValueError: there are fewer scenes than folds, or ``out`` holds another cross-validation.
        OSError: a file cannot be read or written.
        ImportError: torch or optuna is not installed.
    """
    require_torch()
    from viewshed_lab.training.fit import check_device

    settings, folder = Search() if search is None else search, Path(out)
    check_device(Machines(device))
    check_data(config)
    check_folds(config, settings.folds)

    def score_fold(setting: Hyperparameters, number: int) -> FoldScore:
        name = f"{setting.name}/fold-{number}-of-{settings.folds}"
        on_step = None if on_progress is None else partial(on_progress, name)
        best = train(
            setting.of(config), folder / name, device=device, on_progress=on_step, cache=folder / "cache",
            fold=Fold(number, settings.folds),
        ).best  # fmt: skip
        return FoldScore(setting.name, number, best.f1, best.iou, best.validation_loss, best.number)

    try_settings = _search_with_optuna if settings.sampler == "optuna" else _search_grid
    tried = try_settings(
        settings, config, lambda setting: tuple(score_fold(setting, number) for number in range(settings.folds))
    )
    scores = dict(tried)
    result = CrossValidation(min(scores, key=lambda setting: (-mean_f1(scores[setting]), setting)), scores)
    _write(config, folder, result)
    return result


ScoreFolds = Callable[[Hyperparameters], tuple[FoldScore, ...]]
"""Returns one score per fold of a setting; trains the folds that have not finished."""

TriedSettings = Iterator[tuple[Hyperparameters, tuple[FoldScore, ...]]]


def _search_grid(search: Search, config: TrainConfig, score: ScoreFolds) -> TriedSettings:
    order = np.random.default_rng([config.seed, len(search.grid)]).permutation(len(search.grid))
    for index in order[: search.trials]:
        setting = search.grid[index]
        yield setting, score(setting)


def _search_with_optuna(search: Search, config: TrainConfig, score: ScoreFolds) -> TriedSettings:
    """Yield what Optuna's seeded sampler proposes, with its scores; a resumed run proposes the same again."""
    with needed_for("--sampler optuna"):
        import optuna
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(direction="maximize", sampler=optuna.samplers.TPESampler(seed=config.seed))
    choices = {"width": search.widths, "dropout": search.dropouts, "learning_rate": search.learning_rates}
    spaces: dict[str, Any] = {
        name: optuna.distributions.CategoricalDistribution(values) for name, values in choices.items()
    }
    for _ in range(search.trials or len(search.grid)):
        trial = study.ask(spaces)
        setting = Hyperparameters(**trial.params)
        scores = score(setting)
        study.tell(trial, mean_f1(scores))
        yield setting, scores


def mean_f1(scores: Sequence[FoldScore]) -> float:
    """Return the mean F1 over folds."""
    return float(np.mean([score.f1 for score in scores]))


def _write(config: TrainConfig, out: Path, result: CrossValidation) -> None:
    """Write figure, page and the chosen config."""
    from viewshed_lab.training.figures import fold_figure

    ordered = sorted(result.scores)
    values = {setting.name: [score.f1 for score in result.scores[setting]] for setting in ordered}
    save(out / FIGURE, fold_figure(config.name, values, result.chosen.name))
    save(out / PAGE, page_of(config, result).encode())
    save(out / CHOSEN, toml_of(result.chosen.of(config)).encode())


def page_of(config: TrainConfig, result: CrossValidation) -> str:
    """Return the Markdown page of a cross-validation: the chosen setting and the scores of all."""
    rows = []
    for setting in sorted(result.scores, key=lambda key: -mean_f1(result.scores[key])):
        f1 = np.array([score.f1 for score in result.scores[setting]])
        iou = np.mean([score.iou for score in result.scores[setting]])
        name = f"**{setting.name}**" if setting == result.chosen else setting.name
        rows.append([name, f"{f1.mean():.4f}", f"{f1.std():.4f}", f"{f1.min():.4f}", f"{f1.max():.4f}", f"{iou:.4f}"])
    count = len(result.scores[result.chosen])
    about = facts(config=config.name, data=", ".join(config.data), truth=config.truth, seed=str(config.seed))
    chosen = result.chosen
    text = (
        f"Chosen: **{chosen.name}** (width {chosen.width}, dropout {chosen.dropout:g}, learning rate "
        f"{chosen.learning_rate:g}), by the mean F1 over {count} folds of whole scenes. No scene is on both "
        "sides of a fold, and the test split is never read."
    )
    header = ["setting", "mean F1", "deviation", "lowest", "highest", "mean IoU"]
    return page("Cross-validation", about, text, "![F1 of every fold](crossval.png)", table(header, rows))


def toml_of(config: TrainConfig) -> str:
    """Return a config as TOML, without its name, which is the file's.

    The strings, numbers and lists of a config are the same in JSON and TOML.
    """
    values = {key: json.dumps(value, ensure_ascii=False) for key, value in config.to_json().items() if key != "name"}
    return "".join(f"{key} = {value}\n" for key, value in values.items())
