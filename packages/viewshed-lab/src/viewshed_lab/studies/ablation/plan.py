"""What the ablation runs: one training config, and what each variant changes of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

from viewshed_lab import _config
from viewshed_lab.data.presets import preset_named
from viewshed_lab.studies.plan import JobKey, Plan, check_seed
from viewshed_lab.training.config import TrainConfig, read_config

STEPS = ("models", "validation", "test", "chosen", "page")
"""What the command does, in order."""

WHOLE = "whole"
"""The variant that changes nothing."""


@dataclass(frozen=True, slots=True)
class AblationPlan(Plan):
    """What is trained and tried."""

    FOLDER: ClassVar[str] = "studies/ablation/plans"

    name: str
    about: str
    config: str  # name of the training config that the variants change
    domain: str  # preset whose scenes variants are tried on, on the grid of the config
    # further settings in which the shipped networks are reported: by the name of the training config whose
    # grid, target and attacks count there, the preset
    others: Mapping[str, str]
    seed: int  # of the scenes on which variants are compared
    test_seed: int  # of the scenes on which the shipped network is reported
    sweeps: int  # how many sweeps variants are compared on, each from a scene of its own
    test_sweeps: int  # how many the shipped network is reported on
    other_sweeps: int  # the same in each of ``others``
    chosen_sweeps: int  # how many of those of the domain are attacked by points chosen against their victim
    # that such an attacker makes: the first number of every victim, each number of our network
    queries: tuple[int, ...]
    chunk: int  # sweeps of one job; points are chosen for one at a time
    claim_precision: float  # precision of cells claimed in attacked wedges after abstention, for which it is calibrated
    base: Mapping[str, Any]  # changes of the config that all variants share
    variants: Mapping[str, Mapping[str, Any]]  # by name, the further changes of each

    def __post_init__(self) -> None:
        self._check_seeds()
        if min(self.sweeps, self.test_sweeps, self.other_sweeps, self.chunk) < 1:
            raise ValueError("sweeps, test_sweeps, other_sweeps and chunk must be at least 1")
        if not 0 <= self.chosen_sweeps <= self.test_sweeps:
            raise ValueError(f"chosen_sweeps must lie in [0, {self.test_sweeps}], got {self.chosen_sweeps}")
        if not self.queries or min(self.queries) < 1 or len(set(self.queries)) < len(self.queries):
            raise ValueError(f"queries must be different numbers of at least 1, got {list(self.queries)}")
        if not 0.0 < self.claim_precision < 1.0:
            raise ValueError(f"claim_precision must lie in (0, 1), got {self.claim_precision}")
        if self.variants.get(WHOLE) != {}:
            raise ValueError(f"variants must have one named {WHOLE} that changes nothing")
        if self.config in self.others:
            raise ValueError(f"others must not hold {self.config}, the config of the ablation itself")
        _ = [self.config_of(name) for name in self.variants], [self.config_in(setting) for setting in self.others]

    def _check_seeds(self) -> None:
        for key in ("seed", "test_seed"):
            check_seed(key, getattr(self, key))
        for setting in self.settings:
            preset = self.preset_in(setting)
            if len({self.seed, self.test_seed, preset_named(preset).seed}) < 3:
                raise ValueError(f"seed and test_seed must differ from each other and from that of {preset}")

    @property
    def settings(self) -> tuple[str, ...]:
        """Names of configs: that of the ablation, then the others."""
        return self.config, *self.others

    def preset_in(self, setting: str) -> str:
        """Return the preset whose scenes a setting has."""
        return self.domain if setting == self.config else self.others[setting]

    def config_in(self, setting: str) -> TrainConfig:
        """Return the training config whose grid, target and attacks count in a setting."""
        return self.config_of(WHOLE) if setting == self.config else read_config(setting)

    def title_of(self, setting: str) -> str:
        """Return what a setting is called: its preset and its target."""
        return f"{self.preset_in(setting)}, {self.config_in(setting).target}"

    def config_of(self, variant: str) -> TrainConfig:
        """Return how a variant is trained."""
        if variant not in self.variants:
            raise ValueError(f"variant must be one of {', '.join(self.variants)}, got {variant!r}")
        changes = {**self.base, **self.variants[variant]}
        return TrainConfig.from_json(read_config(self.config).to_json() | changes | {"name": variant})

    def count(self, split: str, setting: str) -> int:
        """Return how many sweeps of a setting a split has."""
        if split == "validation":
            return self.sweeps
        return self.test_sweeps if setting == self.config else self.other_sweeps

    def seed_of(self, split: str) -> int:
        """Return the seed of a split's scenes."""
        return self.seed if split == "validation" else self.test_seed

    @classmethod
    def from_json(cls, table: Mapping[str, Any]) -> Self:
        """Return the plan in plain values; three of them are tables of their own."""
        nested = {key: table.get(key) for key in ("base", "others", "variants")}
        rest = {key: value for key, value in table.items() if key not in nested}
        for key, value in nested.items():
            if not isinstance(value, dict):
                raise ValueError(f"{key} must be a table, got {value!r}")
        return cls(**_config.from_dict(cls, rest, "plan", without=nested), **nested)  # type: ignore[arg-type]

    def to_json(self) -> dict[str, Any]:
        """Return the plan as plain values, its tables among them."""
        variants = {name: dict(changes) for name, changes in self.variants.items()}
        return _config.to_dict(self) | {"base": dict(self.base), "others": dict(self.others), "variants": variants}

    def job_keys(self) -> list[JobKey]:
        """Return the names of all jobs, step after step."""
        return [key for step in STEPS for key in self.job_keys_of(step)]

    def job_keys_of(self, step: str) -> list[JobKey]:
        """Return the names of all jobs of a step, in the order in which they are done."""
        if step == "page":
            return []
        if step == "models":
            return [("models", name) for name in self.variants]
        if step == "chosen":
            return [(step, self.config, str(number)) for number in range(self.chosen_sweeps)]
        settings = self.settings if step == "test" else (self.config,)
        chunks = {setting: -(-self.count(step, setting) // self.chunk) for setting in settings}
        return [(step, setting, str(number)) for setting in settings for number in range(chunks[setting])]
