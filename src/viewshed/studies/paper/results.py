"""Results of the study as arrays: pooled figures, and how far they depend on which scenes were drawn.

What arXiv 2503.07375 reports, and what this study set out to reach.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import isnan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.studies.cases import Case
from viewshed.studies.paper.data import Measured
from viewshed.studies.paper.plan import StudyPlan
from viewshed.studies.paper.store import JobStore
from viewshed.studies.robustness.results import f1, precision, recall

Floats = NDArray[np.float64]

Measure = Callable[[Floats], Floats]
"""From counts (…, 4) to a figure (…)."""

DRAWS = 1000

VIEW, WEDGE, UNTOUCHED = slice(0, 4), slice(4, 8), slice(9, 13)
"""Columns of strict scores: counts in the view, in the attacker's wedge, and in that wedge with no return touched."""


def accuracy(counts: Floats) -> Floats:
    """Return the share of the cells that are called right (…); NaN where there are none.

    >>> accuracy(np.array([6.0, 2.0, 2.0, 10.0])).item()
    0.8
    """
    cells = counts.sum(axis=-1)
    right = counts[..., 0] + counts[..., 3]
    share: Floats = np.divide(right, cells, out=np.full(np.shape(cells), np.nan), where=cells > 0)
    return share


MEASURES: dict[str, Measure] = {"precision": precision, "recall": recall, "accuracy": accuracy, "F1": f1}


def interval(counts: Floats, scenes: Sequence[str], measure: Measure) -> tuple[float, float]:
    """Return the 95 % interval of a pooled measure: bootstrap over the scenes, all sweeps of one together.

    Args:
        counts: (S, 4) of each sweep.
        scenes: (S,) of each sweep.
        measure: of pooled counts.
    """
    names, place = np.unique(np.asarray(scenes, object).astype(str), return_inverse=True)
    if not len(names):
        return float("nan"), float("nan")
    pooled = np.zeros((len(names), counts.shape[1]))
    np.add.at(pooled, place, counts)
    rng = np.random.Generator(np.random.PCG64(len(names)))
    drawn = measure(rng.multinomial(len(names), np.full(len(names), 1.0 / len(names)), DRAWS) @ pooled)
    if np.isnan(drawn).all():
        return float("nan"), float("nan")
    low, high = np.nanquantile(drawn, (0.025, 0.975))
    return float(low), float(high)


@dataclass(frozen=True, slots=True)
class PairKey:
    """Whose scores on which sweeps.

    Attributes:
        protocol: of ``PROTOCOLS``.
        contestant: name of a model or of a classical estimator.
        tested: ``benign`` or ``adversarial`` sweeps.
        domain: of the sweeps.
    """

    protocol: str
    contestant: str
    tested: str
    domain: str


@dataclass(frozen=True, slots=True)
class StrictKey:
    """Whose scores under what.

    Attributes:
        domain: of the sweeps.
        case: what was done to them.
        contestant: by name.
    """

    domain: str
    case: Case
    contestant: str


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """All that the study has found so far.

    Attributes:
        store: it is from.
        pairs: what contestants say of held-out sweeps.
        scenes: of those sweeps, by protocol and domain.
        strict: (S, 13) by key, for the sweeps S that were tried; see ``VIEW``, ``WEDGE``, ``UNTOUCHED``; 8 is AUPRC.
        strict_scenes: (S,) of those sweeps, by key.
        refused: domain, case, and why it did not run, with how many sweeps that was.
        others: lines of the other steps, by step and by what names the job in it.
        models: facts of each training, by protocol and name.
        commits: of the code that did the jobs.
    """

    store: JobStore[StudyPlan]
    pairs: dict[PairKey, Measured] = field(default_factory=dict)
    scenes: dict[tuple[str, str], list[str]] = field(default_factory=dict)
    strict: dict[StrictKey, Floats] = field(default_factory=dict)
    strict_scenes: dict[StrictKey, list[str]] = field(default_factory=dict)
    refused: dict[tuple[str, Case, str], int] = field(default_factory=dict)
    others: dict[str, dict[str, dict[str, Any]]] = field(default_factory=dict)
    models: dict[tuple[str, str], dict[str, Any]] = field(default_factory=dict)
    commits: set[str] = field(default_factory=set)

    @classmethod
    def read(cls, store: JobStore[StudyPlan]) -> Results:
        """Return what is in a store; the order of its lines does not matter."""
        found, rows = cls(store), defaultdict[StrictKey, list[list[float]]](list)
        for line in sorted(store.jobs(), key=lambda line: [_sortable(name) for name in line["job"]]):
            found.commits.update(line.get("commits", ()))
            step, *names = line["job"]
            if step == "pairs":
                found._take_pairs(line, *names)
            elif step == "strict":
                found._take_strict(line, names[0], rows)
            elif step == "models":
                found.models[names[0], names[1]] = line
            else:
                found.others.setdefault(step, {})[" ".join(names)] = line
        found.strict.update({key: np.array(values, np.float64) for key, values in rows.items()})
        return found

    def _take_pairs(self, line: dict[str, Any], protocol: str, _: str, domain: str) -> None:
        self.scenes[protocol, domain] = line["scenes"]
        for name, both in line["scores"].items():
            for tested, told in both.items():
                self.pairs[PairKey(protocol, name, tested, domain)] = Measured.from_json(told)

    def _take_strict(self, line: dict[str, Any], domain: str, rows: dict[StrictKey, list[list[float]]]) -> None:
        for entry in line["cases"]:
            case = Case(*entry["case"])
            if "refused" in entry:
                reason = (domain, case, entry["refused"])
                self.refused[reason] = self.refused.get(reason, 0) + 1
            for name, values in entry.get("scores", {}).items():
                key = StrictKey(domain, case, name)
                rows[key].append([np.nan if value is None else value for value in values])
                self.strict_scenes.setdefault(key, []).append(line["scene"])

    def pooled(self, key: PairKey, measure: Measure) -> float:
        """Return a measure of all sweeps of a pair together; NaN where there are none."""
        if key not in self.pairs:
            return float("nan")
        return float(measure(self.pairs[key].counts.sum(axis=0)))

    def bounds(self, key: PairKey, measure: Measure) -> tuple[float, float]:
        """Return the 95 % interval of a pair's measure over scenes; NaN where there are no sweeps."""
        if key not in self.pairs:
            return float("nan"), float("nan")
        return interval(self.pairs[key].counts, self.scenes[key.protocol, key.domain], measure)

    def under(self, key: StrictKey, measure: Measure, columns: slice = VIEW) -> float:
        """Return a measure of all strict sweeps together, in the view or in the wedge; NaN where there are none."""
        if key not in self.strict:
            return float("nan")
        return float(measure(self.strict[key][:, columns].sum(axis=0)))

    def under_bounds(self, key: StrictKey, measure: Measure, columns: slice = VIEW) -> tuple[float, float]:
        """Return the 95 % interval of such a measure over scenes; NaN where there are no sweeps."""
        if key not in self.strict:
            return float("nan"), float("nan")
        return interval(self.strict[key][:, columns], self.strict_scenes[key], measure)

    def has_wedge(self, domain: str, case: Case) -> bool:
        """Return whether any sweep of a case has a wedge."""
        arrays = [rows for key, rows in self.strict.items() if (key.domain, key.case) == (domain, case)]
        return bool(arrays) and bool(arrays[0][:, WEDGE].sum() > 0)


def _sortable(name: str) -> tuple[int, str]:
    return int(name) if name.isdecimal() else -1, name


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

    def key(self, protocol: str, test: str, train: str) -> PairKey:
        """Return whose scores stand in a cell of the table."""
        return PairKey(protocol, f"{self.variant}-{self.trained}-{train}", self.tested, test)


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


def targets_of(results: Results) -> list[Target]:
    """Return the targets of the paper's protocol beside what was reached."""
    return [
        *_in_domain(results, BENIGN_TABLE, 0.95), *_in_domain(results, ADVERSARIAL, 0.95),
        *_in_domain(results, ADVERSARIAL_MCD, 0.94),
        _worst(results, BENIGN_TABLE, 0.90),
        _worst(results, ADVERSARIAL, 0.88),
    ]  # fmt: skip


def _in_domain(results: Results, table: SubTable, least: float) -> list[Target]:
    words = f"in-domain F1, {table.tested}{', MCD' if table.variant == 'mcd' else ''}"
    return [
        Target(f"{words}, {domain}", table.published[domain, domain][3], least, *_found(results, table, domain, domain))
        for domain in ORDER
    ]


def _worst(results: Results, table: SubTable, least: float) -> Target:
    """Return the target of the lowest F1 where training and test set differ."""
    crossed = [(test, train) for test in ORDER for train in ORDER if test != train]
    found = zip(*(_found(results, table, *pair) for pair in crossed), strict=True)
    lowest = [float("nan") if any(map(isnan, each)) else min(each) for each in found]
    return Target(
        f"worst transfer F1, {table.tested}", min(table.published[pair][3] for pair in crossed), least, *lowest
    )


def _found(results: Results, table: SubTable, test: str, train: str) -> tuple[float, float]:
    """Return F1 of a pair with the paper's threshold and with .5; NaN where it was not tried."""
    key = table.key("paper", test, train)
    half = results.pairs[key].scores.f1() if key in results.pairs else float("nan")
    return results.pooled(key, f1), half
