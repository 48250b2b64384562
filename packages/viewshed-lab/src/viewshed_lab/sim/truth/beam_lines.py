"""Beams as lines over the plane, sorted by azimuth; exact truth and labels of real sweeps are counted on them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.arrays import F32
from viewshed.grid import BevGrid
from viewshed_lab._numba import atan2

LANES = 16
"""Number of beams of a ring in a tile, sorted by azimuth."""

SECTORS = 256
"""Sectors of azimuth in which the slopes of each ring are bounded."""

BEND, ALONG_X, ALONG_Y, RISE, SLOPE, STOP, REACH = range(7)
"""Rows of a beam as a line over the plane: distance at which it passes the sensor's reference position on the right,
horizontal unit direction, height at that point, slope (rise over run), run from there to its hit; for tiles: reach."""

_PI = np.float32(np.pi)


class SortedBeams(NamedTuple):
    """The lines of a revolution, ring by ring, sorted into as many azimuth bins as there are columns."""

    # (R, T, 7, LANES) float32 by ascending bin, padded with NaN; the first lane of the last row is the largest distance
    # of a tile's hits from the sensor
    tiles: F32
    starts: NDArray[np.int32]  # (bins + 1, R) int32 index of the first beam of each bin
    bounds: F32  # (2, SECTORS, R) float32 slopes, see :func:`slope_bounds`


@dataclass(frozen=True, slots=True, eq=False)
class BeamLines:
    """The beams of one revolution as line segments, ready for counting."""

    lines: F32  # (6, C·R) float32, rows ``BEND`` to ``STOP``
    azimuth: F32  # (C·R,) float32 of the beams
    sorted: SortedBeams  # the same, sorted by azimuth
    offset_m: np.float32  # largest horizontal distance of a beam's start from the reference position
    lowest_m: np.float32  # smallest height of a beam's start
    highest_m: np.float32  # largest height of a beam's start
    max_range_m: np.float32  # of the sensor

    @classmethod
    def of(cls, origin_m: F32, direction: F32, depth_m: F32, max_range_m: float, yaw: float = 0.0) -> BeamLines:
        """Return beams of starts and unit directions (C, R, 3) and depths (C, R) as lines in axes rotated by yaw."""
        farthest = np.float32(max_range_m)
        lines, azimuth = beam_lines(origin_m, direction, depth_m, np.cos(yaw), np.sin(yaw), farthest)
        rings = depth_m.shape[1]
        tiles, starts = sorted_tiles(lines, azimuth, rings)
        in_order = SortedBeams(tiles, starts, slope_bounds(lines[SLOPE], azimuth, rings))
        offset, lowest, highest = (np.float32(length) for length in extent_of(origin_m))
        return cls(lines, azimuth, in_order, offset, lowest, highest, farthest)


@njit(cache=True, nogil=True, error_model="numpy")
def extent_of(origin: Any) -> Any:
    """Return the largest horizontal distance of starts (C, R, 3) from the reference, and their height bounds."""
    apart2, lowest, highest = np.float32(0.0), np.float32(np.inf), np.float32(-np.inf)
    for c in range(origin.shape[0]):
        for k in range(origin.shape[1]):
            x, y, z = origin[c, k, 0], origin[c, k, 1], origin[c, k, 2]
            apart2, lowest, highest = max(apart2, x * x + y * y), min(lowest, z), max(highest, z)
    return np.sqrt(apart2), lowest, highest


@njit(cache=True, nogil=True, error_model="numpy")
def beam_lines(origin: Any, direction: Any, depth: Any, cos: Any, sin: Any, max_range: Any) -> Any:
    """Return lines (6, C·R) float32 in axes rotated by an angle (``cos``, ``sin``), and their azimuths (C·R,).

    ``origin`` and ``direction`` are (C, R, 3), ``depth`` (C, R). From above a beam is a ray: it passes the reference
    position at distance ``BEND`` and height ``RISE``, and ends after a run of ``STOP`` from there.
    """
    count = depth.size
    out, azimuth = np.empty((6, count), np.float32), np.empty(count, np.float32)
    start, unit, length = origin.reshape(-1, 3), direction.reshape(-1, 3), depth.reshape(-1)
    c, s = np.float32(cos), np.float32(sin)
    for n in range(count):
        dx, dy = c * unit[n, 0] + s * unit[n, 1], c * unit[n, 1] - s * unit[n, 0]
        ox, oy = c * start[n, 0] + s * start[n, 1], c * start[n, 1] - s * start[n, 0]
        flat = max(np.sqrt(dx * dx + dy * dy), np.float32(1e-6))
        inverse = np.float32(1.0) / flat
        ux, uy = dx * inverse, dy * inverse
        slope, begin = unit[n, 2] * inverse, ox * ux + oy * uy
        out[BEND, n], out[ALONG_X, n], out[ALONG_Y, n] = oy * ux - ox * uy, ux, uy
        out[RISE, n], out[SLOPE, n] = start[n, 2] - slope * begin, slope
        out[STOP, n] = begin + min(length[n], max_range) * flat
    for n in range(count):  # a separate loop, so that the one above is vectorized
        azimuth[n] = atan2(out[ALONG_Y, n], out[ALONG_X, n])
    return out, azimuth


@njit(cache=True, nogil=True, error_model="numpy")
def sorted_tiles(beams: Any, azimuth: Any, rings: Any) -> Any:
    """Return tiles and starts, see :class:`SortedBeams`, of lines (6, C·R), by a counting sort of each ring."""
    columns = azimuth.size // rings
    per_rad = np.float32(columns / (2 * np.pi))
    # Count the beams of each ring in each bin, then accumulate over the bins.
    starts = np.zeros((columns + 1, rings), np.int32)
    bins = np.empty(azimuth.size, np.int32)
    ring = 0
    for n in range(azimuth.size):
        bins[n] = min(max(int((azimuth[n] + _PI) * per_rad), 0), columns - 1)
        starts[bins[n] + 1, ring] += 1
        ring = ring + 1 if ring < rings - 1 else 0
    for b in range(columns):
        for k in range(rings):
            starts[b + 1, k] += starts[b, k]
    # Put each beam into the next free place of its bin.
    free = starts[:columns].copy()
    tiles = np.empty((rings, (columns + LANES - 1) // LANES, 7, LANES), np.float32)
    tiles[:, -1, :REACH], tiles[:, :, REACH] = np.float32(np.nan), np.float32(0.0)
    ring = 0
    for n in range(azimuth.size):
        position = free[bins[n], ring]
        free[bins[n], ring] = position + 1
        t, k = position // LANES, position % LANES
        for row in range(6):
            tiles[ring, t, row, k] = beams[row, n]
        bend, run = beams[BEND, n], beams[STOP, n]
        tiles[ring, t, REACH, 0] = max(tiles[ring, t, REACH, 0], np.sqrt(bend * bend + run * run))
        ring = ring + 1 if ring < rings - 1 else 0
    return tiles, starts


@njit(cache=True, nogil=True, error_model="numpy")
def slope_bounds(slope: Any, azimuth: Any, rings: Any) -> Any:
    """Return two bounds (2, SECTORS, R) of slopes (C·R,) that ascend with the ring.

    The largest slope of all rings up to this one, and the smallest of all rings from this one on, each over a sector of
    azimuth and its two neighbors.
    """
    per_rad = np.float32(SECTORS / (2 * np.pi))
    out = np.empty((2, SECTORS, rings), np.float32)
    out[0], out[1] = np.float32(-np.inf), np.float32(np.inf)
    ring = 0
    for n in range(azimuth.size):
        sector = min(max(int((azimuth[n] + _PI) * per_rad), 0), SECTORS - 1)
        out[0, sector, ring] = max(out[0, sector, ring], slope[n])
        out[1, sector, ring] = min(out[1, sector, ring], slope[n])
        ring = ring + 1 if ring < rings - 1 else 0
    # Make them ascend: the rings of a tilted sensor may cross.
    for sector in range(SECTORS):
        for k in range(1, rings):
            out[0, sector, k] = max(out[0, sector, k], out[0, sector, k - 1])
            back = rings - 1 - k
            out[1, sector, back] = min(out[1, sector, back], out[1, sector, back + 1])
    # Combine three sectors, so that a window of azimuth needs only every third.
    wide = np.empty_like(out)
    for sector in range(SECTORS):
        before, after = (sector - 1) % SECTORS, (sector + 1) % SECTORS
        for k in range(rings):
            wide[0, sector, k] = max(out[0, sector, k], out[0, before, k], out[0, after, k])
            wide[1, sector, k] = min(out[1, sector, k], out[1, before, k], out[1, after, k])
    return wide


@njit(cache=True, nogil=True, error_model="numpy")
def mark_stops(
    beams: Any, counts: Any, ground: Any, x0: Any, y0: Any, per_m: Any, cells: Any, low: Any, tops: Any, out: Any
) -> None:
    """Set ``out`` (targets, cells²) where a hit with ``counts`` (C·R,) lies between ``low`` and the target's top.

    ``beams`` are lines (6, C·R); ``ground`` (cells²,) is at the cell centers; ``x0`` and ``y0`` are the grid's corner,
    ``per_m`` cells per meter, ``cells`` cells per side; ``low`` and ``tops`` (targets,) are heights above the ground.
    """
    for n in range(beams.shape[1]):
        if counts[n]:
            bend, ux, uy, run = beams[BEND, n], beams[ALONG_X, n], beams[ALONG_Y, n], beams[STOP, n]
            u, v = (ux * run - bend * uy - x0) * per_m, (uy * run + bend * ux - y0) * per_m
            if u >= 0 and v >= 0 and u < cells and v < cells:
                cell = int(u) * cells + int(v)
                height = beams[RISE, n] + beams[SLOPE, n] * run - ground[cell]
                for k in range(tops.shape[0]):
                    if height > low and height <= tops[k]:
                        out[k, cell] = True


def stops_on_surfaces(
    lines: BeamLines, counts: NDArray[Any], ground: F32, grid: BevGrid, low_m: float, tops_m: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """Return the cells (targets, cells²) with a hit that counts (C·R,), from ``low_m`` to ``tops_m`` above ground."""
    out = np.zeros((len(tops_m), len(ground)), np.bool_)
    x0, y0 = (np.float32(corner) for corner in grid.origin_m)
    per_m, low = np.float32(1 / grid.cell_m), np.float32(low_m)
    mark_stops(lines.lines, counts, ground, x0, y0, per_m, grid.cells, low, tops_m, out)
    return out
