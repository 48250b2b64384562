"""Where every beam of a revolution ended: returns, and as far as the surroundings say, beams without a return."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.arrays import F32
from viewshed.preprocess.leveling import OBSTACLE_HEIGHTS_M
from viewshed_lab.data.labeling.beam_image import BeamImage
from viewshed_lab.data.labeling.ground_map import Patch

OPEN, SURFACE, SWALLOWED = 1, 2, 3
"""What became of a missing beam: nothing stood before the ground or the maximum range; the surface that its neighbors
met; something at an unknown place."""

_NONE, _GROUND = np.float32(-1.0), np.float32(-2.0)
"""What a neighboring beam met in place of a depth: nothing, or the ground."""

_UP_AND_DOWN = 3
"""Rings above and below a missing beam that are looked at."""

_FAR = np.float32(1e9)
"""A depth beyond all others."""

_UNEVEN_M, _SHORT_M, _SHORT_SHARE = np.float32(0.08), np.float32(0.5), np.float32(0.1)
"""A return is a thing's, too, that lies so high and ends so far before level ground."""

SURE = np.float32(0.85)
"""Share of returns from which on ground at a range is sure to return; a beam that does not was swallowed."""

GAP_M = np.float32(5.0)
"""A surface goes on behind missing beams over a gap of at most this: a shop window, a black car."""

SURE_GAP_M = np.float32(0.6)
"""Over a gap of at most this it surely does; a wider one may be a window that beams pass."""

ISOLATED_M = 35.0
"""Isolated returns farther away are kept: there the beams lie too far apart to judge."""

ISOLATED_SHARE = 0.06
"""Isolated returns in the air up to 35 m are drops or flakes, and count as missing, if their share reaches this."""

_BANDS, _SECTORS, _ENOUGH = 20, 32, 8
"""Bands of range and sectors of azimuth in which returns from the ground are counted, and beams that a share needs."""

_QUANTILE = 0.8
"""Of the sectors' shares, the one that stands for a band."""


class GroundFrame(NamedTuple):
    """Where a square lattice of ground heights lies about the sensor, in float32 meters and its own axes.

    Half its side, its middle from the sensor, and cosine and sine of the sensor's yaw.
    """

    half: np.float32
    middle_x: np.float32
    middle_y: np.float32
    cos: np.float32
    sin: np.float32


class Evidence(NamedTuple):
    """What the beams of a revolution, C columns and R rings, and their surroundings say."""

    depth: F32  # (C, R) float32 meters to the return, 0 where there is none
    to_ground: F32  # (C, R) float32 meters to the ground, up to the maximum range
    thing: NDArray[np.bool_]  # (C, R) bool, whether it returned from something above the ground
    lost: NDArray[np.bool_]  # (C,) bool, columns without a return that are not next to one with any
    ground_share: F32  # (bands,) float32, how often ground at a range returns
    ring_share: F32  # (R,) float32, how often a ring returns


class Limits(NamedTuple):
    """What decides about missing beams, in float32 meters."""

    reach: np.float32  # maximum range
    nearest: np.float32  # minimum range
    band: np.float32  # width of a band of ranges


@dataclass(frozen=True, slots=True, eq=False)
class BeamEnds:
    """Where each beam ended, and why."""

    best_m: NDArray[np.float32]  # (C, R) float32 meters from its start to the likeliest end
    least_m: NDArray[np.float32]  # (C, R) it went at least so far
    most_m: NDArray[np.float32]  # (C, R) it went at most so far
    # (C, R) bool, whether it returned from something that stands 0.3 m or more above the ground
    thing: NDArray[np.bool_]
    # (C, R) uint8, what became of a missing beam (``OPEN``, ``SURFACE``, ``SWALLOWED``); 0 where it returned
    kind: NDArray[np.uint8]


def beam_ends_of(image: BeamImage, patch: Patch) -> BeamEnds:
    """Return where the beams of ``image`` ended over the ground ``patch``.

    A beam that returned ended there. One that did not

    - ended on the surface that its neighbors met, if those left and right of it in its ring (a gap of at most 5 m), or
      above and below it, met one surface: a window, a black car;
    - was swallowed at an unknown place if its column and those beside it are empty, or if it aims at ground so near
      that ground there always returns, and its neighbors are not all ground;
    - else met nothing before the ground or the maximum range; at least it went as far as the things next to it.
    """
    reach, low_m = np.float32(image.max_range_m), np.float32(OBSTACLE_HEIGHTS_M[0])
    to_ground, thing = np.empty(image.depth_m.shape, np.float32), np.empty(image.depth_m.shape, np.bool_)
    (x_m, y_m), yaw = patch.center_m[:2], patch.yaw
    frame = GroundFrame(*map(np.float32, (patch.ground.half_extent_m, x_m, y_m, np.cos(yaw), np.sin(yaw))))
    heights, beams = patch.ground.heights_m, (image.origin_m, image.direction)
    cast_to_ground(*beams, image.depth_m, heights, frame, reach, low_m, to_ground, thing)
    # Drops and flakes count as missing where they are many.
    depth, isolated = image.depth_m, is_isolated(image.depth_m, thing, np.float32(ISOLATED_M))
    if isolated.sum() >= ISOLATED_SHARE * np.count_nonzero(thing):
        depth = np.where(isolated, np.float32(0.0), depth)
        cast_to_ground(*beams, depth, heights, frame, reach, low_m, to_ground, thing)
    # Columns without a return, next to such ones: they were not fired, or not kept.
    empty = ~(depth > 0).any(axis=1)
    lost = empty & np.roll(empty, 1) & np.roll(empty, -1)
    band = np.float32(max(image.max_range_m / _BANDS, 1e-3))
    ring_share = np.asarray((depth > 0).mean(axis=0), np.float32)
    evidence = Evidence(depth, to_ground, thing, lost, _ground_share(depth, to_ground, thing, reach, band), ring_share)
    nearest = 0.0 if image.model is None else image.model.min_range_m
    limits = Limits(reach, np.float32(nearest), band)
    depths, kinds = np.empty((3, *to_ground.shape), np.float32), np.empty(to_ground.shape, np.uint8)
    end_beams(evidence, limits, depths, kinds)
    return BeamEnds(depths[0], depths[1], depths[2], thing, kinds)


def _ground_share(depth: F32, to_ground: F32, thing: NDArray[np.bool_], reach: np.float32, band: np.float32) -> F32:
    """Return how often ground returns (bands,), by its range, in the better sectors: others hold windows and cars."""
    missing = depth <= 0
    column, ring = np.nonzero((band / 2 < to_ground) & (to_ground < reach) & (missing | ~thing))
    # Beams that met the ground and those that are missing (2, bands, sectors), by range and azimuth of the ground.
    bands = np.minimum((to_ground[column, ring] / band).astype(np.intp), _BANDS - 1)
    place = (missing[column, ring] * _BANDS + bands) * _SECTORS + column * _SECTORS // len(depth)
    met, lost = np.bincount(place, minlength=2 * _BANDS * _SECTORS).reshape(2, _BANDS, _SECTORS)
    share = np.where(met + lost >= _ENOUGH, met / np.maximum(met + lost, 1), np.nan)
    share[np.isnan(share).all(axis=1), 0] = 0.0
    return np.asarray(np.nanquantile(share, _QUANTILE, axis=1), np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
def cast_to_ground(
    origin: Any, direction: Any, depth: Any, ground: Any, frame: Any, reach: Any, low_m: Any, out: Any, thing: Any
) -> None:
    """Fill ``out`` (C, R) with meters to the ground and ``thing`` (C, R) with whether a return stands above it.

    A missing beam is followed to the ground, up to the maximum range ``reach``; a return keeps its depth. Starts and
    directions (C, R, 3) and depths (C, R) are the beams'. ``ground`` (n, n) is z from the sensor on the lattice of
    ``frame``. A return from ``low_m`` above it is one of a thing whatever its beam. Off the lattice there is no ground:
    every return is a thing's.
    """
    half, c, s = frame.half, frame.cos, frame.sin
    n = ground.shape[0]
    per_m, last = np.float32(n / (2.0 * half)), np.float32(n - 1.001)
    node = np.float32(1.0) / per_m
    for column in range(out.shape[0]):
        for ring in range(out.shape[1]):
            # The beam in the axes of the lattice, from its middle.
            o, d = origin[column, ring], direction[column, ring]
            x, y = c * o[0] - s * o[1] - frame.middle_x, s * o[0] + c * o[1] - frame.middle_y
            dx, dy = c * d[0] - s * d[1], s * d[0] + c * d[1]
            flat = max(np.sqrt(dx * dx + dy * dy), np.float32(1e-3))
            before, height = np.float32(0.0), np.float32(0.0)
            end, t = reach, depth[column, ring]
            returned = t > 0
            thing[column, ring] = returned
            while t < reach or returned:
                # Height above the ground at t, between the four nodes around.
                u, v = (x + dx * t + half) * per_m - np.float32(0.5), (y + dy * t + half) * per_m - np.float32(0.5)
                if u < 0 or v < 0 or u >= last or v >= last:
                    break
                i, j = int(u), int(v)
                fu, fv = u - np.float32(i), v - np.float32(j)
                near = ground[i, j] + (ground[i, j + 1] - ground[i, j]) * fv
                far = ground[i + 1, j] + (ground[i + 1, j + 1] - ground[i + 1, j]) * fv
                above = o[2] + d[2] * t - near - (far - near) * fu
                if returned:  # judged where it ended, once
                    short = above > _UNEVEN_M and above > -d[2] * max(_SHORT_M, _SHORT_SHARE * t)
                    thing[column, ring] = above > low_m or short
                    break
                if above <= 0:  # the step crossed the ground
                    end = before + (t - before) * (height / (height - above)) if height > 0 else t
                    break
                # A longer step the higher it is, but never over more than three nodes.
                before, height = t, above
                t += max(np.float32(0.4) * node, min(np.float32(2.0) * above, np.float32(3.0) * node)) / flat
            out[column, ring] = depth[column, ring] if returned else min(end, reach)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _next_in_ring(depth: Any, thing: Any, c: Any, r: Any, side: Any) -> Any:
    """Return what the next return of the ring met (depth, or ground or none) and how many columns away it is."""
    columns = depth.shape[0]
    for step in range(1, columns // 8):
        k = (c + side * step) % columns
        if depth[k, r] > 0:
            return (depth[k, r] if thing[k, r] else _GROUND), step
    return _NONE, columns


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _next_in_column(depth: Any, thing: Any, c: Any, r: Any, side: Any) -> Any:
    """Return what the next return of the column met, up to three rings away (depth, or ground or none)."""
    for step in range(1, _UP_AND_DOWN + 1):
        k = r + side * step
        if 0 <= k < depth.shape[1] and depth[c, k] > 0:
            return depth[c, k] if thing[c, k] else _GROUND
    return _NONE


@njit(cache=True, nogil=True, error_model="numpy")
def is_isolated(depth: Any, thing: Any, far_m: Any) -> Any:
    """Return which beams (C, R) returned in the air, up to ``far_m``, from where fewer than three others did.

    Of the beams up to two columns and two rings away; rain, snow and fog return so, surfaces do not.
    """
    columns, rings = depth.shape
    isolated = np.zeros(depth.shape, np.bool_)
    for c in range(columns):
        for r in range(rings):
            d = depth[c, r]
            if thing[c, r] and d <= far_m:
                near, shared = np.float32(0.3) + np.float32(0.03) * d, 0
                for k in range(max(r - 2, 0), min(r + 3, rings)):
                    for step in range(-2, 3):
                        shared += abs(depth[(c + step) % columns, k] - d) < near
                isolated[c, r] = shared < 4
    return isolated


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _one_surface(a: Any, b: Any) -> Any:
    middle = np.float32(0.5) * (a + b)
    return (a > 0) & (b > 0) & (abs(a - b) < np.float32(0.1) * middle + np.float32(1.0))


@njit(cache=True, nogil=True, error_model="numpy")
def end_beams(evidence: Any, limits: Any, depths: Any, kinds: Any) -> None:
    """Fill best, least and most depth (3, C, R) float32, and what became of missing beams (C, R) uint8."""
    depth = evidence.depth
    for c in range(depth.shape[0]):
        for r in range(depth.shape[1]):
            best, least, most, kind = depth[c, r], depth[c, r], depth[c, r], 0
            if depth[c, r] <= 0:
                best, least, most, kind = _end_missing_beam(evidence, limits, c, r)
            depths[0, c, r], depths[1, c, r], depths[2, c, r], kinds[c, r] = best, least, most, kind


@njit(cache=True, nogil=True, error_model="numpy")
def _end_missing_beam(evidence: Any, limits: Any, c: Any, r: Any) -> Any:
    """Return best, least and most depth of a missing beam, and what became of it."""
    depth, thing = evidence.depth, evidence.thing
    none, g = np.float32(0.0), evidence.to_ground[c, r]
    left, gap_left = _next_in_ring(depth, thing, c, r, 1)
    right, gap_right = _next_in_ring(depth, thing, c, r, -1)
    up, down = _next_in_column(depth, thing, c, r, 1), _next_in_column(depth, thing, c, r, -1)
    near = min(up if up > 0 else _FAR, down if down > 0 else _FAR)
    near = min(near, left if left > 0 else _FAR, right if right > 0 else _FAR)
    # A lost column, or something nearer than the sensor can measure: it is unknown which.
    if evidence.lost[c] or near < np.float32(1.5) * limits.nearest + np.float32(0.1):
        return none, none, g, SWALLOWED
    # The neighbors on both sides met one surface: a window, a black car.
    wide = np.float32(0.5) * (left + right)
    gap = np.float32((gap_left + gap_right) * (2 * np.pi / depth.shape[0])) * wide
    across, along = _one_surface(left, right) & (gap < GAP_M), _one_surface(up, down)
    if across or along:
        best = min(wide if across else _FAR, np.float32(0.5) * (up + down) if along else _FAR, g)
        certain = across and gap < SURE_GAP_M
        return best, best, best if certain else g, SURFACE
    # Between two things, in a ring that nearly always returns: one of them, or what lies between.
    if left > 0 and right > 0 and evidence.ring_share[r] > SURE:
        return min(wide, g), min(near, g), g, SURFACE
    # Ground so near always returns, so something swallowed the beam; one or two lost amid ground are only lost.
    alone = (gap_left + gap_right <= 3) & (left == _GROUND) & (right == _GROUND)
    shares = evidence.ground_share
    expected = g < limits.reach and shares[min(int(g / limits.band), shares.shape[0] - 1)] > SURE
    if expected and not alone:
        best = near if near < g else none
        return best, best, g, SWALLOWED
    # Nothing stood before the ground or the maximum range; at least it went as far as the things next to it.
    nowhere = (left == _NONE) & (right == _NONE)
    return g, none if nowhere else min(near, g), g, OPEN
