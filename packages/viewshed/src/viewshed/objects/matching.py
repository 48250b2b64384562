"""Matching of detections with true boxes by their centers, and corners of boxes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64

Numbers = NDArray[np.intp]

WITHIN_M = 2.0
"""Maximum distance between the centers of a match."""


def match_boxes(
    found: NDArray[np.floating[Any]], true: NDArray[np.floating[Any]], within_m: float = WITHIN_M
) -> Numbers:
    """Return the index (K,) of the true box of each of K detected boxes, or -1: nearest centers first, one to one.

    >>> true = np.array([[5.0, 0, 1, 4, 2, 2, 0], [9.0, 0, 1, 4, 2, 2, 0]])
    >>> match_boxes(np.array([[6.5, 0, 1, 4, 2, 2, 0], [20.0, 0, 1, 4, 2, 2, 0]]), true).tolist()
    [0, -1]
    """
    matched = np.full(len(found), -1, np.intp)
    distance_m = np.hypot(found[:, None, 0] - true[None, :, 0], found[:, None, 1] - true[None, :, 1])
    near = np.argwhere(distance_m <= within_m)
    is_taken = np.zeros(len(true), np.bool_)
    for k, t in near[np.argsort(distance_m[tuple(near.T)], kind="stable")]:
        if matched[k] < 0 and not is_taken[t]:
            matched[k], is_taken[t] = t, True
    return matched


def corners_of(boxes: NDArray[np.floating[Any]]) -> F64:
    """Return the corners (K, 4, 2) in meters of boxes (K, 7) from above, counter-clockwise."""
    ahead = np.stack([np.cos(boxes[:, 6]), np.sin(boxes[:, 6])], axis=-1) * boxes[:, 3:4] / 2
    left = np.stack([-np.sin(boxes[:, 6]), np.cos(boxes[:, 6])], axis=-1) * boxes[:, 4:5] / 2
    middle = boxes[:, :2]
    corners: F64 = np.stack(
        [middle + ahead + left, middle - ahead + left, middle - ahead - left, middle + ahead - left], axis=1
    )
    return corners
