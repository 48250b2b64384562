"""The few sectors of a circle that cover the most of what lies below a profile of ranges, exactly.

A sector of several directions reaches as far as the shortest of them, so only the widest sectors for each range
matter. Those are nested or apart: they are the nodes of the profile's Cartesian tree (Vuillemin 1980), and choosing
``k`` of them is dynamic programming over the tree with the nearest chosen ancestor as state.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viewshed import _core


def best_sectors(
    ranges: NDArray[np.float64], sectors: int, inner_m: float = 0.0
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Return the at most ``sectors`` sectors below ``ranges`` (bins,) of largest union: first bin, end bin, range.

    They may lie upon one another: a long narrow one over a short wide one. What is nearer than ``inner_m`` does not
    count. An end may exceed ``bins``: it wraps.

    >>> [part.tolist() for part in best_sectors(np.array([1.0, 1.0, 3.0, 1.0]), 2)]
    [[0, 2], [4, 3], [1.0, 3.0]]
    """
    return _core.best_sectors(ranges, sectors, inner_m)
