"""Candidates for objects: returns above the ground that stand close together, at several nested distances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.preprocess.leveling import LeveledSweep

SHAPES = (
    "log_returns", "log_range", "level",
    "long_m", "short_m", "top_m", "bottom_m", "mean_m", "deviation_m",
    "overhead", "share_low", "share_middle", "share_high", "share_tall",
    "upper_long_m", "upper_short_m", "lower_long_m", "lower_short_m",
    "edge_m", "edge_share", "face_m", "face_share",
    "alignment", "fill", "middle_rise_m", "major_m", "minor_m", "log_layers",
    "hidden_left", "hidden_right", "parent_share", "parent_m",
)  # fmt: skip
"""What describes the shape of a candidate; ``src/core/object_candidates.hpp`` says what each is."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """C candidates, a forest: each is a part of its parent, which stands before it."""

    rows: NDArray[np.int32]  # (P,) int32 rows of the leveled sweep's points, each candidate a range of them
    first: NDArray[np.int32]  # (C,) int32 where in ``rows`` each begins
    last: NDArray[np.int32]  # (C,) int32 where in ``rows`` each ends, exclusive
    parent: NDArray[np.int32]  # (C,) int32 the smallest candidate that holds it and more, -1 for none
    # (C, 6) float32 heading of the long side in radians, least and greatest coordinate along it and across it (from the
    # sensor, meters), and 1 or 2 where something nearer hides only its left or only its right end
    sides: NDArray[np.float32]
    shapes: NDArray[np.float32]  # (C, 32) float32, columns ``SHAPES``

    def __len__(self) -> int:
        """Return the number of candidates."""
        return len(self.first)

    @property
    def returns(self) -> NDArray[np.int32]:
        """Number of returns (C,) of each."""
        return self.last - self.first

    def column(self, name: str) -> NDArray[np.float32]:
        """Return one of the columns ``SHAPES``, (C,)."""
        return self.shapes[:, SHAPES.index(name)]


def find_candidates(leveled: LeveledSweep) -> Candidates:
    """Return the candidates for objects in a leveled sweep.

    Returns .3 to 3 m above local ground, up to 80 m ahead and aside, are linked at four distances that grow with
    range (.3 m to 1 m + 2 % of it). What is linked at one of them and larger than its parts is a candidate, from four
    returns on and up to 20 m across. At most 40,000 cells of .2 m, the nearest, and 2,000 candidates, those with most
    returns, are looked at: a million points, wherever they lie, take about a tenth of a second.
    """
    arrays = _core.object_candidates(leveled.points, leveled.height_m, leveled.range_m, leveled.sensor_height_m)
    return Candidates(*arrays)
