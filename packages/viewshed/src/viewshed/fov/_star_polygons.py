"""Star shapes about a point that stay inside a mask: the numerical part of :mod:`viewshed.fov.polygons`.

How far each direction is free, and the few vertices that keep the most of it. Directions are ``bins``
equal wedges, wedge k from angle 2πk/bins to 2π(k+1)/bins, counter-clockwise from x.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import F64
from viewshed.grid import BevGrid


def free_ranges(
    mask: NDArray[np.bool_],
    grid: BevGrid,
    apex_m: tuple[float, float],
    bins: int,
    *,
    margin_m: float = 0.0,
    whole_cells: bool = True,
) -> F64:
    """Return (bins,) meters: how far each wedge reaches from ``apex_m`` without leaving the true cells of ``mask``.

    With ``whole_cells`` no part of another cell is covered, and all stay ``margin_m`` away from it; without, no
    other cell's center is, nor anything off the grid. 0 where the apex itself is not inside. ``bins`` must be a
    multiple of 4.
    """
    if bins % 4 or bins <= 0:
        raise ValueError(f"bins must be a positive multiple of 4, got {bins}")
    lattice = (*grid.origin_m, grid.cell_m, *apex_m)
    if whole_cells:
        return _core.free_ranges(mask, *lattice, 0.5 * grid.cell_m + margin_m, bins, True)
    edge = _core.free_ranges(np.ones_like(mask), *lattice, 0.5 * grid.cell_m + margin_m, bins, True)
    return np.minimum(edge, _core.free_ranges(mask, *lattice, max(margin_m, 1e-6), bins, False))


def star_vertices(ranges: F64, price_m2: float) -> F64:
    """Return (V, 2) angle and range of the star polygon below ``ranges`` with the most area less ``price_m2`` a vertex.

    Vertices stand on the wedges' borders at a few dozen candidate ranges; among those the choice is optimal but for
    its first vertex, which a first pass finds. Empty where some direction is not free or nothing pays.
    """
    return _core.star_vertices(ranges, price_m2)
