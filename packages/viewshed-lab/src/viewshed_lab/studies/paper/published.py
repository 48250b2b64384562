"""The figures of arXiv 2503.07375, the targets of this study, and its results."""

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
"""The case of the held-out sweeps, by mixture."""


@dataclass(frozen=True, slots=True, eq=False)
class PaperResults:
    """All results of the study so far, by step."""

    store: ResultStore[PaperPlan]  # source of the results
    pairs: Results[PaperPlan]  # held-out sweeps, benign and attacked, by networks and classical estimators
    strict: Results[PaperPlan]  # sweeps under every attack
    trade: Results[PaperPlan]  # networks of other widths, depths and resolutions
    monitor: Results[PaperPlan]  # deviation monitor, by the training mixture of its network
    models: dict[tuple[str, ...], dict[str, Any]]  # facts of each training, by protocol and name

    @classmethod
    def read(cls, store: ResultStore[PaperPlan]) -> PaperResults:
        """Return the results in a store."""
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
        """Return the results of all pairs that were tested in a domain."""
        return Domain(self.pairs, domain, protocol)


@dataclass(frozen=True, slots=True)
class SubTable:
    """One of the tables in the paper's layout."""

    title: str  # of the table
    variant: str  # of the models
    trained: str  # mixture of the training
    tested: str  # mixture of the test

    def key(self, protocol: str, test: str, train: str) -> Series:
        """Return the series of a cell of the table, by test and training domain."""
        return Series(test, f"{self.variant}-{self.trained}-{train}", TESTED_ON[self.tested], protocol=protocol)

    def published(self, test: str, train: str) -> list[float] | None:
        """Return the paper's precision, recall, accuracy and F1 of a cell; None if it has no such table."""
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
    """One target of the study in the paper's protocol."""

    what: str  # description
    published: float  # the paper's figure
    least: float  # the target
    found: float  # our figure, NaN if not measured
    at_half: float  # our figure at a threshold of .5 instead of the paper's

    @property
    def verdict(self) -> str:
        """``met``, ``missed``, or ``not measured``."""
        return "not measured" if isnan(self.found) else "met" if self.found >= self.least else "missed"


def targets_of(results: PaperResults) -> list[PublishedTarget]:
    """Return the targets of the paper's protocol, those of the plan ``medium``, with the reached figures."""
    in_domain = [(BENIGN_TABLE, (0.93, 0.92, 0.91)), (ADVERSARIAL, (0.93, 0.91, 0.90))]
    worst = [(BENIGN_TABLE, 0.89), (ADVERSARIAL, 0.87)]
    targets = [target for table, minima in in_domain for target in _in_domain(results, table, minima)]
    return targets + [_worst(results, table, minimum) for table, minimum in worst]


def _in_domain(results: PaperResults, table: SubTable, minima: Sequence[float]) -> Iterator[PublishedTarget]:
    for domain, target in zip(ORDER, minima, strict=True):
        what, published = f"in-domain F1, {table.tested}, {domain}", _paper_f1(table, domain, domain)
        yield PublishedTarget(what, published, target, *_f1(results, table, domain, domain))


def _worst(results: PaperResults, table: SubTable, minimum: float) -> PublishedTarget:
    """Return the target of the lowest F1 over pairs of different training and test domains."""
    crossed = [(test, train) for test, train in product(ORDER, ORDER) if test != train]
    by_threshold = zip(*(_f1(results, table, *pair) for pair in crossed), strict=True)
    lowest = [float("nan") if any(map(isnan, rates)) else min(rates) for rates in by_threshold]
    published = min(_paper_f1(table, *pair) for pair in crossed)
    return PublishedTarget(f"worst transfer F1, {table.tested}", published, minimum, *lowest)


def _paper_f1(table: SubTable, test: str, train: str) -> float:
    return (table.published(test, train) or [float("nan")])[-1]


def _f1(results: PaperResults, table: SubTable, test: str, train: str) -> tuple[float, float]:
    """Return F1 of a pair at the paper's threshold and at .5; NaN without results."""
    key = table.key(PAPER, test, train)
    return results.pairs.counts(key).f1, results.pairs.scores([key]).f1()
