"""What a monitor is tried on, after it was fitted and calibrated on benign sweeps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import ClassVar

from viewshed_lab.data.presets import preset_names
from viewshed_lab.studies.plan import JobKey, Plan, check_names, check_seed
from viewshed_lab.studies.records import BENIGN, Case
from viewshed_lab.threats.attacks import ATTACKS
from viewshed_lab.threats.corruptions import CORRUPTIONS


@dataclass(frozen=True, slots=True)
class Trials:
    """What is done to the sweeps that a monitor is reported on."""

    attacks: tuple[str, ...] = tuple(ATTACKS)  # names of ``ATTACKS``, each with its own budget
    corruptions: tuple[str, ...] = tuple(CORRUPTIONS)  # names of ``CORRUPTIONS``
    severity: int = 3  # of the corruptions, 1 to 5
    false_alarm_rate: float = 0.05  # that the monitor is calibrated for
    sigmas: float = 3.0  # standard deviations above its mean from which a cell is suspect
    seed: int = 0  # of all that is random

    def __post_init__(self) -> None:
        check_names("attacks", self.attacks, ATTACKS)
        check_names("corruptions", self.corruptions, CORRUPTIONS)
        CORRUPTIONS["fog"](self.severity)

    def cases(self) -> list[Case]:
        """Return all that is done to a sweep, nothing first."""
        attacks = [Case("attack", name) for name in self.attacks]
        return [BENIGN, *attacks, *(Case("corruption", name) for name in self.corruptions)]


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviationPlan(Trials, Plan):
    """The study of the monitor with the shipped network."""

    FOLDER: ClassVar[str] = "studies/deviation/plans"
    WHOLE_TABLES: ClassVar[Mapping[str, Iterable[str]]] = {"attacks": ATTACKS, "corruptions": CORRUPTIONS}

    name: str
    about: str
    domain: str  # preset of simulated data, on whose grid the network must be shipped
    target: str  # of the network
    passes: int  # of Monte Carlo dropout
    frames: int  # benign sweeps that it is fitted on, calibrated on and reported on, each from a scene of its own

    def __post_init__(self) -> None:
        check_names("domain", (self.domain,), preset_names())
        check_seed("seed", self.seed)
        self.check_at_least(1, "passes", "frames")
        Trials.__post_init__(self)

    def job_keys(self) -> list[JobKey]:
        """Return the names of all jobs: one that fits, then one for each reported sweep."""
        return [("fit",), *(("watch", str(number)) for number in range(self.frames))]
