"""The range image of a sweep: which beam measured each return, and which returns nothing around confirms.

Rows are rings, the lowest first; columns are firings. Column 0 begins behind the sensor (azimuth -π), and columns count
counter-clockwise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed._numba import BLOCK, atan2, split
from viewshed.preprocess.isolated_returns import find_clutter, find_isolated_returns, is_cluttered
from viewshed.preprocess.ring_recovery import RingAssignment
from viewshed.preprocess.sensor_identification import SensorId

DEFAULT_COLUMNS = 1024
"""Columns of a revolution where the sensor is not known."""

FULL_COUNT = 255
"""Pixels count their returns up to this number."""

AWAKE_SHARE = 0.5
"""A column that returned from less than this share of the usual number of rings did not fire, or hardly."""

_FULL_RING = 0.9
"""A ring with at least this share of its columns' returns is full; the median of these may have no more than ..."""

_FULLEST_RING = 1.05
"""... this share. A few rings with points added do not matter."""

_PHASES = 16

Floats = NDArray[np.float32]

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class RangeImage:
    """The N returns of a sweep on an image of rings × columns; made once for a sweep, read-only.

    Attributes:
        ring: (N,) int16 row of each return; -1 where no beam explains it.
        column: (N,) int32 column of each return; -1 where it has no row, or is clutter.
        counts: (rings, columns) uint8 returns of each pixel, up to 255.
        squared_range_m2: (rings, columns) float32 squared distance from the sensor to the nearest return of each pixel
            within the sweep's limits of range; +inf for none.
        phase: (rings,) float32 in [0, 1): where in its columns a ring fires.
        elevation: (rings,) float64 radians of each ring's beams above the horizon; NaN where the sensor is not known.
        origin_m: (rings,) float64 height of each ring's beams above the sensor's origin at range 0.
        pixels_are_beams: whether each pixel stands for one beam: elevations are known, and the rings are about as full
            as the columns are many. Else a pixel without a return says nothing.
        isolated: (N,) bool, returns with no return around at a similar range; and clutter.
        behind: (N,) bool, isolated returns behind another one of their own pixel: the beam had ended before.
        clutter: (N,) bool, returns that too few around confirm, of a sweep with many isolated ones; None for any other.
    """

    ring: NDArray[np.int16]
    column: NDArray[np.int32]
    counts: NDArray[np.uint8]
    squared_range_m2: Floats
    phase: Floats
    elevation: NDArray[np.float64]
    origin_m: NDArray[np.float64]
    pixels_are_beams: bool
    isolated: Mask
    behind: Mask
    clutter: Mask | None

    @property
    def columns(self) -> int:
        """Columns of a revolution."""
        return int(self.counts.shape[1])

    @property
    def range_m(self) -> Floats:
        """Distance (rings, columns) in meters from the sensor to the nearest return of each pixel; +inf for none."""
        range_m: Floats = np.sqrt(self.squared_range_m2)
        return range_m

    def pixels_without(self, left_out: Mask) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
        """Return ``column`` (N,) and ``counts`` (rings, columns) without the returns ``left_out`` (N,)."""
        column, counts = self.column.copy(), self.counts.copy()
        _take_out(self.ring, left_out, column, counts)
        return column, counts


def range_image_by_sensor(points: Floats, sensor_id: SensorId, limits_m: tuple[float, float]) -> RangeImage | None:
    """Return the range image of points (N, 3) by their rings and their sensor's columns; None where rings are unknown.

    Columns somewhat too wide or too narrow still show which returns are isolated.
    """
    ring, model = sensor_id.ring, sensor_id.model
    if ring is None or len(points) == 0:
        return None
    if model is None:
        unknown = np.full(int(ring.max()) + 1, np.nan)
        return _range_image(points, ring, DEFAULT_COLUMNS, unknown, np.zeros(len(unknown)), limits_m)
    return _range_image(points, ring, model.azimuth_columns, model.elevation, model.origin_m, limits_m)


def range_image_by_rings(points: Floats, rings: RingAssignment, limits_m: tuple[float, float]) -> RangeImage:
    """Return the range image of points (N, 3) by recovered rings and the columns and elevations measured with them."""
    image = _range_image(points, rings.ring, rings.columns, rings.elevation, np.zeros(rings.rings), limits_m)
    return replace(image, pixels_are_beams=rings.source != "elevation bins")


def _range_image(
    points: Floats,
    ring: NDArray[np.int16],
    columns: int,
    elevation: NDArray[np.float64],
    origin_m: NDArray[np.float64],
    limits_m: tuple[float, float],
) -> RangeImage:
    """Return the range image of points (N, 3); returns outside ``limits_m`` confirm none and are not isolated."""
    # 1. The pixel of each return.
    column, phase, counts, ring_sizes = assign_pixels(points, ring, columns, len(elevation))
    # 2. The nearest return of each pixel.
    near_m, far_m = np.float32(limits_m[0]), np.float32(limits_m[1])
    squared_m2, nearest_m2 = _nearest_returns(points, ring, column, near_m, far_m, len(elevation), columns)
    # 3. Isolated returns: no pixel around has a similar range.
    isolated, behind = find_isolated_returns(ring, column, squared_m2, nearest_m2, silent_columns(counts))
    clutter = None
    if is_cluttered(isolated):
        # 4. Where many are isolated, chance makes random returns similar. What too few around confirm is clutter and
        #    leaves the image; then isolated returns are found again.
        clutter = find_clutter(ring, column, squared_m2, nearest_m2, isolated, limits_m[0])
        _take_out(ring, clutter, column, counts)
        squared_m2, nearest_m2 = _nearest_returns(points, ring, column, near_m, far_m, len(elevation), columns)
        isolated, behind = find_isolated_returns(ring, column, squared_m2, nearest_m2, silent_columns(counts))
        isolated |= clutter
    fits = bool(np.isfinite(elevation).all()) and _rings_are_full(ring_sizes, columns)
    image = RangeImage(
        ring, column, counts, nearest_m2, phase, elevation, origin_m, fits, isolated, behind, clutter
    )  # fmt: skip
    for array in (column, counts, nearest_m2, phase, isolated, behind, *(() if clutter is None else (clutter,))):
        array.setflags(write=False)
    return image


def _rings_are_full(ring_sizes: NDArray[np.int64], columns: int) -> bool:
    """Return whether the full rings hold about one return a column: the sensor fires as often as the image assumes."""
    full = np.sort(ring_sizes[ring_sizes >= _FULL_RING * columns])
    return bool(full.size and (full[(full.size - 1) // 2] + full[full.size // 2]) / 2 <= _FULLEST_RING * columns)


@njit(cache=True, nogil=True, error_model="numpy")
def assign_pixels(points: Any, ring: Any, columns: int, rings: int) -> Any:  # pragma: no cover - compiled
    """Return each point's column (N,), each ring's phase (rings,), and the points of each pixel and of each ring.

    The phase says where in its columns a ring fires, so that a firing just at an edge does not fall into either column
    by chance: the circular mean of the azimuths' remainders, from a histogram, so that the order of the points does not
    matter. A point without a ring has column -1.
    """
    # Each position is read before its column is written over it: fresh memory costs more than the sums.
    position = np.empty(points.shape[0], np.float32)
    column = position.view(np.int32)
    phases = np.zeros((rings, _PHASES), np.int32)
    counts = np.zeros((rings, columns), np.uint8)
    _positions(points, ring, np.float32(columns / (2 * np.pi)), position, phases)
    phase = _circular_means(phases)
    # A column reaches half a step to either side of its firing: + 0.5 - phase, and one turn so that it is not negative.
    start = np.float32(columns + 0.5) - phase
    flat, turn = counts.reshape(-1), np.int32(columns)
    for n in range(points.shape[0]):
        c = np.int32(-1)
        if ring[n] >= 0:
            r = np.uint32(ring[n])
            c = np.int32(position[n] + start[r])
            # Into [0, columns): up to two turns too many. Subtracting is faster than a division.
            c -= turn if c >= turn else np.int32(0)
            c -= turn if c >= turn else np.int32(0)
            pixel = r * np.uint32(turn) + np.uint32(c)
            flat[pixel] += flat[pixel] < FULL_COUNT
        column[n] = c
    return column, phase, counts, phases.sum(axis=1)


@njit(cache=True, nogil=True, error_model="numpy")
def _positions(points: Any, ring: Any, per_rad: Any, position: Any, phases: Any) -> None:  # pragma: no cover - compiled
    """Write the azimuth (N,) of each point in columns, from 0, and count its phase (rings, _PHASES)."""
    x, y, z = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    phase = np.empty(BLOCK, np.int32)
    for start in range(0, points.shape[0], BLOCK):
        count = split(points, start, x, y, z)
        _positions_of_block(x[:count], y[:count], per_rad, position[start : start + count], phase)
        rings = ring[start : start + count]
        for k in range(count):
            if rings[k] >= 0:
                phases[np.uint32(rings[k]), np.uint32(phase[k])] += 1


@njit(cache=True, nogil=True, error_model="numpy")
def _positions_of_block(x: Any, y: Any, per_rad: Any, position: Any, phase: Any) -> None:  # pragma: no cover - compiled
    """Two loops without branches, so that both vectorize."""
    for k in range(x.shape[0]):
        position[k] = (atan2(y[k], x[k]) + np.float32(np.pi)) * per_rad
    for k in range(x.shape[0]):
        phase[k] = np.int32(position[k] * np.float32(_PHASES)) % np.int32(_PHASES)


@njit(cache=True, nogil=True, error_model="numpy")
def _circular_means(phases: Any) -> Any:  # pragma: no cover - compiled
    """Return the circular mean of each row of a histogram over [0, 1)."""
    mean = np.full(phases.shape[0], 0.5, np.float32)
    for r in range(phases.shape[0]):
        x, y = 0.0, 0.0
        for p in range(_PHASES):
            angle = 2 * np.pi * (p + 0.5) / _PHASES
            x += phases[r, p] * np.cos(angle)
            y += phases[r, p] * np.sin(angle)
        if x * x + y * y > 1e-6:
            mean[r] = np.arctan2(y, x) / (2 * np.pi) % 1.0
    return mean


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest_returns(
    points: Any, ring: Any, column: Any, near_m: Any, far_m: Any, rings: int, columns: int
) -> Any:  # pragma: no cover - compiled
    """Return each point's squared distance (N,), -1 where it is not used, and the least of each pixel, +inf for none.

    Not used are points without a pixel and those nearer than ``near_m`` or farther than ``far_m``.
    """
    near2, far2 = near_m * near_m, far_m * far_m
    squared, nearest = np.empty(points.shape[0], np.float32), np.full((rings, columns), np.inf, np.float32)
    x, y, z = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    for start in range(0, points.shape[0], BLOCK):
        count = split(points, start, x, y, z)
        block = slice(start, start + count)
        rows, cols, away2 = ring[block], column[block], squared[block]
        for k in range(count):
            d2 = x[k] * x[k] + y[k] * y[k] + z[k] * z[k]
            away2[k] = d2 if (d2 >= near2) & (d2 <= far2) & (cols[k] >= 0) else np.float32(-1.0)
        for k in range(count):
            if away2[k] >= 0.0:
                r, c = np.uint32(rows[k]), np.uint32(cols[k])
                nearest[r, c] = min(nearest[r, c], away2[k])
    return squared, nearest


@njit(cache=True, nogil=True, error_model="numpy")
def silent_columns(counts: Any) -> Any:  # pragma: no cover - compiled
    """Return the columns that returned from less than ``AWAKE_SHARE`` as many rings as the median of those that did.

    They were dropped, or lie at the edge of a dropped sector, whatever a few points in them say.
    """
    rings = np.zeros(counts.shape[1], np.int32)
    for r in range(counts.shape[0]):
        for c in range(counts.shape[1]):
            rings[c] += counts[r, c] > 0
    some = np.sort(rings[rings > 0])
    least = AWAKE_SHARE * some[some.shape[0] // 2] if some.shape[0] else 0.0
    return (rings == 0) | (rings < least)


@njit(cache=True, nogil=True, error_model="numpy")
def _take_out(ring: Any, left_out: Any, column: Any, counts: Any) -> None:  # pragma: no cover - compiled
    """Take returns out of their pixels, in place.

    Pixels that were full stay so: how many more returns they hold is not known.
    """
    full = counts == FULL_COUNT
    for n in range(left_out.shape[0]):
        if left_out[n] and column[n] >= 0:
            r, c = np.uint32(ring[n]), np.uint32(column[n])
            counts[r, c] -= not full[r, c]
            column[n] = -1
