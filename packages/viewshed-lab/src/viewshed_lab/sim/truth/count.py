"""Count the beams that aim at a plate in each cell, and those that reach it.

Each beam is tested against the 4 x 4 cells of a patch; near the sensor, where the cells of a patch are far apart in
azimuth, 16 beams are tested against one cell. Both are vectorized, and both test every beam that may hit a plate.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.arrays import F32, Mask
from viewshed.fov.estimate import CellState
from viewshed.fov.visibility import Target
from viewshed.grid import BevGrid, polar_of_cells
from viewshed_lab._numba import atan2
from viewshed_lab.sim.truth.beam_lines import LANES, REACH, SECTORS, BeamLines, stops_on_surfaces

MANY = 255
"""Largest count of beams."""

BELOW_GROUND_M = 0.02
"""Depth below the ground of the cell's center down to which beams that cross the plate count: the rise of the ground
over half the width of a car at a crown of 2 %."""

_NEAR = np.float32(20.0 * 2.0 * np.pi)
"""A patch is near if its cells spread over more than 20 columns (times 2π)."""

_FULL = np.int32(255 * 65537)
"""Packed count: 255 beams aim, and 255 reach."""

_AZIMUTH_MARGIN = np.float32(1e-4)

_SLOPE_MARGIN = np.float32(1e-5)
"""Margins of windows against rounding."""

_SIDE = 4
"""Cells along a side of a patch."""

_ROUNDING = 1e-6
_PI = np.float32(np.pi)
FREE, SURFACE, HIDDEN, UNKNOWN = (np.uint8(CellState[name]) for name in ("FREE", "SURFACE", "HIDDEN", "UNKNOWN"))

SURFACE_FROM_M = 0.2
"""Smallest height above local ground of the hits on things that make a cell a surface."""

ByTarget = dict[str, NDArray[np.uint8]]


class Patches(NamedTuple):
    """The cells of a grid in P patches of 4 x 4; cells at the grid's edge are repeated."""

    lanes: F32  # (P, 3, LANES) float32 unit vector towards each cell's center, and its range
    cells: NDArray[np.int32]  # (P, LANES) int32 indices of the cells
    middles: F32  # (P, 4) float32 azimuth of the center, largest angle of a cell from it, smallest and largest range


class Plates(NamedTuple):
    """Two targets as upright plates across the line of sight, a the wider one; lengths are float32 meters."""

    half_a: np.float32
    half_b: np.float32
    high_a: np.float32
    high_b: np.float32
    min_returns_a: int
    min_returns_b: int


class Limits(NamedTuple):
    """Limits of counting, in float32 meters."""

    cell: np.float32  # side of a cell: a beam reaches a plate if it ends no more than this before it
    below: np.float32  # depth below the ground of its cell at which a plate begins
    aside: np.float32  # largest horizontal offset of a beam's start
    lowest: np.float32  # smallest height of a beam's start
    highest: np.float32  # largest height of a beam's start
    max_range: np.float32  # beyond which nothing is counted


@lru_cache(maxsize=2)
def ranges_of(grid: BevGrid) -> F32:
    """Return the horizontal range of the cell centers (cells²,) in meters."""
    return polar_of_cells(grid)[0].reshape(-1)


@lru_cache(maxsize=2)
def patches_of(grid: BevGrid) -> Patches:
    """Return the patches of a grid."""
    count = -(-grid.cells // _SIDE)
    rows = np.minimum(np.arange(count * _SIDE), grid.cells - 1).reshape(count, 1, _SIDE, 1)
    cells = (rows * grid.cells + rows.reshape(1, count, 1, _SIDE)).reshape(-1, LANES)
    x, y = (grid.centers[..., axis].reshape(-1) for axis in range(2))
    range_m = np.maximum(ranges_of(grid), 1e-6)
    lanes = np.stack([x / range_m, y / range_m, ranges_of(grid)])[:, cells].astype(np.float32).transpose(1, 0, 2)
    middle = np.arctan2(y[cells].mean(axis=1), x[cells].mean(axis=1))
    turned = np.arctan2(y[cells], x[cells]) - middle[:, None]
    spread = np.abs((turned + np.pi) % (2 * np.pi) - np.pi).max(axis=1) + _ROUNDING
    near, far = lanes[:, 2].min(axis=1), lanes[:, 2].max(axis=1)
    middles = np.stack([middle, spread, near, far], axis=1).astype(np.float32)
    return Patches(np.ascontiguousarray(lanes), cells.astype(np.int32), middles)


def count_targets(
    lines: BeamLines, grid: BevGrid, ground: F32, targets: tuple[Target, Target], mask: Mask | None = None
) -> dict[str, tuple[NDArray[np.uint8], NDArray[np.uint8]]]:
    """Count per target the beams that aim at it in each cell, and those that reach it, (cells²,) uint8 up to 255.

    Args:
        lines: the beams.
        grid: of the cells.
        ground: z from the sensor (cells²,) of the ground at the cell centers.
        targets: two object types.
        mask: cells (cells²,) to count; others may stay 0.
    """
    a, b = sorted(targets, key=lambda target: -target.width_m)
    half_a, half_b, high_a, high_b = (
        np.float32(size) for size in (a.width_m / 2, b.width_m / 2, a.height_m, b.height_m)
    )
    plates = Plates(half_a, half_b, high_a, high_b, min(a.min_returns, MANY), min(b.min_returns, MANY))
    limits = Limits(
        np.float32(grid.cell_m), np.float32(BELOW_GROUND_M), lines.offset_m, lines.lowest_m, lines.highest_m,
        lines.max_range_m,
    )  # fmt: skip
    patches = patches_of(grid)
    if mask is not None:
        rows = mask[patches.cells].any(axis=1)
        patches = Patches(patches.lanes[rows], patches.cells[rows], patches.middles[rows])
    counts = np.zeros(ground.size, np.int32)
    count_cells(lines.sorted, patches, ground, plates, limits, counts)
    aimed_a, aimed_b, reached_a, reached_b = ((counts >> shift).astype(np.uint8) for shift in (0, 8, 16, 24))
    return {a.name: (aimed_a, reached_a), b.name: (aimed_b, reached_b)}


def reached_and_states(
    lines: BeamLines, blocks: NDArray[Any], ground: F32, grid: BevGrid, targets: tuple[Target, ...]
) -> tuple[ByTarget, ByTarget]:
    """Return per target the number of beams that reach it, up to 255, and the states, (cells, cells) uint8.

    ``blocks`` (C·R,) marks the beams that hit a thing; ``ground`` (cells²,) is z from the sensor.
    """
    tops = np.array([target.height_m for target in targets], np.float32)
    surfaces = stops_on_surfaces(lines, blocks, ground, grid, SURFACE_FROM_M, tops)
    surface = dict(zip((target.name for target in targets), surfaces, strict=True))
    reached: ByTarget = {}
    state: ByTarget = {}
    for k in range(0, len(targets), 2):  # two at a time
        pair = (targets[k], targets[min(k + 1, len(targets) - 1)])
        counts = count_targets(lines, grid, ground, pair)
        for target in pair:
            aimed, reaching = counts[target.name]
            states = states_of(aimed, reaching, surface[target.name], min(target.min_returns, MANY))
            reached[target.name], state[target.name] = reaching.reshape(grid.shape), states.reshape(grid.shape)
    return reached, state


@njit(cache=True, nogil=True, error_model="numpy")
def states_of(aimed: Any, reaching: Any, surface: Any, min_returns: Any) -> Any:
    """Return states (cells²,) uint8 from the numbers of aiming and reaching beams and whether one hit a thing there."""
    out = np.empty(aimed.size, np.uint8)
    for n in range(aimed.size):
        visible, hidden = SURFACE if surface[n] else FREE, HIDDEN if aimed[n] >= min_returns else UNKNOWN
        out[n] = visible if reaching[n] >= min_returns else hidden
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def count_cells(beams: Any, patches: Any, ground: Any, plates: Any, limits: Any, out: Any) -> None:
    """Fill ``out`` (cells²,) int32, initially 0, with four counts of one byte, the lowest byte first.

    The counts are: beams that aim at the wider plate, aim at the narrower, reach the wider, reach the narrower. Once
    enough beams aim, only tiles that reach the patch are tested, so the number of aiming beams may be too small beyond
    the required minimum. ``ground`` (cells²,) is z from the sensor.
    """
    tiles, starts = beams.tiles, beams.starts
    columns, guess = starts.shape[0] - 1, (0, -1)
    lanes, counts = np.empty((6, LANES), np.float32), np.empty((2, LANES), np.int32)
    for p in range(patches.cells.shape[0]):
        azimuth, spread = patches.middles[p, 0], patches.middles[p, 1]
        nearest, farthest = patches.middles[p, 2], patches.middles[p, 3]
        if nearest - limits.cell > limits.max_range:
            continue
        bottom, top = _load(patches, p, ground, plates, limits, lanes)
        counts[:] = 0
        if spread * columns > _NEAR or nearest <= 2 * limits.aside:
            _count_near(beams, lanes, counts, plates, limits)
        else:
            # The window of azimuth and rings whose beams may hit a plate of the patch.
            angle = spread + _half_window(plates.half_a + limits.aside, nearest)
            min_slope, max_slope = _slopes(nearest, farthest, bottom, top, plates.half_a, limits)
            first_bin, last_bin = _bins_of(azimuth, angle, columns)
            guess, needed = _rings_of(beams.bounds, azimuth, angle, min_slope, max_slope, guess), np.float32(-1.0)
            for ring in range(guess[0], guess[1] + 1):
                begin, end, rest = _span(starts, first_bin, last_bin, ring)
                _meet_patch(tiles, ring, begin, end, needed, lanes, plates, limits, counts)
                _meet_patch(tiles, ring, 0, rest, needed, lanes, plates, limits, counts)
                needed = nearest - limits.cell if _clamp(counts, plates.min_returns_a, plates.min_returns_b) else needed
        for k in range(LANES):
            out[patches.cells[p, k]] = counts[0, k] + (counts[1, k] << 8)


@njit(cache=True, nogil=True, error_model="numpy")
def _load(patches: Any, p: Any, ground: Any, plates: Any, limits: Any, lanes: Any) -> Any:
    """Store unit vectors, ranges, bottoms and tops of a patch's plates in ``lanes``; return lowest and highest z.

    The bottom of a plate that is not counted is infinite.
    """
    bottom, top, tall = np.float32(np.inf), np.float32(-np.inf), max(plates.high_a, plates.high_b)
    for k in range(LANES):
        r, height = patches.lanes[p, 2, k], ground[patches.cells[p, k]]
        counts = r > limits.aside and r - limits.cell <= limits.max_range
        lanes[0, k], lanes[1, k], lanes[2, k] = patches.lanes[p, 0, k], patches.lanes[p, 1, k], r
        lanes[3, k] = height - limits.below if counts else np.float32(np.inf)
        lanes[4, k], lanes[5, k] = height + plates.high_a, height + plates.high_b
        bottom, top = min(bottom, lanes[3, k]), max(top, height + tall)
    return bottom, top


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _meet_patch(
    tiles: Any, ring: Any, begin: Any, end: Any, needed: Any, lanes: Any, plates: Any, limits: Any, counts: Any
) -> None:
    """Add beams ``begin`` to ``end`` of a ring to the counts of a patch, if any of them reaches ``needed``."""
    if _farthest(tiles, ring, begin, end) >= needed:
        for n in range(begin, end):
            t, i = np.uint64(n // LANES), np.uint64(n % LANES)
            bend, ux, uy = tiles[ring, t, 0, i], tiles[ring, t, 1, i], tiles[ring, t, 2, i]
            rise, slope, stop = tiles[ring, t, 3, i], tiles[ring, t, 4, i], tiles[ring, t, 5, i]
            for k in range(LANES):
                plate = (lanes[0, k], lanes[1, k], lanes[2, k], lanes[3, k], lanes[4, k], lanes[5, k])
                a, b = _aim((bend, ux, uy, rise, slope, stop), plate, plates, limits)
                counts[0, k] += a
                counts[1, k] += b


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _clamp(counts: Any, min_returns_a: Any, min_returns_b: Any) -> Any:
    """Limit all counts to 255; return whether enough beams aim at every cell."""
    enough = 0
    for k in range(LANES):
        a, b = _limited(counts[0, k]), _limited(counts[1, k])
        enough += 1 if (a & 255) >= min_returns_a and (b & 255) >= min_returns_b else 0
        counts[0, k], counts[1, k] = a, b
    return enough == LANES


@njit(cache=True, nogil=True, error_model="numpy")
def _limited(count: Any) -> Any:
    """Return aimed + 65536 · reached, either of them 255 at most."""
    return np.int32(min(count & 65535, 255) + (min(count >> 16, 255) << 16))


@njit(cache=True, nogil=True, error_model="numpy")
def _count_near(beams: Any, lanes: Any, counts: Any, plates: Any, limits: Any) -> None:
    """Count beams per cell of a patch, in batches of beams: near the sensor the windows of its cells overlap little."""
    tiles, starts = beams.tiles, beams.starts
    columns, guess = starts.shape[0] - 1, (0, -1)
    for k in range(LANES):
        plate = (lanes[0, k], lanes[1, k], lanes[2, k], lanes[3, k], lanes[4, k], lanes[5, k])
        azimuth, r, a, b = atan2(plate[1], plate[0]), plate[2], np.int32(0), np.int32(0)
        if plate[3] < np.inf:
            angle = _half_window(plates.half_a + limits.aside, r)
            min_slope, max_slope = _slopes(r, r, plate[3], max(plate[4], plate[5]), plates.half_a, limits)
            guess = _rings_of(beams.bounds, azimuth, angle, min_slope, max_slope, guess)
            first_bin, last_bin = _bins_of(azimuth, angle, columns)
            needed = np.float32(-1.0)
            for ring in range(guess[0], guess[1] + 1):
                begin, end, rest = _span(starts, first_bin, last_bin, ring)
                some_a, some_b = _meet_cell(tiles, ring, begin, end, needed, plate, plates, limits)
                more_a, more_b = _meet_cell(tiles, ring, 0, rest, needed, plate, plates, limits)
                a, b = _limited(a + some_a + more_a), _limited(b + some_b + more_b)
                # Enough beams aim: from here on only beams that may reach are counted.
                if (a & 255) >= plates.min_returns_a and (b & 255) >= plates.min_returns_b:
                    needed = r - limits.cell
                # The wider plate's count is full: the narrower plate's window is enough.
                if a == _FULL:
                    first_bin, last_bin = _bins_of(azimuth, _half_window(plates.half_b + limits.aside, r), columns)
                if a == _FULL and b == _FULL:
                    break
        counts[0, k], counts[1, k] = a, b


@njit(cache=True, nogil=True, error_model="numpy")
def _meet_cell(tiles: Any, ring: Any, begin: Any, end: Any, needed: Any, plate: Any, plates: Any, limits: Any) -> Any:
    """Return the counts of both plates of a cell from the tiles of beams ``begin`` to ``end`` of a ring."""
    a, b = np.int32(0), np.int32(0)
    for t in range(begin // LANES, (end + LANES - 1) // LANES):
        if tiles[ring, t, REACH, 0] >= needed:
            some_a, some_b = np.int32(0), np.int32(0)
            for n in range(LANES):
                line = (tiles[ring, t, 0, n], tiles[ring, t, 1, n], tiles[ring, t, 2, n],
                        tiles[ring, t, 3, n], tiles[ring, t, 4, n], tiles[ring, t, 5, n])  # fmt: skip
                hit_a, hit_b = _aim(line, plate, plates, limits)
                some_a, some_b = np.int32(some_a + hit_a), np.int32(some_b + hit_b)
            a, b = np.int32(a + some_a), np.int32(b + some_b)
    return a, b


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _aim(line: Any, plate: Any, plates: Any, limits: Any) -> Any:
    """Return for both plates 0 if the beam does not aim at it, 1 if it aims, 65537 if it also reaches.

    ``line`` is a beam (``BEND`` to ``STOP``); ``plate`` is unit vector and range of its center, bottom, and both tops.
    All lengths are scaled by the cosine between beam and line of sight (``forward``), which avoids divisions.
    """
    bend, ux, uy, rise, slope, stop = line
    cx, cy, r, bottom, top_a, top_b = plate
    forward, aside = ux * cx + uy * cy, uy * cx - ux * cy
    # Crossing of the beam and the plane of the plate: run up to it, lateral offset from the center, and height.
    run, lateral = r + bend * aside, abs(bend + r * aside)
    height = rise * forward + slope * run
    ahead = (forward > np.float32(0.0)) & (height >= bottom * forward)
    hit_a = ahead & (lateral <= plates.half_a * forward) & (height <= top_a * forward)
    hit_b = ahead & (lateral <= plates.half_b * forward) & (height <= top_b * forward)
    worth = np.int32(65537) if stop * forward >= run - limits.cell else np.int32(1)
    return worth if hit_a else np.int32(0), worth if hit_b else np.int32(0)


@njit(cache=True, nogil=True, error_model="numpy")
def _farthest(tiles: Any, ring: Any, begin: Any, end: Any) -> Any:
    """Return the largest reach of the tiles of a run of a ring's beams; -1 for an empty run."""
    out = np.float32(-1.0)
    for t in range(begin // LANES, (end + LANES - 1) // LANES):
        out = max(out, tiles[ring, t, REACH, 0])
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _span(starts: Any, first: Any, last: Any, ring: Any) -> Any:
    """Return the run of a ring's beams in a window, and the end of a second run from 0 if it crosses ±π (else 0)."""
    begin, end = starts[first, ring], starts[last + 1, ring]
    if first <= last:
        return begin, end, 0
    if end + LANES > begin:
        return 0, starts.shape[0] - 1, 0
    return begin, starts.shape[0] - 1, end


@njit(cache=True, nogil=True, error_model="numpy")
def _half_window(wide: Any, r: Any) -> Any:
    """Return an upper bound of arcsin(wide / r), half the width of the azimuth window of beams that cross the plate."""
    x = min(wide / r, np.float32(1.0))
    return x + np.float32(0.5709) * x * x * x + _AZIMUTH_MARGIN


@njit(cache=True, nogil=True, error_model="numpy")
def _slopes(nearest: Any, farthest: Any, bottom: Any, top: Any, half: Any, limits: Any) -> Any:
    """Return the smallest and largest slope of beams that may hit plates between two ranges and heights."""
    low, high = bottom - limits.highest, top - limits.lowest
    near, far = nearest - limits.aside, farthest + half + 2 * limits.aside
    min_slope, max_slope = low / (near if low < 0 else far), high / (far if high < 0 else near)
    return min_slope - _SLOPE_MARGIN, max_slope + _SLOPE_MARGIN


@njit(cache=True, nogil=True, error_model="numpy")
def _bins_of(azimuth: Any, half: Any, columns: Any) -> Any:
    """Return the first and last bin of a window, given its center and half width; first > last if it crosses ±π."""
    per_rad = np.float32(columns / (2 * np.pi))
    first = int(np.floor((azimuth + _PI - half) * per_rad))
    last = int(np.floor((azimuth + _PI + half) * per_rad))
    if last - first + 1 >= columns:
        return 0, columns - 1
    return (first + columns if first < 0 else first), (last - columns if last >= columns else last)


@njit(cache=True, nogil=True, error_model="numpy")
def _rings_of(bounds: Any, azimuth: Any, half: Any, min_slope: Any, max_slope: Any, guess: Any) -> Any:
    """Return the first and last ring that may have slopes between two limits in a window of azimuth.

    The search starts from ``guess``, the rings of the previous patch, which differ little.
    """
    rings = bounds.shape[2]
    per_rad = np.float32(SECTORS / (2 * np.pi))
    begin = int(np.floor((azimuth + _PI - half) * per_rad))
    end = int(np.floor((azimuth + _PI + half) * per_rad))
    first, last = rings, -1
    for sector in range(begin + 1, end + 2, 3):  # a bound holds for three sectors
        s = sector % SECTORS
        f, k = min(guess[0], rings - 1), max(guess[1], 0)
        while f > 0 and bounds[0, s, f - 1] >= min_slope:
            f -= 1
        while f < rings and bounds[0, s, f] < min_slope:
            f += 1
        while k < rings - 1 and bounds[1, s, k + 1] <= max_slope:
            k += 1
        while k >= 0 and bounds[1, s, k] > max_slope:
            k -= 1
        first, last = min(first, f), max(last, k)
    return first, last
