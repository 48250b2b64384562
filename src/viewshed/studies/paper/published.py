"""What arXiv 2503.07375 reports, what this study set out to reach, and all that it has found."""

from __future__ import annotations

from dataclasses import dataclass
from math import isnan
from typing import Any

from viewshed.studies.paper.jobs import ATTACKED
from viewshed.studies.paper.plan import PaperPlan
from viewshed.studies.records import BENIGN, PAPER, Results, Series
from viewshed.studies.statistics import f1
from viewshed.studies.store import ResultStore


@dataclass(frozen=True, slots=True, eq=False)
class PaperResults:
    """All that the study has found so far, by step.

    Attributes:
        store: it is from.
        pairs: held-out sweeps, benign and attacked, by networks and classical estimators.
        strict: sweeps under every attack.
        trade: networks of other widths, depths and resolutions.
        monitor: of the deviation, by what its network was trained on.
        models: facts of each training, by protocol and name.
    """

    store: ResultStore[PaperPlan]
    pairs: Results[PaperPlan]
    strict: Results[PaperPlan]
    trade: Results[PaperPlan]
    monitor: Results[PaperPlan]
    models: dict[tuple[str, ...], dict[str, Any]]

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


def pair(protocol: str, method: str, tested: str, domain: str) -> Series:
    """Return whose scores on which held-out sweeps, ``benign`` or ``adversarial``."""
    return Series(domain, method, BENIGN if tested == "benign" else ATTACKED, protocol=protocol)


Figures = tuple[float, float, float, float]
"""Precision, recall, accuracy, F1."""

ORDER = ("carla", "nuscenes", "ugv")


@dataclass(frozen=True, slots=True)
class SubTable:
    """One of the tables in the paper's layout.

    Attributes:
        title: of the table.
        variant: of the models.
        trained: what they are trained on.
        tested: what they are tested on.
        published: by test set and training set the paper's figures; empty where it has none.
    """

    title: str
    variant: str
    trained: str
    tested: str
    published: dict[tuple[str, str], Figures]

    def key(self, protocol: str, test: str, train: str) -> Series:
        """Return whose scores stand in a cell of the table."""
        return pair(protocol, f"{self.variant}-{self.trained}-{train}", self.tested, test)


def _cells(*rows: tuple[Figures, Figures, Figures]) -> dict[tuple[str, str], Figures]:
    return {
        (test, train): figures
        for test, row in zip(ORDER, rows, strict=True)
        for train, figures in zip(ORDER, row, strict=True)
    }


BENIGN_TABLE = SubTable(
    "Benign: trained and tested without attacks", "mle", "benign", "benign",
    _cells(
        ((0.95, 0.90, 0.97, 0.92), (0.91, 0.92, 0.96, 0.91), (0.95, 0.83, 0.95, 0.88)),
        ((0.91, 0.80, 0.93, 0.85), (0.92, 0.84, 0.95, 0.88), (0.95, 0.70, 0.92, 0.80)),
        ((0.92, 0.80, 0.95, 0.85), (0.91, 0.84, 0.96, 0.87), (0.97, 0.79, 0.96, 0.87)),
    ),
)  # fmt: skip

ADVERSARIAL = SubTable(
    "Adversarial: trained and tested with attacks", "mle", "adversarial", "adversarial",
    _cells(
        ((0.95, 0.91, 0.97, 0.93), (0.93, 0.89, 0.96, 0.91), (0.97, 0.61, 0.90, 0.75)),
        ((0.92, 0.76, 0.93, 0.83), (0.93, 0.77, 0.93, 0.84), (0.97, 0.55, 0.89, 0.69)),
        ((0.92, 0.81, 0.95, 0.86), (0.91, 0.83, 0.95, 0.86), (0.98, 0.72, 0.94, 0.82)),
    ),
)  # fmt: skip

ADVERSARIAL_MCD = SubTable(
    "Adversarial, Monte Carlo dropout: trained and tested with attacks", "mcd", "adversarial", "adversarial",
    _cells(
        ((0.97, 0.85, 0.96, 0.90), (0.93, 0.85, 0.95, 0.89), (0.95, 0.71, 0.92, 0.81)),
        ((0.95, 0.70, 0.92, 0.80), (0.94, 0.73, 0.93, 0.82), (0.94, 0.62, 0.90, 0.74)),
        ((0.93, 0.76, 0.95, 0.84), (0.91, 0.78, 0.95, 0.84), (0.95, 0.79, 0.95, 0.86)),
    ),
)  # fmt: skip

LEFT_OUT = SubTable(
    "Left out by the paper: trained without attacks, tested with them", "mle", "benign", "adversarial", {}
)

SUB_TABLES = (BENIGN_TABLE, ADVERSARIAL, ADVERSARIAL_MCD, LEFT_OUT)

OTHERS = (
    SubTable("Benign, Monte Carlo dropout", "mcd", "benign", "benign", {}),
    SubTable("Trained without attacks, tested with them, Monte Carlo dropout", "mcd", "benign", "adversarial", {}),
    SubTable("Trained with attacks, tested without", "mle", "adversarial", "benign", {}),
    SubTable("Trained with attacks, tested without, Monte Carlo dropout", "mcd", "adversarial", "benign", {}),
)
"""The rest of the 72 pairs."""


@dataclass(frozen=True, slots=True)
class Target:
    """One figure that the study set out to reach in the paper's protocol.

    Attributes:
        what: in words.
        published: the paper's figure.
        least: the target.
        found: ours, NaN where it is not measured.
        at_half: ours with a threshold of .5, not the paper's.
    """

    what: str
    published: float
    least: float
    found: float
    at_half: float

    @property
    def verdict(self) -> str:
        """``met``, ``missed``, or ``not measured``."""
        return "not measured" if isnan(self.found) else "met" if self.found >= self.least else "missed"


def targets_of(results: PaperResults) -> list[Target]:
    """Return the targets of the paper's protocol beside what was reached."""
    return [
        *_in_domain(results, BENIGN_TABLE, 0.95), *_in_domain(results, ADVERSARIAL, 0.95),
        *_in_domain(results, ADVERSARIAL_MCD, 0.94),
        _worst(results, BENIGN_TABLE, 0.90),
        _worst(results, ADVERSARIAL, 0.88),
    ]  # fmt: skip


def _in_domain(results: PaperResults, table: SubTable, least: float) -> list[Target]:
    words = f"in-domain F1, {table.tested}{', MCD' if table.variant == 'mcd' else ''}"
    return [
        Target(f"{words}, {domain}", table.published[domain, domain][3], least, *_found(results, table, domain, domain))
        for domain in ORDER
    ]


def _worst(results: PaperResults, table: SubTable, least: float) -> Target:
    """Return the target of the lowest F1 where training and test set differ."""
    crossed = [(test, train) for test in ORDER for train in ORDER if test != train]
    found = zip(*(_found(results, table, *pair) for pair in crossed), strict=True)
    lowest = [float("nan") if any(map(isnan, rates)) else min(rates) for rates in found]
    return Target(
        f"worst transfer F1, {table.tested}", min(table.published[pair][3] for pair in crossed), least, *lowest
    )


def _found(results: PaperResults, table: SubTable, test: str, train: str) -> tuple[float, float]:
    """Return F1 of a pair with the paper's threshold and with .5; NaN where it was not tried."""
    key = table.key(PAPER, test, train)
    return results.pairs.rate(key, f1), results.pairs.scores([key]).f1()
