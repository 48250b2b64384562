"""From what an attacker added and removed to the sweep that the victim reads: rows in firing order, all columns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64, Mask
from viewshed.sweep import Sweep
from viewshed_lab.threats.attacks.base import Tampered, Wedge
from viewshed_lab.threats.attacks.beam_lattice import BeamLattice, lattice_of

COLUMNS = ("points", "intensity", "ring", "azimuth", "time_s")
"""What a sweep has of each return."""


@dataclass(frozen=True, slots=True, eq=False)
class Forged:
    """A returns that an attacker makes."""

    points: NDArray[np.float32]  # (A, 3) float32 meters, sensor frame
    ring: NDArray[Any]  # (A,) beam, -1 where it is not known
    column: NDArray[Any]  # (A,) azimuth column, -1 where it is not known
    row: NDArray[np.intp]  # (A,) row of the return that each replaces, -1 where it replaces none


def untouched(sweep: Sweep, wedge: Wedge | None = None) -> Tampered:
    """Return the sweep as it is."""
    none = np.zeros(len(sweep), np.bool_)
    return Tampered(sweep, none, none, wedge)


def assemble(sweep: Sweep, removed: Mask, forged: Forged, wedge: Wedge | None, rng: np.random.Generator) -> Tampered:
    """Return the sweep without the rows ``removed`` (N,) and with what is forged, each where a sensor would store it.

    A return that replaces another takes its place, its ring, azimuth and time; any other is stored next to its
    neighbor on the beams. Intensities are drawn from those of the sweep.
    """
    # Sort what is forged among the rows that are kept: a key is a row, or lies between two.
    source, key = _neighbors(sweep, forged)
    order = np.argsort(key, kind="stable")
    kept = np.flatnonzero(~removed)
    index = np.insert(kept, np.searchsorted(kept, key[order]), len(sweep) + order)
    columns = {"points": forged.points} | _columns(sweep, forged, source, rng)
    changed = {name: np.concatenate([getattr(sweep, name), column])[index] for name, column in columns.items()}
    return Tampered(sweep.replace(**changed), index >= len(sweep), removed, wedge)


def add_points(sweep: Sweep, points: NDArray[Any], rng: np.random.Generator) -> Tampered:
    """Return the sweep with points (A, 3) added anywhere, each stored next to the return of the nearest beam."""
    points = points.astype(np.float32)
    ring = column = none = np.full(len(points), -1)
    lattice = lattice_of(sweep)
    if lattice is not None:
        ring, column = lattice.nearest_pixels(points)
    elif sweep.model is not None:
        x, y, z = points.T.astype(np.float64)
        ring = np.abs(np.arctan2(z, np.hypot(x, y))[:, None] - sweep.model.elevation).argmin(axis=1)
    return assemble(sweep, np.zeros(len(sweep), np.bool_), Forged(points, ring, column, none), None, rng)


def _neighbors(sweep: Sweep, forged: Forged) -> tuple[NDArray[np.intp], F64]:
    """Return the row (A,) that each is like, -1 where there is none, and a key (A,) that sorts it among the rows."""
    row, key = forged.row.copy(), forged.row.astype(np.float64)
    alone = np.flatnonzero(row < 0)
    key[alone] = len(sweep)
    lattice = lattice_of(sweep)
    if lattice is not None and len(alone):
        row[alone], key[alone] = lattice.storage_keys(forged.ring[alone], forged.column[alone])
    return row, key


def _columns(
    sweep: Sweep, forged: Forged, source: NDArray[np.intp], rng: np.random.Generator
) -> dict[str, NDArray[Any]]:
    """Return the columns of what is forged, for those that the sweep has."""
    columns: dict[str, NDArray[Any]] = {}
    if sweep.intensity is not None:
        some = sweep.intensity if len(sweep) else np.zeros(1, np.float32)
        columns["intensity"] = some[rng.integers(len(some), size=len(source))]
    if sweep.ring is not None:
        like = _take(sweep.ring, source, np.int16(0))
        columns["ring"] = np.where(forged.ring >= 0, forged.ring, like).astype(np.int16)
    if sweep.azimuth is not None:
        aimed = np.arctan2(forged.points[:, 1], forged.points[:, 0])
        columns["azimuth"] = np.where(source >= 0, _take(sweep.azimuth, source, np.float32(0)), aimed)
    if sweep.time_s is not None:
        columns["time_s"] = _times(sweep.time_s, forged, source, lattice_of(sweep))
    return columns


def _take(column: NDArray[Any], source: NDArray[np.intp], default: Any) -> NDArray[Any]:
    """Return the values of ``column`` at ``source`` (A,), ``default`` where that is -1."""
    return np.append(column, default)[source]


def _times(
    time_s: NDArray[np.float32], forged: Forged, source: NDArray[np.intp], lattice: BeamLattice | None
) -> NDArray[np.float32]:
    """Return times (A,): those of the columns where they are known, else of the neighbors."""
    times = _take(time_s, source, np.float32(0))
    if lattice is not None and lattice.firing.time_s is not None:
        times = np.where(forged.row >= 0, times, lattice.firing.time_s[forged.column])
    return times.astype(np.float32)
