"""HeightMap: ground height on a square lattice, with bilinear interpolation."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.geometry import FloatArray
from viewshed.grid import BevGrid

NODES = 64
"""Lattice nodes per side."""


class LatticePositions(NamedTuple):
    """Positions of points on the lattice: index (…,) of the preceding node, and offsets (…,) from it in i and j."""

    node: NDArray[np.int32]
    down: NDArray[np.float64]
    right: NDArray[np.float64]


def lattice_positions(xy: FloatArray, half_extent_m: float, nodes: int) -> LatticePositions:
    """Return the positions of points (…, 2+) in ``level`` on a lattice of ``nodes`` nodes per side."""
    xy = np.ascontiguousarray(xy, dtype=np.float32)
    node, down, right = _core.lattice_positions(xy.reshape(-1, xy.shape[-1]), half_extent_m, nodes)
    shape = xy.shape[:-1]
    return LatticePositions(node.reshape(shape), down.reshape(shape), right.reshape(shape))


@lru_cache(maxsize=8)
def positions_of_cells(grid: BevGrid, half_extent_m: float, nodes: int) -> LatticePositions:
    """Return the positions (cells, cells) of a grid's cell centers on a lattice; cached."""
    return lattice_positions(grid.centers, half_extent_m, nodes)


@dataclass(frozen=True, slots=True, eq=False)
class HeightMap:
    """Ground height z (meters, ``level`` frame) on a square lattice around the sensor, bilinearly interpolated."""

    # (n, n) float32 ground z at the center of each node's cell, indexed like a BevGrid
    heights_m: NDArray[np.float32]
    half_extent_m: float  # the lattice spans ±half_extent_m in x and y; beyond it the edge value is used
    seen: NDArray[np.bool_]  # (n, n) bool, True where returns gave the height, False where it was filled in
    # (a, b, c) of the plane z = a x + b y + c through the near ground
    plane: tuple[float, float, float] = (0.0, 0.0, 0.0)
    support: float = 0.0  # share of the near nodes that lie on that plane, in [0, 1]
    # (n, n) float32 standard deviation of the heights; zeros by default
    std_m: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0), np.float32))

    def __post_init__(self) -> None:
        if not self.std_m.size:
            object.__setattr__(self, "std_m", np.zeros_like(self.heights_m))

    @classmethod
    def flat(cls, half_extent_m: float, z_m: float = 0.0, std_m: float = 0.0) -> HeightMap:
        """Return horizontal ground at ``z_m`` with standard deviation ``std_m``, marked as not seen."""
        heights, std = np.full((NODES, NODES), z_m, np.float32), np.full((NODES, NODES), std_m, np.float32)
        return cls(heights, half_extent_m, np.zeros((NODES, NODES), bool), (0.0, 0.0, z_m), std_m=std)

    def at(self, xy: FloatArray) -> NDArray[np.float32]:
        """Return ground z (…,) in meters below points (…, 2+) of ``level``.

        >>> HeightMap.flat(64.0, -1.5).at(np.array([[3.0, 4.0]])).tolist()
        [-1.5]
        """
        return self.at_positions(lattice_positions(xy, self.half_extent_m, len(self.heights_m)))

    def at_positions(self, positions: LatticePositions) -> NDArray[np.float32]:
        """Return ground z (…,) in meters at precomputed positions on a lattice of the same size."""
        node, down, right = positions.node.reshape(-1), positions.down.reshape(-1), positions.right.reshape(-1)
        return _core.interpolate(self.heights_m, node, down, right).reshape(positions.node.shape)

    def shifted(self, deviations: float) -> HeightMap:
        """Return the ground raised by ``deviations`` standard deviations.

        >>> HeightMap.flat(64.0, -1.5, std_m=0.5).shifted(2.0).at(np.zeros(2)).tolist()
        -0.5
        """
        return replace(self, heights_m=self.heights_m + np.float32(deviations) * self.std_m)

    def raised(self, delta_m: float) -> HeightMap:
        """Return the ground raised by ``delta_m`` meters.

        >>> HeightMap.flat(64.0, -1.5).raised(0.5).plane
        (0.0, 0.0, -1.0)
        """
        a, b, c = self.plane
        return replace(self, heights_m=self.heights_m + np.float32(delta_m), plane=(a, b, c + delta_m))
