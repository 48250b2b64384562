"""Cross-validation by scene: which width, dropout and learning rate; a stopped run goes on where it was."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import viewshed
from viewshed.training.config import TrainConfig
from viewshed.training.data import Fold, check_data, check_folds
from viewshed.training.files import save
from viewshed.training.folds import FoldScore, FoldStore
from viewshed.training.run import Machines, require_torch, train

if TYPE_CHECKING:
    from viewshed.training.learner import Step

WIDTHS = (4, 8, 16, 32)
DROPOUTS = (0.05, 0.10, 0.15)
LEARNING_RATES = (1e-4, 1e-3, 1e-2)
"""The settings of arXiv 2503.07375."""
SAMPLERS = ("grid", "optuna")
FIGURE, PAGE, CHOSEN = "crossval.png", "crossval.md", "chosen.toml"
"""What cross-validation leaves in its folder, beside the trainings."""


@dataclass(frozen=True, slots=True, order=True)
class Setting:
    """What cross-validation chooses.

    Attributes:
        width: channels of the first stage.
        dropout: share of dropped channels.
        learning_rate: of Adam.

    >>> Setting(8, 0.1, 1e-3).name
    'w8-p0.10-lr1e-03'
    """

    width: int
    dropout: float
    learning_rate: float

    @property
    def name(self) -> str:
        """Short name, also of its folder."""
        return f"w{self.width}-p{self.dropout:.2f}-lr{self.learning_rate:.0e}"

    def of(self, config: TrainConfig) -> TrainConfig:
        """Return the config with this setting."""
        return replace(
            config, width=self.width, dropout=self.dropout, learning_rate=self.learning_rate,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Search:
    """Which settings are tried.

    Attributes:
        sampler: ``grid`` tries all in an order drawn at random, ``optuna`` those that its sampler (TPE) asks for.
        trials: how many; None is all of the grid.
        folds: of the scenes.
        widths: to choose from.
        dropouts: to choose from.
        learning_rates: to choose from.

    Raises:
        ValueError: a name is not known or a number is too small.
    """

    sampler: str = "grid"
    trials: int | None = None
    folds: int = 5
    widths: tuple[int, ...] = WIDTHS
    dropouts: tuple[float, ...] = DROPOUTS
    learning_rates: tuple[float, ...] = LEARNING_RATES

    def __post_init__(self) -> None:
        if self.sampler not in SAMPLERS:
            raise ValueError(f"sampler must be one of {', '.join(SAMPLERS)}, got {self.sampler!r}")
        if self.trials is not None and self.trials < 1:
            raise ValueError(f"trials must be at least 1, got {self.trials}")
        if self.folds < 2:
            raise ValueError(f"folds must be at least 2, got {self.folds}")

    @property
    def grid(self) -> list[Setting]:
        """All settings."""
        return [Setting(*values) for values in product(self.widths, self.dropouts, self.learning_rates)]

    def to_json(self) -> dict[str, Any]:
        """Return what the results depend on as plain values: not how many or which are tried."""
        return {"folds": self.folds}


@dataclass(frozen=True, slots=True)
class Validated:
    """What cross-validation found.

    Attributes:
        chosen: the setting with the highest mean F1; of equals the smaller network.
        scores: by setting, one of each fold, in the order in which they were tried.
    """

    chosen: Setting
    scores: dict[Setting, tuple[FoldScore, ...]]


def crossval(
    config: TrainConfig,
    out: str | Path,
    *,
    search: Search | None = None,
    device: str = "cpu",
    progress: Callable[[str, Step], None] | None = None,
) -> Validated:
    """Return the best setting of a config by folds of whole scenes; figure, page and chosen config are in ``out``.

    Folds that are finished stay; one that was stopped goes on after its last epoch.

    Args:
        config: what is trained; its own width, dropout and learning rate do not matter.
        out: folder of this cross-validation alone.
        search: which settings; None is the whole grid.
        device: ``cpu`` or ``cuda``.
        progress: is told of every batch, with the name of the fold.

    Raises:
        ValueError: there are fewer scenes than folds, or ``out`` holds another cross-validation.
        OSError: something cannot be read or written.
        ImportError: torch or optuna is not installed.
    """
    require_torch()
    from viewshed.training.fit import check_device

    wanted, folder = Search() if search is None else search, Path(out)
    check_device(Machines(device))
    check_data(config)
    check_folds(config, wanted.folds)
    store = FoldStore.open(folder, {"version": viewshed.__version__, "config": config.to_json()} | wanted.to_json())
    runner = _Runner(config, folder, store, wanted.folds, device, progress)
    tried = _asked(wanted, config, runner) if wanted.sampler == "optuna" else _swept(wanted, config, runner)
    scores = dict(tried)
    found = Validated(_best(scores), scores)
    _write(config, folder, found)
    return found


@dataclass(frozen=True, slots=True, eq=False)
class _Runner:
    """Runs the folds of a setting that the store does not have."""

    config: TrainConfig
    out: Path
    store: FoldStore
    folds: int
    device: str
    progress: Callable[[str, Step], None] | None

    def scores(self, setting: Setting) -> tuple[FoldScore, ...]:
        """Return one score of each fold."""
        return tuple(self._score(setting, number) for number in range(self.folds))

    def _score(self, setting: Setting, number: int) -> FoldScore:
        done = self.store.get(setting.name, number)
        if done is not None:
            return done
        name = f"{setting.name}/fold-{number}"
        told = None if self.progress is None else _named(self.progress, name)
        trained = train(
            setting.of(self.config), self.out / name, device=self.device, progress=told,
            cache=self.out / "cache", fold=Fold(number, self.folds),
        )  # fmt: skip
        best = trained.best
        score = FoldScore(setting.name, number, best.f1, best.iou, best.validation_loss, best.number)
        self.store.add(score)
        return score


def _named(progress: Callable[[str, Step], None], name: str) -> Callable[[Step], None]:
    return lambda step: progress(name, step)


Tried = Iterator[tuple[Setting, tuple[FoldScore, ...]]]


def _swept(search: Search, config: TrainConfig, runner: _Runner) -> Tried:
    order = np.random.default_rng([config.seed, len(search.grid)]).permutation(len(search.grid))
    for index in order[: search.trials]:
        setting = search.grid[index]
        yield setting, runner.scores(setting)


def _asked(search: Search, config: TrainConfig, runner: _Runner) -> Tried:
    """Yield what optuna asks for; as its sampler has a seed, a run that goes on asks for the same again."""
    optuna = _optuna()
    study = optuna.create_study(direction="maximize", sampler=optuna.samplers.TPESampler(seed=config.seed))
    choices = {"width": search.widths, "dropout": search.dropouts, "learning_rate": search.learning_rates}
    spaces = {name: optuna.distributions.CategoricalDistribution(values) for name, values in choices.items()}
    for _ in range(search.trials or len(search.grid)):
        trial = study.ask(spaces)
        setting = Setting(**trial.params)
        scores = runner.scores(setting)
        study.tell(trial, mean_f1(scores))
        yield setting, scores


def _optuna() -> Any:
    try:
        import optuna
    except ImportError as error:
        raise ImportError(f"--sampler optuna needs optuna ({error}); pip install 'viewshed[train]'") from error
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna


def mean_f1(scores: Sequence[FoldScore]) -> float:
    """Return the mean F1 of the folds."""
    return float(np.mean([score.f1 for score in scores]))


def _best(scores: dict[Setting, tuple[FoldScore, ...]]) -> Setting:
    return min(scores, key=lambda setting: (-mean_f1(scores[setting]), setting))


def _write(config: TrainConfig, out: Path, found: Validated) -> None:
    """Write figure, page and the chosen config."""
    from viewshed.plot_training import fold_figure
    from viewshed.training.page import page_of, toml_of

    ordered = sorted(found.scores)
    values = {setting.name: [score.f1 for score in found.scores[setting]] for setting in ordered}
    save(out / FIGURE, fold_figure(config.name, values, found.chosen.name))
    save(out / PAGE, page_of(config, found).encode())
    save(out / CHOSEN, toml_of(found.chosen.of(config)).encode())
