"""The beams of a sweep: which pixel (ring, column) each return has, which are empty, where each starts and points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.attacks.firing_fit import Firing, at_rest, even_azimuths, fitted
from viewshed.attacks.lattice_kernels import empty_pixels, fired, neighbors, pixel_rows, returned
from viewshed.beams import Beams, recover_beams
from viewshed.sensors import LidarModel
from viewshed.sim.optics import step_of
from viewshed.sweep import Sweep

JITTER_COLUMNS = 4
"""Where azimuths jitter, a return may lie this many columns from its firing."""
_SAMPLED = 4000
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """The beams of one sweep, R rings by C columns.

    Attributes:
        ring: (N,) int16 beam of each return, -1 where none explains it.
        elevation: (R,) float64 radians.
        azimuth_offset: (R,) float64 radians against the firing azimuth.
        origin_m: (R,) float64 height of the start of each beam.
        firing: when and from where each column was fired.
        rows: (R, C) int32 row of the first return of each pixel, -1 where there is none.
        empty: (R, C) bool, beams that were fired and did not return.
        step_m: the sensor's step of range, 0 where it is not known.
        by_column: the sweep is stored column by column, not ring by ring.
        sense: +1 where ring (or column) ascends within a column (or ring) as it is stored, else -1.
        seam: where the sweep is stored ring by ring, the lowest column that lies at an end of the stored rings.
    """

    ring: NDArray[np.int16]
    elevation: Floats
    azimuth_offset: Floats
    origin_m: Floats
    firing: Firing
    rows: NDArray[np.int32]
    empty: NDArray[np.bool_]
    step_m: float
    by_column: bool
    sense: int
    seam: int

    def of_returns(self, points: NDArray[np.float32], row: NDArray[np.intp]) -> tuple[Floats, Floats, Floats]:
        """Return starts (K, 3) in metres, directions (K, 3) and depths (K,) in metres of the beams of some returns."""
        pixels = self.ring[row], self.firing.column[row]
        up = np.ascontiguousarray(self.firing.turn[:, :, 2])
        found: tuple[Floats, Floats, Floats] = returned(points, row, pixels, self.origin_m, (up, self.firing.shift_m))
        return found

    def of_pixels(self, ring: NDArray[Any], column: NDArray[Any]) -> tuple[Floats, Floats]:
        """Return starts (K, 3) in metres and directions (K, 3) of the beams of pixels (K,)."""
        shape = self.elevation, self.azimuth_offset, self.origin_m
        poses = self.firing.turn, self.firing.shift_m
        found: tuple[Floats, Floats] = fired((ring, column), shape, self.firing.azimuth, poses)
        return found

    def nearest_pixels(self, points: NDArray[Any]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the ring and column (K,) of the beams that pass nearest to points (K, 3), seen from the sensor."""
        x, y, z = points.astype(np.float64).T
        rings = np.argsort(self.elevation, kind="stable")
        ascending = self.elevation[rings]
        elevation = np.arctan2(z - float(np.median(self.origin_m)), np.hypot(x, y))
        ring = rings[np.searchsorted((ascending[1:] + ascending[:-1]) / 2, elevation)]
        step = 2 * np.pi / len(self.firing.azimuth)
        column = np.rint((np.arctan2(y, x) - self.azimuth_offset[ring] - self.firing.azimuth[0]) / step)
        return ring, column.astype(np.intp) % len(self.firing.azimuth)

    def places(self, ring: NDArray[Any], column: NDArray[Any]) -> tuple[NDArray[np.int64], Floats]:
        """Return the row of the nearest return (K,) and a key (K,) that sorts pixels among the sweep's rows.

        A key is a row, plus less than one half in the order of storage; both are -1 and N for a sweep without returns.
        """
        rows = self.rows if self.by_column else np.roll(self.rows, -self.seam, axis=1)
        column = column if self.by_column else (column - self.seam) % rows.shape[1]
        found, ahead = neighbors(rows, ring, column, self.by_column)
        side = np.where(ahead >= 0, self.sense, -self.sense)
        key = found + side * (0.25 + 0.2 * np.minimum(np.abs(ahead) / self.rows.size, 1.0))
        return found, np.where(found >= 0, key, float(len(self.ring)))


@lru_cache(maxsize=2)
def lattice_of(sweep: Sweep) -> Lattice | None:
    """Return the beams of ``sweep``, or None where they cannot be told: no rings, not even by the order of the points.

    Exact where the returns lie on the beams of the sweep's model within 2 mm; else columns are those of the returns
    themselves and empty beams point where the median of their ring does.
    """
    model = sweep.model
    if model is not None and sweep.ring is not None:
        firing = fitted(sweep, model)
        if firing is not None:
            shape = (model.elevation, model.azimuth_offset, model.origin_m)
            return _lattice(sweep.ring, shape, firing, step_of(model))
    beams = recover_beams(sweep)
    if beams.source == "elevation bins" or len(sweep) == 0:
        return None
    return _lattice(beams.ring, _recovered_shape(beams, model), _recovered_firing(sweep, beams), 0.0)


def _lattice(ring: NDArray[np.int16], shape: tuple[Floats, Floats, Floats], firing: Firing, step_m: float) -> Lattice:
    exact = step_m > 0.0
    columns = len(firing.azimuth)
    rows, several = pixel_rows(ring, firing.column, len(shape[0]), columns)
    by_column, sense, ends = _order(ring, firing.column)
    if not exact and not by_column:
        several[ring[ends], firing.column[ends]] = True  # the end of a ring is as blurred as its azimuths
    empty = empty_pixels(rows, several, 0 if exact else JITTER_COLUMNS, exact)
    seam = 0 if by_column or len(ends) == 0 else _seam(firing.column[ends], columns)
    return Lattice(ring, *shape, firing, rows, empty, step_m, by_column, sense, seam)


def _seam(column: NDArray[np.int32], columns: int) -> int:
    """Return the column at which rings begin, by the circular mean of the columns at their ends."""
    turn = np.angle(np.exp(2j * np.pi * column / columns).sum()) / (2 * np.pi)
    return int(np.ceil(turn * columns)) % columns


def _recovered_shape(beams: Beams, model: LidarModel | None) -> tuple[Floats, Floats, Floats]:
    none = np.zeros(beams.rings)
    if model is not None and model.rings == beams.rings:
        return model.elevation, none, model.origin_m
    return beams.elevation, none, none


def _recovered_firing(sweep: Sweep, beams: Beams) -> Firing:
    """Columns of the returns themselves, their common phase at the middle of a column."""
    position = (np.arctan2(sweep.points[:, 1], sweep.points[:, 0]) + np.float32(np.pi)) / np.float32(beams.azimuth_step)
    sampled = position[:: max(len(position) // _SAMPLED, 1)].astype(np.float64)
    phase = float(np.angle(np.exp(2j * np.pi * sampled).sum())) / (2 * np.pi) % 1.0
    column = np.rint(position - np.float32(phase)).astype(np.int32) % beams.columns
    return Firing(column, even_azimuths(beams.columns, phase), *at_rest(beams.columns))


def _order(ring: NDArray[np.int16], column: NDArray[np.int32]) -> tuple[bool, int, NDArray[np.intp]]:
    """Return whether returns are stored column by column, in which sense, and the rows at the ends of stored rings."""
    up, along = np.diff(ring), np.diff(column)
    changes = up != 0
    by_column = bool(changes.sum() * 2 > len(up))
    steps = np.sign(up[along == 0]) if by_column else np.sign(along[~changes])
    last = np.flatnonzero(changes)
    return by_column, -1 if int(steps.sum()) < 0 else 1, np.concatenate([last, last + 1])
