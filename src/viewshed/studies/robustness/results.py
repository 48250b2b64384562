"""Results of a study as arrays over samples: pooled figures, and how far they depend on which samples were drawn.

Who withstands what: losses against the same sweeps unattacked, and the rule that turns them into a verdict.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from math import isnan
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from viewshed.metrics import ConfusionCounts
from viewshed.studies.cases import BENIGN, Case
from viewshed.studies.robustness.plan import Study
from viewshed.studies.robustness.store import ResultStore, key_of
from viewshed.studies.statistics import COUNTS
from viewshed.threats.attacks import ATTACKS

Block = Literal["strict", "paper"]

Where = Literal["view", "wedge"]

Floats = NDArray[np.float64]

DRAWS = 1000

_WIDTH = 2 * COUNTS + 1

_COLUMNS: dict[Where, slice] = {"view": slice(0, COUNTS), "wedge": slice(COUNTS, 2 * COUNTS)}


@dataclass(frozen=True, slots=True)
class Key:
    """Whose scores: one estimator in one case.

    Attributes:
        domain: where the samples are from.
        block: ``strict`` or ``paper``.
        case: what was done to the sweeps.
        estimator: by name.
    """

    domain: str
    block: Block
    case: Case
    estimator: str


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """All that a study has found so far.

    Attributes:
        study: it is of.
        scores: (samples, 9) for each key: counts in the view, counts in the wedge, average precision; NaN not done.
        judged: (samples, 5) for each domain and case with a defense: see ``viewshed.studies.robustness.jobs``.
        refused: domain, case, and why it did not run, with how many samples that was.
        cell_m2: area of a cell by domain and block.
        done: jobs that are finished.
        commits: of the code that did them, as far as they are known.
    """

    study: Study
    scores: dict[Key, Floats]
    judged: dict[tuple[str, Case], Floats]
    refused: dict[tuple[str, Case, str], int]
    cell_m2: dict[tuple[str, Block], float]
    done: int
    commits: tuple[str, ...] = ()

    @classmethod
    def read(cls, store: ResultStore) -> Results:
        """Return what is in a store; the order of its lines does not matter."""
        counts = dict(zip(store.study.domains, store.study.samples, strict=True))
        blank = {domain: np.full((count, _WIDTH), np.nan) for domain, count in counts.items()}
        commits = {commit for line in store.jobs() for commit in line["about"].get("commits", ())}
        found = cls(store.study, {}, {}, {}, {}, len(store.keys()), tuple(sorted(commits)))
        for line in store.jobs():
            domain, number, part = key_of(line)
            block: Block = "paper" if part == "paper" else "strict"
            found.cell_m2[domain, block] = line["about"]["cell_m2"]
            for entry in line["cases"]:
                found._take(entry, (domain, number, block), blank[domain])
        return found

    def _take(self, entry: dict[str, Any], where: tuple[str, int, Block], blank: Floats) -> None:
        domain, number, block = where
        case = Case(*entry["case"])
        if "refused" in entry:
            reason = (domain, case, entry["refused"])
            self.refused[reason] = self.refused.get(reason, 0) + 1
        for name, values in entry.get("scores", {}).items():
            key = Key(domain, block, case, name)
            if key not in self.scores:
                self.scores[key] = blank.copy()
            self.scores[key][number] = [np.nan if value is None else value for value in values]
        if "defense" in entry:
            if (domain, case) not in self.judged:
                self.judged[domain, case] = blank[:, :5].copy()
            self.judged[domain, case][number] = [np.nan if value is None else value for value in entry["defense"]]

    @property
    def domains(self) -> list[str]:
        """Domains of which there are results, in the order of the study."""
        there = {key.domain for key in self.scores}
        return [domain for domain in self.study.domains if domain in there]

    def met(self, domain: str, kind: str) -> Results:
        """Return the results of only those samples of a domain that met a kind of case, to compare like with like."""
        of_domain = {key: values for key, values in self.scores.items() if key.domain == domain}
        there = np.zeros(0, np.bool_)
        for key, values in of_domain.items():
            if key.case.kind == kind:
                there = ~np.isnan(values[:, 0]) | (there if len(there) else np.zeros(len(values), np.bool_))
        if not len(there):
            return replace(self, scores={})
        return replace(self, scores={k: np.where(there[:, None], values, np.nan) for k, values in of_domain.items()})

    def samples(self, domain: str, block: Block = "strict") -> int:
        """Return how many samples of a domain there are results of."""
        return max((_there(v) for k, v in self.scores.items() if k.domain == domain and k.block == block), default=0)

    def tally(self, key: Key, where: Where = "view") -> ConfusionCounts:
        """Return the cells of all samples together; an empty tally where there are none."""
        values = self.scores.get(key, np.full((1, _WIDTH), np.nan))
        both, over, under, neither = (int(n) for n in np.nansum(values[:, _COLUMNS[where]], axis=0))
        area_m2 = (both + over + under + neither) * self.cell_m2.get((key.domain, key.block), 1.0)
        return ConfusionCounts(both, over, under, neither, area_m2, max(_there(values), 1))

    def each(self, key: Key, measure: Measure, where: Where = "view") -> Floats:
        """Return a measure of each sample that is there, NaN where it has none."""
        values = self.scores.get(key, np.empty((0, _WIDTH)))
        return measure(values[~np.isnan(values[:, 0]), _COLUMNS[where]])

    def areas(self, key: Key) -> Floats:
        """Return the average precision of each sample that has one."""
        values = self.scores.get(key, np.empty((0, _WIDTH)))[:, -1]
        return values[~np.isnan(values)]

    def interval(self, keys: Iterable[Key], measure: Measure, where: Where = "view") -> tuple[float, float]:
        """Return the 95 % interval of the mean over ``keys`` of a pooled measure: bootstrap over the samples.

        All keys must be of one domain. The draws are the same for all calls with as many samples.
        """
        means = [measure(_drawn(self.scores[key][:, _COLUMNS[where]])) for key in keys if key in self.scores]
        if not means:
            return float("nan"), float("nan")
        mean = np.mean(means, axis=0)
        if np.isnan(mean).all():
            return float("nan"), float("nan")
        low, high = np.nanquantile(mean, (0.025, 0.975))
        return float(low), float(high)


Measure = Callable[[Floats], Floats]
"""From counts (…, 4) to a figure (…)."""


def precision(counts: Floats) -> Floats:
    """Return the share of the claimed cells that are visible (…); NaN where none is claimed."""
    return _ratio(counts[..., 0], counts[..., 0] + counts[..., 1])


def recall(counts: Floats) -> Floats:
    """Return the share of the visible cells that are claimed (…); NaN where none is visible."""
    return _ratio(counts[..., 0], counts[..., 0] + counts[..., 2])


def f1(counts: Floats) -> Floats:
    """Return the harmonic mean of precision and recall (…); NaN where nothing is claimed and nothing visible.

    >>> f1(np.array([6.0, 2.0, 2.0, 10.0])).item()
    0.75
    """
    return _ratio(2 * counts[..., 0], 2 * counts[..., 0] + counts[..., 1] + counts[..., 2])


def _ratio(part: Floats, whole: Floats) -> Floats:
    ratio: Floats = np.divide(part, whole, out=np.full(np.shape(whole), np.nan), where=whole > 0)
    return ratio


def _there(values: Floats) -> int:
    return int((~np.isnan(values[:, 0])).sum())


def _drawn(counts: Floats) -> Floats:
    """Return (draws, 4) counts of samples drawn with replacement."""
    there = counts[~np.isnan(counts[:, 0])]
    rng = np.random.Generator(np.random.PCG64(len(there)))
    weights = rng.multinomial(len(there), np.full(len(there), 1.0 / max(len(there), 1)), DRAWS) if len(there) else 0.0
    return np.asarray(weights @ there if len(there) else np.zeros((DRAWS, COUNTS)), np.float64)


def by_name(cases: Iterable[Case]) -> dict[str, list[Case]]:
    """Return the cases of each attack or corruption, in their order."""
    found: dict[str, list[Case]] = defaultdict(list)
    for case in cases:
        found[case.name].append(case)
    return dict(found)


MODEST = 200
"""Returns that spoofers of the first years placed, and the paper's attacker."""

MAX_F1_LOSS = 0.02
"""F1 of the whole view that an estimator may lose at any budget and still withstand the attack."""

MAX_WEDGE_LOSS = 0.05
"""Precision and recall in the attacker's wedge that it may lose; of the whole view where there is no wedge."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """The worst losses of one estimator under one attack, over its budgets.

    Attributes:
        f1: loss of F1 in the whole view.
        precision: loss of precision in the wedge: what is claimed and not true.
        recall: loss of recall in the wedge: what is true and not claimed.
    """

    f1: float
    precision: float
    recall: float

    @property
    def withstands(self) -> bool:
        """Whether all losses are within the limits."""
        return self.f1 <= MAX_F1_LOSS and max(self.precision, self.recall) <= MAX_WEDGE_LOSS

    def words(self) -> str:
        """Return ``yes``, or what is lost by how much.

        >>> Verdict(0.01, 0.0, 0.04).words(), Verdict(0.03, 0.31, 0.0).words(), Verdict(0.1, 0.2, 0.3).words()
        ('yes', 'over .31', 'over .20, under .30')
        """
        if self.withstands:
            return "yes"
        losses = {"over": self.precision, "under": self.recall}
        words = [f"{word} {_hundredths(loss)}" for word, loss in losses.items() if loss > MAX_WEDGE_LOSS]
        return ", ".join(words) or f"F1 {_hundredths(self.f1)}"


def _hundredths(loss: float) -> str:
    return f"{loss:.2f}".removeprefix("0")


_UNTOUCHED = {"attack": "attack", "adaptive": "adaptive", "unaware": "adaptive"}
"""Kinds of attack that are also run with budget 0, and under which kind that is."""


def cases_against(results: Results, domain: str, name: str) -> list[Case]:
    """Return the attack's cases with a budget above 0 that there are results of, or its strengths if it has none."""
    cases = {key.case: None for key in results.scores if key.domain == domain and key.block == "strict"}
    of_name = [case for case in cases if case.name == name and not case.defense and case.level != "0"]
    return [case for case in of_name if case.kind == "attack"] or [case for case in of_name if case.kind == "strength"]


def attacks_of(results: Results, domain: str) -> list[str]:
    """Return the attacks of which there are results, in the order of the table."""
    return [name for name in ATTACKS if name in results.study.attacks and cases_against(results, domain, name)]


def has_wedge(results: Results, key: Key) -> bool:
    """Return whether there are cells in a wedge of the attack."""
    return results.tally(key, "wedge").cells > 0


def reference_of(results: Results, key: Key) -> tuple[Key, Where]:
    """Return what an attacked score is held against: the same wedge with no return touched, else the benign view."""
    before = replace(key, case=replace(key.case, kind=_UNTOUCHED.get(key.case.kind, ""), level="0"))
    if has_wedge(results, key) and has_wedge(results, before):
        return before, "wedge"
    return Key(key.domain, key.block, BENIGN, key.estimator), "view"


def verdict_of(results: Results, domain: str, name: str, estimator: str, most: int | None = None) -> Verdict:
    """Return the worst losses of an estimator under an attack, over all budgets that there are results of.

    Args:
        results: of the study.
        domain: one of its.
        name: of the attack.
        estimator: by name.
        most: returns that the attacker has at most; None for any number.
    """
    cases = [case for case in cases_against(results, domain, name) if most is None or _returns(case) <= most]
    losses = [losses_of(results, Key(domain, "strict", case, estimator)) for case in cases]
    f1, precision, recall = (max((one[k] for one in losses), default=float("nan")) for k in range(3))
    return Verdict(f1, precision, recall)


def adaptive_verdict(results: Results, domain: str, name: str, estimator: str) -> Verdict:
    """Return the losses of an estimator under an attacker who asked it, against the same wedge with nothing touched."""
    case = Case("adaptive", name, str(results.study.adaptive_budget))
    return Verdict(*losses_of(results, Key(domain, "strict", case, estimator)))


def _returns(case: Case) -> float:
    """Return the budget; strengths have none and touch no return, a full wedge has no end."""
    return 0.0 if case.kind == "strength" else float(case.level) if case.level.isdecimal() else float("inf")


def losses_of(results: Results, key: Key) -> tuple[float, float, float]:
    """Return what one case costs: F1 of the view, precision and recall in the wedge (of the view without one)."""
    before, where = reference_of(results, key)
    clean = Key(key.domain, key.block, BENIGN, key.estimator) if key.case.kind in ("attack", "strength") else before
    was, now = results.tally(before, where), results.tally(key, where)
    precision = _loss(was.precision, now.precision)  # claims nothing: nothing false
    recall = _loss(was.recall, 0.0 if isnan(now.recall) else now.recall)
    return _loss(results.tally(clean).f1, results.tally(key).f1), precision, recall


def _loss(was: float, now: float) -> float:
    return 0.0 if isnan(was) or isnan(now) else was - now
