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
from viewshed.blocks import BLOCK
from viewshed.level import LevelSweep
from viewshed.missing import ToldBeams, told_beams
from viewshed.networks.scan import Scan, scan
from viewshed.past import Past
from viewshed.polar import bins_of_cells
from viewshed.visible import Target, returns_by_kind

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
    def scan(self) -> Scan:
        """What one pass over the returns tells."""
        return scan(self.level, self.grid)

    @cached_property
    def told(self) -> ToldBeams:
        """The beams by what is known of them."""
        return told_beams(self.level, self.target.height_m)

    @cached_property
    def returns(self) -> Floats:
        """(3, cells, cells) expected returns by confirmed, explained and unexplained beams."""
        level, told = self.level, self.told
        kinds = told.confirmed, told.explained, told.unexplained
        return returns_by_kind(kinds, level.sensor_height_m, level.ground, self.grid, self.target)

    @cached_property
    def codes(self) -> Bytes:
        """(3, cells, cells) codes of the returns expected by confirmed, by told (also explained) and by other beams."""
        codes = np.empty(self.returns.shape, np.uint8)
        _codes(self.returns.reshape(3, -1), _returns_table(), codes.reshape(3, -1))
        return codes

    def beyond(self, limit_m: Floats) -> Bytes:
        """Return the code (cells, cells) of how far a limit (bins,) lies beyond each cell; 128 where they meet."""
        code, bins = np.empty(self.grid.shape, np.uint8), bins_of_cells(self.grid, self.scan.bins)
        flat = bins.reshape(-1), polar_of_cells(self.grid)[0].reshape(-1)
        _beyond(limit_m, *flat, *_away_table(), code.reshape(-1))
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
def _away_table() -> tuple[Bytes, Floats]:
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
    return away_code(np.maximum(steps - np.float32(1e-4), ends[0])), np.append(high, np.float32(np.inf))


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
    "lowest": lambda shown: shown.scan.lowest,
    "highest": lambda shown: shown.scan.highest,
    "confirmed": lambda shown: shown.codes[0],
    "expected": lambda shown: shown.codes[1],
    "unexplained": lambda shown: shown.codes[2],
    "blocker": lambda shown: shown.beyond(shown.scan.blocker_m),
    "farthest": lambda shown: shown.beyond(shown.scan.farthest_m),
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
    maps = np.empty((len(names), *shown.grid.shape), np.uint8)
    for name, found in zip(names, maps, strict=True):
        found[:] = CHANNELS[name](shown)
    return maps


@njit(cache=True, nogil=True, error_model="numpy")
def _beyond(limit_m: Any, bins: Any, range_m: Any, table: Any, begins: Any, codes: Any) -> None:  # pragma: no cover
    """By blocks: what is calculated vectorizes, what is looked up does not."""
    most, per_m = np.float32(FARTHEST_M), np.float32(_STEPS_A_METRE)
    away, step = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.int32)
    for start in range(0, codes.shape[0], BLOCK):
        block = slice(start, min(start + BLOCK, codes.shape[0]))
        some, ranges, found = bins[block], range_m[block], codes[block]
        for k in range(found.shape[0]):
            away[k] = limit_m[np.uint32(some[k])]
        for k in range(found.shape[0]):
            away[k] = min(max(away[k] - ranges[k], -most), most)
            step[k] = np.int32((away[k] + most) * per_m)
        for k in range(found.shape[0]):
            code = np.uint32(table[np.uint32(step[k])])
            found[k] = code + np.uint32(away[k] >= begins[code + np.uint32(1)])


@njit(cache=True, nogil=True, error_model="numpy")
def _codes(returns: Any, table: Any, codes: Any) -> None:  # pragma: no cover - compiled
    both = np.empty(BLOCK, np.float32)
    for start in range(0, returns.shape[1], BLOCK):
        block = slice(start, min(start + BLOCK, returns.shape[1]))
        confirmed, explained = returns[0, block], returns[1, block]
        for k in range(confirmed.shape[0]):
            both[k] = confirmed[k] + explained[k]
        _looked_up(confirmed, table, codes[0, block])
        _looked_up(both[: confirmed.shape[0]], table, codes[1, block])
        _looked_up(returns[2, block], table, codes[2, block])


@njit(cache=True, nogil=True, error_model="numpy")
def _looked_up(returns: Any, table: Any, codes: Any) -> None:  # pragma: no cover - compiled
    steps, last = np.float32(_STEPS), np.float32(table.shape[0] - 1)
    for n in range(returns.shape[0]):
        codes[n] = table[np.uint32(np.int32(min(returns[n] * steps, last)))]


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


@njit(cache=True, nogil=True, error_model="numpy")
def recode(blocks: Any, table: Any) -> None:  # pragma: no cover - compiled
    """Replace each byte of blocks (side, side, size) by what a table (256,) has for it."""
    for i in range(blocks.shape[0]):
        for j in range(blocks.shape[1]):
            for k in range(blocks.shape[2]):
                blocks[i, j, k] = table[blocks[i, j, k]]
