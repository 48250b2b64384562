"""Local ground: heights above it decide what is an obstacle and which beams meet a target."""
from __future__ import annotations
from dataclasses import dataclass
import numpy as np
from numpy.typing import NDArray
from viewshed.geometry import FloatArray

@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """Ground height z (metres, ``level`` frame) on a square lattice about the sensor, bilinear in between.

    Attributes:
        heights_m: (n, n) float32 z of the ground at the lattice's nodes.
        half_extent_m: the lattice spans [-half_extent_m, half_extent_m] in x and y; beyond it the edge holds.
        share_seen: share of lattice cells inside the sensor's range that rest on returns, in [0, 1].
    """

    heights_m: NDArray[np.float32]
    half_extent_m: float
    share_seen: float = 1.0

    def at(self, xy: FloatArray) -> NDArray[np.float32]:
        """Return ground z (…,) in metres below points (…, 2+) of ``level``."""
        raise NotImplementedError
