"""What arXiv 2503.07375 reports, what this study set out to reach, and all that it has found."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from itertools import product
from math import isnan
from typing import Any

from viewshed_lab.studies.paper.jobs import ATTACKED
from viewshed_lab.studies.paper.plan import PaperPlan
from viewshed_lab.studies.records import BENIGN, PAPER, Domain, Results, Series
from viewshed_lab.studies.store import ResultStore

ORDER = ("carla", "nuscenes", "ugv")
"""Domains in the paper's order."""

TESTED_ON = {"benign": BENIGN, "adversarial": ATTACKED}
"""The case of the held-out sweeps by the mixture that they are of."""


@dataclass(frozen=True, slots=True, eq=False)
class PaperResults:
    """All that the study has found so far, by step."""

    store: ResultStore[PaperPlan]  # it is from
    pairs: Results[PaperPlan]  # held-out sweeps, benign and attacked, by networks and classical estimators
    strict: Results[PaperPlan]  # sweeps under every attack
    trade: Results[PaperPlan]  # networks of other widths, depths and resolutions
    monitor: Results[PaperPlan]  # of the deviation, by what its network was trained on
    models: dict[tuple[str, ...], dict[str, Any]]  # facts of each training, by protocol and name

    @classmethod
    def read(cls, store: ResultStore[PaperPlan]) -> PaperResults:
        """Return what is in a store; the order of its lines does not matter."""
        pairs, strict, trade, monitor = (store.results(step) for step in ("pairs", "strict", "trade", "monitor"))
        models = {key[1:]: facts for key, facts in sorted(store.results("models").facts.items())}
        return cls(store, pairs, strict, trade, monitor, models)

    @property
    def plan(self) -> PaperPlan:
        """Plan of the study."""
        return self.store.plan

    @property
    def domains(self) -> list[str]:
        """Domains of the plan in the paper's order."""
        domains = self.plan.domains
        return [*(name for name in ORDER if name in domains), *(name for name in domains if name not in ORDER)]

    def pairs_in(self, protocol: str, domain: str) -> Domain[PaperPlan]:
        """Return the scores of all pairs that were tested in a domain."""
        return Domain(self.pairs, domain, protocol)


@dataclass(frozen=True, slots=True)
class SubTable:
    """One of the tables in the paper's layout."""

    title: str  # of the table
    variant: str  # of the models
    trained: str  # what they are trained on
    tested: str  # what they are tested on

    def key(self, protocol: str, test: str, train: str) -> Series:
        """Return whose scores stand in a cell of the table."""
        return Series(test, f"{self.variant}-{self.trained}-{train}", TESTED_ON[self.tested], protocol=protocol)

    def published(self, test: str, train: str) -> list[float] | None:
        """Return the paper's precision, recall, accuracy and F1 of a cell; None where it has none."""
        figures = _published().get(f"{self.variant}-{self.trained}-{self.tested}", {})
        return figures.get(f"{test}-{train}", [float("nan")] * 4) if figures else None


@cache
def _published() -> dict[str, dict[str, list[float]]]:
    return tomllib.loads(resources.files(__package__).joinpath("published.toml").read_text(encoding="utf-8"))


BENIGN_TABLE = SubTable("Benign: trained and tested without attacks", "mle", "benign", "benign")

ADVERSARIAL = SubTable("Adversarial: trained and tested with attacks", "mle", "adversarial", "adversarial")

ADVERSARIAL_MCD = SubTable(
    "Adversarial, Monte Carlo dropout: trained and tested with attacks", "mcd", "adversarial", "adversarial"
)

LEFT_OUT = SubTable("Left out by the paper: trained without attacks, tested with them", "mle", "benign", "adversarial")

SUB_TABLES = (BENIGN_TABLE, ADVERSARIAL, ADVERSARIAL_MCD, LEFT_OUT)

OTHERS = (
    SubTable("Benign, Monte Carlo dropout", "mcd", "benign", "benign"),
    SubTable("Trained without attacks, tested with them, Monte Carlo dropout", "mcd", "benign", "adversarial"),
    SubTable("Trained with attacks, tested without", "mle", "adversarial", "benign"),
    SubTable("Trained with attacks, tested without, Monte Carlo dropout", "mcd", "adversarial", "benign"),
)
"""The rest of the 72 pairs."""


@dataclass(frozen=True, slots=True)
class PublishedTarget:
    """One figure that the study set out to reach in the paper's protocol."""

    what: str  # in words
    published: float  # the paper's figure
    least: float  # the target
    found: float  # ours, NaN where it is not measured
    at_half: float  # ours with a threshold of .5, not the paper's

    @property
    def verdict(self) -> str:
        """``met``, ``missed``, or ``not measured``."""
        return "not measured" if isnan(self.found) else "met" if self.found >= self.least else "missed"


def targets_of(results: PaperResults) -> list[PublishedTarget]:
    """Return the targets of the paper's protocol, those of the plan ``medium``, beside what was reached."""
    in_domain = [(BENIGN_TABLE, (0.93, 0.92, 0.91)), (ADVERSARIAL, (0.93, 0.91, 0.90))]
    worst = [(BENIGN_TABLE, 0.89), (ADVERSARIAL, 0.87)]
    targets = [target for table, least in in_domain for target in _in_domain(results, table, least)]
    return targets + [_worst(results, table, least) for table, least in worst]


def _in_domain(results: PaperResults, table: SubTable, least: Sequence[float]) -> Iterator[PublishedTarget]:
    for domain, target in zip(ORDER, least, strict=True):
        what, published = f"in-domain F1, {table.tested}, {domain}", _paper_f1(table, domain, domain)
        yield PublishedTarget(what, published, target, *_f1(results, table, domain, domain))


def _worst(results: PaperResults, table: SubTable, least: float) -> PublishedTarget:
    """Return the target of the lowest F1 where training and test set differ."""
    crossed = [(test, train) for test, train in product(ORDER, ORDER) if test != train]
    found = zip(*(_f1(results, table, *pair) for pair in crossed), strict=True)
    lowest = [float("nan") if any(map(isnan, rates)) else min(rates) for rates in found]
    published = min(_paper_f1(table, *pair) for pair in crossed)
    return PublishedTarget(f"worst transfer F1, {table.tested}", published, least, *lowest)


def _paper_f1(table: SubTable, test: str, train: str) -> float:
    return (table.published(test, train) or [float("nan")])[-1]


def _f1(results: PaperResults, table: SubTable, test: str, train: str) -> tuple[float, float]:
    """Return F1 of a pair with the paper's threshold and with .5; NaN where it was not tried."""
    key = table.key(PAPER, test, train)
    return results.pairs.counts(key).f1, results.pairs.scores([key]).f1()
