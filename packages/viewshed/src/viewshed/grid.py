"""BevGrid: a bird's-eye-view grid, which converts meters to cells."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import as_int
from viewshed.geometry import FloatArray, Rigid

MAX_CELLS = 4096


@dataclass(frozen=True)
class BevGrid:
    """A square bird's-eye-view grid in the ``level`` frame, cell (i, j) with i forward (x) and j left (y), half-open.

    Attributes:
        cells: number of cells per side.
        half_extent_m: half the side, in meters.
        offset_m: (x, y) of the grid's center from the sensor, in meters.

    Raises:
        ValueError: no cells, too many, or an extent that is not positive and finite.

    >>> grid = BevGrid(cells=256, half_extent_m=64.0)
    >>> grid.cell_m, grid.shape
    (0.5, (256, 256))
    """

    cells: int = 256
    half_extent_m: float = 64.0
    offset_m: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "cells", as_int("cells", self.cells))
        if not 1 <= self.cells <= MAX_CELLS:
            raise ValueError(f"cells must lie in [1, {MAX_CELLS}], got {self.cells}")
        if not (np.isfinite(self.half_extent_m) and self.half_extent_m > 0):
            raise ValueError(f"half_extent_m must be positive and finite, got {self.half_extent_m}")
        if len(self.offset_m) != 2 or not np.isfinite(self.offset_m).all():
            raise ValueError(f"offset_m must be two finite numbers, got {self.offset_m}")
        object.__setattr__(self, "half_extent_m", float(self.half_extent_m))
        object.__setattr__(self, "offset_m", (float(self.offset_m[0]), float(self.offset_m[1])))

    def __reduce__(self) -> tuple[type[BevGrid], tuple[int, float, tuple[float, float]]]:
        """Pickle the constructor's arguments, not the cached centers."""
        return BevGrid, (self.cells, self.half_extent_m, self.offset_m)

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (cells, cells) of every array on this grid."""
        return self.cells, self.cells

    @property
    def cell_m(self) -> float:
        """Side of a cell in meters."""
        return 2.0 * self.half_extent_m / self.cells

    @property
    def cell_area_m2(self) -> float:
        """Area of a cell in square meters."""
        return self.cell_m**2

    @property
    def origin_m(self) -> tuple[float, float]:
        """(x, y) of the corner of cell (0, 0): the smallest x and y of the grid, in meters."""
        return self.offset_m[0] - self.half_extent_m, self.offset_m[1] - self.half_extent_m

    @cached_property
    def centers(self) -> NDArray[np.float64]:
        """(cells, cells, 2) x and y of the center of each cell, in meters; read-only."""
        steps = (np.arange(self.cells) + 0.5) * self.cell_m
        x, y = np.meshgrid(self.origin_m[0] + steps, self.origin_m[1] + steps, indexing="ij")
        centers: NDArray[np.float64] = np.stack([x, y], axis=-1)
        centers.setflags(write=False)
        return centers

    def index(self, xy: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """Return cell indices (…, 2) of points (…, 2+) and a mask (…) of those inside; points outside get (-1, -1).

        >>> BevGrid(4, 2.0).index(np.array([[0.0, -2.0], [2.0, 0.0]]))[0].tolist()
        [[2, 0], [-1, -1]]
        """
        xy = np.asarray(xy, np.float64)
        if xy.shape[-1:] < (2,):  # a single column would be broadcast to x and y
            raise ValueError(f"points must have shape (…, 2+), got {xy.shape}")
        scaled = (xy[..., :2] - self.origin_m) / self.cell_m
        x, y = scaled[..., 0], scaled[..., 1]
        inside: NDArray[np.bool_] = np.asarray((x >= 0) & (x < self.cells) & (y >= 0) & (y < self.cells))
        cells = np.floor(np.where(inside[..., None], scaled, -1.0)).astype(np.intp)
        return cells, inside

    def count(
        self,
        points: FloatArray,
        level_from_sensor: Rigid | None = None,
        *,
        max_range_m: float = np.inf,
        height_m: tuple[float, float] = (-np.inf, np.inf),
        null_range_m: float = 0.0,
    ) -> NDArray[np.int32]:
        """Return (cells, cells) int32 counts of points (N, 3+), transformed to ``level``.

        Not counted: points farther than ``max_range_m`` (horizontal), outside ``height_m`` (z in ``level``), or within
        ``null_range_m`` of the origin of ``points`` (null returns).

        >>> int(BevGrid(4, 2.0).count(np.array([[0.5, 0.5, 0.0], [9.0, 0.0, 0.0]])).sum())
        1
        """
        transform = Rigid.identity() if level_from_sensor is None else level_from_sensor
        return _core.count_points(
            np.ascontiguousarray(np.asarray(points)[:, :3], np.float32),
            transform.rotation.astype(np.float32, order="C"),
            transform.translation.astype(np.float32),
            cells=self.cells,
            cell_m=self.cell_m,
            origin_x_m=self.origin_m[0],
            origin_y_m=self.origin_m[1],
            low_m=height_m[0],
            high_m=height_m[1],
            max_range_m=max_range_m,
            null_range_m=null_range_m,
        )


GRIDS: dict[str, BevGrid] = {
    "road": BevGrid(256, 64.0),
    "indoor": BevGrid(256, 16.0),
    "paper": BevGrid(512, 80.0),
    "paper_indoor": BevGrid(512, 18.0),
}
"""The preset grids by name: for roads and for rooms, and both of arXiv 2503.07375 (``paper…``)."""


@lru_cache(maxsize=8)
def polar_of_cells(grid: BevGrid) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return range (cells, cells) in meters and azimuth (cells, cells) in [-π, π) of the cell centers; read-only."""
    range_m, azimuth = _core.polar_of_cells(grid.cells, grid.cell_m, *grid.origin_m)
    for array in (range_m, azimuth):
        array.setflags(write=False)
    return range_m, azimuth
