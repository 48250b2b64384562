"""The range image of a sweep: which beam measured each return, and which returns nothing around confirms.

Rows are rings, the lowest first; columns are firings. Column 0 begins behind the sensor (azimuth -π), and columns count
counter-clockwise.

A return is isolated if no neighboring pixel has a similar range (ratio < 1.25). A surface that a beam meets is met by
some of the beams beside it as well, unless it is thinner than the gaps between them or seen through a hole. So an
isolated return proves neither a surface nor a free way to it: it may be noise, rain, light of another sensor, or a
point that somebody put there. Of a sweep in clear air they are about one return in 200. Where they are many, in snow,
fog or under jamming, chance makes random returns similar: then several of those around a return must confirm it, or it
is clutter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import F32, Mask
from viewshed.preprocess.ring_recovery import DEFAULT_COLUMNS, RingAssignment
from viewshed.preprocess.sensor_identification import SensorId


@dataclass(frozen=True, slots=True, eq=False)
class RangeImage:
    """The N returns of a sweep on an image of rings × columns; made once for a sweep, read-only."""

    ring: NDArray[np.int16]  # (N,) int16 row of each return; -1 where no beam explains it
    column: NDArray[np.int32]  # (N,) int32 column of each return; -1 where it has no row, or is clutter
    counts: NDArray[np.uint8]  # (rings, columns) uint8 returns of each pixel, up to 255
    # (rings, columns) float32 squared distance from the sensor to the nearest return of each pixel within the sweep's
    # limits of range; +inf for none
    squared_range_m2: F32
    phase: F32  # (rings,) float32 in [0, 1): where in its columns a ring fires
    # (rings,) float64 radians of each ring's beams above the horizon; NaN where the sensor is not known
    elevation: NDArray[np.float64]
    origin_m: NDArray[np.float64]  # (rings,) float64 height of each ring's beams above the sensor's origin at range 0
    # whether each pixel stands for one beam: elevations are known, and the rings are about as full as the columns are
    # many. Else a pixel without a return says nothing.
    pixels_are_beams: bool
    isolated: Mask  # (N,) bool, returns with no return around at a similar range; and clutter
    behind: Mask  # (N,) bool, isolated returns behind another one of their own pixel: the beam had ended before
    # (N,) bool, returns that too few around confirm, of a sweep with many isolated ones; None for any other
    clutter: Mask | None

    @property
    def columns(self) -> int:
        """Columns of a revolution."""
        return int(self.counts.shape[1])

    @property
    def range_m(self) -> F32:
        """Distance (rings, columns) in meters from the sensor to the nearest return of each pixel; +inf for none."""
        range_m: F32 = np.sqrt(self.squared_range_m2)
        return range_m

    def pixels_without(self, left_out: Mask) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
        """Return ``column`` (N,) and ``counts`` (rings, columns) without the returns ``left_out`` (N,)."""
        return _core.pixels_without(self.ring, left_out, self.column, self.counts)


@dataclass(frozen=True, slots=True, eq=False)
class Pixels:
    """Where the returns of a sweep go on its range image, and where the beams of its rows point."""

    ring: NDArray[np.int16]  # (N,) int16 row of each return; -1 where no beam explains it
    columns: int  # of a revolution
    elevation: NDArray[np.float64]  # (rings,) float64 radians above the horizon; NaN where the sensor is not known
    origin_m: NDArray[np.float64]  # (rings,) float64 height above the sensor's origin at range 0

    def image(
        self,
        column: NDArray[np.int32],
        counts: NDArray[np.uint8],
        nearest_m2: F32,
        phase: F32,
        isolated: Mask,
        behind: Mask,
        clutter: Mask | None,
        has_full_rings: bool,
    ) -> RangeImage:
        """Return the range image of what the core found."""
        for array in (column, counts, nearest_m2, phase, isolated, behind, *(() if clutter is None else (clutter,))):
            array.setflags(write=False)
        fits = bool(np.isfinite(self.elevation).all()) and has_full_rings
        return RangeImage(
            self.ring, column, counts, nearest_m2, phase, self.elevation, self.origin_m, fits, isolated, behind, clutter
        )

    def image_of(self, points: F32, limits_m: tuple[float, float]) -> RangeImage:
        """Return the range image of points (N, 3); returns outside ``limits_m`` confirm none and are not isolated."""
        return self.image(*_core.range_image(points, self.ring, self.columns, len(self.elevation), *limits_m))


def pixels_of(sensor_id: SensorId) -> Pixels | None:
    """Return the pixels by the rings of a sweep and its sensor's columns; None where rings are unknown.

    Columns somewhat too wide or too narrow still show which returns are isolated.
    """
    ring, model = sensor_id.ring, sensor_id.model
    if ring is None or len(ring) == 0:
        return None
    if model is None:
        unknown = np.full(int(ring.max()) + 1, np.nan)
        return Pixels(ring, DEFAULT_COLUMNS, unknown, np.zeros(len(unknown)))
    return Pixels(ring, model.azimuth_columns, model.elevation, model.origin_m)


def range_image_by_rings(points: F32, rings: RingAssignment, limits_m: tuple[float, float]) -> RangeImage:
    """Return the range image of points (N, 3) by recovered rings and the columns and elevations measured with them."""
    pixels = Pixels(rings.ring, rings.columns, rings.elevation, np.zeros(rings.rings))
    return replace(pixels.image_of(points, limits_m), pixels_are_beams=rings.source != "elevation bins")
