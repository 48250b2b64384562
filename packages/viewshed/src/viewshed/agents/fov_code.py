"""Compressed field of view: the exact state of each cell, its probability in 16 levels, its standard deviation in 8.

The native core predicts each cell from those coded before it, and an adaptive range coder stores the residual
(``src/core/fov_code.cpp``). Decoding takes a bounded number of steps; invalid bytes are refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.fov.estimate import FovEstimate
from viewshed.grid import BevGrid

LEVELS = 16
"""Levels of probability: eight below the threshold and eight from it on, so that visible cells stay exact."""

STD_LEVELS = 8
"""Levels of the standard deviation, each 1/16 wide: a probability has a standard deviation of at most 0.5."""

MAX_CELLS = 512
"""Maximum number of cells per side of a coded grid."""

_NO_STD = STD_LEVELS

# Standard deviation of each level: the middle of its interval; NaN for none.
_STD_VALUES = np.append((np.arange(STD_LEVELS) + 0.5) / (2 * STD_LEVELS), np.nan).astype(np.float32)

# Coarse levels for codes that would be too long: levels between the extremes become one of two.
_COARSE = np.array([0, 4, 4, 4, 4, 4, 4, 4, 11, 11, 11, 11, 11, 11, 11, 15], np.uint8)

_NO_PLANE = np.zeros((0, 0), np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class ViewCells:
    """Decoded cells of a view."""

    state: NDArray[np.uint8]  # (cells, cells) uint8 of :class:`viewshed.CellState`, exact
    visible_prob: NDArray[np.float32]  # (cells, cells) float32, middles of the levels
    # (cells, cells) float32, middles of the levels, NaN where there was none; None if no cell had one
    std: NDArray[np.float32] | None


def max_code_bytes(grid: BevGrid) -> int:
    """Return the maximum number of bytes of a code on ``grid``: two bits per cell, but at least 64 bytes.

    >>> max_code_bytes(BevGrid())
    16384
    """
    return max(64, grid.cells**2 // 4)


@lru_cache(maxsize=16)
def level_values(threshold: float) -> NDArray[np.float32]:
    """Return the probability (16,) float32 of each level, read-only: the middle of its interval.

    >>> level_values(0.5)[[0, 7, 8, 15]].tolist()
    [0.03125, 0.46875, 0.53125, 0.96875]
    """
    middles = (np.arange(8) + 0.5) / 8
    values = np.append(middles * threshold, threshold + middles * (1.0 - threshold)).astype(np.float32)
    values.setflags(write=False)
    return values


def encode_fov(estimate: FovEstimate) -> bytes:
    """Return the code of the cells of an estimate; it does not contain grid, threshold and time.

    If the code is longer than :func:`max_code_bytes`, the levels are made coarse; if that is not enough, standard
    deviations are left out, and :func:`decode_fov` returns NaN.

    Raises:
        ValueError: there are more than 512 cells per side, or the states are too irregular for a short code.
    """
    grid = estimate.grid
    if grid.cells > MAX_CELLS:
        raise ValueError(f"a view in a message must have at most {MAX_CELLS} cells per side, got {grid.cells}")
    threshold, prob = np.float32(estimate.threshold), estimate.visible_prob
    below = np.minimum(prob * (8 / threshold), 7)
    above = 8 + np.minimum((prob - threshold) * np.float32(8 / max(1.0 - estimate.threshold, 1e-6)), 7)
    level = np.where(prob >= threshold, above, below).astype(np.uint8)
    std, deviation = estimate.std, _NO_PLANE
    if std is not None and has_std(estimate):
        levels = np.minimum(np.nan_to_num(std, nan=0.0) * (2 * STD_LEVELS), STD_LEVELS - 1).astype(np.uint8)
        deviation = np.where(np.isnan(std), np.uint8(_NO_STD), levels)
    no_deviation = np.full_like(deviation, _NO_STD)
    for coded_level, deviations in ((level, deviation), (_COARSE[level], deviation), (_COARSE[level], no_deviation)):
        code = _core.encode_view(estimate.state, coded_level, deviations, *sensor_cell(grid))
        if 0 < len(code) <= max_code_bytes(grid):
            return code
    raise ValueError("the states of a view must compress to two bits a cell, got states that look like noise")


def has_std(estimate: FovEstimate) -> bool:
    """Return whether any cell of an estimate has a standard deviation, an argument of :func:`decode_fov`."""
    return estimate.std is not None and not bool(np.isnan(estimate.std).all())


def decode_fov(code: bytes, grid: BevGrid, threshold: float, with_std: bool) -> ViewCells:
    """Return the cells of a code.

    Args:
        code: result of :func:`encode_fov`.
        grid: of the view.
        threshold: of the estimate.
        with_std: result of :func:`has_std` for the estimate.

    Raises:
        ValueError: the grid is too large for messages, or the bytes are too many or not a code of such a view.
    """
    if grid.cells > MAX_CELLS:
        raise ValueError(f"a view in a message must have at most {MAX_CELLS} cells per side, got {grid.cells}")
    if len(code) > max_code_bytes(grid):
        raise ValueError(f"the code of a view must have at most {max_code_bytes(grid)} bytes, got {len(code)}")
    cells = _core.decode_view(
        np.frombuffer(code, np.uint8),
        grid.cells,
        *sensor_cell(grid),
        prob=level_values(threshold),
        std=_STD_VALUES if with_std else _STD_VALUES[:0],
    )
    if cells is None:
        raise ValueError("the code of a view is damaged, or not of this grid")
    return ViewCells(*cells)


def sensor_cell(grid: BevGrid) -> tuple[int, int]:
    """Return row and column of the sensor's cell, or of the nearest cell of the grid.

    >>> sensor_cell(BevGrid(256, 64.0))
    (128, 128)
    """
    row, column = (int(min(max(-corner // grid.cell_m, 0), grid.cells - 1)) for corner in grid.origin_m)
    return row, column
