"""Fields of view for a tracker: could an object be seen, would it be detected, and could it have come unseen."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import lru_cache
from typing import Protocol

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from viewshed import _core
from viewshed.arrays import F64
from viewshed.detections import moved_boxes
from viewshed.fov.estimate import FovEstimate
from viewshed.fov.visibility import CAR, probability_of_visible
from viewshed.geometry import Rigid
from viewshed.objects.detection_table import detection_table
from viewshed.preprocess.evidence import expected_returns
from viewshed.preprocess.leveling import LeveledSweep

Kinds = NDArray[np.uint8]

DetectionProb = Callable[[F64, F64, Kinds], F64]
"""Probability (K,) that a detector finds objects, by expected returns (K,), range (K,) in meters and kind (K,)."""

ALWAYS_FOUND = 0.9
"""Default probability that a detector finds a visible object, for views without a detector model."""

_STEP_M = 1.5
"""Distance in meters between the rings of ``hides_near``, ..."""

_MAX_RINGS = 8
"""... and their maximum number at any radius."""

_MAX_PLACES = 10_000
"""Maximum number of sample points per query, whatever the number of boxes; then rings are fewer, at least one."""


class View(Protocol):
    """What one sensor could see during one sweep; boxes (K, 7) are in the tracks' frame."""

    @property
    def t_s(self) -> float:
        """Time of the sweep in seconds."""
        ...

    @property
    def in_world(self) -> bool:
        """Whether the tracks' frame is the world; False where the sweep has no pose and the frame is ``level``."""
        ...

    def visible(self, boxes: F64) -> F64:
        """Return the probability (K,) that an object in each box could be seen."""
        ...

    def detectable(self, boxes: F64, kinds: Kinds) -> F64:
        """Return the probability (K,) that the detector finds an object in each box, given that it can be seen."""
        ...

    def false_odds(self, boxes: F64, kinds: Kinds) -> F64 | None:
        """Return the number (K,) of false detections like each per true one; None if unknown."""
        ...

    def hides_near(self, boxes: F64, within_m: F64) -> F64:
        """Return the probability (K,) that some point within (K,) meters of each box could not be seen.

        A new object may have come from there; the border of the grid counts as such a point.
        """
        ...


class _LevelView(ABC):
    """Base of views in ``level``; without a detector model all visible objects are equally detectable."""

    _detectable = ALWAYS_FOUND

    def __init__(self, t_s: float, world_from_level: Rigid | None) -> None:
        self.t_s, self.in_world = t_s, world_from_level is not None
        self._level_from_tracks = Rigid.identity() if world_from_level is None else world_from_level.inverse()

    @abstractmethod
    def visible(self, boxes: F64) -> F64:
        """Return the probability (K,) that an object in each box could be seen."""

    def detectable(self, boxes: F64, kinds: Kinds) -> F64:
        """Return the same probability (K,) for all boxes."""
        return np.full(len(boxes), self._detectable)

    def false_odds(self, boxes: F64, kinds: Kinds) -> F64 | None:
        """Return None."""
        return None

    def hides_near(self, boxes: F64, within_m: F64) -> F64:
        """Return the maximum probability (K,) of not being seen within (K,) meters of each box."""
        return hidden_within(self, boxes, within_m)


class SeesAll(_LevelView):
    """View without a field of view: everything is visible, but new objects may still have come unseen."""

    def __init__(self, t_s: float, *, detectable: float = ALWAYS_FOUND, in_world: bool = True) -> None:
        """Build the view of a sweep at ``t_s``."""
        super().__init__(t_s, Rigid.identity() if in_world else None)
        self._detectable = detectable

    def visible(self, boxes: F64) -> F64:
        """Return ones (K,)."""
        return np.ones(len(boxes))

    def hides_near(self, boxes: F64, within_m: F64) -> F64:
        """Return ones (K,)."""
        return np.ones(len(boxes))


class PolygonView(_LevelView):
    """Field of view as a polygon, as published: an object is visible if the polygon covers its center."""

    def __init__(self, polygon: BaseGeometry, world_from_level: Rigid | None, t_s: float) -> None:
        """Build the view from a polygon in ``level``; without a pose the tracks are in ``level``."""
        super().__init__(t_s, world_from_level)
        self._polygon = polygon
        shapely.prepare(polygon)

    @classmethod
    def of(cls, estimate: FovEstimate, t_s: float) -> PolygonView:
        """Return the view of an estimate's polygon, which covers exactly its visible cells."""
        return cls(estimate.polygon(), estimate.world_from_level, t_s)

    def visible(self, boxes: F64) -> F64:
        """Return 1 (K,) where the polygon covers the center, else 0."""
        level = moved_boxes(boxes, self._level_from_tracks)
        return np.asarray(shapely.contains_xy(self._polygon, level[:, 0], level[:, 1]), np.float64)


class GridView(_LevelView):
    """Estimated field of view, sampled in front of an object, because an object hides the cells behind its surface.

    Five lines of sight across the box are followed to its near side and one cell back; the visibility of the object is
    the mean over these cells.
    """

    def __init__(self, estimate: FovEstimate, t_s: float) -> None:
        """Build the view of an estimate at ``t_s``; without a pose the tracks are in its ``level`` frame."""
        super().__init__(t_s, estimate.world_from_level)
        self._estimate = estimate

    def visible(self, boxes: F64) -> F64:
        """Return the mean probability (K,) of the cells in front of each box; 0 outside the grid."""
        level, grid = moved_boxes(boxes, self._level_from_tracks), self._estimate.grid
        return _core.visible_before(self._estimate.visible_prob, *grid.origin_m, grid.cell_m, level)


class BeamView(_LevelView):
    """Beams of the sweep: how many would hit a box if its own returns were removed."""

    def __init__(self, leveled: LeveledSweep, t_s: float, *, found: DetectionProb | None = None) -> None:
        """Build the view of a leveled sweep; without a pose the tracks are in its ``level`` frame.

        Args:
            leveled: the sweep.
            t_s: its time in seconds.
            found: detection probability by expected returns, range and kind; None is that of the shipped detector.
                False detections of another detector are unknown: :meth:`false_odds` returns None.
        """
        super().__init__(t_s, leveled.world_from_level)
        self._table = detection_table() if found is None else None
        self._leveled, self._found = leveled, found or detection_table().prob
        self._counted = np.zeros((0, 7)), np.zeros(0)

    def visible(self, boxes: F64) -> F64:
        """Return the probability (K,) that at least ``min_returns`` beams hit each box."""
        return self._visible(self._counts(moved_boxes(boxes, self._level_from_tracks)))

    def detectable(self, boxes: F64, kinds: Kinds) -> F64:
        """Return the probability (K,) that the detector finds an object, given that it can be seen.

        The detector's table includes the effect of few returns: the product with :meth:`visible` is at most the table.
        """
        level = moved_boxes(boxes, self._level_from_tracks)
        counts = self._counts(level)
        prob = self._found(counts, np.hypot(level[:, 0], level[:, 1]), kinds)
        return np.clip(prob / np.maximum(self._visible(counts), 1e-6), 0.0, 1.0)

    def false_odds(self, boxes: F64, kinds: Kinds) -> F64 | None:
        """Return the number (K,) of false detections like each per true one."""
        if self._table is None:
            return None
        level = moved_boxes(boxes, self._level_from_tracks)
        return self._table.false_odds(np.hypot(level[:, 0], level[:, 1]), kinds)

    def _counts(self, level: F64) -> F64:
        """Return the expected returns (K,), cached because a tracker queries the same boxes twice."""
        boxes, counts = self._counted
        if not np.array_equal(boxes[: len(level)], level):
            counts = expected_returns(self._leveled, level, leave_out_own=True).astype(np.float64)
            self._counted = level, counts
        return counts[: len(level)]

    def _visible(self, counts: F64) -> F64:
        return probability_of_visible(counts.astype(np.float32), CAR.min_returns).astype(np.float64)


def hidden_within(view: View, boxes: F64, within_m: F64) -> F64:
    """Return the maximum probability (K,) of not being seen at any point within (K,) meters of each box.

    The box is moved to points on up to eight rings about its center, 1.5 m apart where eight suffice.
    """
    if not len(boxes):
        return np.zeros(0)
    rings = int(np.clip(np.ceil(within_m.max() / _STEP_M), 1, _MAX_RINGS))
    while rings > 1 and len(boxes) * len(_places(rings)) > _MAX_PLACES:
        rings -= 1
    unit = _places(rings)
    places = np.repeat(boxes[:, None], len(unit), axis=1)
    places[..., :2] += within_m[:, None, None] * unit
    visible = view.visible(places.reshape(-1, 7)).reshape(len(boxes), len(unit))
    return np.asarray(1.0 - visible.min(axis=1))


@lru_cache(maxsize=_MAX_RINGS)
def _places(rings: int) -> F64:
    """Return points of the unit disc (places, 2): the center and ``rings`` rings of 6, 12, ... points."""
    numbers = np.arange(1, rings + 1)
    radii = np.repeat(numbers / rings, 6 * numbers)
    angles = np.concatenate([2 * np.pi * np.arange(6 * k) / (6 * k) for k in numbers])
    ring_points = radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return np.concatenate([np.zeros((1, 2)), ring_points])
