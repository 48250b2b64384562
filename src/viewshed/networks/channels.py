"""Channels: what a network may be shown of a sweep, each a map of one byte a cell.

``counts`` is the input of arXiv 2503.07375. The others are measured as the classical estimators measure them, so that a
network starts from what they know and learns what they do not: what a missing return means here, which ground to
believe, which returns to doubt.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.bev import BevGrid, polar_of_cells
from viewshed.level import OBSTACLE_HEIGHTS_M, LevelSweep
from viewshed.missing import ToldBeams, told_beams
from viewshed.past import Past
from viewshed.polar import bins_of_cells, farthest_in_bins, measured_azimuth_bins, nearest_obstacle_in_bins
from viewshed.visible import Beams, Target, returns_by_kind

HEIGHTS_M = (-2.0, 4.0)
"""Heights above local ground that ``lowest`` and ``highest`` tell apart."""
MOST_RETURNS = 127
"""Expected returns that the codes tell apart."""
FARTHEST_M = 100.0
"""Distances that ``blocker``, ``farthest`` and ``range`` tell apart."""
NO_PAST = 128
"""Code of ``supported`` without earlier sweeps: neither none of them nor all."""
_STEPS = 16
_STEPS_A_METRE = 32
Bytes = NDArray[np.uint8]
Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Shown:
    """What the channels of one sweep are made of; each part is computed when it is first asked for.

    Attributes:
        level: the sweep.
        grid: of the maps.
        target: what would have to be seen.
        counts: (cells, cells) uint8, returns of each cell as the network's card counts them.
        past: what earlier sweeps saw, or None where there are none.
    """

    level: LevelSweep
    grid: BevGrid
    target: Target
    counts: Bytes
    past: Past | None = None

    @cached_property
    def heights(self) -> tuple[Bytes, Bytes]:
        """Codes (cells, cells) of the lowest and the highest return of each cell: 0 for none, 1 to 255 upwards."""
        codes = np.zeros(self.grid.shape, np.uint8), np.zeros(self.grid.shape, np.uint8)
        lattice = np.array([*self.grid.origin_m, 1.0 / self.grid.cell_m, *HEIGHTS_M], np.float32)
        _heights(self.level.points, self.level.height_m, lattice, *codes)
        return codes

    @cached_property
    def told(self) -> ToldBeams:
        """The beams by what is known of them."""
        return told_beams(self.level, self.target.height_m)

    @cached_property
    def returns(self) -> Floats:
        """(3, cells, cells) expected returns by confirmed, explained and unexplained beams."""
        told = self.told
        return self._returns_by(told.confirmed, told.explained, told.unexplained)

    def _returns_by(self, *kinds: Beams) -> Floats:
        level = self.level
        return returns_by_kind(kinds, level.sensor_height_m, level.ground, self.grid, self.target)

    @cached_property
    def bins(self) -> int:
        """Azimuth bins."""
        return measured_azimuth_bins(self.level.azimuth)

    @cached_property
    def blocker_m(self) -> Floats:
        """(bins,) range in metres of the nearest obstacle of each azimuth bin; inf where none."""
        return nearest_obstacle_in_bins(self.level, self.bins, 1, OBSTACLE_HEIGHTS_M)

    @cached_property
    def farthest_m(self) -> Floats:
        """(bins,) range in metres of the farthest return of each azimuth bin; -1 where none."""
        return farthest_in_bins(self.level, self.bins)

    def beyond(self, limit_m: Floats) -> Bytes:
        """Return the code (cells, cells) of how far a limit (bins,) lies beyond each cell; 128 where they meet."""
        code = np.empty(self.grid.shape, np.uint8)
        _beyond(limit_m, bins_of_cells(self.grid, self.bins), polar_of_cells(self.grid)[0], *_away_table(), code)
        return code


def away_code(away_m: Floats) -> Bytes:
    """Return the code (…) of signed distances (…): 128.5, more or less their logarithm, cut to a whole number.

    >>> away_code(np.array([-np.inf, -1.0, 0.0, 1.0, np.inf], np.float32)).tolist()
    [1, 109, 128, 147, 255]
    """
    size = np.log1p(np.minimum(np.abs(away_m), np.float32(FARTHEST_M))) * np.float32(127.0 / np.log1p(FARTHEST_M))
    code: Bytes = (np.float32(128.5) + np.copysign(size, away_m)).astype(np.uint8)
    return code


@lru_cache(maxsize=1)
def _away_table() -> tuple[NDArray[np.int32], Floats]:
    """Return the code at each step of distance from -``FARTHEST_M`` on, and the distances (257,) where codes begin.

    A step is shorter than any code is wide, so that a distance has the code of its step or the next one.
    """
    ends = np.array([-FARTHEST_M, FARTHEST_M], np.float32)
    low, high = np.full(256, ends[0]), np.full(256, ends[1])
    codes = np.arange(256)
    for _ in range(64):
        middle = (low + high) / np.float32(2.0)
        reached = away_code(middle) >= codes
        low, high = np.where(reached, low, middle), np.where(reached, middle, high)
    steps = np.arange(int(2 * FARTHEST_M) * _STEPS_A_METRE + 1, dtype=np.float32) / np.float32(_STEPS_A_METRE) + ends[0]
    table = away_code(np.maximum(steps - np.float32(1e-4), ends[0])).astype(np.int32)
    return table, np.append(high, np.float32(np.inf))


def returns_code(returns: Floats) -> Bytes:
    """Return the code (…) of expected returns (…): their logarithm, 255 from ``MOST_RETURNS`` on.

    >>> returns_code(np.array([0.0, 5.0, 1000.0], np.float32)).tolist()
    [0, 94, 255]
    """
    code = np.empty(returns.shape, np.uint8)
    _looked_up(np.ascontiguousarray(returns, np.float32).reshape(-1), _returns_table(), code.reshape(-1))
    return code


@lru_cache(maxsize=1)
def _returns_table() -> Bytes:
    returns = np.arange(MOST_RETURNS * _STEPS + 1) / _STEPS
    table: Bytes = np.round(255.0 * np.log1p(returns) / np.log1p(MOST_RETURNS)).astype(np.uint8)
    return table


@lru_cache(maxsize=8)
def _range_code(grid: BevGrid) -> Bytes:
    code: Bytes = np.minimum(polar_of_cells(grid)[0] * np.float32(255.0 / FARTHEST_M), 255.0).astype(np.uint8)
    return code


def _supported(shown: Shown) -> Bytes:
    """Return the code of the share of the earlier sweeps that saw each cell: 0 to 255, 128 without any."""
    if shown.past is None:
        return np.full(shown.grid.shape, NO_PAST, np.uint8)
    share = shown.past.support(shown.grid, shown.target) * (255.0 / len(shown.past.earlier))
    code: Bytes = np.round(share).astype(np.uint8)
    return code


CHANNELS: dict[str, Callable[[Shown], Bytes]] = {
    "counts": lambda shown: shown.counts,
    "lowest": lambda shown: shown.heights[0],
    "highest": lambda shown: shown.heights[1],
    "confirmed": lambda shown: returns_code(shown.returns[0]),
    "expected": lambda shown: returns_code(shown.returns[0] + shown.returns[1]),
    "unexplained": lambda shown: returns_code(shown.returns[2]),
    "blocker": lambda shown: shown.beyond(shown.blocker_m),
    "farthest": lambda shown: shown.beyond(shown.farthest_m),
    "range": lambda shown: _range_code(shown.grid),
    "supported": _supported,
}
"""The channels by name. ``expected`` is what the shadow map counts, ``confirmed`` only the beams that returned and that
another one confirms, ``unexplained`` the beams whose end nothing tells, as if nothing stopped them; ``blocker`` and
``farthest`` tell how far the nearest obstacle and the farthest return of the azimuth lie beyond the cell.

One is of earlier sweeps: ``supported`` tells how many of them would have seen a target in the cell."""
PAST_CHANNELS = ("supported",)
"""Channels that earlier sweeps change."""


def maps_of(names: Sequence[str], shown: Shown) -> Bytes:
    """Return the maps (channels, cells, cells) of channels by their names."""
    return np.stack([CHANNELS[name](shown) for name in names])


@njit(cache=True, nogil=True, error_model="numpy")
def _heights(points: Any, height: Any, lattice: Any, lowest: Any, highest: Any) -> None:  # pragma: no cover - compiled
    x0, y0, per_m, bottom, top = lattice
    cells, scale = lowest.shape[0], np.float32(254.0) / (top - bottom)
    for n in range(points.shape[0]):
        u, v = (points[n, 0] - x0) * per_m, (points[n, 1] - y0) * per_m
        if u >= 0.0 and v >= 0.0 and u < cells and v < cells:
            i, j = int(u), int(v)
            code = np.uint8(1 + int(min(max(height[n] - bottom, np.float32(0.0)), top - bottom) * scale))
            highest[i, j] = max(highest[i, j], code)
            lowest[i, j] = code if lowest[i, j] == 0 else min(lowest[i, j], code)


@njit(cache=True, nogil=True, error_model="numpy")
def _beyond(limit_m: Any, bins: Any, range_m: Any, table: Any, begins: Any, codes: Any) -> None:  # pragma: no cover
    most, per_m = np.float32(FARTHEST_M), np.float32(_STEPS_A_METRE)
    for i in range(codes.shape[0]):
        for j in range(codes.shape[1]):
            away = limit_m[bins[i, j]] - range_m[i, j]
            near = min(max(away, -most), most)
            code = table[np.uint32((near + most) * per_m)]
            codes[i, j] = code + np.int32(near >= begins[np.uint32(code + 1)])


@njit(cache=True, nogil=True, error_model="numpy")
def _looked_up(returns: Any, table: Any, codes: Any) -> None:  # pragma: no cover - compiled
    steps, last = np.float32(_STEPS), np.float32(table.shape[0] - 1)
    for n in range(returns.shape[0]):
        codes[n] = table[np.int32(min(returns[n] * steps, last))]


def folded(maps: Bytes, fold: int) -> Bytes:
    """Return maps (channels, cells, cells) in blocks (side, side, channels · fold²), ordered by channel, row, column.

    >>> folded(np.arange(8, dtype=np.uint8).reshape(2, 2, 2), 2).tolist()
    [[[0, 1, 2, 3, 4, 5, 6, 7]]]
    """
    channels, cells = maps.shape[:2]
    side = cells // fold
    if fold not in (1, 2, 4, 8):
        blocks = maps.reshape(channels, side, fold, side, fold).transpose(1, 3, 0, 2, 4)
        return np.ascontiguousarray(blocks).reshape(side, side, -1)
    found = np.empty((side, side, channels * fold**2), np.uint8)
    word = f"u{fold}"
    _fold(np.ascontiguousarray(maps).view(word), found.view(word))
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _fold(words: Any, blocks: Any) -> None:  # pragma: no cover - compiled
    """Move what lies side by side in a row of a block at once."""
    fold = words.shape[1] // blocks.shape[0]
    for i in range(blocks.shape[0]):
        for c in range(words.shape[0]):
            for d in range(fold):
                for j in range(blocks.shape[1]):
                    blocks[i, j, c * fold + d] = words[c, i * fold + d, j]
