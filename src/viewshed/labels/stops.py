"""Where every beam of a revolution ended: those that returned, and as well as it can be told those that did not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed.labels.ground_map import Patch
from viewshed.labels.image import BeamImage
from viewshed.labels.stop_kernels import cast_to_ground, count_ground, drop_lonely, explain, lost_columns
from viewshed.level import OBSTACLE_HEIGHTS_M

Floats = NDArray[np.float32]

SURE = 0.85
"""Share of returns from which on ground at a range is sure to return; a beam that does not was swallowed."""
GAP_M = 5.0
"""A surface goes on behind missing beams over a gap of at most this: a shop window, a black car."""
SURE_GAP_M = 0.6
"""Over a gap of at most this it surely does; a wider one may be a window that beams pass."""
LONELY_M = 35.0
LONELY_SHARE = 0.06
"""Returns in the air up to 35 m that no others share are drops or flakes if they are so many, and count as missing."""
_BANDS, _SECTORS, _ENOUGH = 20, 32, 8
_QUANTILE = 0.8


@dataclass(frozen=True, slots=True, eq=False)
class Stops:
    """Where each beam ended, and why.

    Attributes:
        best_m: (C, R) float32 metres from its start to the likeliest end.
        least_m: (C, R) it went at least so far.
        most_m: (C, R) it went at most so far.
        thing: (C, R) bool, whether it returned from something that stands 0.3 m or more above the ground.
        kind: (C, R) uint8, what became of a missing beam (``stop_kernels``); 0 where it returned.
    """

    best_m: NDArray[np.float32]
    least_m: NDArray[np.float32]
    most_m: NDArray[np.float32]
    thing: NDArray[np.bool_]
    kind: NDArray[np.uint8]


def stops_of(image: BeamImage, patch: Patch) -> Stops:
    """Return where the beams of ``image`` ended over the ground ``patch``.

    A beam that returned ended there. One that did not

    - ended on the surface that its neighbors met, if those left and right of it in its ring (a gap of at most 5 m), or
      above and below it, met one surface: a window, a black car;
    - was swallowed, nobody knows where, if its column and those beside it are empty, or if it aims at ground so near
      that ground there always returns, and its neighbors are not all ground;
    - else met nothing before the ground or the maximum range; at least it went as far as the things next to it.
    """
    reach = np.float32(image.max_range_m)
    to_ground, thing = np.empty(image.depth_m.shape, np.float32), np.empty(image.depth_m.shape, np.bool_)
    c, s = np.cos(patch.yaw), np.sin(patch.yaw)
    numbers = [patch.ground.half_extent_m, *patch.center_m, c, s, reach, OBSTACLE_HEIGHTS_M[0]]
    frame = tuple(np.array(numbers, np.float32))
    beams = (image.origin_m, image.direction, image.depth_m)
    cast_to_ground(beams, patch.ground.heights_m, frame, to_ground, thing)
    depth, lost = np.empty_like(to_ground), np.empty(len(to_ground), np.bool_)
    lonely = drop_lonely(image.depth_m, thing, np.float32(LONELY_M), depth)
    if lonely < LONELY_SHARE * np.count_nonzero(thing):
        depth = image.depth_m
    else:
        cast_to_ground((*beams[:2], depth), patch.ground.heights_m, frame, to_ground, thing)
    lost_columns(depth, lost)
    band = np.float32(max(image.max_range_m / _BANDS, 1e-3))
    shares = (_seen_share((depth, to_ground, thing), reach, band), np.asarray((depth > 0).mean(axis=0), np.float32))
    depths, kinds = np.empty((3, *to_ground.shape), np.float32), np.empty(to_ground.shape, np.uint8)
    nearest = 0.0 if image.model is None else image.model.min_range_m
    limits = tuple(np.array([reach, nearest, band, SURE, GAP_M, SURE_GAP_M], np.float32))
    explain((depth, to_ground, thing, lost), shares, limits, (depths, kinds))
    return Stops(depths[0], depths[1], depths[2], thing, kinds)


def _seen_share(beams: tuple[Floats, Floats, NDArray[np.bool_]], reach: np.float32, band: np.float32) -> Floats:
    """Return how often ground returns (bands,), by its range, in the better sectors: others hold windows and cars."""
    counts = np.zeros((_BANDS, _SECTORS, 2))
    count_ground(*beams, (band / 2, reach, band), counts)
    total = counts.sum(axis=-1)
    share = np.where(total >= _ENOUGH, counts[..., 0] / np.maximum(total, 1), np.nan)
    share[np.isnan(share).all(axis=1), 0] = 0.0
    return np.asarray(np.nanquantile(share, _QUANTILE, axis=1), np.float32)
