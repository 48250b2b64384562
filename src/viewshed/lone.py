"""Lone returns: on the range image, no beam around them ended at a like range.

A surface that a beam meets is met by some of the beams beside it as well, unless it is thinner than the gaps between
them or seen through a hole. So a lone return is no proof of a surface, nor of a free way to it: it may be noise, rain,
light of another sensor, or a point that somebody put there. Of a benign sweep they are about one return in 200.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.missing_kernels import place
from viewshed.sweep import Sweep

ALIKE = 1.25
"""Two ranges are alike if their ratio is below this."""
BESIDE = 16
"""The return beside one in its ring is the next one at most so many columns away."""
_FULL_RING = 0.9
"""A ring with a larger share of its columns' returns is full; the median of these must not have more than ..."""
_MOST_RING = 1.05
"""... this share, or the columns are not those of the sweep. A few rings with points added do not matter."""


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """Where the returns of a sweep lie on its range image.

    Attributes:
        column: (N,) int32 azimuth column of each return, -1 where it has no ring.
        phase: (rings,) float32 where in a column the firings of a ring lie, in columns.
        counts: (rings, columns) uint8 returns of each pixel, up to 255.
        sizes: (rings,) returns of each ring.
        lone: (N,) bool, returns that none around confirms: the next ones in the ring, the six pixels above and below.
        behind: (N,) bool, lone returns behind another one of their own pixel: a beam cannot have passed that one.
    """

    column: NDArray[np.int32]
    phase: NDArray[np.float32]
    counts: NDArray[np.uint8]
    sizes: NDArray[np.int64]
    lone: NDArray[np.bool_]
    behind: NDArray[np.bool_]


def placed_by_model(sweep: Sweep, limits_m: tuple[float, float]) -> Placed | None:
    """Return the places by the sweep's rings and its sensor's columns; None without them or if they do not fit."""
    model = sweep.model
    if sweep.ring is None or model is None or len(sweep) == 0:
        return None
    found = placed(sweep.points, sweep.ring, (model.rings, model.azimuth_columns), limits_m)
    full = found.sizes[found.sizes >= _FULL_RING * model.azimuth_columns]
    return found if full.size and np.median(full) <= _MOST_RING * model.azimuth_columns else None


def placed(
    points: NDArray[np.float32], ring: NDArray[np.int16], shape: tuple[int, int], limits_m: tuple[float, float]
) -> Placed:
    """Return the places of points (N, 3) on an image of ``shape`` (rings, columns), and which of them are lone.

    A pixel confirms by its nearest return. Returns outside the ranges ``limits_m`` confirm none and are not lone.

    >>> points = np.array([[-9.0, -1, 0], [-9.0, 1, 0], [3.0, 0, 0]], np.float32)
    >>> placed(points, np.zeros(3, np.int16), (1, 4), (0.5, 100.0)).lone.tolist()
    [False, False, True]
    """
    column, phase, counts, sizes = place(points, ring, shape[1], shape[0])
    lone, behind = np.zeros(len(points), np.bool_), np.zeros(len(points), np.bool_)
    _mark(points, (ring, column), np.array(limits_m, np.float32), np.full(shape, np.inf, np.float32), (lone, behind))
    return Placed(column, phase, counts, sizes, lone, behind)


@njit(cache=True, nogil=True, error_model="numpy")
def _mark(points: Any, pixel: Any, limits: Any, nearest2: Any, marks: Any) -> None:  # pragma: no cover - compiled
    ring, column = pixel
    lone, behind = marks
    near2, far2 = limits[0] * limits[0], limits[1] * limits[1]
    away2 = np.empty(points.shape[0], np.float32)
    for n in range(points.shape[0]):
        d2 = points[n, 0] * points[n, 0] + points[n, 1] * points[n, 1] + points[n, 2] * points[n, 2]
        usable = (d2 >= near2) & (d2 <= far2) & (column[n] >= 0)
        away2[n] = d2 if usable else np.float32(-1.0)
        if usable:
            nearest2[ring[n], column[n]] = min(nearest2[ring[n], column[n]], d2)
    for n in range(points.shape[0]):
        if away2[n] >= 0.0 and _denied(nearest2, ring[n], column[n], away2[n]):
            lone[n] = True
            behind[n] = away2[n] > nearest2[ring[n], column[n]]


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _denied(nearest2: Any, r: Any, c: Any, d2: Any) -> Any:  # pragma: no cover - compiled
    """Whether there are returns around (r, c), and none of them at a range like the root of ``d2``."""
    rings, columns = nearest2.shape
    low, high = d2 / np.float32(ALIKE * ALIKE), d2 * np.float32(ALIKE * ALIKE)
    left, right = _beside(nearest2[r], c, -1), _beside(nearest2[r], c, 1)
    if _between(left, low, high) or _between(right, low, high):
        return False
    nearest = min(left, right)
    before, after = (c - 1 if c > 0 else columns - 1), (c + 1 if c + 1 < columns else 0)
    for p in range(max(r - 1, 0), min(r + 2, rings)):
        if p != r:
            one, two, three = nearest2[p, before], nearest2[p, c], nearest2[p, after]
            if _between(one, low, high) or _between(two, low, high) or _between(three, low, high):
                return False
            nearest = min(nearest, one, two, three)
    return nearest < np.inf


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _beside(row: Any, c: Any, step: Any) -> Any:  # pragma: no cover - compiled
    """Next return of a ring on one side of a column, at most ``BESIDE`` columns away, +inf for none."""
    columns = row.shape[0]
    for _ in range(BESIDE):
        c += step
        c = columns - 1 if c < 0 else (0 if c >= columns else c)
        if row[c] < np.inf:
            return row[c]
    return np.float32(np.inf)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _between(value: Any, low: Any, high: Any) -> Any:  # pragma: no cover - compiled
    return (value > low) & (value < high)
