"""Evidence against tracks: likelihood ratios counted on benign drives, and e-values that combine them over time.

Each sweep gives three likelihood ratios of a track against *this track is honest*: that it is fabricated, that its
detections are removed, that it is moved. They compare how often a value occurs on benign drives and on the same
drives with the track put elsewhere; for the cells in a box they are weights of evidence (Good, 1985) by logistic
regression. A ratio has mean 1 on honest tracks, so it is an e-value (Vovk and Wang, 2021, arXiv 1912.06116).

Two kinds of evidence combine differently over time.

*The cells in a box* repeat the same fact: a parked car behind a hedge looks odd for as long as it stands there. Their
e-value is the geometric mean of the ratios R, weighted by exp(-age/τ):

    log E ← (1 - a) log E + a log R,  a = (1 - exp(-dt/τ)) / (1 - exp(-t/τ)) after t seconds.

It is at most the arithmetic mean of the ratios, so its mean is at most 1 however they depend on each other. Cells
reveal a forged detection. A ghost made in the sweep has the cells of a car, and is revealed by the origin of its
surface (:mod:`.before`), looked up twice. The e-value of *fabricated* is the mean of both.

*Misses and jumps* are new events. Their ratios enter the value W of an e-detector,

    W ← (W + dt/τ) · R^(dt/τ),

after Shiryaev and Roberts (Shin, Ramdas and Rinaldo, 2022, arXiv 2203.03532): an attack may begin at any time, and
ratios below 1 make W forget. Within τ seconds, ratios count once (again a geometric mean); beyond, W is an e-value only
if later evidence is independent of earlier. Drives do not guarantee that, so limits are calibrated on whole benign
drives.
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
"""Maximum of a ratio and of its inverse, because rare bins of a table are not known better."""

_BOUNDS = CELL_BOUNDS | {"range_m": (8.0, 15.0, 25.0, 35.0), "found": (0.05, 0.5, 0.85, 0.95)}
"""Bin edges of the features of a box: ``BoxCells``, and ``found``, the detection probability of an object."""

BOX_FEATURES: tuple[tuple[str, ...], ...] = (
    ("surface", "found"), ("surface", "range_m"), ("free", "range_m"), ("ring",), ("ring_free",), ("near_free",),
    ("first_m",),
)  # fmt: skip
"""Features whose bins have weights, alone or jointly."""

_VISIBLE = np.array([0.1, 0.5, 0.9])
"""Bin edges of the probability that an object in the box could be seen."""

_JUMP = np.array([0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0])
"""Bin edges of a jump in standard deviations."""

MIN_KNOWN_SHARE = 0.5
"""Minimum share of a box in known cells; with less, its cells give no evidence."""

BLIND = -1
"""Bin of a track without evidence."""


@dataclass(frozen=True, slots=True)
class EvidenceTable:
    """Counts of one kind of evidence by bin (B,), on honest and on forged tracks."""

    honest: tuple[float, ...]  # counts on benign drives
    forged: tuple[float, ...]  # counts of the same tracks put elsewhere

    def ratios(self) -> F64:
        """Return the ratio forged : honest of each bin (B,), with one pseudo-count per bin, within :data:`CAP`."""
        honest, forged = np.array(self.honest), np.array(self.forged)
        bins = len(honest)
        ratio = (forged + 1.0) / (forged.sum() + bins) * (honest.sum() + bins) / (honest + 1.0)
        return np.asarray(np.clip(ratio, 1.0 / CAP, CAP))


_FREE_BEFORE = np.array([0.2, 0.5, 0.9])
"""Bin edges of the free share of the place where a track's surface came from."""

WEIGHTS = sum(int(np.prod([len(_BOUNDS[name]) + 1 for name in names])) for names in BOX_FEATURES)
"""Number of bins of ``BOX_FEATURES``, each with a weight."""

VIEW_BINS = len(_VISIBLE) + 1
BIRTH_BINS = len(_FREE_BEFORE) + 1
JUMP_BINS = len(_JUMP) + 1


def cell_bins(cells: BoxCells, found: F64) -> Columns:
    """Return the bins (K, F) of K boxes in a model's weights, or a row of ``BLIND`` if most of a box is unknown."""
    values, bins = cells._asdict() | {"found": found}, Bins(found.shape, _BOUNDS)
    for names in BOX_FEATURES:
        bins.add(*(bins.of(name, values[name]) for name in names))
    is_known = cells.surface + cells.free + cells.hidden >= MIN_KNOWN_SHARE
    return np.where(is_known[:, None], bins.columns(), np.int32(BLIND))


def cell_ratios(weights: F64, bins: Columns) -> F64:
    """Return the ratio (K,) forged : honest of boxes with bins (K, F), by their summed weights; 1 for ``BLIND``."""
    total = weights[-1] + weights[bins].sum(axis=1)
    return np.where(bins[:, 0] == BLIND, 1.0, np.exp(np.clip(total, -np.log(CAP), np.log(CAP))))


def fit_weights(honest: Columns, forged: Columns) -> F64:
    """Return the weights (W + 1,), last the bias, fitted on bins of honest (N, F) and forged (M, F) boxes."""
    honest, forged = honest[honest[:, 0] != BLIND], forged[forged[:, 0] != BLIND]
    label = np.repeat([0.0, 1.0], [len(honest), len(forged)])
    fitted = Weights.fit(counted(np.concatenate([honest, forged]), WEIGHTS), label, evenly(label))
    return np.append(fitted.of_bins, fitted.bias)


def view_bins(visible: F64) -> NDArray[np.int64]:
    """Return the bin (K,) of each box's probability of visible."""
    return np.digitize(visible, _VISIBLE)


def birth_bins(free_before: F64) -> NDArray[np.int64]:
    """Return the bin (K,) of each free share of a place of origin, ``BLIND`` for NaN."""
    return np.where(np.isnan(free_before), BLIND, np.digitize(free_before, _FREE_BEFORE))


def jump_bins(deviations: F64) -> NDArray[np.int64]:
    """Return the bin (K,) of each jump in standard deviations, ``BLIND`` for NaN."""
    return np.where(np.isnan(deviations), BLIND, np.digitize(deviations, _JUMP))


def ratios_of(table: EvidenceTable, bins: NDArray[np.int64]) -> F64:
    """Return the ratio (K,) of each bin; 1 for ``BLIND``."""
    return np.where(bins == BLIND, 1.0, table.ratios()[bins])


def wealth_after(wealth: F64, ratios: F64, dt_s: float, block_s: float) -> F64:
    """Return the value (…,) of the e-detector after ``dt_s`` seconds with ratios (…,); ``block_s`` is its τ.

    >>> wealth_after(np.array([0.0, 3.0]), np.array([4.0, 1.0]), 0.5, 1.0).tolist()
    [1.0, 3.5]
    """
    exponent = min(dt_s / block_s, 1.0)
    return np.asarray((wealth + exponent) * np.maximum(ratios, 1e-12) ** exponent)


def mean_after(log_mean: F64, ratios: F64, dt_s: float, age_s: F64, window_s: float) -> F64:
    """Return the updated log (…,) of the geometric mean of ratios, weighted by exp(-age / ``window_s``).

    Args:
        log_mean: before, (…,).
        ratios: of this sweep, (…,).
        dt_s: seconds since the last sweep.
        age_s: seconds since the first ratio, (…,); ``dt_s`` at the first one.
        window_s: time constant of the weights.
    """
    weight_new = -np.expm1(-dt_s / window_s) / -np.expm1(-np.maximum(age_s, dt_s) / window_s)
    return np.asarray((1.0 - weight_new) * log_mean + weight_new * np.log(ratios))


@dataclass(frozen=True, slots=True)
class EvidenceModel:
    """Evidence model: weights and tables of log ratios, and the limits of e-values."""

    weights: tuple[float, ...]  # log ratios of the cells of a box, by the bins of ``BOX_FEATURES``; last the bias
    view: EvidenceTable  # by how well it could be seen
    birth: EvidenceTable  # by how free the place was where its surface came from
    jump: EvidenceTable  # by the size of its jump
    limits: tuple[float, float, float]  # e-values from which a track is accused as fabricated, removed or moved
    accused: float = 0.03  # maximum share of honest tracks that the three limits accuse together
    tracks: int = 0  # number of honest tracks behind the limits
    gone: float = 0.2  # probability that an object whose track is no longer detected has gone
    still_found: float = 0.02  # minimum probability that the detector misses a detectable object
    jump_share: float = 0.3  # probability that a moved object jumps in a given sweep
    window_s: float = 1.0  # time constant of the mean over a box's cells
    block_s: tuple[float, float] = (1.0, 0.3)  # time constants of misses and of jumps

    def save(self, path: Path) -> None:
        """Write the model as JSON, atomically."""
        write_atomic(path, (json.dumps(asdict(self), indent=1) + "\n").encode())

    @classmethod
    def load(cls, path: Path) -> Self:
        """Return the model in a file.

        Raises:
            ValueError: the file does not hold one.
            OSError: it cannot be read.
        """
        try:
            return cls.from_json(json.loads(path.read_text(encoding="utf-8")))
        except (TypeError, KeyError, AttributeError, UnicodeDecodeError) as error:
            raise ValueError(f"{path} must hold an evidence model, got something else ({error})") from error

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Self:
        """Return the model from plain values."""
        tables = {name: EvidenceTable(tuple(values[name]["honest"]), tuple(values[name]["forged"])) for name in TABLES}
        rows = {name: tuple(values[name]) for name in ("weights", "limits", "block_s")}
        others: dict[str, Any] = values | tables | rows
        return cls(**others)


TABLES = {"view": VIEW_BINS, "birth": BIRTH_BINS, "jump": JUMP_BINS}
"""Tables of a model and their numbers of bins."""


_KINDS = ("honest", "forged")


@dataclass(slots=True)
class EvidenceCounts:
    """Counts of table bins, and bins of cells, on honest and forged tracks."""

    counts: dict[str, F64] = field(
        default_factory=lambda: {f"{kind}_{name}": np.zeros(bins) for kind in _KINDS for name, bins in TABLES.items()}
    )
    cells: dict[str, list[Columns]] = field(default_factory=lambda: {kind: [] for kind in _KINDS})

    def add(self, name: str, honest: NDArray[np.int64], forged: NDArray[np.int64]) -> None:
        """Add bins of honest and of forged tracks to a table."""
        for kind, bins in zip(_KINDS, (honest, forged), strict=True):
            self.counts[f"{kind}_{name}"] += np.bincount(bins[bins != BLIND], minlength=TABLES[name])

    def table(self, name: str) -> EvidenceTable:
        """Return a table by name."""
        return EvidenceTable(*(tuple(self.counts[f"{kind}_{name}"].tolist()) for kind in _KINDS))

    def weights(self) -> tuple[float, ...]:
        """Return the fitted weights of cells; all 0 if no field of view had states."""
        if not self.cells["honest"]:
            return (0.0,) * (WEIGHTS + 1)
        return tuple(fit_weights(*(np.concatenate(self.cells[kind]) for kind in _KINDS)).tolist())

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return all counts as arrays by name, to save."""
        empty = np.zeros((0, len(BOX_FEATURES)), np.int64)
        cells = {f"{kind}_cells": np.concatenate([empty, *self.cells[kind]]).astype(np.int16) for kind in _KINDS}
        return self.counts | cells

    def add_arrays(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Add counts saved by :meth:`arrays`."""
        self.counts = {name: counts + arrays[name] for name, counts in self.counts.items()}
        for kind in _KINDS:
            if len(arrays[f"{kind}_cells"]):
                self.cells[kind].append(arrays[f"{kind}_cells"].astype(np.int32))
