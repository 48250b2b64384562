"""Cells of a field of view in and around boxes: obstacle surfaces, beams that pass, or nothing."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import F64
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.geometry import FloatArray, Rigid
from viewshed.grid import BevGrid

FINE, COARSE = (17, 9), (9, 5)
"""Sample points along and across a box: to classify its cells, and to move it."""

MARGIN_M = 0.25
"""Margin around sampled boxes: half a cell of a grid for roads."""

REACH_M, STEP_M = 2.0, 0.5
"""Maximum distance and step by which a box is moved to find its surface."""

_WEIGHTS = np.array([0.0, -1.0, 1.0, 0.0], np.float32)
"""Score of a point of a moved box by its cell's state (unknown, free, surface, hidden)."""

_SHARPNESS = 8.0
"""Factor from mean score to log weight of a place; higher prefers the best places more."""

_NEAR_FIRST_PER_M2 = 0.12
"""Score penalty per squared distance, so that the nearest of equal places wins."""


class BoxCells(NamedTuple):
    """Cells in and around K boxes, (K,) each; shares lie in [0, 1]."""

    surface: F64  # share of the footprint in cells with an obstacle return
    free: F64  # share in cells that beams pass
    hidden: F64  # share in cells that something nearer blocks; the rest is unknown or outside the grid
    ring: F64  # share of the meter around the box with an obstacle return
    ring_free: F64  # share of the meter around the box that beams pass
    near_free: F64  # share of the side facing the sensor that beams pass
    first_m: F64  # meters from the side facing the sensor to the first surface in the box, 10 for none
    range_m: F64  # meters from the sensor


@dataclass(frozen=True, slots=True, eq=False)
class SeenCells:
    """States of a field of view, queried in the frame of the tracks."""

    grid: BevGrid  # cells in the ``level`` frame
    state: NDArray[np.uint8]  # (cells, cells) uint8 of ``CellState``
    frame_from_level: Rigid  # pose of the ``level`` frame of the sweep in the tracks' frame

    @classmethod
    def of(cls, estimate: FovEstimate) -> SeenCells:
        """Return the cells of an estimate, in the world if it has a pose, else in its own ``level`` frame."""
        return cls(estimate.grid, estimate.state, estimate.world_from_level or Rigid.identity())

    def states_at(self, xy: FloatArray) -> NDArray[np.uint8]:
        """Return the states (…,) at points (…, 2) of the tracks' frame; UNKNOWN outside the grid."""
        cells = np.floor(self._places(np.asarray(xy, np.float64)))
        return self._states(cells)

    def _places(self, xy: F64) -> F64:
        """Return points (…, 2) in units of cells (2, …); integers are the lower corners of cells."""
        x, y = xy[..., 0] - self.frame_from_level.translation[0], xy[..., 1] - self.frame_from_level.translation[1]
        yaw, (left, low), cell_m = self.frame_from_level.yaw, self.grid.origin_m, self.grid.cell_m
        cos, sin = np.cos(yaw) / cell_m, np.sin(yaw) / cell_m
        return np.stack([cos * x + sin * y - left / cell_m, cos * y - sin * x - low / cell_m])

    def _states(self, cells: NDArray[Any]) -> NDArray[np.uint8]:
        """Return the states (…,) of cells by integer indices (2, …); UNKNOWN outside the grid."""
        side = self.grid.cells
        inside = ((cells >= 0) & (cells < side)).all(axis=0)
        flat = np.where(inside, cells[0] * side + cells[1], 0).astype(np.int32)
        return np.where(inside, self.state.reshape(-1)[flat], np.uint8(CellState.UNKNOWN))

    def look(self, boxes: F64, place: F64, counts: tuple[int, int] = FINE) -> BoxCells:
        """Return the cells in and around boxes (K, 7), seen from a point (2,), sampled at ``counts`` points."""
        pose = np.append(self.frame_from_level.translation, self.frame_from_level.yaw)
        cells = _core.look_at_boxes(
            self.state, *self.grid.origin_m, self.grid.cell_m, pose, np.ascontiguousarray(boxes, np.float64),
            float(place[0]), float(place[1]), *counts,
        )  # fmt: skip
        return BoxCells(*cells.T)

    def shifts(self, boxes: F64) -> F64:
        """Return the vector (K, 2) in meters from each box to the nearest matching surface, 0 if there is none.

        The box is moved within :data:`REACH_M`; surface in it supports a place, free cells speak against it. The result
        is the weighted mean over all places, so that it is finer than a cell.
        """
        # Move by whole cells along the axes of the grid, so that each point of a box is transformed once.
        cell_m = self.grid.cell_m
        stride = max(round(STEP_M / cell_m), 1)
        steps = stride * np.arange(-round(REACH_M / (stride * cell_m)), round(REACH_M / (stride * cell_m)) + 1)
        moves = np.stack(np.meshgrid(steps, steps, indexing="ij")).reshape(2, -1).astype(np.int32)
        points = np.floor(self._places(footprint_points(boxes, COARSE))).astype(np.int32)
        states = self._states(points[:, :, None] + moves[:, None, :, None])
        moves_m = cell_m * moves.T
        score = _WEIGHTS[states].mean(axis=2) - _NEAR_FIRST_PER_M2 * (moves_m**2).sum(axis=1)
        weight = np.exp(_SHARPNESS * (score - score.max(axis=1, keepdims=True, initial=-np.inf)))
        mean = weight @ moves_m / weight.sum(axis=1, keepdims=True)
        has_surface = (states == CellState.SURFACE).any(axis=(1, 2))
        cos, sin = np.cos(self.frame_from_level.yaw), np.sin(self.frame_from_level.yaw)
        return np.asarray(np.where(has_surface[:, None], mean @ np.array([[cos, sin], [-sin, cos]]), 0.0))


def footprint_points(boxes: F64, counts: tuple[int, int] = FINE, margin_m: float = MARGIN_M) -> NDArray[Any]:
    """Return points (K, P, 2) spread over the footprints of boxes (K, 7) with a margin."""
    along, across = _lattice(*counts)
    forward = along * (boxes[:, 3:4] + 2 * margin_m)
    left = across * (boxes[:, 4:5] + 2 * margin_m)
    cos, sin = np.cos(boxes[:, 6:7]), np.sin(boxes[:, 6:7])
    points = np.stack([cos * forward - sin * left, sin * forward + cos * left], axis=-1)
    return np.asarray(boxes[:, None, :2] + points)


@lru_cache(maxsize=8)
def _lattice(lengthwise: int, crosswise: int) -> NDArray[Any]:
    """Return sample points along and across a box, (2, lengthwise x crosswise), in fractions of its sides."""
    sides = (np.linspace(-0.5, 0.5, count) for count in (lengthwise, crosswise))
    return np.stack(np.meshgrid(*sides, indexing="ij")).reshape(2, -1)
