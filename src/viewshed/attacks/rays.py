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
    narrow = Wedge(wedge.azimuth, max(wedge.width - 2 * _EDGE, _EDGE))
    xy = points[:, :2].astype(np.float64)
    return narrow.holds(np.arctan2(xy[:, 1], xy[:, 0]))


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
    if lattice is None:
        unknown = np.full(len(row), -1)
        ring, column, start_m = unknown, unknown, np.zeros((len(row), 3))
    else:
        ring, column = lattice.ring[row].astype(np.intp), lattice.firing.column[row].astype(np.intp)
        start_m = lattice.starts_m(ring, column)
    reach = sweep.points[row] - start_m
    depth_m = np.sqrt((reach * reach).sum(axis=1))
    return Rays(row, ring, column, start_m, reach / np.maximum(depth_m, 1e-9)[:, None], depth_m)


def _missing(lattice: Lattice, wedge: Wedge) -> Rays:
    ring, column = np.nonzero(lattice.empty)
    direction = lattice.directions(ring, column)
    keep = within(direction, wedge)
    ring, column = ring[keep], column[keep]
    none = np.full(len(ring), -1)
    return Rays(none, ring, column, lattice.starts_m(ring, column), direction[keep], np.full(len(ring), np.inf))
