"""Connected regions of a mask, and how deep a cell lies in one: what polygons need to know of masks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import Mask


def label_regions(mask: Mask, diagonal: bool = False) -> NDArray[np.int32]:
    """Return the number of each cell's connected region (rows, columns), 0 where ``mask`` is False.

    Regions are numbered from 1 on by their first cells in row-major order. Cells connect across sides, with
    ``diagonal`` across corners as well.

    >>> label_regions(np.array([[True, False, True], [True, False, True], [False, True, False]])).tolist()
    [[1, 0, 2], [1, 0, 2], [0, 3, 0]]
    """
    return _core.label_regions(np.ascontiguousarray(mask), diagonal)


def squared_depth(mask: Mask) -> NDArray[np.int64]:
    """Return the squared distance (rows, columns) from each cell to the nearest False one, in cells; 0 at those.

    Cells beyond the border count as False.

    >>> squared_depth(np.ones((3, 4), bool)).tolist()
    [[1, 1, 1, 1], [1, 4, 4, 1], [1, 1, 1, 1]]
    """
    return _core.squared_depth(np.ascontiguousarray(mask))
