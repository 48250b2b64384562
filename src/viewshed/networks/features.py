"""Features: maps of one byte a cell, computed from a leveled sweep, that a network takes as input.

``counts`` is the input of arXiv 2503.07375. The others are measured as the classical estimators measure them, so that a
network starts from what they know and learns what they do not: what a missing return means here, which ground to
believe, which returns to doubt.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed._numba import BLOCK, split
from viewshed.fov.height_map import HeightMap, positions_of_cells
from viewshed.fov.visibility import Target
from viewshed.grid import BevGrid, polar_of_cells
from viewshed.preprocess.azimuth_bins import (
    BINS_LADDER,
    bins_filled,
    bins_of_cells,
    farthest_in_bins,
    nearest_obstacle_in_bins,
)
from viewshed.preprocess.evidence import BeamEvidence, beam_evidence
from viewshed.preprocess.history import History
from viewshed.preprocess.leveling import OBSTACLE_HEIGHTS_M, LeveledSweep

HEIGHTS_M = (-2.0, 4.0)
"""Heights above local ground that ``lowest`` and ``highest`` resolve."""

EVIDENCE_BINS = 360
"""Azimuth bins in which returns are counted."""

_BINS = BINS_LADDER[0]

_EXACT_BINS = (1080, 540, 360, 180, 120)
"""Bins that are the same whether computed from azimuths or from the narrowest bins; edges of others are rounded."""

Bytes = NDArray[np.uint8]

Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class CellStatistics:
    """Statistics of the returns of a leveled sweep, by cell and by azimuth.

    Attributes:
        lowest: (cells, cells) code of the lowest return of each cell: 0 for none, 1 to 255 upwards.
        highest: (cells, cells) code of the highest one.
        obstacle: (cells, cells) bool, as :meth:`viewshed.preprocess.leveling.LeveledSweep.obstacle_cells`.
        returns: (EVIDENCE_BINS,) returns of each azimuth bin.
        bins: azimuth bins that the returns fill, as :func:`viewshed.preprocess.azimuth_bins.measured_azimuth_bins`.
        blocker_m: (bins,) range in meters of the nearest obstacle of each azimuth bin; inf where none.
        farthest_m: (bins,) range in meters of the farthest return of each azimuth bin; -1 where none.
    """

    lowest: Bytes
    highest: Bytes
    obstacle: NDArray[np.bool_]
    returns: NDArray[np.int32]
    bins: int
    blocker_m: Floats
    farthest_m: Floats


def cell_statistics(leveled: LeveledSweep, grid: BevGrid) -> CellStatistics:
    """Return the statistics of the returns of a leveled sweep on ``grid``, in one pass over them."""
    x0_m, y0_m, cells_per_m = np.array([*grid.origin_m, 1.0 / grid.cell_m], np.float32)
    low_m, high_m, obstacle_low_m, obstacle_high_m = np.array([*HEIGHTS_M, *OBSTACLE_HEIGHTS_M], np.float32)
    # Each kernel's arrays have one cell more than the grid: the last one takes the returns outside.
    last = grid.cells**2
    lowest, highest = np.zeros(last + 1, np.uint8), np.zeros(last + 1, np.uint8)
    obstacle, returns = np.zeros(last + 1, np.bool_), np.zeros(_BINS, np.int32)
    nearest_m, farthest_m = np.full(_BINS, np.inf, np.float32), np.full(_BINS, -1.0, np.float32)
    _cell_statistics(
        leveled.points, leveled.range_m, leveled.azimuth, leveled.height_m, x0_m, y0_m, cells_per_m,
        np.float32(grid.cells), low_m, high_m, obstacle_low_m, obstacle_high_m, lowest, highest, obstacle, returns,
        nearest_m, farthest_m,
    )  # fmt: skip
    # From the narrowest azimuth bins to those that the returns fill.
    bins = bins_filled(returns > 0)
    if bins in _EXACT_BINS:
        shape = bins, _BINS // bins
        blocker_m, farthest_m = nearest_m.reshape(shape).min(axis=1), farthest_m.reshape(shape).max(axis=1)
    else:
        blocker_m = nearest_obstacle_in_bins(leveled, bins, 1, OBSTACLE_HEIGHTS_M)
        farthest_m = farthest_in_bins(leveled, bins)
    counts = returns.reshape(EVIDENCE_BINS, -1).sum(axis=1, dtype=np.int32)
    return CellStatistics(
        lowest[:-1].reshape(grid.shape),
        highest[:-1].reshape(grid.shape),
        obstacle[:-1].reshape(grid.shape),
        counts,
        bins,
        blocker_m,
        farthest_m,
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _cell_statistics(
    points: Any,
    range_m: Any,
    azimuth: Any,
    height_m: Any,
    x0_m: Any,
    y0_m: Any,
    cells_per_m: Any,
    side: Any,
    low_m: Any,
    high_m: Any,
    obstacle_low_m: Any,
    obstacle_high_m: Any,
    lowest: Any,
    highest: Any,
    obstacle: Any,
    returns: Any,
    nearest_m: Any,
    farthest_m: Any,
) -> None:  # pragma: no cover - compiled
    """Write codes of the lowest and highest return and obstacles by cell, returns and ranges by azimuth bin.

    In blocks: what is calculated vectorizes and stays at hand, what is looked up does not.
    """
    x, y, z = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    cell, bearing, code = np.empty(BLOCK, np.int32), np.empty(BLOCK, np.int32), np.empty(BLOCK, np.uint8)
    for start in range(0, points.shape[0], BLOCK):
        count = split(points, start, x, y, z)
        block = slice(start, start + count)
        ranges, highs = range_m[block], height_m[block]
        _write_cells(x[:count], y[:count], x0_m, y0_m, cells_per_m, side, cell)
        _write_bins_and_heights(azimuth[block], highs, low_m, high_m, bearing, code)
        for k in range(count):
            c, b = np.uint32(cell[k]), np.uint32(bearing[k])
            highest[c] = max(highest[c], code[k])
            lowest[c] = max(lowest[c], np.uint8(-code[k]))  # 256 less the code, so that 0 is none here as well
            returns[b] += 1
            farthest_m[b] = max(farthest_m[b], ranges[k])
            if obstacle_low_m < highs[k] < obstacle_high_m:
                obstacle[c] = True
                nearest_m[b] = min(nearest_m[b], ranges[k])
    for k in range(lowest.shape[0] - 1):
        lowest[k] = np.uint8(-lowest[k])


@njit(cache=True, nogil=True, error_model="numpy")
def _write_cells(
    x: Any, y: Any, x0_m: Any, y0_m: Any, cells_per_m: Any, side: Any, cell: Any
) -> None:  # pragma: no cover - compiled
    """Write the cell of each point of a block, cells · cells outside."""
    none = np.float32(0.0)
    for k in range(x.shape[0]):
        u, v = (x[k] - x0_m) * cells_per_m, (y[k] - y0_m) * cells_per_m
        inside = (u >= none) & (v >= none) & (u < side) & (v < side)
        i, j = np.int32(u if inside else side), np.int32(v if inside else none)
        cell[k] = i * np.int32(side) + j


@njit(cache=True, nogil=True, error_model="numpy")
def _write_bins_and_heights(
    azimuth: Any, height_m: Any, low_m: Any, high_m: Any, bearing: Any, code: Any
) -> None:  # pragma: no cover - compiled
    """Write the azimuth bin of each point of a block, and the code of its height."""
    scale = np.float32(254.0) / (high_m - low_m)
    for k in range(azimuth.shape[0]):
        position = (np.float64(azimuth[k]) + np.pi) * (_BINS / (2.0 * np.pi))
        bearing[k] = min(max(np.int32(position), np.int32(0)), np.int32(_BINS - 1))
    for k in range(azimuth.shape[0]):
        code[k] = 1 + np.int32(min(max(height_m[k] - low_m, np.float32(0.0)), high_m - low_m) * scale)


MOST_RETURNS = 127
"""Expected returns that the codes resolve."""

FARTHEST_M = 100.0
"""Distances that ``blocker``, ``farthest`` and ``range`` resolve."""

NO_HISTORY = 128
"""Code of ``confirmations`` without earlier sweeps: neither none of them nor all."""

LEAST_STD_M, MOST_STD_M = 0.05, 5.0
"""Standard deviations of the ground that ``ground_std`` resolves."""

_STEPS = 16

_STEPS_A_METER = 32


@dataclass(frozen=True, eq=False)
class FeatureContext:
    """What the features of one sweep are computed from; each part is computed when it is first read.

    Attributes:
        leveled: the sweep.
        grid: of the maps.
        target: what would have to be seen.
        counts: (cells, cells) uint8, returns of each cell as the network's card counts them.
        history: what earlier sweeps saw, or None where there are none.
    """

    leveled: LeveledSweep
    grid: BevGrid
    target: Target
    counts: Bytes
    history: History | None = None

    @cached_property
    def statistics(self) -> CellStatistics:
        """Statistics of the returns, by cell and by azimuth."""
        return cell_statistics(self.leveled, self.grid)

    @cached_property
    def evidence(self) -> BeamEvidence:
        """What the beams say about a target in each cell, with what earlier sweeps saw."""
        return beam_evidence(self.leveled, self.grid, self.target, self.history)

    @cached_property
    def returns(self) -> Floats:
        """(3, cells, cells) expected returns by measured, inferred and unresolved beams, of this sweep alone."""
        evidence = beam_evidence(self.leveled, self.grid, self.target)
        return np.stack([evidence.measured, evidence.inferred, evidence.unresolved])

    @cached_property
    def codes(self) -> Bytes:
        """(3, cells, cells) codes of the returns by measured, by measured and inferred, and by unresolved beams."""
        codes = np.empty(self.returns.shape, np.uint8)
        _write_beam_codes(self.returns.reshape(3, -1), _returns_table(), codes.reshape(3, -1))
        return codes

    def beyond(self, limit_m: Floats) -> Bytes:
        """Return the code (cells, cells) of how far a limit (bins,) lies beyond each cell; 128 where they meet."""
        code, bins = np.empty(self.grid.shape, np.uint8), bins_of_cells(self.grid, self.statistics.bins)
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
    steps = np.arange(int(2 * FARTHEST_M) * _STEPS_A_METER + 1, dtype=np.float32) / np.float32(_STEPS_A_METER) + ends[0]
    return away_code(np.maximum(steps - np.float32(1e-4), ends[0])), np.append(high, np.float32(np.inf))


def returns_code(returns: Floats) -> Bytes:
    """Return the code (…) of expected returns (…): their logarithm, 255 from ``MOST_RETURNS`` on.

    >>> returns_code(np.array([0.0, 5.0, 1000.0], np.float32)).tolist()
    [0, 94, 255]
    """
    code = np.empty(returns.shape, np.uint8)
    _look_up(np.ascontiguousarray(returns, np.float32).reshape(-1), _returns_table(), code.reshape(-1))
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


def _confirmations_code(context: FeatureContext) -> Bytes:
    """Return the code of the share of the earlier sweeps that saw each cell: 0 to 255, 128 without any."""
    history = context.history
    if history is None:
        return np.full(context.grid.shape, NO_HISTORY, np.uint8)
    share = history.confirmations(context.grid, context.target) * (255.0 / len(history.earlier))
    code: Bytes = np.round(share).astype(np.uint8)
    return code


def _prob_code(prob: Floats) -> Bytes:
    """Return the code of probabilities (…): 0 to 255, with 0.5 between two codes."""
    code: Bytes = (prob * np.float32(255.0)).astype(np.uint8)
    return code


def _std_code(ground: HeightMap, grid: BevGrid) -> Bytes:
    """Return the code of the ground's standard deviation in each cell: its logarithm, 255 from ``MOST_STD_M`` on."""
    size = np.log1p(np.minimum(ground.std_m, np.float32(MOST_STD_M)) * np.float32(1.0 / LEAST_STD_M))
    # The logarithm at the nodes, which are fewer than the cells, and bilinear in between.
    at_nodes = replace(ground, heights_m=size * np.float32(255.0 / np.log1p(MOST_STD_M / LEAST_STD_M)))
    code: Bytes = at_nodes.at_positions(positions_of_cells(grid, ground.half_extent_m, len(size))).astype(np.uint8)
    return code


FEATURES: dict[str, Callable[[FeatureContext], Bytes]] = {
    "counts": lambda context: context.counts,
    "lowest": lambda context: context.statistics.lowest,
    "highest": lambda context: context.statistics.highest,
    "measured": lambda context: context.codes[0],
    "expected": lambda context: context.codes[1],
    "unresolved": lambda context: context.codes[2],
    "blocker": lambda context: context.beyond(context.statistics.blocker_m),
    "farthest": lambda context: context.beyond(context.statistics.farthest_m),
    "range": lambda context: _range_code(context.grid),
    "confirmations": _confirmations_code,
    "shadow_map": lambda context: _prob_code(context.evidence.visible_prob),
    "ground_std": lambda context: _std_code(context.leveled.ground, context.grid),
}
"""The features by name. ``measured`` counts the expected returns of beams that returned and that are not isolated;
``expected`` those of measured and inferred beams, as the shadow map does; ``unresolved`` those of the beams whose depth
is not known, as if nothing stopped them. ``blocker`` and ``farthest`` are how far the nearest obstacle and the farthest
return of the azimuth lie beyond the cell. ``confirmations`` is the share of the earlier sweeps that would have seen a
target in the cell. ``shadow_map`` is the probability by measured and inferred beams that end at the obstacles of
earlier sweeps; ``ground_std`` the standard deviation of the ground's height."""

HISTORY_FEATURES = ("confirmations", "shadow_map")
"""Features that earlier sweeps change."""


def feature_maps(names: Sequence[str], context: FeatureContext) -> Bytes:
    """Return the maps (features, cells, cells) of features by their names."""
    maps = np.empty((len(names), *context.grid.shape), np.uint8)
    for name, out in zip(names, maps, strict=True):
        out[:] = FEATURES[name](context)
    return maps


@njit(cache=True, nogil=True, error_model="numpy")
def _beyond(limit_m: Any, bins: Any, range_m: Any, table: Any, begins: Any, codes: Any) -> None:  # pragma: no cover
    """Write the code (cells) of how far the limit of each cell's azimuth bin lies beyond its range.

    In blocks of three loops: what is calculated vectorizes, what is looked up does not.
    """
    most, per_m = np.float32(FARTHEST_M), np.float32(_STEPS_A_METER)
    away, step = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.int32)
    for start in range(0, codes.shape[0], BLOCK):
        block = slice(start, min(start + BLOCK, codes.shape[0]))
        bin_of, ranges, out = bins[block], range_m[block], codes[block]
        for k in range(out.shape[0]):
            away[k] = limit_m[np.uint32(bin_of[k])]
        for k in range(out.shape[0]):
            away[k] = min(max(away[k] - ranges[k], -most), most)
            step[k] = np.int32((away[k] + most) * per_m)
        for k in range(out.shape[0]):
            code = np.uint32(table[np.uint32(step[k])])
            out[k] = code + np.uint32(away[k] >= begins[code + np.uint32(1)])


@njit(cache=True, nogil=True, error_model="numpy")
def _write_beam_codes(returns: Any, table: Any, codes: Any) -> None:  # pragma: no cover - compiled
    """Write the codes (3, cells) of expected returns (3, cells): measured, measured and inferred, unresolved."""
    both = np.empty(BLOCK, np.float32)
    for start in range(0, returns.shape[1], BLOCK):
        block = slice(start, min(start + BLOCK, returns.shape[1]))
        measured, inferred = returns[0, block], returns[1, block]
        for k in range(measured.shape[0]):
            both[k] = measured[k] + inferred[k]
        _look_up(measured, table, codes[0, block])
        _look_up(both[: measured.shape[0]], table, codes[1, block])
        _look_up(returns[2, block], table, codes[2, block])


@njit(cache=True, nogil=True, error_model="numpy")
def _look_up(returns: Any, table: Any, codes: Any) -> None:  # pragma: no cover - compiled
    """Write the code of each number of returns: of the last step of the table below it."""
    steps, last = np.float32(_STEPS), np.float32(table.shape[0] - 1)
    for n in range(returns.shape[0]):
        codes[n] = table[np.uint32(np.int32(min(returns[n] * steps, last)))]


def fold_maps(maps: Bytes, fold: int) -> Bytes:
    """Return maps (features, cells, cells) in blocks (side, side, features · fold²), ordered by feature, row, column.

    >>> fold_maps(np.arange(8, dtype=np.uint8).reshape(2, 2, 2), 2).tolist()
    [[[0, 1, 2, 3, 4, 5, 6, 7]]]
    """
    features, cells = maps.shape[:2]
    side = cells // fold
    if fold not in (1, 2, 4, 8):
        blocks = maps.reshape(features, side, fold, side, fold).transpose(1, 3, 0, 2, 4)
        return np.ascontiguousarray(blocks).reshape(side, side, -1)
    out = np.empty((side, side, features * fold**2), np.uint8)
    word = f"u{fold}"
    _fold(np.ascontiguousarray(maps).view(word), out.view(word))
    return out


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
def replace_codes(blocks: Any, table: Any) -> None:  # pragma: no cover - compiled
    """Replace each byte of blocks (side, side, size) by what a table (256,) has for it."""
    for i in range(blocks.shape[0]):
        for j in range(blocks.shape[1]):
            for k in range(blocks.shape[2]):
                blocks[i, j, k] = table[blocks[i, j, k]]
