"""Features: maps of one byte a cell, computed from a leveled sweep, that a network takes as input.

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
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import F32
from viewshed.fov.visibility import Target
from viewshed.grid import BevGrid, polar_of_cells
from viewshed.preprocess.azimuth_bins import bins_of_cells
from viewshed.preprocess.evidence import BeamEvidence, beam_evidence
from viewshed.preprocess.history import History
from viewshed.preprocess.leveling import OBSTACLE_HEIGHTS_M, LeveledSweep

NO_HISTORY = 128
"""Code of ``confirmations`` without earlier sweeps: neither none of them nor all."""

Bytes = NDArray[np.uint8]

Coded = tuple[str, tuple[NDArray[Any], ...]]
"""How a feature's codes are made (``src/core/features.hpp``), and the arrays that they are made of: ``bytes`` as they
are, ``returns`` of expected returns or of the sum of two kinds of them, ``probability``, ``beyond`` of a limit (bins,)
in range, ``range`` of the cells, ``deviation`` of the ground's standard deviation (nodes, nodes)."""


@dataclass(frozen=True, eq=False)
class FeatureContext:
    """What the features of one sweep are computed from; each part is computed when it is first read."""

    leveled: LeveledSweep  # the sweep
    grid: BevGrid  # of the maps
    target: Target  # what would have to be seen
    # (cells, cells) uint8, returns of each cell as the network's card counts them; None where no network is shown them
    counts: Bytes | None
    history: History | None = None  # what earlier sweeps saw, or None where there are none

    @cached_property
    def ranges_m(self) -> tuple[F32, F32]:
        """Ranges (bins,) of the farthest return and of the nearest obstacle, by the azimuth bins that returns fill.

        -1 where there is no return, and +inf where there is no obstacle.
        """
        leveled = self.leveled
        return _core.ranges_in_bins(leveled.azimuth, leveled.range_m, leveled.height_m, *OBSTACLE_HEIGHTS_M)

    @cached_property
    def height_codes(self) -> tuple[Bytes, Bytes]:
        """(cells, cells) codes of the lowest and of the highest return: 0 for none, 1 to 255 from -2 to 4 m up."""
        leveled, grid = self.leveled, self.grid
        return _core.height_codes(leveled.points, leveled.height_m, *grid.origin_m, 1.0 / grid.cell_m, grid.cells)

    @cached_property
    def evidence(self) -> BeamEvidence:
        """What the beams say about a target in each cell, with what earlier sweeps saw."""
        return beam_evidence(self.leveled, self.grid, self.target, self.history)

    @cached_property
    def own_evidence(self) -> BeamEvidence:
        """What the beams of this sweep alone say."""
        return beam_evidence(self.leveled, self.grid, self.target)


def _counts(context: FeatureContext) -> Coded:
    if context.counts is None:
        raise ValueError("counts must be given for the feature counts, got None; take the context of a card with it")
    return "bytes", (context.counts,)


def _confirmations(context: FeatureContext) -> Coded:
    """The share of the earlier sweeps that saw each cell: 0 to 255, 128 without any."""
    history = context.history
    if history is None:
        return "bytes", (_no_history(context.grid),)
    share = history.confirmations(context.grid, context.target) * (255.0 / len(history.earlier))
    return "bytes", (np.round(share).astype(np.uint8),)


@lru_cache(maxsize=8)
def _no_history(grid: BevGrid) -> Bytes:
    return np.full(grid.shape, NO_HISTORY, np.uint8)


FEATURES: dict[str, Callable[[FeatureContext], Coded]] = {
    "counts": _counts,
    "lowest": lambda context: ("bytes", (context.height_codes[0],)),
    "highest": lambda context: ("bytes", (context.height_codes[1],)),
    "measured": lambda context: ("returns", (context.own_evidence.measured,)),
    "expected": lambda context: ("returns", (context.own_evidence.measured, context.own_evidence.inferred)),
    "unresolved": lambda context: ("returns", (context.own_evidence.unresolved,)),
    "blocker": lambda context: ("beyond", (context.ranges_m[1],)),
    "farthest": lambda context: ("beyond", (context.ranges_m[0],)),
    "range": lambda context: ("range", ()),
    "confirmations": _confirmations,
    "shadow_map": lambda context: ("probability", (context.evidence.visible_prob,)),
    "ground_std": lambda context: ("deviation", (context.leveled.ground.std_m,)),
}
"""The features by name. ``measured`` counts the expected returns of beams that returned and that are not isolated;
``expected`` those of measured and inferred beams, as the shadow map does; ``unresolved`` what beams without
a return add where they end late. ``blocker`` and ``farthest`` are how far the nearest obstacle and the farthest
return of the azimuth lie beyond the cell. ``confirmations`` is the share of the earlier sweeps that would have seen a
target in the cell. ``shadow_map`` is the probability by measured and inferred beams that end at the obstacles of
earlier sweeps; ``ground_std`` the standard deviation of the ground's height."""

HISTORY_FEATURES = ("confirmations", "shadow_map")
"""Features that earlier sweeps change."""


def feature_maps(names: Sequence[str], context: FeatureContext, fold: int = 0) -> Bytes:
    """Return the maps (features, cells, cells) of features by their names.

    With ``fold`` they come as :func:`fold_maps` folds them.
    """
    coded, grid = [FEATURES[name](context) for name in names], context.grid
    bins = next((len(arrays[0]) for coding, arrays in coded if coding == "beyond"), 1)
    x_m, y_m = _middles(grid)
    return _core.feature_maps(
        coded, polar_of_cells(grid)[0], bins_of_cells(grid, bins), x_m, y_m, context.leveled.ground.half_extent_m, fold
    )


@lru_cache(maxsize=8)
def _middles(grid: BevGrid) -> tuple[F32, F32]:
    """Return x (cells,) of the cells' rows and y (cells,) of their columns in meters."""
    x_m, y_m = grid.centers[:, 0, 0].astype(np.float32), grid.centers[0, :, 1].astype(np.float32)
    return x_m, y_m


def fold_maps(maps: Bytes, fold: int) -> Bytes:
    """Return maps (features, cells, cells) in blocks (side, side, features · fold²), ordered by feature, row, column.

    >>> fold_maps(np.arange(8, dtype=np.uint8).reshape(2, 2, 2), 2).tolist()
    [[[0, 1, 2, 3, 4, 5, 6, 7]]]
    """
    return _core.fold_maps(np.ascontiguousarray(maps), fold)
