"""Lone returns: on the range image, no beam around them ended at a like range.

A surface that a beam meets is met by some of the beams beside it as well, unless it is thinner than the gaps between
them or seen through a hole. So a lone return is no proof of a surface, nor of a free way to it: it may be noise, rain,
light of another sensor, or a point that somebody put there. Of a sweep in clear air they are about one return in 200.
Where they are many, in snow, fog or under jamming, chance makes random returns alike: then several of those around a
return must confirm it, or it is clutter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed._numba import BLOCK, split
from viewshed.preprocess.range_image import place, silent_columns
from viewshed.preprocess.sensor_identification import SensorId

Floats = NDArray[np.float32]

ALIKE = 1.25
"""Two ranges are alike if their ratio is below this."""

BESIDE = 8
"""The return beside one in its ring is the next one at most so many columns away."""

_FULL_RING = 0.9
"""A ring with at least this share of its columns' returns is full; the median of these may have no more than ..."""

_MOST_RING = 1.05
"""... this share. A few rings with points added do not matter."""

USUAL_COLUMNS = 1024
"""Columns of a revolution where the sensor is not known."""

CLUTTERED = 0.02
"""A sweep with a larger share of lone returns (of a few hundred at least) is cluttered: ..."""

BY_CHANCE = 0.01
"""... so many of its random returns may be confirmed by chance, and all others are clutter."""

CONFIRMING = 1.1
"""A return confirms another one if the ratio of their ranges is below this, ..."""

_AROUND_RINGS, _AROUND_COLUMNS = 1, 4
"""... and it lies at most so many rings and columns away."""

_AROUND = (2 * _AROUND_RINGS + 1) * (2 * _AROUND_COLUMNS + 1) - 1

_LEAST_ALIKE = 2

_FEWEST = 256

_BINS = 128

_FOUND_ISOLATED = 0.6
"""About so many of the returns at random ranges are lone."""


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """Where the returns of a sweep lie on its range image.

    Attributes:
        column: (N,) int32 azimuth column of each return, -1 where it has no ring or is clutter.
        phase: (rings,) float32 where in a column the firings of a ring lie, in columns.
        counts: (rings, columns) uint8 returns of each pixel, up to 255.
        lone: (N,) bool, returns that none around confirms: the next ones in the ring, the six pixels above and below;
            and clutter.
        behind: (N,) bool, lone returns behind another one of their own pixel: a beam cannot have passed that one.
        fits: the rings are as full as those of a sensor with so many columns; else a pixel need not be a beam.
        clutter: (N,) bool, returns that too few around confirm, of a sweep with many lone ones; None for any other.
    """

    column: NDArray[np.int32]
    phase: NDArray[np.float32]
    counts: NDArray[np.uint8]
    isolated: NDArray[np.bool_]
    behind: NDArray[np.bool_]
    fits: bool
    clutter: NDArray[np.bool_] | None = None


def placed_by_rings(points: NDArray[np.float32], told: SensorId, limits_m: tuple[float, float]) -> Placed | None:
    """Return the places of points (N, 3) by their rings and their sensor's columns; None where nothing tells the rings.

    Columns somewhat too wide or too narrow still tell which returns are lone.
    """
    if told.ring is None or len(points) == 0:
        return None
    if told.model is None:
        return placed(points, told.ring, (int(told.ring.max()) + 1, USUAL_COLUMNS), limits_m)
    return placed(points, told.ring, (told.model.rings, told.model.azimuth_columns), limits_m)


def placed(
    points: NDArray[np.float32], ring: NDArray[np.int16], shape: tuple[int, int], limits_m: tuple[float, float]
) -> Placed:
    """Return the places of points (N, 3) on an image of ``shape`` (rings, columns), and which of them are lone.

    A pixel confirms by its nearest return. Returns outside the ranges ``limits_m`` confirm none and are not lone, nor
    are single ones with none around, unless in columns that hardly fired.

    >>> points = np.array([[-9.0, -3, 0], [-9.0, 3, 0], [3.0, 0, 0]], np.float32)
    >>> placed(points, np.zeros(3, np.int16), (1, 8), (0.5, 100.0)).isolated.tolist()
    [False, False, True]
    """
    column, phase, counts, sizes = place(points, ring, shape[1], shape[0])
    isolated, behind = np.zeros(len(points), np.bool_), np.zeros(len(points), np.bool_)
    nearest2, limits = np.full(shape, np.inf, np.float32), np.array(limits_m, np.float32)
    _mark(points, (ring, column), silent_columns(counts), limits, nearest2, (isolated, behind))
    full = np.sort(sizes[sizes >= _FULL_RING * shape[1]])
    fits = bool(full.size and (full[(full.size - 1) // 2] + full[full.size // 2]) / 2 <= _MOST_RING * shape[1])
    found = Placed(column, phase, counts, isolated, behind, fits)
    if len(isolated) < _FEWEST or np.count_nonzero(isolated) <= CLUTTERED * len(isolated):
        return found
    return _without_clutter(found, (points, ring), limits, nearest2)


def _without_clutter(
    found: Placed, returns: tuple[NDArray[np.float32], NDArray[np.int16]], limits: Floats, nearest2: Floats
) -> Placed:
    """Return the places without clutter.

    Returns at random ranges confirm each other by chance, and the more so the more of them have like ranges: their
    number around a return is Poisson with the mean that the lone returns tell. A return is clutter unless more confirm
    it than ``BY_CHANCE`` allows (an a contrario test, Desolneux et al. 2000).
    """
    points, ring = returns
    range_m, alike = _alike(points, (ring, found.column), limits, nearest2)
    step = np.log(np.maximum(range_m, limits[0]) / limits[0]) * np.float32(1.0 / np.log(CONFIRMING))
    bins = np.minimum(step.astype(np.intp), _BINS - 1)
    tally = np.convolve(np.bincount(bins[found.isolated], minlength=_BINS), [0.5, 1.0, 0.5], "same")
    least = _least_alike(tally * (_AROUND / (_FOUND_ISOLATED * found.counts.size)))
    clutter = (alike < least[bins]) & (found.column >= 0)
    left = taken_out(found, ring, clutter)
    isolated, behind, again = clutter.copy(), np.zeros_like(clutter), np.full_like(nearest2, np.inf)
    _mark(points, (ring, left.column), silent_columns(left.counts), limits, again, (isolated, behind))
    return replace(left, isolated=isolated, behind=behind, clutter=clutter)


def _least_alike(mean: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the least number that a Poisson variable of each mean (…) reaches with at most ``BY_CHANCE``."""
    numbers = np.arange(1, _AROUND + 1)
    terms = np.cumprod(np.concatenate([np.ones((*mean.shape, 1)), mean[..., None] / numbers], axis=-1), axis=-1)
    below = np.exp(-mean)[..., None] * np.cumsum(terms, axis=-1)  # P(N < number), from number 1 on
    least: NDArray[np.intp] = 1 + (1.0 - below > BY_CHANCE).sum(axis=-1)
    return np.maximum(least, _LEAST_ALIKE)


def taken_out(found: Placed, ring: NDArray[np.int16], out: NDArray[np.bool_]) -> Placed:
    """Return the places with these returns (N,) bool taken out of their pixels."""
    column, counts = found.column.copy(), found.counts.copy()
    _take_out(ring, out, column, counts)
    return replace(found, column=column, counts=counts)


@njit(cache=True, nogil=True, error_model="numpy")
def _take_out(ring: Any, out: Any, column: Any, counts: Any) -> None:  # pragma: no cover - compiled
    """Pixels that were full stay so: how many more returns they hold is not known."""
    full = counts == 255
    for n in range(out.shape[0]):
        if out[n] and column[n] >= 0:
            r, c = np.uint32(ring[n]), np.uint32(column[n])
            counts[r, c] -= not full[r, c]
            column[n] = -1


@njit(cache=True, nogil=True, error_model="numpy")
def _mark(
    points: Any, pixel: Any, silent: Any, limits: Any, nearest2: Any, marks: Any
) -> None:  # pragma: no cover - compiled
    ring, column = pixel
    isolated, behind = marks
    away2 = _nearest(points, pixel, limits, nearest2)
    sure = _sure(nearest2)
    for n in range(points.shape[0]):
        if away2[n] >= 0.0:
            r, c = np.uint32(ring[n]), np.uint32(column[n])
            behind_own = away2[n] > nearest2[r, c]
            if (behind_own or not sure[r, c]) and _denied(nearest2, ring[n], column[n], away2[n], silent[c]):
                isolated[n], behind[n] = True, behind_own


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest(points: Any, pixel: Any, limits: Any, nearest2: Any) -> Any:  # pragma: no cover - compiled
    """Return each point's square distance (N,), -1 where it is not usable; lower ``nearest2`` of its pixel to it."""
    ring, column = pixel
    near2, far2 = limits[0] * limits[0], limits[1] * limits[1]
    away2 = np.empty(points.shape[0], np.float32)
    x, y, z = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    for start in range(0, points.shape[0], BLOCK):
        count = split(points, start, x, y, z)
        block = slice(start, start + count)
        rings, columns, away = ring[block], column[block], away2[block]
        for k in range(count):
            d2 = x[k] * x[k] + y[k] * y[k] + z[k] * z[k]
            away[k] = d2 if (d2 >= near2) & (d2 <= far2) & (columns[k] >= 0) else np.float32(-1.0)
        for k in range(count):
            if away[k] >= 0.0:
                r, c = np.uint32(rings[k]), np.uint32(columns[k])
                nearest2[r, c] = min(nearest2[r, c], away[k])
    return away2


@njit(cache=True, nogil=True, error_model="numpy")
def _alike(points: Any, pixel: Any, limits: Any, nearest2: Any) -> Any:  # pragma: no cover - compiled
    """Return each point's range (N,), and how many pixels around its own hold a return at a like one (N,).

    Unusable points have range 0 and very many.
    """
    ring, column = pixel
    rings, columns = nearest2.shape
    near2, far2 = limits[0] * limits[0], limits[1] * limits[1]
    down, up = np.float32(1.0 / CONFIRMING**2), np.float32(CONFIRMING**2)
    range_m, alike = np.zeros(points.shape[0], np.float32), np.full(points.shape[0], 255, np.uint8)
    for n in range(points.shape[0]):
        d2 = points[n, 0] * points[n, 0] + points[n, 1] * points[n, 1] + points[n, 2] * points[n, 2]
        if d2 < near2 or d2 > far2 or column[n] < 0:
            continue
        found, r, c = 0, ring[n], column[n]
        for p in range(max(r - _AROUND_RINGS, 0), min(r + _AROUND_RINGS + 1, rings)):
            for q in range(c - _AROUND_COLUMNS, c + _AROUND_COLUMNS + 1):
                at = q + columns if q < 0 else (q - columns if q >= columns else q)
                found += (p != r or q != c) and _between(nearest2[p, at], d2 * down, d2 * up)
        range_m[n], alike[n] = np.sqrt(d2), found
    return range_m, alike


@njit(cache=True, nogil=True, error_model="numpy")
def _sure(nearest2: Any) -> Any:  # pragma: no cover - compiled
    """Return the pixels whose nearest return one of the four next to them confirms: most, and found by vectors."""
    rings, columns = nearest2.shape
    sure, none = np.zeros((rings, columns), np.bool_), np.full(columns, np.inf, np.float32)
    down, up = np.float32(1.0 / ALIKE**2), np.float32(ALIKE**2)
    for r in range(rings):
        row = nearest2[r]
        below, above = nearest2[r - 1] if r > 0 else none, nearest2[r + 1] if r + 1 < rings else none
        for c in range(1, columns - 1):
            low, high = row[c] * down, row[c] * up
            beside = _between(row[c - 1], low, high) | _between(row[c + 1], low, high)
            sure[r, c] = beside | _between(below[c], low, high) | _between(above[c], low, high)
    return sure


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _denied(nearest2: Any, r: Any, c: Any, d2: Any, alone: Any) -> Any:  # pragma: no cover - compiled
    """Whether there are returns around (r, c), and none of them at a range like the root of ``d2``.

    ``alone``: that none is alike suffices.
    """
    rings, columns = nearest2.shape
    low, high = d2 * np.float32(1.0 / ALIKE**2), d2 * np.float32(ALIKE**2)
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
    return alone or nearest < np.inf


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
