"""The plan of the robustness study: names from the tables of attacks, corruptions and defenses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import ClassVar

from viewshed_lab.data.presets import preset_names
from viewshed_lab.studies.cases import (
    FULL,
    MIXTURE,
    behind,
    budget_cases,
    corruption_cases,
    strength_cases,
    strongest_case,
)
from viewshed_lab.studies.plan import JobKey, Plan, check_names, check_seed
from viewshed_lab.studies.records import BENIGN, Case
from viewshed_lab.studies.suite import TESTED
from viewshed_lab.threats.attacks import ATTACKS
from viewshed_lab.threats.attacks.adaptive import ADAPTIVE
from viewshed_lab.threats.attacks.points import MAX_FREE_POINTS
from viewshed_lab.threats.corruptions import CORRUPTIONS
from viewshed_lab.threats.defenses import DEFENSES

SEVERITIES = (1, 2, 3, 4, 5)

PARTS = ("attacks", "corruptions", "defenses", "paper", "adaptive")
"""Parts of a sample's evaluation, one job each: three of the strict protocol, the paper's protocol, and on some samples
of each domain the adaptive attackers."""


@dataclass(frozen=True, slots=True)
class RobustnessPlan(Plan):
    """Plan of the study. Names are of the package's tables; ``all`` in the TOML stands for all names of a table."""

    FOLDER: ClassVar[str] = "studies/robustness/plans"
    WHOLE_TABLES: ClassVar[Mapping[str, Iterable[str]]] = {
        "attacks": ATTACKS, "corruptions": CORRUPTIONS, "defenses": DEFENSES, "defended": TESTED,
        "adaptive": ADAPTIVE, "adaptive_defended": TESTED, "adaptive_against_defenses": ADAPTIVE,
    }  # fmt: skip

    name: str
    about: str
    domains: tuple[str, ...]  # presets of simulated data; held-out scenes are simulated as needed
    samples: tuple[int, ...]  # number of samples per domain, each from its own scene
    seed: int  # of all random draws and of the simulated domains, so it must not be a seed of training data
    attacks: tuple[str, ...]  # of ``ATTACKS``
    budgets: tuple[str, ...]  # numbers of returns, or ``full`` for a full wedge; each attack runs those it supports
    strengths: bool  # whether attacks also run with other sectors, shares and offsets (``attacks.SEVERITIES``)
    corruptions: tuple[str, ...]  # of ``CORRUPTIONS``
    severities: tuple[int, ...]  # of the corruptions, 1 to 5
    defenses: tuple[str, ...]  # of ``DEFENSES``
    defended: tuple[str, ...]  # estimators that are evaluated behind the defenses
    defended_severity: int  # of the corruptions for the defenses
    paper_points: tuple[int, ...]  # numbers of points in the part ``paper``
    # of ``attacks.adaptive.ADAPTIVE``: attackers that query their victim; each attacks every estimator
    adaptive: tuple[str, ...]
    adaptive_budget: int  # maximum number of their returns
    adaptive_queries: int  # maximum number of their queries
    adaptive_samples: tuple[int, ...]  # number of samples per domain for them, spread evenly
    adaptive_defended: tuple[str, ...]  # estimators that adaptive attackers also attack behind each defense
    adaptive_against_defenses: tuple[str, ...]  # the attackers of ``adaptive`` that do

    def __post_init__(self) -> None:
        for key, table in self.WHOLE_TABLES.items():
            check_names(key, getattr(self, key), table)
        if not self.domains or len(self.domains) != len(self.samples) or min(self.samples) < 1:
            raise ValueError(f"samples must be a positive number for each of {list(self.domains)}, got {self.samples}")
        check_names("domains", self.domains, preset_names(), once=True)
        check_seed("seed", self.seed)
        check_names("severities", (*self.severities, self.defended_severity), SEVERITIES)
        for budget in self.budgets:
            if budget != FULL and not budget.isdecimal():
                raise ValueError(f"budgets must be whole numbers or {FULL}, got {budget!r}")
        if min(self.paper_points, default=0) < 0:
            raise ValueError(f"paper_points must not be negative, got {self.paper_points}")
        self._check_adaptive()

    def _check_adaptive(self) -> None:
        counts = self.adaptive_samples
        if len(counts) != len(self.domains) or any(
            not 0 <= few <= count for few, count in zip(counts, self.samples, strict=True)
        ):
            raise ValueError(f"adaptive_samples must be 0 to {list(self.samples)}, one a domain, got {list(counts)}")
        if not 1 <= self.adaptive_budget <= MAX_FREE_POINTS:
            raise ValueError(f"adaptive_budget must lie in [1, {MAX_FREE_POINTS}], got {self.adaptive_budget}")
        if self.adaptive_queries < 3:
            raise ValueError(f"adaptive_queries must be at least 3, got {self.adaptive_queries}")

    def job_keys(self) -> list[JobKey]:
        """Return part, domain and number of each job; samples of the domains alternate."""
        numbers = sorted(
            (number / count, position, number)
            for position, count in enumerate(self.samples)
            for number in range(count)
        )  # fmt: skip
        return [
            (part, self.domains[position], str(number))
            for _, position, number in numbers
            for part in self.parts(self.domains[position], number)
        ]

    def parts(self, domain: str, number: int) -> tuple[str, ...]:
        """Return the parts of a sample: all of ``PARTS``, or all but the last."""
        few, count = self.adaptive_samples[self.domains.index(domain)], self.count(domain)
        met = bool(self.adaptive) and number in {k * count // few for k in range(few)}
        return PARTS if met else PARTS[:-1]

    def count(self, domain: str) -> int:
        """Return the number of samples of a domain."""
        return self.samples[self.domains.index(domain)]

    def cases(self, part: str) -> list[Case]:
        """Return the cases of one of ``PARTS``, without duplicates."""
        makers = {"attacks": self._attacks, "corruptions": self._corruptions, "defenses": self._defenses,
                  "paper": self._paper, "adaptive": self._adaptive}  # fmt: skip
        return list(dict.fromkeys(makers[part]()))

    def strongest(self, attack: str) -> Case:
        """Return an attack with the largest budget of the plan that it supports, or with its largest strength."""
        return strongest_case(attack, self.budgets)

    def _attacks(self) -> Iterator[Case]:
        yield BENIGN
        for name in self.attacks:
            yield from budget_cases(name, self.budgets)
            yield from strength_cases(name) if self.strengths else []
            yield self.strongest(name)

    def _corruptions(self) -> Iterator[Case]:
        return iter(corruption_cases(self.corruptions, self.severities))

    def _defenses(self) -> Iterator[Case]:
        attacked = [BENIGN, *map(self.strongest, self.attacks)]
        return behind([*attacked, *corruption_cases(self.corruptions, (self.defended_severity,))], self.defenses)

    def _paper(self) -> Iterator[Case]:
        yield BENIGN
        yield MIXTURE
        for name in ("uniform", "cluster"):
            yield from (Case("paper", name, str(points)) for points in self.paper_points)

    def _adaptive(self) -> Iterator[Case]:
        budget = str(self.adaptive_budget)
        for name in self.adaptive:
            yield from (Case("adaptive", name, level) for level in ("0", budget))
        for name in self.adaptive_against_defenses:
            for defense in self.defenses:
                yield Case("adaptive", name, "0", defense)
                yield from (Case(kind, name, budget, defense) for kind in ("unaware", "adaptive"))
