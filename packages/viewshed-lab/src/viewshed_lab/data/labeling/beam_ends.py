"""Estimate where every beam of a revolution ended; beams without a return are judged by their surroundings."""

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
"""End of a missing beam: ``OPEN``: nothing before the ground or the maximum range. ``SURFACE``: the surface that its
neighbors hit. ``SWALLOWED``: something at an unknown range."""

_NONE, _GROUND = np.float32(-1.0), np.float32(-2.0)
"""Codes in place of the depth of a neighboring beam: no return, or a return from the ground."""

_MAX_RING_STEPS = 3
"""Rings above and below a missing beam that are searched for a return."""

_FAR = np.float32(1e9)
"""A depth beyond all others."""

_UNEVEN_M, _SHORT_M, _SHORT_SHARE = np.float32(0.08), np.float32(0.5), np.float32(0.1)
"""A return this high above the ground also belongs to a thing if its beam ended this far before level ground."""

SURE = np.float32(0.85)
"""Share of returns above which ground at a range always returns; a beam there without a return was swallowed."""

GAP_M = np.float32(5.0)
"""Largest gap of missing beams across which a surface continues: a shop window, a black car."""

SURE_GAP_M = np.float32(0.6)
"""Largest gap across which it certainly continues; a wider one may be a window that beams pass."""

ISOLATED_M = 35.0
"""Largest range at which isolated returns are removed: farther away the beams are too far apart to judge."""

ISOLATED_SHARE = 0.06
"""Smallest share of isolated returns in the air, up to 35 m, at which they are drops or flakes and count as missing."""

_BANDS, _SECTORS, _MIN_BEAMS = 20, 32, 8
"""Range bands and azimuth sectors in which ground returns are counted, and beams that a share needs."""

_QUANTILE = 0.8
"""Quantile of the sectors' shares that represents a band."""


class GroundFrame(NamedTuple):
    """Pose of a square lattice of ground heights around the sensor, in float32 meters and the lattice's axes."""

    half: np.float32  # half its side
    middle_x: np.float32  # its center from the sensor
    middle_y: np.float32
    cos: np.float32  # of the sensor's yaw
    sin: np.float32


class Evidence(NamedTuple):
    """Measurements of a revolution, C columns and R rings, from which missing beams are judged."""

    depth: F32  # (C, R) float32 meters to the return, 0 where there is none
    to_ground: F32  # (C, R) float32 meters to the ground, up to the maximum range
    thing: NDArray[np.bool_]  # (C, R) bool, whether the beam returned from something above the ground
    lost: NDArray[np.bool_]  # (C,) bool, columns without a return whose neighbor columns have none either
    ground_share: F32  # (bands,) float32, share of ground beams that return, by range
    ring_share: F32  # (R,) float32, share of each ring's beams that return


class Limits(NamedTuple):
    """Ranges that decide about missing beams, in float32 meters."""

    reach: np.float32  # maximum range
    nearest: np.float32  # minimum range
    band: np.float32  # width of a band of ranges


@dataclass(frozen=True, slots=True, eq=False)
class BeamEnds:
    """Where each beam ended, and why."""

    best_m: NDArray[np.float32]  # (C, R) float32 meters from the beam's start to its most likely end
    min_m: NDArray[np.float32]  # (C, R) smallest possible depth
    max_m: NDArray[np.float32]  # (C, R) largest possible depth
    thing: NDArray[np.bool_]  # (C, R) bool, whether it returned from something 0.3 m or more above the ground
    kind: NDArray[np.uint8]  # (C, R) uint8, ``OPEN``, ``SURFACE`` or ``SWALLOWED`` for a missing beam; 0 for a return


def beam_ends_of(image: BeamImage, patch: Patch) -> BeamEnds:
    """Estimate where the beams of ``image`` ended over the ground ``patch``.

    A beam with a return ended there. A beam without a return

    - ended on its neighbors' surface, if those left and right of it in its ring (a gap of at most 5 m), or above and
      below it, hit one surface: a window, a black car;
    - was swallowed at an unknown range, if its column and the neighbor columns are empty, or if it aims at ground so
      close that ground there always returns, and its neighbors are not all ground;
    - otherwise hit nothing before the ground or the maximum range; it went at least as far as the things next to it.
    """
    reach, low_m = np.float32(image.max_range_m), np.float32(OBSTACLE_HEIGHTS_M[0])
    to_ground, thing = np.empty(image.depth_m.shape, np.float32), np.empty(image.depth_m.shape, np.bool_)
    (x_m, y_m), yaw = patch.center_m[:2], patch.yaw
    frame = GroundFrame(*map(np.float32, (patch.ground.half_extent_m, x_m, y_m, np.cos(yaw), np.sin(yaw))))
    heights, beams = patch.ground.heights_m, (image.origin_m, image.direction)
    cast_to_ground(*beams, image.depth_m, heights, frame, reach, low_m, to_ground, thing)
    # Many isolated returns are drops or flakes: count them as missing.
    depth, isolated = image.depth_m, is_isolated(image.depth_m, thing, np.float32(ISOLATED_M))
    if isolated.sum() >= ISOLATED_SHARE * np.count_nonzero(thing):
        depth = np.where(isolated, np.float32(0.0), depth)
        cast_to_ground(*beams, depth, heights, frame, reach, low_m, to_ground, thing)
    # Empty columns between empty columns were not fired, or not recorded.
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
    """Return the share of ground beams that return (bands,): a quantile over sectors, as some have windows and cars."""
    missing = depth <= 0
    column, ring = np.nonzero((band / 2 < to_ground) & (to_ground < reach) & (missing | ~thing))
    # Count the beams that hit the ground and the missing beams (2, bands, sectors), by range and azimuth of the ground.
    bands = np.minimum((to_ground[column, ring] / band).astype(np.intp), _BANDS - 1)
    bins = (missing[column, ring] * _BANDS + bands) * _SECTORS + column * _SECTORS // len(depth)
    hits, lost = np.bincount(bins, minlength=2 * _BANDS * _SECTORS).reshape(2, _BANDS, _SECTORS)
    share = np.where(hits + lost >= _MIN_BEAMS, hits / np.maximum(hits + lost, 1), np.nan)
    share[np.isnan(share).all(axis=1), 0] = 0.0
    return np.asarray(np.nanquantile(share, _QUANTILE, axis=1), np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
def cast_to_ground(
    origin: Any, direction: Any, depth: Any, ground: Any, frame: Any, reach: Any, low_m: Any, out: Any, thing: Any
) -> None:
    """Fill ``out`` (C, R) with meters to the ground, and ``thing`` (C, R) with whether a return is above the ground.

    A missing beam is followed to the ground, up to the maximum range ``reach``; a return keeps its depth. ``origin``
    and ``direction`` (C, R, 3) and ``depth`` (C, R) describe the beams. ``ground`` (n, n) is z from the sensor on the
    lattice of ``frame``. A return more than ``low_m`` above the ground always belongs to a thing. Outside the lattice
    there is no ground, so every return belongs to a thing.
    """
    half, c, s = frame.half, frame.cos, frame.sin
    n = ground.shape[0]
    per_m, last = np.float32(n / (2.0 * half)), np.float32(n - 1.001)
    node = np.float32(1.0) / per_m
    for column in range(out.shape[0]):
        for ring in range(out.shape[1]):
            # The beam in the axes of the lattice, from its center.
            o, d = origin[column, ring], direction[column, ring]
            x, y = c * o[0] - s * o[1] - frame.middle_x, s * o[0] + c * o[1] - frame.middle_y
            dx, dy = c * d[0] - s * d[1], s * d[0] + c * d[1]
            flat = max(np.sqrt(dx * dx + dy * dy), np.float32(1e-3))
            before, height = np.float32(0.0), np.float32(0.0)
            end, t = reach, depth[column, ring]
            returned = t > 0
            thing[column, ring] = returned
            while t < reach or returned:
                # Height above the ground at t, interpolated between the four nodes around.
                u, v = (x + dx * t + half) * per_m - np.float32(0.5), (y + dy * t + half) * per_m - np.float32(0.5)
                if u < 0 or v < 0 or u >= last or v >= last:
                    break
                i, j = int(u), int(v)
                fu, fv = u - np.float32(i), v - np.float32(j)
                near = ground[i, j] + (ground[i, j + 1] - ground[i, j]) * fv
                far = ground[i + 1, j] + (ground[i + 1, j + 1] - ground[i + 1, j]) * fv
                above = o[2] + d[2] * t - near - (far - near) * fu
                if returned:  # judge the return at its depth, once
                    short = above > _UNEVEN_M and above > -d[2] * max(_SHORT_M, _SHORT_SHARE * t)
                    thing[column, ring] = above > low_m or short
                    break
                if above <= 0:  # the step crossed the ground
                    end = before + (t - before) * (height / (height - above)) if height > 0 else t
                    break
                # Step farther the higher the beam is, but over at most three nodes.
                before, height = t, above
                t += max(np.float32(0.4) * node, min(np.float32(2.0) * above, np.float32(3.0) * node)) / flat
            out[column, ring] = depth[column, ring] if returned else min(end, reach)


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _next_in_ring(depth: Any, thing: Any, c: Any, r: Any, side: Any) -> Any:
    """Return the depth of the ring's next return (or ground, or none) and how many columns away it is."""
    columns = depth.shape[0]
    for step in range(1, columns // 8):
        k = (c + side * step) % columns
        if depth[k, r] > 0:
            return (depth[k, r] if thing[k, r] else _GROUND), step
    return _NONE, columns


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _next_in_column(depth: Any, thing: Any, c: Any, r: Any, side: Any) -> Any:
    """Return the depth of the column's next return, up to three rings away (or ground, or none)."""
    for step in range(1, _MAX_RING_STEPS + 1):
        k = r + side * step
        if 0 <= k < depth.shape[1] and depth[c, k] > 0:
            return depth[c, k] if thing[c, k] else _GROUND
    return _NONE


@njit(cache=True, nogil=True, error_model="numpy")
def is_isolated(depth: Any, thing: Any, far_m: Any) -> Any:
    """Return which beams (C, R) have isolated returns in the air, up to ``far_m``: rain, snow or fog.

    A return is isolated if fewer than three beams up to two columns and two rings away have a similar depth.
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
    """Fill ``depths`` (3, C, R) float32 with best, minimum and maximum depth, and ``kinds`` (C, R) uint8."""
    depth = evidence.depth
    for c in range(depth.shape[0]):
        for r in range(depth.shape[1]):
            best, min_m, max_m, kind = depth[c, r], depth[c, r], depth[c, r], 0
            if depth[c, r] <= 0:
                best, min_m, max_m, kind = _end_missing_beam(evidence, limits, c, r)
            depths[0, c, r], depths[1, c, r], depths[2, c, r], kinds[c, r] = best, min_m, max_m, kind


@njit(cache=True, nogil=True, error_model="numpy")
def _end_missing_beam(evidence: Any, limits: Any, c: Any, r: Any) -> Any:
    """Return best, minimum and maximum depth of a missing beam, and its kind."""
    depth, thing = evidence.depth, evidence.thing
    none, g = np.float32(0.0), evidence.to_ground[c, r]
    left, gap_left = _next_in_ring(depth, thing, c, r, 1)
    right, gap_right = _next_in_ring(depth, thing, c, r, -1)
    up, down = _next_in_column(depth, thing, c, r, 1), _next_in_column(depth, thing, c, r, -1)
    near = min(up if up > 0 else _FAR, down if down > 0 else _FAR)
    near = min(near, left if left > 0 else _FAR, right if right > 0 else _FAR)
    # A lost column, or something closer than the sensor can measure: the end is unknown.
    if evidence.lost[c] or near < np.float32(1.5) * limits.nearest + np.float32(0.1):
        return none, none, g, SWALLOWED
    # The neighbors on both sides hit one surface: a window, a black car.
    wide = np.float32(0.5) * (left + right)
    gap = np.float32((gap_left + gap_right) * (2 * np.pi / depth.shape[0])) * wide
    across, along = _one_surface(left, right) & (gap < GAP_M), _one_surface(up, down)
    if across or along:
        best = min(wide if across else _FAR, np.float32(0.5) * (up + down) if along else _FAR, g)
        certain = across and gap < SURE_GAP_M
        return best, best, best if certain else g, SURFACE
    # Between two things, in a ring that nearly always returns: one of them, or something between them.
    if left > 0 and right > 0 and evidence.ring_share[r] > SURE:
        return min(wide, g), min(near, g), g, SURFACE
    # Ground so close always returns, so something swallowed the beam, unless only one or two are missing amid ground.
    alone = (gap_left + gap_right <= 3) & (left == _GROUND) & (right == _GROUND)
    shares = evidence.ground_share
    expected = g < limits.reach and shares[min(int(g / limits.band), shares.shape[0] - 1)] > SURE
    if expected and not alone:
        best = near if near < g else none
        return best, best, g, SWALLOWED
    # Nothing before the ground or the maximum range; the beam went at least as far as the things next to it.
    nowhere = (left == _NONE) & (right == _NONE)
    return g, none if nowhere else min(near, g), g, OPEN
