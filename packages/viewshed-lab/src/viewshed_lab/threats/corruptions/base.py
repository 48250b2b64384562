"""The role of a corruption, and what several of them need: which rows lie above the ground, moves along the ray."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F32
from viewshed.grid import BevGrid
from viewshed.preprocess.leveling import level
from viewshed.sweep import Sweep

NEAREST_M = 0.05
"""A return that is moved along its ray stays at least this far from the sensor."""

_EXTENT = BevGrid(256, 64.0)


class Corruption(Protocol):
    """Anything benign that degrades a sweep. The clean sweep is never modified; the same generator, the same bytes."""

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return the worse sweep: rows are removed or moved, never added, and keep their order and other columns."""
        ...


@runtime_checkable
class InTheWorld(Corruption, Protocol):
    """A corruption by things that stand in the world: seen from elsewhere, they are where they were."""

    def place(self, sweep: Sweep, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return where the things stand (K, 3), in the sensor's frame of a sweep."""
        ...

    def apply_at(self, sweep: Sweep, places: NDArray[np.float64], rng: np.random.Generator) -> Sweep:
        """Return a sweep with the things at ``places`` (K, 3) in its sensor's frame."""
        ...


def ranges_of(sweep: Sweep) -> F32:
    """Return the range of each return (N,) float32 from the sensor's origin, in meters.

    >>> ranges_of(Sweep(np.array([[3.0, 4.0, 12.0]]))).tolist()
    [13.0]
    """
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", sweep.points, sweep.points)), np.float32)


def at_ranges(sweep: Sweep, range_m: NDArray[np.floating[Any]]) -> Sweep:
    """Return ``sweep`` with each return moved along its ray to ``range_m`` (N,) meters; one at the origin stays there.

    >>> at_ranges(Sweep(np.array([[0.0, 2.0, 0.0]])), np.array([3.0])).points.tolist()
    [[0.0, 3.0, 0.0]]
    """
    before = ranges_of(sweep)
    factor = np.where(before > 0, np.maximum(range_m, NEAREST_M) / np.maximum(before, 1e-12), 1.0)
    return sweep.replace(points=sweep.points * factor[:, None].astype(np.float32))


def heights_of(sweep: Sweep) -> F32:
    """Return the height of each return (N,) float32 above local ground in meters; NaN for null and ego returns."""
    heights = np.full(len(sweep), np.nan, np.float32)
    if len(sweep):
        leveled = level(sweep, _EXTENT)
        heights[leveled.rows] = leveled.height_m
    return heights
