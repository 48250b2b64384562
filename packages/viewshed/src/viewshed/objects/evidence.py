"""Evidence about tracks: likelihood ratios from counts on benign drives, and the e-values that they make over time.

Each sweep gives three likelihood ratios of a track, each against *this track is honest*: that it is fabricated, that
its detections are removed, that it is moved. They are counted: how often a value is seen on benign drives, and how
often on the same drives with the track put elsewhere; of what a box holds, weights of evidence (Good, 1985) by logistic
regression. A ratio has mean 1 on honest tracks, so it is an e-value (Vovk and Wang, 2021, arXiv 1912.06116).

Over time there are two rules, for evidence about one track comes in two kinds.

*What its box holds* is the same fact again and again: a parked car behind a hedge looks odd for as long as it stands
there. Its e-value is the geometric mean of the ratios R, weighted by exp(-age/τ):

    log E ← (1 - a) log E + a log R,  a = (1 - exp(-dt/τ)) / (1 - exp(-t/τ)) after t seconds.

That is at most the arithmetic mean of the ratios, and so has mean 1 at most however they depend on each other.
What was forged as a detection is betrayed by its cells. What was made in the sweep has cells as a car has, and is
betrayed by where its surface came from (:mod:`.before`), looked up twice. The e-value of *fabricated* is the mean of
both.

*Misses and jumps* happen anew. Their ratios enter the value W of an e-detector

    W ← (W + dt/τ) · R^(dt/τ),

that of Shiryaev and Roberts (Shin, Ramdas and Rinaldo, 2022, arXiv 2203.03532): each time is a possible
beginning, ratios below 1 make it forget. Within τ seconds ratios count as one (again a geometric mean); beyond, W is an
e-value if what comes later is independent of what came before. That is more than drives give, so limits are taken from
whole benign drives.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from viewshed._files import write_atomic
from viewshed.arrays import F64
from viewshed.objects.cells import BoxCells
from viewshed.objects.log_ratios import CELL_BOUNDS, Bins, Columns, Weights, counted, evenly

CAP = 300.0
"""No ratio is above this or below its inverse: rare cells of a table are known no better."""

_BOUNDS = CELL_BOUNDS | {"range_m": (8.0, 15.0, 25.0, 35.0), "found": (0.05, 0.5, 0.85, 0.95)}
"""Bounds of the bins of what is measured about a box: of ``BoxCells``, and ``found``, P_D of an object there."""

BOX_FEATURES: tuple[tuple[str, ...], ...] = (
    ("surface", "found"), ("surface", "range_m"), ("free", "range_m"), ("ring",), ("ring_free",), ("near_free",),
    ("first_m",),
)  # fmt: skip
"""Measures whose bins have weights, alone or two together."""

_VISIBLE = np.array([0.1, 0.5, 0.9])
"""Bounds of the probability that an object in the box could be seen."""

_JUMP = np.array([0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0])
"""Bounds of a sudden move in standard deviations."""

MOSTLY = 0.5
"""Boxes of which a larger share is unknown or outside the grid: the cells say nothing of them."""

BLIND = -1
"""The bin of a track about which nothing is known."""


@dataclass(frozen=True, slots=True)
class EvidenceTable:
    """Counts of one kind of evidence by bins (B,), on honest tracks and on tracks that are not."""

    honest: tuple[float, ...]  # counts on benign drives
    forged: tuple[float, ...]  # counts of the same tracks put elsewhere

    def ratios(self) -> F64:
        """Return forged : honest of each bin (B,), each bin counted once more, within :data:`CAP`."""
        honest, forged = np.array(self.honest), np.array(self.forged)
        bins = len(honest)
        ratio = (forged + 1.0) / (forged.sum() + bins) * (honest.sum() + bins) / (honest + 1.0)
        return np.asarray(np.clip(ratio, 1.0 / CAP, CAP))


_FREE_BEFORE = np.array([0.2, 0.5, 0.9])
"""Bounds of the share of the place where a track's surface came from that was seen free."""

WEIGHTS = sum(int(np.prod([len(_BOUNDS[name]) + 1 for name in names])) for names in BOX_FEATURES)
"""Bins of ``BOX_FEATURES``, each of which has a weight."""

VIEW_BINS = len(_VISIBLE) + 1
BIRTH_BINS = len(_FREE_BEFORE) + 1
JUMP_BINS = len(_JUMP) + 1


def cell_bins(cells: BoxCells, found: F64) -> Columns:
    """Return the bins (K, F) of K boxes in a model's weights, a row of ``BLIND`` where most of a box is unknown."""
    values, bins = cells._asdict() | {"found": found}, Bins(found.shape, _BOUNDS)
    for names in BOX_FEATURES:
        bins.add(*(bins.of(name, values[name]) for name in names))
    known = cells.surface + cells.free + cells.hidden >= MOSTLY
    return np.where(known[:, None], bins.columns(), np.int32(BLIND))


def cell_ratios(weights: F64, bins: Columns) -> F64:
    """Return the ratio (K,) of forged : honest of boxes with bins (K, F): their weights add up; 1 for ``BLIND``."""
    total = weights[-1] + weights[bins].sum(axis=1)
    return np.where(bins[:, 0] == BLIND, 1.0, np.exp(np.clip(total, -np.log(CAP), np.log(CAP))))


def fit_weights(honest: Columns, forged: Columns) -> F64:
    """Return the weights (W + 1,) of bins (N, F) of honest and (M, F) of forged boxes; the last one is the bias."""
    honest, forged = honest[honest[:, 0] != BLIND], forged[forged[:, 0] != BLIND]
    label = np.repeat([0.0, 1.0], [len(honest), len(forged)])
    fitted = Weights.fit(counted(np.concatenate([honest, forged]), WEIGHTS), label, evenly(label))
    return np.append(fitted.of_bins, fitted.bias)


def view_bins(visible: F64) -> NDArray[np.int64]:
    """Return the bin (K,) of the probabilities with which boxes could be seen."""
    return np.digitize(visible, _VISIBLE)


def birth_bins(free_before: F64) -> NDArray[np.int64]:
    """Return the bin (K,) of the shares of places of birth that were seen free, ``BLIND`` where there is none (NaN)."""
    return np.where(np.isnan(free_before), BLIND, np.digitize(free_before, _FREE_BEFORE))


def jump_bins(deviations: F64) -> NDArray[np.int64]:
    """Return the bin (K,) of sudden moves in standard deviations, ``BLIND`` where there is none (NaN)."""
    return np.where(np.isnan(deviations), BLIND, np.digitize(deviations, _JUMP))


def ratios_of(table: EvidenceTable, bins: NDArray[np.int64]) -> F64:
    """Return the ratio (K,) of each bin, 1 for ``BLIND``."""
    return np.where(bins == BLIND, 1.0, table.ratios()[bins])


def wealth_after(wealth: F64, ratios: F64, dt_s: float, block_s: float) -> F64:
    """Return the value (…,) of the e-detector after ``dt_s`` seconds with ratios (…,); ``block_s`` are one evidence.

    >>> wealth_after(np.array([0.0, 3.0]), np.array([4.0, 1.0]), 0.5, 1.0).tolist()
    [1.0, 3.5]
    """
    part = min(dt_s / block_s, 1.0)
    return np.asarray((wealth + part) * np.maximum(ratios, 1e-12) ** part)


def mean_after(log_mean: F64, ratios: F64, dt_s: float, age_s: F64, window_s: float) -> F64:
    """Return the log (…,) of the geometric mean of ratios after one more, weighted by exp(-age / ``window_s``).

    Args:
        log_mean: before, (…,).
        ratios: of this sweep, (…,).
        dt_s: seconds since the one before.
        age_s: seconds since the first one, (…,), ``dt_s`` at the first one.
        window_s: after so long a ratio counts for a third.
    """
    part = -np.expm1(-dt_s / window_s) / -np.expm1(-np.maximum(age_s, dt_s) / window_s)
    return np.asarray((1.0 - part) * log_mean + part * np.log(ratios))


@dataclass(frozen=True, slots=True)
class EvidenceModel:
    """What evidence is worth, and from which e-value on a track is accused."""

    # log ratios of what the cells of a box are, by the bins of ``BOX_FEATURES``, last the bias
    weights: tuple[float, ...]
    view: EvidenceTable  # of how well it could be seen
    birth: EvidenceTable  # of how free the place was where its surface came from
    jump: EvidenceTable  # of how suddenly it moved
    limits: tuple[float, float, float]  # e-values from which a track is accused to be fabricated, removed or moved
    accused: float = 0.03  # share of honest tracks that the limits accuse at most, all three together
    tracks: int = 0  # number of honest tracks that the limits are from
    gone: float = 0.2  # probability that a track that is no longer detected is no longer there
    still_found: float = 0.02  # probability that the detector misses what it can find, at least
    jump_share: float = 0.3  # probability that a moved object jumps in a sweep
    window_s: float = 1.0  # of the mean of what a box holds
    block_s: tuple[float, float] = (1.0, 0.3)  # of misses and of jumps, seconds that count as one

    def save(self, path: Path) -> None:
        """Write it as JSON, at once or not at all."""
        write_atomic(path, (json.dumps(asdict(self), indent=1) + "\n").encode())

    @classmethod
    def load(cls, path: Path) -> Self:
        """Return the model in a file.

        Raises:
            ValueError: the file holds none.
            OSError: it cannot be read.
        """
        try:
            return cls.from_json(json.loads(path.read_text(encoding="utf-8")))
        except (TypeError, KeyError, AttributeError, UnicodeDecodeError) as error:
            raise ValueError(f"{path} must hold an evidence model, got something else ({error})") from error

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Self:
        """Return the model in plain values."""
        tables = {name: EvidenceTable(tuple(values[name]["honest"]), tuple(values[name]["forged"])) for name in TABLES}
        rows = {name: tuple(values[name]) for name in ("weights", "limits", "block_s")}
        others: dict[str, Any] = values | tables | rows
        return cls(**others)


TABLES = {"view": VIEW_BINS, "birth": BIRTH_BINS, "jump": JUMP_BINS}
"""The tables of a model and their number of bins."""


_KINDS = ("honest", "forged")


@dataclass(slots=True)
class EvidenceCounts:
    """Counts the bins of tables, and keeps those of cells: honest and forged."""

    counts: dict[str, F64] = field(
        default_factory=lambda: {f"{kind}_{name}": np.zeros(bins) for kind in _KINDS for name, bins in TABLES.items()}
    )
    cells: dict[str, list[Columns]] = field(default_factory=lambda: {kind: [] for kind in _KINDS})

    def add(self, name: str, honest: NDArray[np.int64], forged: NDArray[np.int64]) -> None:
        """Add the bins of honest and of forged tracks to a table."""
        for kind, bins in zip(_KINDS, (honest, forged), strict=True):
            self.counts[f"{kind}_{name}"] += np.bincount(bins[bins != BLIND], minlength=TABLES[name])

    def table(self, name: str) -> EvidenceTable:
        """Return one of the tables."""
        return EvidenceTable(*(tuple(self.counts[f"{kind}_{name}"].tolist()) for kind in _KINDS))

    def weights(self) -> tuple[float, ...]:
        """Return the weights of what cells say, all 0 where no field of view had states."""
        if not self.cells["honest"]:
            return (0.0,) * (WEIGHTS + 1)
        return tuple(fit_weights(*(np.concatenate(self.cells[kind]) for kind in _KINDS)).tolist())

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return all counts as arrays by name, to be kept."""
        empty = np.zeros((0, len(BOX_FEATURES)), np.int64)
        cells = {f"{kind}_cells": np.concatenate([empty, *self.cells[kind]]).astype(np.int16) for kind in _KINDS}
        return self.counts | cells

    def add_arrays(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Add counts that were kept by :meth:`arrays`."""
        self.counts = {name: counts + arrays[name] for name, counts in self.counts.items()}
        for kind in _KINDS:
            if len(arrays[f"{kind}_cells"]):
                self.cells[kind].append(arrays[f"{kind}_cells"].astype(np.int32))
