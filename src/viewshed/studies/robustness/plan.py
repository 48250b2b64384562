"""What a study runs: one flat TOML each, with names taken from the tables of attacks, corruptions and defenses."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from viewshed import _config as flat
from viewshed.datasets.presets import MAX_SEED
from viewshed.studies.suite import ENTRANTS
from viewshed.threats.attacks import ATTACKS
from viewshed.threats.attacks.adaptive import ADAPTIVE
from viewshed.threats.attacks.points import MOST_FREE
from viewshed.threats.corruptions import CORRUPTIONS
from viewshed.threats.defenses import DEFENSES

_FOLDER = "studies/robustness/plans"

FULL = "full"
"""The budget of every beam in the wedge."""

SEVERITIES = (1, 2, 3, 4, 5)

PARTS = ("attacks", "corruptions", "defenses", "paper", "adaptive")
"""What is done with a sample, one job each: the strict block in three, the paper's, and on some samples of each domain
the attackers who know their victim."""


@dataclass(frozen=True, slots=True)
class Study:
    """What is run over what. Names come from the tables of the package; ``all`` in the TOML stands for a whole table.

    Attributes:
        name: of the study.
        about: one line for people.
        domains: presets of simulated data (held-out scenes are made as needed), or places of archives.
        samples: how many of each domain, one a scene as far as there are scenes.
        seed: of everything random; simulated domains are made with it, so it must not be one that anybody trained on.
        attacks: of ``ATTACKS``.
        budgets: numbers of returns, ``full`` for a whole wedge; of these each attack runs what fits it.
        strengths: whether attacks also run with other sectors, shares and offsets (``attacks.SEVERITIES``).
        corruptions: of ``CORRUPTIONS``.
        severities: of the corruptions, 1 to 5.
        defenses: of ``DEFENSES``.
        defended: estimators that the defenses stand before.
        defended_budgets: what the defenses face besides the largest budget of each attack.
        defended_severity: of the corruptions that the defenses face.
        paper_points: numbers of points in the paper's own block.
        adaptive: of ``attacks.adaptive.ADAPTIVE``: attackers who ask their victim, each of all estimators.
        adaptive_budget: most returns that they place.
        adaptive_queries: most questions that they ask.
        adaptive_samples: how many samples of each domain they meet, spread evenly.
        adaptive_defended: estimators whose attackers also know the defense before them, for each defense.
        adaptive_against_defenses: which of ``adaptive`` these attackers are.

    Raises:
        ValueError: a name is not known, or a number is out of range.
    """

    name: str
    about: str
    domains: tuple[str, ...]
    samples: tuple[int, ...]
    seed: int
    attacks: tuple[str, ...]
    budgets: tuple[str, ...]
    strengths: bool
    corruptions: tuple[str, ...]
    severities: tuple[int, ...]
    defenses: tuple[str, ...]
    defended: tuple[str, ...]
    defended_budgets: tuple[str, ...]
    defended_severity: int
    paper_points: tuple[int, ...]
    adaptive: tuple[str, ...]
    adaptive_budget: int
    adaptive_queries: int
    adaptive_samples: tuple[int, ...]
    adaptive_defended: tuple[str, ...]
    adaptive_against_defenses: tuple[str, ...]

    def __post_init__(self) -> None:
        for key, table in _NAMES.items():
            _check_names(key, getattr(self, key), table)
        if not self.domains or len(self.domains) != len(self.samples) or min(self.samples) < 1:
            raise ValueError(f"samples must be a positive number for each of {list(self.domains)}, got {self.samples}")
        if len(set(self.domains)) != len(self.domains):
            raise ValueError(f"domains must be different, got {', '.join(self.domains)}")
        if not 0 <= self.seed <= MAX_SEED:
            raise ValueError(f"seed must lie in [0, {MAX_SEED}], got {self.seed}")
        _check_names("severities", (*self.severities, self.defended_severity), SEVERITIES)
        for budget in (*self.budgets, *self.defended_budgets):
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
        if not 1 <= self.adaptive_budget <= MOST_FREE:
            raise ValueError(f"adaptive_budget must lie in [1, {MOST_FREE}], got {self.adaptive_budget}")
        if self.adaptive_queries < 3:
            raise ValueError(f"adaptive_queries must be at least 3, got {self.adaptive_queries}")

    @classmethod
    def from_json(cls, table: Mapping[str, Any]) -> Study:
        """Return the study in plain values: keys as the attributes, lists for tuples.

        Raises:
            ValueError: a key is missing or unknown, or a value is wrong.
        """
        return cls(**flat.from_dict(cls, table, "study", _NAMES))

    def to_json(self) -> dict[str, Any]:
        """Return the study as plain values, every name spelt out."""
        return flat.to_dict(self)

    def jobs(self) -> list[Job]:
        """Return what there is to do, sample after sample and domain after domain in turn."""
        numbers = sorted(
            (number / count, place, number)
            for place, count in enumerate(self.samples)
            for number in range(count)
        )  # fmt: skip
        return [Job(self, place, number, part) for _, place, number in numbers for part in self.parts(place, number)]

    def parts(self, place: int, number: int) -> tuple[str, ...]:
        """Return what is done with a sample of the domain ``place``: all of ``PARTS``, or all but the last."""
        few, count = self.adaptive_samples[place], self.samples[place]
        met = bool(self.adaptive) and number in {k * count // few for k in range(few)}
        return PARTS if met else PARTS[:-1]


@dataclass(frozen=True, slots=True)
class Job:
    """One part of the study on one sample.

    Attributes:
        study: that it is part of.
        place: number of its domain.
        number: of the sample in its domain.
        part: of ``PARTS``.
    """

    study: Study
    place: int
    number: int
    part: str

    @property
    def key(self) -> tuple[str, int, str]:
        """Domain, number and part: what it is stored under."""
        return self.study.domains[self.place], self.number, self.part


_NAMES: dict[str, Iterable[str]] = {
    "attacks": ATTACKS, "corruptions": CORRUPTIONS, "defenses": DEFENSES, "defended": ENTRANTS,
    "adaptive": ADAPTIVE, "adaptive_defended": ENTRANTS, "adaptive_against_defenses": ADAPTIVE,
}  # fmt: skip


def _check_names(key: str, names: Iterable[object], table: Iterable[object]) -> None:
    known = list(table)
    for name in names:
        if isinstance(name, bool) or name not in known:
            raise ValueError(f"{key} must be among {', '.join(map(str, known))}, got {name!r}")


def study_names() -> tuple[str, ...]:
    """Return the names that :func:`study_named` knows, in alphabetical order."""
    return flat.preset_names(_FOLDER)


def study_named(name: str) -> Study:
    """Return the study called ``name``.

    Raises:
        ValueError: there is none of that name; the message lists those that exist.

    >>> study_named("small").domains
    ('nuscenes', 'carla', 'ugv')
    """
    return Study.from_json(flat.load_preset(_FOLDER, name))
