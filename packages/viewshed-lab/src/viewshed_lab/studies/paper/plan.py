"""The plan of the paper's study, with every parameter spelled out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from viewshed_lab.data.presets import preset_named, preset_names
from viewshed_lab.studies.plan import JobKey, Plan, check_names, check_seed
from viewshed_lab.studies.records import PAPER, STRICT
from viewshed_lab.threats.attacks import ATTACKS
from viewshed_lab.threats.corruptions import CORRUPTIONS

PROTOCOLS = (PAPER, STRICT)
"""The paper's label as truth on its grids, and exact truth on ours."""

VARIANTS = ("mle", "mcd")
"""One pass with dropout off; the mean of several with dropout on."""

MIXTURES = ("benign", "adversarial")
"""Kinds of training and test data."""

STEPS = ("data", "crossval", "models", "pairs", "strict", "trade", "monitor", "pages")
"""Steps of the command, in order."""

CLASSICAL = "classical"
"""Stands for the classical estimators in job keys, in place of a model's name."""

PER_DOMAIN = ("train_scenes", "train_times", "test_scenes", "test_times", "interval_s", "pair_frames")
"""Keys with one number per domain."""


@dataclass(frozen=True, slots=True, order=True)
class Model:
    """One of the twelve models of a protocol."""

    protocol: str  # of ``PROTOCOLS``
    variant: str  # of ``VARIANTS``
    mixture: str  # of ``MIXTURES``, its training data
    domain: str  # of its training data

    @property
    def name(self) -> str:
        """Its name within the protocol."""
        return f"{self.short_name}-{self.domain}"

    @property
    def short_name(self) -> str:
        """Its name in tables of its own domain."""
        return f"{self.variant}-{self.mixture}"

    @property
    def key(self) -> JobKey:
        """Key of its training job."""
        return "models", self.protocol, self.name


@dataclass(frozen=True, slots=True)
class PaperPlan(Plan):
    """Plan of the study. ``all`` in the TOML stands for all names of a table."""

    FOLDER: ClassVar[str] = "studies/paper/plans"
    WHOLE_TABLES: ClassVar[Mapping[str, Iterable[str]]] = {"monitor_corruptions": CORRUPTIONS}

    name: str
    about: str
    domains: tuple[str, ...]  # presets of simulated data
    train_scenes: tuple[int, ...]  # number of scenes for training and validation, per domain
    train_times: tuple[int, ...]  # sweeps of each agent in such a scene
    test_scenes: tuple[int, ...]  # number of held-out scenes
    test_times: tuple[int, ...]  # sweeps of each agent in such a scene
    interval_s: tuple[float, ...]  # between two sweeps of one agent
    seed: int  # of the training data and of the training
    test_seed: int  # of the held-out scenes and of all random draws in the evaluation
    cells: int  # cells per side, in both protocols
    width: int  # channels of the network's first stage
    depth: int  # number of its poolings
    dropout: float  # share of channels that a mask sets to zero; cross-validation replaces it
    loss: str  # name of the loss
    learning_rate: float  # of the optimizer; cross-validation replaces it
    schedule: str  # of the learning rate: ``constant`` or ``cosine``
    batch: int  # frames per step
    epochs: int  # maximum number
    patience: int  # epochs without a better validation loss after which training stops
    frames_per_epoch: int
    validation_share: float  # share of the training scenes used for validation
    versions: int  # number of precomputed versions of a training frame, each with its own attack, used in turn
    mirrored: bool  # whether training frames are randomly mirrored and turned by quarter turns
    counts: str  # scale of the returns per cell in the input, ``linear`` or ``log``
    precision: str  # of the training, ``32`` or ``bf16``
    workers: int  # processes that prepare training frames
    crossval_folds: int  # folds of whole scenes, on the trade study's domain; 0 for no cross-validation
    crossval_dropouts: tuple[float, ...]  # values to try
    crossval_learning_rates: tuple[float, ...]  # values to try
    crossval_cells: int  # cells per side of its networks
    crossval_epochs: int  # maximum number of epochs of each of its trainings
    crossval_frames: int  # frames per epoch
    attack_share: float  # share of training frames that the strict protocol attacks
    trained_attacks: tuple[str, ...]  # of ``ATTACKS``: training attacks of the strict protocol; all others are unseen
    passes: int  # stochastic passes of Monte Carlo dropout
    pair_frames: tuple[int, ...]  # number of held-out sweeps on which each of the 72 pairs is scored, per domain
    pair_part: int  # number of these sweeps per job: the most that a stopped run loses
    mcd_every: int  # N: models with several passes are scored on every Nth sweep
    strict_frames: int  # number of held-out sweeps with every attack
    strengths: bool  # whether these sweeps also get every strength of ``attacks.SEVERITIES``
    trade_domain: str  # domain of the trade study
    trade_widths: tuple[int, ...]  # widths to try
    trade_depths: tuple[int, ...]  # depths to try
    trade_cells: tuple[int, ...]  # resolutions to try
    trade_epochs: int  # epochs of each of its trainings
    trade_repeats: int  # passes whose median is the latency
    monitor_domain: str  # domain of the deviation monitor
    monitor_frames: int  # number of benign sweeps for fitting, for calibration and for the report, each
    monitor_false_alarms: float  # false alarm rate of its calibration
    monitor_corruptions: tuple[str, ...]  # of ``CORRUPTIONS``, whose false alarms are counted
    monitor_severity: int  # of these corruptions

    def __post_init__(self) -> None:
        for key, table in (("domains", preset_names()), ("trained_attacks", ATTACKS),
                           ("monitor_corruptions", CORRUPTIONS)):  # fmt: skip
            check_names(key, getattr(self, key), table, once=True)
        for key in ("trade_domain", "monitor_domain"):
            check_names(key, (getattr(self, key),), self.domains)
        for key in PER_DOMAIN:
            if len(getattr(self, key)) != len(self.domains) or min(getattr(self, key)) <= 0:
                raise ValueError(f"{key} must be a positive number for each domain, got {list(getattr(self, key))}")
        for key in ("seed", "test_seed"):
            check_seed(key, getattr(self, key))
        if self.seed == self.test_seed:
            raise ValueError(f"test_seed must not be the seed that is trained on, got {self.test_seed} for both")
        CORRUPTIONS["fog"](self.monitor_severity)
        self._check_sizes()
        self._check_held_out()

    def _check_sizes(self) -> None:
        self.check_at_least(1, "passes", "pair_part", "mcd_every", "strict_frames", "epochs", "trade_epochs",
                            "trade_repeats", "monitor_frames", "frames_per_epoch", "batch")  # fmt: skip
        if self.crossval_folds:
            self.check_at_least(2, "crossval_folds")
            self.check_at_least(1, "crossval_epochs", "crossval_frames")
            if not (self.crossval_dropouts and self.crossval_learning_rates):
                raise ValueError("crossval_dropouts and crossval_learning_rates must not be empty; or crossval_folds 0")
        shapes = [(self.cells, self.depth), (self.crossval_cells, self.depth)]
        for cells, depth in [*shapes, *((c, d) for c in self.trade_cells for d in self.trade_depths)]:
            if cells % 2**depth:
                raise ValueError(f"cells must divide by 2 to the power of the depth {depth}, got {cells}")
        if not self.trained_attacks or set(self.trained_attacks) == set(ATTACKS):
            raise ValueError("trained_attacks must name some attacks and leave others unseen")

    def _check_held_out(self) -> None:
        held_out = zip(self.domains, self.test_scenes, self.test_times, self.pair_frames, strict=True)
        for domain, scenes, times, frames in held_out:
            high = scenes * preset_named(domain).agents * (times - 1)
            if max(frames, self.strict_frames) > high:
                raise ValueError(
                    f"pair_frames and strict_frames must be at most {high}, the frames of {domain} with an earlier one"
                )
        scenes = self.test_scenes[self.domains.index(self.monitor_domain)]
        if 3 * self.monitor_frames > scenes:
            raise ValueError(f"monitor_frames must be at most {scenes // 3}, a third of the held-out scenes")
        if not 1 / (self.monitor_frames + 1) <= self.monitor_false_alarms < 1:
            raise ValueError(
                f"monitor_false_alarms must lie in [1 / (monitor_frames + 1), 1), got {self.monitor_false_alarms}"
            )

    def job_keys(self) -> list[JobKey]:
        """Return the keys of all jobs, step by step."""
        return [key for step in STEPS for key in self.job_keys_of(step)]

    def job_keys_of(self, step: str, protocols: Sequence[str] = PROTOCOLS) -> list[JobKey]:
        """Return the keys of all jobs of a step in some protocols, in the order in which they run."""
        if step == "models":
            return [model.key for model in self.models(protocols)]
        if step == "crossval" and PAPER in protocols:
            return [
                (step, f"{dropout:g}", f"{rate:g}", str(fold))
                for dropout in self.crossval_dropouts
                for rate in self.crossval_learning_rates
                for fold in range(self.crossval_folds)
            ]
        if step == "pairs":
            return [
                (step, protocol, name, domain, str(part))
                for protocol in protocols
                for name in [*(model.name for model in self.models([protocol])), CLASSICAL]
                for domain in self.domains
                for part in range(len(self.parts(domain, self.is_mcd(name))))
            ]
        if step == "trade" and PAPER in protocols:
            return [
                (step, str(width), str(depth), str(cells))
                for cells in self.trade_cells
                for depth in self.trade_depths
                for width in self.trade_widths
            ]
        if step == "strict" and STRICT in protocols:
            return [(step, domain, str(n)) for n in range(self.strict_frames) for domain in self.domains]
        return [(step, mixture) for mixture in MIXTURES] if step == "monitor" and STRICT in protocols else []

    def is_mcd(self, name: str) -> bool:
        """Return whether a model of this name uses several passes."""
        return name.startswith(VARIANTS[1])

    def parts(self, domain: str, mcd: bool) -> list[list[int]]:
        """Return the numbers of the held-out sweeps of a domain's pairs, part by part.

        Numbers go through the scenes in rounds. With ``mcd``, the choice among every ``mcd_every`` sweeps shifts by one
        in each round, so that no scene is left out.

        >>> plan = PaperPlan.load("tiny")
        >>> [list(part) for part in plan.parts("ugv", mcd=False)], [list(part) for part in plan.parts("ugv", mcd=True)]
        ([[0, 1], [2]], [[0, 2]])
        """
        place, every = self.domains.index(domain), self.mcd_every if mcd else 1
        frames, scenes = self.pair_frames[place], self.test_scenes[place]
        numbers = [number for first in range(0, frames, every) if (number := first + first // scenes % every) < frames]
        return [numbers[start : start + self.pair_part] for start in range(0, len(numbers), self.pair_part)]

    def models(self, protocols: Sequence[str] = PROTOCOLS) -> list[Model]:
        """Return the models of some protocols; each has 2 variants × 2 mixtures × the domains."""
        return [
            Model(protocol, variant, mixture, domain)
            for protocol in protocols
            for variant in VARIANTS
            for mixture in MIXTURES
            for domain in self.domains
        ]

    def model(self, protocol: str, name: str) -> Model:
        """Return the model called ``name``."""
        return next(model for model in self.models([protocol]) if model.name == name)
