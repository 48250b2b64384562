"""The definition of *visible*.

A cell is visible to a sweep if a target standing there would have given at least ``min_returns`` returns.

The core counts beams by azimuth column and range bin, and builds cumulative sums over the columns. The number of beams
within a target's azimuth window is then the difference of the sums at its two ends.
"""

from __future__ import annotations

import atexit
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import as_int
from viewshed.fov.height_map import HeightMap
from viewshed.grid import BevGrid, polar_of_cells


@dataclass(frozen=True, slots=True)
class Target:
    """The target whose visibility is estimated: an upright box on the local ground.

    Attributes:
        name: name of the target.
        length_m: longer side.
        width_m: shorter side, which faces the sensor.
        height_m: height above local ground.
        min_returns: minimum number of returns of a visible target.
    """

    name: str
    length_m: float
    width_m: float
    height_m: float
    min_returns: int

    def __post_init__(self) -> None:
        for key in ("length_m", "width_m", "height_m"):
            value = getattr(self, key)
            if not (np.isfinite(value) and 0 < value <= 100):
                raise ValueError(f"{key} must lie in (0, 100], got {value}")
        object.__setattr__(self, "min_returns", as_int("min_returns", self.min_returns))
        if not 1 <= self.min_returns <= 10_000:
            raise ValueError(f"min_returns must lie in [1, 10000], got {self.min_returns}")


CAR = Target("car", 4.2, 1.8, 1.5, 5)

PEDESTRIAN = Target("pedestrian", 0.6, 0.6, 1.7, 3)

TARGETS: dict[str, Target] = {target.name: target for target in (CAR, PEDESTRIAN)}
"""The targets by name."""


@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """Straight beams from the sensor in the ``level`` frame, which the definition of visible counts."""

    azimuth: NDArray[np.float32]  # (B,) float32 radians in [-π, π)
    slope: NDArray[np.float32]  # (B,) float32 rise over horizontal range
    depth_m: NDArray[np.float32]  # (B,) float32 horizontal range at which the beam ended; +inf if nothing stopped it

    def __post_init__(self) -> None:
        if not (self.azimuth.shape == self.slope.shape == self.depth_m.shape) or self.azimuth.ndim != 1:
            raise ValueError("azimuth, slope and depth_m must have one shape (B,)")

    @property
    def arrays(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """Azimuth, slope and depth_m as contiguous float32 arrays for the core."""
        azimuth, slope, depth_m = (
            np.ascontiguousarray(array, np.float32) for array in (self.azimuth, self.slope, self.depth_m)
        )
        return azimuth, slope, depth_m

    def __add__(self, other: Beams) -> Beams:
        """Return the concatenation of both."""
        pairs = ((self.azimuth, other.azimuth), (self.slope, other.slope), (self.depth_m, other.depth_m))
        return Beams(*map(np.concatenate, pairs))


def expected_returns(
    beams: Beams, sensor_height_m: float, ground: HeightMap, grid: BevGrid, target: Target
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return (cells, cells) float32 expected returns of a target in each cell, and the number of beams aimed at it.

    A beam counts for a cell at range r if its azimuth is within the target's width at r, its height at r is between
    the local ground and the target's top, and its depth is at least r minus one cell. The aimed beams ignore the
    depth: they would hit the target if there were no occlusion. Counts are interpolated within an azimuth column
    (aimed beams: averaged over neighboring sectors of 2.8°), so they are not integers. Beams up to 0.3 m below the
    ground count too: the tolerance of a measured ground.
    """
    return _core.expected_returns(
        cell_windows(grid, target.width_m),
        beams.arrays,
        ground.heights_m,
        ground.half_extent_m,
        sensor_height_m,
        target.height_m,
    )


def probability_of_visible(counts: NDArray[np.float32], min_returns: int) -> NDArray[np.float32]:
    """Return P(N ≥ min_returns), N Poisson with mean ``counts``, float32 of the same shape.

    Jitter of azimuth and ground height makes beam counts of a measured sweep uncertain. The median of a Poisson
    variable with integer mean m is m, so the threshold 0.5 is equivalent to the definition.

    >>> probability_of_visible(np.array([0.0, 4.0, 5.0, 50.0], np.float32), 5).round(2).tolist()
    [0.0, 0.3700000047683716, 0.5600000023841858, 1.0]
    """
    counts = np.ascontiguousarray(counts, np.float32)
    return _core.probability_of_visible(counts.reshape(-1), poisson_table(min_returns)).reshape(counts.shape)


@lru_cache(maxsize=8)
def poisson_table(min_returns: int) -> NDArray[np.float32]:
    """Return the core's lookup table of P(N ≥ min_returns), float32 at means 0, 1/32, 2/32 and so on."""
    return _core.poisson_table(min_returns)


@lru_cache(maxsize=16)
def cell_windows(grid: BevGrid, width_m: float) -> _core.CellWindows:
    """Return the azimuth window of a target of ``width_m`` that faces the sensor, for each cell of a grid."""
    return _core.CellWindows(*polar_of_cells(grid), grid.cell_m, width_m)


# If another extension leaks a reference to this module, nanobind would report the cached windows as leaks.
atexit.register(cell_windows.cache_clear)
