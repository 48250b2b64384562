"""Candidate objects: clusters of returns above the ground, at several nested distances."""

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
"""Shape features of a candidate; ``src/core/object_candidates.hpp`` defines each."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """C candidates in a forest: each may be a part of its parent, which has a smaller index."""

    rows: NDArray[np.int32]  # (P,) int32 rows of the leveled sweep's points; each candidate is a range of them
    first: NDArray[np.int32]  # (C,) int32 start of each in ``rows``
    last: NDArray[np.int32]  # (C,) int32 end of each in ``rows``, exclusive
    parent: NDArray[np.int32]  # (C,) int32 smallest candidate that contains it and more, -1 for none
    # (C, 6) float32 heading of the long side in radians; minimum and maximum coordinate along it, then across it (from
    # the sensor, meters); 1 or 2 where something nearer hides only its left or only its right end
    sides: NDArray[np.float32]
    shapes: NDArray[np.float32]  # (C, 32) float32, columns ``SHAPES``

    def __len__(self) -> int:
        """Return the number of candidates."""
        return len(self.first)

    @property
    def returns(self) -> NDArray[np.int32]:
        """(C,) number of returns of each."""
        return self.last - self.first

    def column(self, name: str) -> NDArray[np.float32]:
        """Return one of the columns ``SHAPES``, (C,)."""
        return self.shapes[:, SHAPES.index(name)]


def find_candidates(leveled: LeveledSweep) -> Candidates:
    """Return the candidate objects in a leveled sweep.

    Returns .3 to 3 m above local ground, up to 80 m along each axis, are linked at four distances that grow with range
    (.3 m to 1 m + 2 % of it). A cluster at one of them that is larger than its parts is a candidate, if it has at least
    four returns and is at most 20 m across. At most the nearest 40,000 cells of .2 m and the 2,000 candidates with most
    returns are used: any million points take about a tenth of a second.
    """
    arrays = _core.object_candidates(leveled.points, leveled.height_m, leveled.range_m, leveled.sensor_height_m)
    return Candidates(*arrays)
