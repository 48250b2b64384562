"""A field of view in few bytes: the state of each cell as it is, its probability in 16 levels, its deviation in 8.

The native core predicts each cell from those coded before it, and an adaptive range coder writes what the prediction
leaves open (``src/core/fov_code.cpp``). Decoding takes a bounded number of steps; bytes that are no code are refused.
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
"""Levels of probability: eight below the threshold and eight from it on, so that the visible cells stay exact."""

STD_LEVELS = 8
"""Levels of the standard deviation, 1/16 wide: no deviation of a probability exceeds 0.5."""

MAX_CELLS = 512
"""The most cells per side of a grid in a code."""

_NO_STD = STD_LEVELS

# What levels of deviation stand for: the middles of their intervals, NaN for none.
_STD_VALUES = np.append((np.arange(STD_LEVELS) + 0.5) / (2 * STD_LEVELS), np.nan).astype(np.float32)

# Where a code would be too long: levels between the extremes become one of two.
_COARSE = np.array([0, 4, 4, 4, 4, 4, 4, 4, 11, 11, 11, 11, 11, 11, 11, 15], np.uint8)

_NO_PLANE = np.zeros((0, 0), np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class ViewCells:
    """The cells of a view as a code gives them back."""

    state: NDArray[np.uint8]  # (cells, cells) uint8 of :class:`viewshed.CellState`, as it was
    visible_prob: NDArray[np.float32]  # (cells, cells) float32, the middles of the levels
    # (cells, cells) float32, the middles of the levels, NaN where there was none; None where no cell had one
    std: NDArray[np.float32] | None


def max_code_bytes(grid: BevGrid) -> int:
    """Return the most bytes that the code of a view on ``grid`` may have: two bits a cell, at least 64.

    >>> max_code_bytes(BevGrid())
    16384
    """
    return max(64, grid.cells**2 // 4)


@lru_cache(maxsize=16)
def level_values(threshold: float) -> NDArray[np.float32]:
    """Return the probability (16,) float32 that each level stands for, read-only: the middle of its interval.

    >>> level_values(0.5)[[0, 7, 8, 15]].tolist()
    [0.03125, 0.46875, 0.53125, 0.96875]
    """
    middles = (np.arange(8) + 0.5) / 8
    values = np.append(middles * threshold, threshold + middles * (1.0 - threshold)).astype(np.float32)
    values.setflags(write=False)
    return values


def encode_fov(estimate: FovEstimate) -> bytes:
    """Return the code of the cells of an estimate; of its grid, threshold and time nothing is in it.

    Where a view is too irregular for :func:`max_code_bytes`, levels between the extremes become two, and where that
    does not suffice, deviations are left out: :func:`decode_fov` then gives NaN.

    Raises:
        ValueError: more than 512 cells per side, or states so irregular that no code is short enough.
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
    nothing = np.full_like(deviation, _NO_STD)
    for each, deviations in ((level, deviation), (_COARSE[level], deviation), (_COARSE[level], nothing)):
        code = _core.encode_view(estimate.state, each, deviations, *sensor_cell(grid))
        if 0 < len(code) <= max_code_bytes(grid):
            return code
    raise ValueError("the states of a view must be regular enough for two bits a cell; got what looks like noise")


def has_std(estimate: FovEstimate) -> bool:
    """Return whether any cell of an estimate has a deviation: :func:`decode_fov` must be given this."""
    return estimate.std is not None and not bool(np.isnan(estimate.std).all())


def decode_fov(code: bytes, grid: BevGrid, threshold: float, with_std: bool) -> ViewCells:
    """Return the cells of a code.

    Args:
        code: what :func:`encode_fov` returned.
        grid: of the view.
        threshold: of the estimate.
        with_std: whether it had deviations.

    Raises:
        ValueError: the grid is too large for messages, or the bytes are no code of such a view, or too many.
    """
    if grid.cells > MAX_CELLS:
        raise ValueError(f"a view in a message must have at most {MAX_CELLS} cells per side, got {grid.cells}")
    if len(code) > max_code_bytes(grid):
        raise ValueError(f"the code of a view must have at most {max_code_bytes(grid)} bytes, got {len(code)}")
    found = _core.decode_view(
        np.frombuffer(code, np.uint8),
        grid.cells,
        *sensor_cell(grid),
        prob=level_values(threshold),
        std=_STD_VALUES if with_std else _STD_VALUES[:0],
    )
    if found is None:
        raise ValueError("the code of a view is damaged, or not of this grid")
    return ViewCells(*found)


def sensor_cell(grid: BevGrid) -> tuple[int, int]:
    """Return row and column of the cell that the sensor stands in, or of the nearest to it.

    >>> sensor_cell(BevGrid(256, 64.0))
    (128, 128)
    """
    row, column = (int(min(max(-corner // grid.cell_m, 0), grid.cells - 1)) for corner in grid.origin_m)
    return row, column
