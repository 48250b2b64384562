"""What a claim of visibility is worth: how often an honest agent reports an object where its view claims to see."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from viewshed.agents.view_checks import HEIGHTS
from viewshed.arrays import F64

EDGES = (0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98, 0.995)
"""Between these probabilities of visibility claims are alike."""

SMALL_M = 2.4
"""Objects shorter than this are people and bicycles, which give few returns."""

RANGES_M = (15.0, 30.0)
"""Nearer than the first, between both, and farther."""

_FEW = 20.0
"""A kind of claims counts as if this number more had been seen, found as often as all of their visibility."""

_FILE = "claims.json"


@dataclass(frozen=True, slots=True, eq=False)
class ClaimTable:
    """Share of the objects that honest agents report, by what their views claim before them.

    Attributes:
        found: (3, 2, ranges, bins) for sensors among the traffic, above it and on tall masts, for large and small
            objects, by range and probability.

    Raises:
        ValueError: the table has another shape, or a number is no share.
    """

    found: F64

    def __post_init__(self) -> None:
        shape = (HEIGHTS, 2, len(RANGES_M) + 1, len(EDGES) + 1)
        if self.found.shape != shape or not ((self.found >= 0) & (self.found <= 1)).all():
            raise ValueError(f"found must be shares of shape {shape}, got shape {self.found.shape}")

    def __call__(self, prob: F64, boxes: F64, range_m: F64, *, height: int) -> F64:
        """Return the chance (K,) that an honest agent reports an object in each box.

        Args:
            prob: (K,) probability that it could be seen, as the agent claims.
            boxes: (K, 7) of the objects.
            range_m: (K,) from the agent's sensor.
            height: where the sensor is: 0 among the traffic, 1 above it, 2 on a tall mast.
        """
        chance: F64 = self.found[height, _is_small(boxes), _bin(RANGES_M, range_m), _bin(EDGES, prob)]
        return chance

    @classmethod
    def fit(cls, prob: F64, boxes: F64, range_m: F64, height: Any, found: Any) -> Self:
        """Return the table of N objects before honest agents: what was claimed, and which (N,) were reported.

        A bin of few claims leans on all of its probability; shares never fall as the probability rises.
        """
        rows = (np.asarray(height, np.intp), _is_small(boxes), _bin(RANGES_M, range_m), _bin(EDGES, prob))
        shape = (HEIGHTS, 2, len(RANGES_M) + 1, len(EDGES) + 1)
        total, hits = np.zeros(shape), np.zeros(shape)
        np.add.at(total, rows, 1.0)
        np.add.at(hits, rows, np.asarray(found, np.float64))
        usual = hits.sum(axis=2, keepdims=True) / np.maximum(total.sum(axis=2, keepdims=True), 1.0)
        shares = (hits + _FEW * usual) / (total + _FEW)
        return cls(np.maximum.accumulate(shares, axis=-1))

    def to_json(self) -> str:
        """Return the table as text."""
        return (
            json.dumps({"edges": EDGES, "ranges_m": RANGES_M, "found": self.found.round(4).tolist()}, indent=1) + "\n"
        )

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Return the table in a text of :meth:`to_json`.

        Raises:
            ValueError: it has other bins.
        """
        table = json.loads(text)
        if tuple(table["edges"]) != EDGES or tuple(table["ranges_m"]) != RANGES_M:
            raise ValueError("edges and ranges_m must be those of this version; fit the claims again")
        return cls(np.array(table["found"], np.float64))


@lru_cache(maxsize=1)
def claim_table() -> ClaimTable:
    """Return the shipped table, of the default estimate and our detector (docs/results/agents.md)."""
    return ClaimTable.from_json(resources.files("viewshed.agents").joinpath(_FILE).read_text("utf-8"))


def _is_small(boxes: F64) -> NDArray[np.intp]:
    return np.asarray(boxes[:, 3:5].max(axis=1, initial=0.0) < SMALL_M, np.intp)


def _bin(edges: tuple[float, ...], values: F64) -> NDArray[np.intp]:
    return np.searchsorted(np.array(edges), values, side="right")
