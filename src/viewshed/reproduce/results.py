"""Results of the study as arrays: pooled figures, and how far they depend on which scenes were drawn."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.reproduce.plan import StudyPlan
from viewshed.reproduce.scoring import Measured
from viewshed.reproduce.store import JobStore
from viewshed.vulnerability.cases import Case
from viewshed.vulnerability.results import f1, precision, recall

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
