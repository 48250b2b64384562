"""Rays: the beams of a sweep that an attacker reaches, as straight lines."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.attacks.lattice import Lattice, lattice_of
from viewshed.attacks.tampering import Wedge
from viewshed.sweep import Sweep

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
_EDGE = 1e-6
"""Radians from the edge of a wedge at which a return counts as outside, more than rounding can move it."""


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """K beams, in the sensor's frame: first those that returned, in the order of the sweep, then those that did not.

    Attributes:
        row: (K,) row of the return in the sweep, -1 where there is none.
        ring: (K,) beam, -1 where it is not known.
        column: (K,) azimuth column, -1 where it is not known.
        start_m: (K, 3) float64 metres.
        direction: (K, 3) float64 unit vectors.
        depth_m: (K,) float64 metres from the start to the return, +inf where there is none.
    """

    row: NDArray[np.intp]
    ring: NDArray[np.intp]
    column: NDArray[np.intp]
    start_m: Floats
    direction: Floats
    depth_m: Floats

    def __len__(self) -> int:
        return len(self.row)

    def select(self, keep: NDArray[Any]) -> Rays:
        """Return the rays that ``keep`` ((K,) mask or indices) names."""
        return Rays(*(getattr(self, f.name)[keep] for f in fields(self)))

    def at(self, depth_m: Floats) -> NDArray[np.float32]:
        """Return the points (K, 3) float32 at depths (K,) in metres."""
        return (self.start_m + depth_m[:, None] * self.direction).astype(np.float32)


def within(points: NDArray[Any], wedge: Wedge) -> Mask:
    """Return which points (K, 3) lie in the wedge, clear of its edges by more than rounding can move them."""
    if wedge.width >= 2 * np.pi:
        return np.ones(len(points), np.bool_)
    x, y = points[:, 0].astype(np.float64), points[:, 1].astype(np.float64)
    range_m = np.sqrt(x * x + y * y)
    forward = x * np.cos(wedge.azimuth) + y * np.sin(wedge.azimuth)
    inside: Mask = (forward >= np.cos(max(wedge.width / 2 - _EDGE, 0.0)) * range_m) & (range_m > 0)
    return inside


def rays_in(sweep: Sweep, wedge: Wedge, *, empty: bool = False) -> Rays:
    """Return the beams of ``sweep`` that returned in the wedge and, with ``empty``, those there that did not.

    Raises:
        ValueError: ``empty`` beams are asked for and the sweep's beams cannot be told.
    """
    lattice = lattice_of(sweep)
    if empty and lattice is None and len(sweep):
        raise ValueError(
            f"the beams of this sweep must be known, got {len(sweep)} points without rings; name the sensor, give "
            "rings, or use an attack that is free of beams"
        )
    returned = _returned(sweep, lattice, np.flatnonzero(within(sweep.points, wedge)))
    if not empty or lattice is None:
        return returned
    missing = _missing(lattice, wedge)
    return Rays(*(np.concatenate([getattr(returned, f.name), getattr(missing, f.name)]) for f in fields(Rays)))


def _returned(sweep: Sweep, lattice: Lattice | None, row: NDArray[np.intp]) -> Rays:
    if lattice is not None:
        ring, column = lattice.ring[row].astype(np.intp), lattice.firing.column[row].astype(np.intp)
        return Rays(row, ring, column, *lattice.of_returns(sweep.points, row))
    unknown, reach = np.full(len(row), -1), sweep.points[row].astype(np.float64)
    depth_m = np.sqrt((reach * reach).sum(axis=1))
    return Rays(row, unknown, unknown, np.zeros((len(row), 3)), reach / np.maximum(depth_m, 1e-9)[:, None], depth_m)


def _missing(lattice: Lattice, wedge: Wedge) -> Rays:
    ring, column = np.nonzero(lattice.empty)
    start_m, direction = lattice.of_pixels(ring, column)
    none = np.full(len(ring), -1)
    missing = Rays(none, ring, column, start_m, direction, np.full(len(ring), np.inf))
    return missing if wedge.width >= 2 * np.pi else missing.select(within(direction, wedge))
