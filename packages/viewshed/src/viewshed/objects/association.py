"""Association of detections with tracks: the assignment of maximum total benefit (global nearest neighbor)."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from viewshed._extras import needed_for
from viewshed.arrays import F64, Mask
from viewshed.objects.matching import corners_of

Numbers = NDArray[np.int32]


@lru_cache(maxsize=1)
def assignment_solver() -> Callable[..., tuple[NDArray[Any], NDArray[Any]]]:
    """Return scipy's solver of the linear assignment problem.

    Raises:
        ImportError: scipy is not installed.
    """
    with needed_for("tracking"):
        from scipy.optimize import linear_sum_assignment
    solver: Callable[..., tuple[NDArray[Any], NDArray[Any]]] = linear_sum_assignment
    return solver


def assign(benefit: F64) -> Numbers:
    """Return the index (N,) of each track's detection, -1 for none, that maximizes the total ``benefit`` (N, K).

    The benefit of a pair is relative to leaving both unmatched; pairs without a positive benefit are never matched.

    >>> assign(np.array([[5.0, 4.0, -1.0], [4.5, 0.0, -1.0]])).tolist()
    [1, 0]
    """
    gain = np.where(benefit > 0.0, benefit, 0.0)
    rows, columns = assignment_solver()(gain, maximize=True)
    assigned = np.full(len(benefit), -1, np.int32)
    is_gain = gain[rows, columns] > 0.0
    assigned[rows[is_gain]] = columns[is_gain]
    return assigned


def volume_overlaps(first: F64, second: F64) -> F64:
    """Return the intersection over union (N, K) of the volumes of boxes (N, 7) and (K, 7).

    >>> box = np.array([[0.0, 0.0, 0.0, 4.0, 2.0, 2.0, 0.0]])
    >>> volume_overlaps(box, box + np.array([1.0, 0, 0, 0, 0, 0, 0])).tolist()
    [[0.6]]
    """
    intersection = np.zeros((len(first), len(second)))
    diagonals = np.hypot(first[:, None, 3], first[:, None, 4]) + np.hypot(second[None, :, 3], second[None, :, 4])
    distance_m = np.hypot(first[:, None, 0] - second[None, :, 0], first[:, None, 1] - second[None, :, 1])
    rows, columns = np.nonzero(2.0 * distance_m < diagonals)
    footprints = np.asarray(shapely.polygons(corners_of(first))), np.asarray(shapely.polygons(corners_of(second)))
    areas = shapely.area(shapely.intersection(footprints[0][rows], footprints[1][columns]))
    low = np.maximum((first[:, 2] - first[:, 5] / 2)[rows], (second[:, 2] - second[:, 5] / 2)[columns])
    high = np.minimum((first[:, 2] + first[:, 5] / 2)[rows], (second[:, 2] + second[:, 5] / 2)[columns])
    intersection[rows, columns] = areas * np.maximum(high - low, 0.0)
    volumes = first[:, 3:6].prod(axis=1)[:, None] + second[:, 3:6].prod(axis=1)[None, :]
    return np.asarray(intersection / (volumes - intersection))


def inside(points: F64, boxes: F64, margin_m: float = 0.0) -> Mask:
    """Return which points (K, 2+) lie in the footprints of boxes (N, 7) or within a margin around them: mask (N, K)."""
    dx = points[None, :, 0] - boxes[:, 0, None]
    dy = points[None, :, 1] - boxes[:, 1, None]
    cos, sin = np.cos(boxes[:, 6])[:, None], np.sin(boxes[:, 6])[:, None]
    is_along = np.abs(cos * dx + sin * dy) <= boxes[:, 3, None] / 2 + margin_m
    return np.asarray(is_along & (np.abs(cos * dy - sin * dx) <= boxes[:, 4, None] / 2 + margin_m))


def no_part_of_earlier(is_part: Mask) -> Mask:
    """Return the mask (K,) of boxes that are in no earlier box that is kept; ``is_part[i, k]`` is whether k is in i."""
    kept = np.ones(len(is_part), np.bool_)
    for k in np.flatnonzero(np.triu(is_part, k=1).any(axis=0)):
        kept[k] = not (is_part[:k, k] & kept[:k]).any()
    return kept
