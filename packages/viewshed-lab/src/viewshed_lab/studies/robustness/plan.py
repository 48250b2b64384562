"""What is run over what: names taken from the tables of attacks, corruptions and defenses."""

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
"""What is done with a sample, one job each: the strict block in three, the paper's, and on some samples of each domain
the attackers who know their victim."""


@dataclass(frozen=True, slots=True)
class RobustnessPlan(Plan):
    """What is run over what. Names are of the tables of the package; ``all`` in the TOML is a whole table."""

    FOLDER: ClassVar[str] = "studies/robustness/plans"
    WHOLE_TABLES: ClassVar[Mapping[str, Iterable[str]]] = {
        "attacks": ATTACKS, "corruptions": CORRUPTIONS, "defenses": DEFENSES, "defended": TESTED,
        "adaptive": ADAPTIVE, "adaptive_defended": TESTED, "adaptive_against_defenses": ADAPTIVE,
    }  # fmt: skip

    name: str
    about: str
    domains: tuple[str, ...]  # presets of simulated data, of which held-out scenes are made as needed
    samples: tuple[int, ...]  # how many of each domain, one a scene as far as there are scenes
    seed: int  # of everything random; simulated domains are made with it, so it must not be one that anybody trained on
    attacks: tuple[str, ...]  # of ``ATTACKS``
    budgets: tuple[str, ...]  # numbers of returns, ``full`` for a whole wedge; of these each attack runs what fits it
    strengths: bool  # whether attacks also run with other sectors, shares and offsets (``attacks.SEVERITIES``)
    corruptions: tuple[str, ...]  # of ``CORRUPTIONS``
    severities: tuple[int, ...]  # of the corruptions, 1 to 5
    defenses: tuple[str, ...]  # of ``DEFENSES``
    defended: tuple[str, ...]  # estimators that the defenses stand before
    defended_severity: int  # of the corruptions that the defenses face
    paper_points: tuple[int, ...]  # numbers of points in the paper's own block
    # of ``attacks.adaptive.ADAPTIVE``: attackers who query their victim, each of all estimators
    adaptive: tuple[str, ...]
    adaptive_budget: int  # most returns that they place
    adaptive_queries: int  # most queries that they make
    adaptive_samples: tuple[int, ...]  # how many samples of each domain they meet, spread evenly
    adaptive_defended: tuple[str, ...]  # estimators whose attackers also know the defense before them, for each defense
    adaptive_against_defenses: tuple[str, ...]  # which of ``adaptive`` these attackers are

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
        """Return part, domain and number of each job, sample after sample and domain after domain in turn."""
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
        """Return what is done with a sample: all of ``PARTS``, or all but the last."""
        few, count = self.adaptive_samples[self.domains.index(domain)], self.count(domain)
        met = bool(self.adaptive) and number in {k * count // few for k in range(few)}
        return PARTS if met else PARTS[:-1]

    def count(self, domain: str) -> int:
        """Return how many samples a domain has."""
        return self.samples[self.domains.index(domain)]

    def cases(self, part: str) -> list[Case]:
        """Return the cases of one of ``PARTS``, each once."""
        makers = {"attacks": self._attacks, "corruptions": self._corruptions, "defenses": self._defenses,
                  "paper": self._paper, "adaptive": self._adaptive}  # fmt: skip
        return list(dict.fromkeys(makers[part]()))

    def strongest(self, attack: str) -> Case:
        """Return an attack with the largest budget of the plan that fits it, or its largest strength."""
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
        faced = [BENIGN, *map(self.strongest, self.attacks)]
        return behind([*faced, *corruption_cases(self.corruptions, (self.defended_severity,))], self.defenses)

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
