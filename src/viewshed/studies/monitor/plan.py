"""What a monitor is tried on, after it was fitted and calibrated on benign sweeps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from viewshed import _config
from viewshed.datasets.presets import preset_names
from viewshed.studies.plan import JobKey, check_names, check_seed
from viewshed.studies.records import BENIGN, Case
from viewshed.threats.attacks import ATTACKS
from viewshed.threats.corruptions import CORRUPTIONS

_FOLDER = "studies/monitor/plans"


@dataclass(frozen=True, slots=True)
class Trials:
    """What is done to the sweeps that a monitor is reported on.

    Attributes:
        attacks: names of ``ATTACKS``, each with its own budget.
        corruptions: names of ``CORRUPTIONS``.
        severity: of the corruptions, 1 to 5.
        false_alarm_rate: that the monitor is calibrated for.
        sigmas: standard deviations above its mean from which a cell is suspect.
        seed: of all that is random.

    Raises:
        ValueError: there is no such attack, corruption or severity.
    """

    attacks: tuple[str, ...] = tuple(ATTACKS)
    corruptions: tuple[str, ...] = tuple(CORRUPTIONS)
    severity: int = 3
    false_alarm_rate: float = 0.05
    sigmas: float = 3.0
    seed: int = 0

    def __post_init__(self) -> None:
        check_names("attacks", self.attacks, ATTACKS)
        check_names("corruptions", self.corruptions, CORRUPTIONS)
        CORRUPTIONS["fog"](self.severity)

    def cases(self) -> list[Case]:
        """Return all that is done to a sweep, nothing first."""
        attacks = [Case("attack", name) for name in self.attacks]
        return [BENIGN, *attacks, *(Case("corruption", name) for name in self.corruptions)]


@dataclass(frozen=True, slots=True)
class MonitorPlan:
    """The study of the monitor with the shipped network.

    Attributes:
        name: of the plan.
        about: one line for people.
        domain: preset of simulated data, on whose grid the network must be shipped.
        target: of the network.
        passes: of Monte Carlo dropout.
        frames: benign sweeps that it is fitted on, calibrated on and reported on, each from a scene of its own.
        attacks: names of ``ATTACKS``, each with its own budget.
        corruptions: names of ``CORRUPTIONS``.
        severity: of the corruptions, 1 to 5.
        false_alarm_rate: that the monitor is calibrated for.
        sigmas: standard deviations above its mean from which a cell is suspect.
        seed: of the scenes and of all that is random.

    Raises:
        ValueError: a name is not known, or a number is out of range.
    """

    name: str
    about: str
    domain: str
    target: str
    passes: int
    frames: int
    attacks: tuple[str, ...]
    corruptions: tuple[str, ...]
    severity: int
    false_alarm_rate: float
    sigmas: float
    seed: int

    def __post_init__(self) -> None:
        check_names("domain", (self.domain,), preset_names())
        check_seed("seed", self.seed)
        for key in ("passes", "frames"):
            if getattr(self, key) < 1:
                raise ValueError(f"{key} must be at least 1, got {getattr(self, key)}")
        _ = self.trials

    @property
    def trials(self) -> Trials:
        """What is done to the sweeps."""
        return Trials(
            self.attacks, self.corruptions, self.severity, self.false_alarm_rate, self.sigmas, self.seed
        )  # fmt: skip

    @classmethod
    def from_json(cls, table: Mapping[str, Any]) -> MonitorPlan:
        """Return the plan in plain values: keys as the attributes, lists for tuples.

        Raises:
            ValueError: a key is missing or unknown, or a value is wrong.
        """
        return cls(**_config.from_dict(cls, table, "plan", {"attacks": ATTACKS, "corruptions": CORRUPTIONS}))

    def to_json(self) -> dict[str, Any]:
        """Return the plan as plain values, every name spelt out."""
        return _config.to_dict(self)

    @classmethod
    def load(cls, name: str) -> MonitorPlan:
        """Return the plan called ``name``.

        Raises:
            ValueError: there is none of that name; the message lists those that exist.
        """
        return cls.from_json(_config.load_preset(_FOLDER, name))

    def job_keys(self) -> list[JobKey]:
        """Return the names of all jobs: one that fits, then one for each reported sweep."""
        return [("fit",), *(("watch", str(number)) for number in range(self.frames))]
