"""Isolated returns: no neighboring pixel of the range image has a similar range (ratio < 1.25).

A surface that a beam meets is met by some of the beams beside it as well, unless it is thinner than the gaps between
them or seen through a hole. So an isolated return proves neither a surface nor a free way to it: it may be noise, rain,
light of another sensor, or a point that somebody put there. Of a sweep in clear air they are about one return in 200.
Where they are many, in snow, fog or under jamming, chance makes random returns similar: then several of those around a
return must confirm it, or it is clutter.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

SIMILAR = 1.25
"""Two ranges are similar if their ratio is below this."""

NEIGHBOR_COLUMNS = 8
"""The neighbor of a return in its ring is the next one, at most so many columns away."""

CLUTTERED_SHARE = 0.02
"""A sweep with a larger share of isolated returns (of a few hundred at least) is cluttered: ..."""

CHANCE = 0.01
"""... so many of its random returns may be confirmed by chance, and all others are clutter."""

CONFIRMING = 1.1
"""A return confirms another one if the ratio of their ranges is below this, ..."""

_WINDOW_RINGS, _WINDOW_COLUMNS = 1, 4
"""... and it lies at most so many rings and columns away."""

_WINDOW_PIXELS = (2 * _WINDOW_RINGS + 1) * (2 * _WINDOW_COLUMNS + 1) - 1

_LEAST_CONFIRMATIONS = 2

_FEWEST_RETURNS = 256

_RANGE_BINS = 128

_ISOLATED_OF_RANDOM = 0.6
"""About this share of the returns at random ranges is isolated."""

Floats = NDArray[np.float32]

Mask = NDArray[np.bool_]


def is_cluttered(isolated: Mask) -> bool:
    """Return whether so many of the returns (N,) are isolated that chance makes others similar."""
    return len(isolated) >= _FEWEST_RETURNS and int(np.count_nonzero(isolated)) > CLUTTERED_SHARE * len(isolated)


def find_clutter(
    ring: NDArray[np.int16], column: NDArray[np.int32], squared_m2: Floats, nearest_m2: Floats, isolated: Mask,
    near_m: float,
) -> Mask:  # fmt: skip
    """Return which returns (N,) of a cluttered sweep too few pixels around confirm.

    Returns at random ranges confirm each other by chance, and the more so the more of them have similar ranges: their
    number around a return is Poisson, and its mean follows from the isolated returns. A return is clutter unless more
    confirm it than ``CHANCE`` allows (an a contrario test, Desolneux et al. 2000).

    Args:
        ring: (N,) row of each return on the range image.
        column: (N,) column of each return, -1 where it has no pixel.
        squared_m2: (N,) squared distance of each return, -1 where it is not used.
        nearest_m2: (rings, columns) the least of each pixel, +inf for none.
        isolated: (N,) isolated returns.
        near_m: nearest range that is used.
    """
    range_m, confirmations = _count_confirmations(ring, column, squared_m2, nearest_m2)
    # Isolated returns by logarithmic bins of range, each as wide as two returns that confirm each other may differ.
    step = np.log(np.maximum(range_m, np.float32(near_m)) / np.float32(near_m)) * np.float32(1.0 / np.log(CONFIRMING))
    bins = np.minimum(step.astype(np.intp), _RANGE_BINS - 1)
    similar = np.convolve(np.bincount(bins[isolated], minlength=_RANGE_BINS), [0.5, 1.0, 0.5], "same")
    # The mean number of random returns of similar range in a window of pixels.
    least = _least_confirmations(similar * (_WINDOW_PIXELS / (_ISOLATED_OF_RANDOM * nearest_m2.size)))
    clutter: Mask = (confirmations < least[bins]) & (column >= 0)
    return clutter


def _least_confirmations(mean: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the least number that a Poisson variable of each mean (…) reaches with at most ``CHANCE``."""
    numbers = np.arange(1, _WINDOW_PIXELS + 1)
    terms = np.cumprod(np.concatenate([np.ones((*mean.shape, 1)), mean[..., None] / numbers], axis=-1), axis=-1)
    below = np.exp(-mean)[..., None] * np.cumsum(terms, axis=-1)  # P(N < number), from number 1 on
    least: NDArray[np.intp] = 1 + (1.0 - below > CHANCE).sum(axis=-1)
    return np.maximum(least, _LEAST_CONFIRMATIONS)


@njit(cache=True, nogil=True, error_model="numpy")
def find_isolated_returns(
    ring: Any, column: Any, squared_m2: Any, nearest_m2: Any, silent: Any
) -> Any:  # pragma: no cover - compiled
    """Return the isolated returns (N,), and those of them behind another return of their own pixel (N,).

    A pixel confirms by its nearest return. A return around which nothing returned is not isolated, unless its column
    is ``silent`` (columns,): hardly fired.
    """
    isolated, behind = np.zeros(ring.shape[0], np.bool_), np.zeros(ring.shape[0], np.bool_)
    confirmed = _confirmed_pixels(nearest_m2)
    for n in range(ring.shape[0]):
        if squared_m2[n] >= 0.0:
            r, c = np.uint32(ring[n]), np.uint32(column[n])
            behind_own = squared_m2[n] > nearest_m2[r, c]
            # Most returns are the nearest of a pixel that vectors have already confirmed.
            if (behind_own or not confirmed[r, c]) and _is_isolated(
                nearest_m2, ring[n], column[n], squared_m2[n], silent[c]
            ):
                isolated[n], behind[n] = True, behind_own
    return isolated, behind


@njit(cache=True, nogil=True, error_model="numpy")
def _confirmed_pixels(nearest_m2: Any) -> Any:  # pragma: no cover - compiled
    """Return the pixels whose nearest return one of the four beside them confirms: most of all, found by vectors."""
    rings, columns = nearest_m2.shape
    confirmed, none = np.zeros((rings, columns), np.bool_), np.full(columns, np.inf, np.float32)
    down, up = np.float32(1.0 / SIMILAR**2), np.float32(SIMILAR**2)
    for r in range(rings):
        row = nearest_m2[r]
        below, above = nearest_m2[r - 1] if r > 0 else none, nearest_m2[r + 1] if r + 1 < rings else none
        for c in range(1, columns - 1):
            low, high = row[c] * down, row[c] * up
            in_ring = _between(row[c - 1], low, high) | _between(row[c + 1], low, high)
            confirmed[r, c] = in_ring | _between(below[c], low, high) | _between(above[c], low, high)
    return confirmed


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _is_isolated(nearest_m2: Any, r: Any, c: Any, d2: Any, silent: Any) -> Any:  # pragma: no cover - compiled
    """Whether there are returns around (r, c), and none of them at a range similar to the root of ``d2``.

    In a ``silent`` column it suffices that none is similar.
    """
    rings, columns = nearest_m2.shape
    low, high = d2 * np.float32(1.0 / SIMILAR**2), d2 * np.float32(SIMILAR**2)
    # The next return on either side in the ring.
    left, right = _next_in_ring(nearest_m2[r], c, -1), _next_in_ring(nearest_m2[r], c, 1)
    if _between(left, low, high) or _between(right, low, high):
        return False
    nearest = min(left, right)
    # The three pixels of the ring below and of the ring above; the image closes around the circle.
    before, after = (c - 1 if c > 0 else columns - 1), (c + 1 if c + 1 < columns else 0)
    for p in range(max(r - 1, 0), min(r + 2, rings)):
        if p != r:
            one, two, three = nearest_m2[p, before], nearest_m2[p, c], nearest_m2[p, after]
            if _between(one, low, high) or _between(two, low, high) or _between(three, low, high):
                return False
            nearest = min(nearest, one, two, three)
    return silent or nearest < np.inf


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _next_in_ring(row: Any, c: Any, step: Any) -> Any:  # pragma: no cover - compiled
    """Next return of a ring on one side of a column, at most ``NEIGHBOR_COLUMNS`` columns away, +inf for none."""
    columns = row.shape[0]
    for _ in range(NEIGHBOR_COLUMNS):
        c += step
        c = columns - 1 if c < 0 else (0 if c >= columns else c)
        if row[c] < np.inf:
            return row[c]
    return np.float32(np.inf)


@njit(cache=True, nogil=True, error_model="numpy")
def _count_confirmations(ring: Any, column: Any, squared_m2: Any, nearest_m2: Any) -> Any:  # pragma: no cover
    """Return each return's range (N,), and how many pixels in the window around its own confirm it (N,) uint8.

    Returns that are not used have range 0 and 255 confirmations.
    """
    rings, columns = nearest_m2.shape
    down, up = np.float32(1.0 / CONFIRMING**2), np.float32(CONFIRMING**2)
    range_m, confirmations = np.zeros(ring.shape[0], np.float32), np.full(ring.shape[0], 255, np.uint8)
    for n in range(ring.shape[0]):
        d2 = squared_m2[n]
        if d2 < 0.0:
            continue
        count, r, c = 0, ring[n], column[n]
        for p in range(max(r - _WINDOW_RINGS, 0), min(r + _WINDOW_RINGS + 1, rings)):
            for q in range(c - _WINDOW_COLUMNS, c + _WINDOW_COLUMNS + 1):
                at = q + columns if q < 0 else (q - columns if q >= columns else q)
                count += (p != r or q != c) and _between(nearest_m2[p, at], d2 * down, d2 * up)
        range_m[n], confirmations[n] = np.sqrt(d2), count
    return range_m, confirmations


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _between(value: Any, low: Any, high: Any) -> Any:  # pragma: no cover - compiled
    return (value > low) & (value < high)
