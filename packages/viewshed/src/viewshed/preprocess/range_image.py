"""The range image of a sweep: the beam of each return; isolated returns and clutter.

Rows are rings, the lowest first; columns are firings. Column 0 begins behind the sensor (azimuth -π), and columns count
counter-clockwise.

A return is isolated if no neighboring pixel has a similar range (ratio < 1.25). A surface is hit by several neighboring
beams, unless it is thinner than the gaps between them or seen through a hole. So an isolated return proves neither a
surface nor free space in front of it: it may be noise, rain, light of another sensor, or a spoofed point. In clear air
about one return in 200 is isolated. If many are (snow, fog, jamming), random returns have similar ranges by chance:
then several neighbors must confirm a return, else it is clutter.
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
    """The N returns of a sweep on an image of rings × columns; read-only."""

    ring: NDArray[np.int16]  # (N,) int16 row of each return; -1 if it matches no beam
    column: NDArray[np.int32]  # (N,) int32 column of each return; -1 if it has no row or is clutter
    counts: NDArray[np.uint8]  # (rings, columns) uint8 number of returns of each pixel, up to 255
    # (rings, columns) float32 squared distance from the sensor to the nearest return of each pixel within the sweep's
    # range limits; +inf for none
    squared_range_m2: F32
    phase: F32  # (rings,) float32 in [0, 1): position of a ring's firings within its columns
    # (rings,) float64 radians of each ring's beams above the horizon; NaN if the sensor is unknown
    elevation: NDArray[np.float64]
    origin_m: NDArray[np.float64]  # (rings,) float64 height of each ring's beams above the sensor's origin at range 0
    # whether each pixel is one beam: elevations are known, and full rings have about as many returns as there are
    # columns; if False, a pixel without a return carries no information
    pixels_are_beams: bool
    isolated: Mask  # (N,) bool, returns without a neighbor of similar range, and clutter
    behind: Mask  # (N,) bool, isolated returns behind another return of their pixel, where the beam had already ended
    # (N,) bool, returns confirmed by too few neighbors, in a sweep with many isolated returns; None for other sweeps
    clutter: Mask | None

    @property
    def columns(self) -> int:
        """Number of columns of a revolution."""
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
    """Layout of a range image: row of each return, number of columns, beams of the rows."""

    ring: NDArray[np.int16]  # (N,) int16 row of each return; -1 if it matches no beam
    columns: int  # number of columns of a revolution
    elevation: NDArray[np.float64]  # (rings,) float64 radians above the horizon; NaN if the sensor is unknown
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
        """Return the range image from the arrays of the core."""
        for array in (column, counts, nearest_m2, phase, isolated, behind, *(() if clutter is None else (clutter,))):
            array.setflags(write=False)
        pixels_are_beams = bool(np.isfinite(self.elevation).all()) and has_full_rings
        return RangeImage(
            self.ring, column, counts, nearest_m2, phase, self.elevation, self.origin_m, pixels_are_beams, isolated,
            behind, clutter,
        )  # fmt: skip

    def image_of(self, points: F32, limits_m: tuple[float, float]) -> RangeImage:
        """Return the range image of points (N, 3); returns outside ``limits_m`` confirm none and are never isolated."""
        return self.image(*_core.range_image(points, self.ring, self.columns, len(self.elevation), *limits_m))


def pixels_of(sensor_id: SensorId) -> Pixels | None:
    """Return the pixels by the rings of a sweep and its sensor's columns; None if the rings are unknown.

    Without a sensor the number of columns is a default, which is good enough to find isolated returns.
    """
    ring, model = sensor_id.ring, sensor_id.model
    if ring is None or len(ring) == 0:
        return None
    if model is None:
        unknown = np.full(int(ring.max()) + 1, np.nan)
        return Pixels(ring, DEFAULT_COLUMNS, unknown, np.zeros(len(unknown)))
    return Pixels(ring, model.azimuth_columns, model.elevation, model.origin_m)


def range_image_by_rings(points: F32, rings: RingAssignment, limits_m: tuple[float, float]) -> RangeImage:
    """Return the range image of points (N, 3) by recovered rings, with their columns and elevations."""
    pixels = Pixels(rings.ring, rings.columns, rings.elevation, np.zeros(rings.rings))
    return replace(pixels.image_of(points, limits_m), pixels_are_beams=rings.source != "elevation bins")
