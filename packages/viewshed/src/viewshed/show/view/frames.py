"""Pack one frame of the page: estimate, points and monitor report as compact binary arrays, numbers as JSON.

Before deflate, the data are arrays one after the other, read by ``page.js`` in this order:

- cells, (cells, cells) uint8, row i forward and column j left: bits 0 and 1 the state, bit 2 visible, bit 3 suspect,
  bits 4 to 7 the probability as step k of 16: it lies in [k, k + 1] / 16;
- deviation, (cells, cells) uint8, only if ``deviation_top`` is set: k of 31 shares of it; 255 is none;
- points, (3, 2, points) uint8: for x, y and height the low bytes, then the high bytes, of int16 centimeters. x and y
  are differences to the preceding point, which compress well because points are sorted by cell.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.agents.legend import ShownTracks
from viewshed.detections import Detections
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.grid import BevGrid
from viewshed.monitor.report import IntegrityReport
from viewshed.preprocess.leveling import LeveledSweep

MAX_POINTS = 10_000
"""Maximum number of points of a sweep; more cannot be distinguished on a screen."""

POINT_CELLS = 1024
"""Cells a side of a grid over the same extent; only the highest point of a cell is kept, as it is drawn on top."""

PROBABILITY_STEPS = 16

DEVIATION_STEPS = 31
"""Number of steps of the deviation; finer ones would increase the size of a frame by half."""

NO_DEVIATION = 255

_MAX_CM = 32_767
"""Range of int16: 327 m."""


@dataclass(frozen=True, slots=True)
class AgentTrust:
    """A center's trust in one agent."""

    agent: str  # name
    trust: float  # probability that it is honest
    accused: bool = False  # the center's limits say that it lies
    disputed: bool = False  # it or another agent lies
    forged: bool = False  # an adversary is known to forge its messages


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A sweep with its estimate and results, as a viewer shows it.

    Raises:
        ValueError: the report's cells are on another grid than the estimate.
    """

    name: str  # of the sweep
    estimate: FovEstimate
    leveled: LeveledSweep | None = None  # the estimated sweep; None draws no points
    report: IntegrityReport | None = None  # of a monitor, or None
    detections: Detections | None = None  # objects of this sweep in ``level``; None if not detected
    tracks: ShownTracks | None = None  # in ``level``; None if objects are not tracked
    trust: tuple[AgentTrust, ...] = ()  # a center's trust in each agent; empty without a center
    lies: tuple[str, ...] = ()  # the center's statements on contradicting agents, one sentence each

    def __post_init__(self) -> None:
        grid = None if self.report is None else self.report.grid
        if grid is not None and grid != self.estimate.grid:
            raise ValueError(f"report must be on the grid of the estimate, {self.estimate.grid}, got {grid}")


@dataclass(frozen=True, slots=True)
class PackedFrame:
    """A frame as stored in a page."""

    about: Mapping[str, Any]  # names and numbers, JSON serializable
    data: bytes  # the arrays described above, raw deflate


def pack_frame(frame: Frame) -> PackedFrame:
    """Return a frame packed for a page; probabilities are exact to 1/32, points to a centimeter."""
    estimate, report = frame.estimate, frame.report
    top = _deviation_top(estimate)
    arrays = [_packed_cells(estimate, None if report is None or report.grid is None else report.suspect_cells)]
    if top is not None:
        arrays.append(_packed_deviation(estimate, top))
    points_cm = np.empty((0, 3), np.int16) if frame.leveled is None else shown_points_cm(frame.leveled, estimate.grid)
    arrays.append(_packed_points(points_cm))
    about = {
        **_about_estimate(frame.name, estimate),
        "returns": 0 if frame.leveled is None else len(frame.leveled.delivered),
        "points": len(points_cm),
        "deviation_top": top,
        **_about_report(report),
        **_about_objects(frame),
    }
    if frame.lies:
        about["alarms"] = [*about.get("alarms", ()), *({"verdict": "center", "reason": lie} for lie in frame.lies)]
    return PackedFrame(about, _deflated(b"".join(array.tobytes() for array in arrays)))


def shown_points_cm(leveled: LeveledSweep, grid: BevGrid) -> NDArray[np.int16]:
    """Return x, y and height above local ground (M, 3) in centimeters of the points that a page draws.

    Keeps the highest point of each small cell, thinned evenly to ``MAX_POINTS``. Points outside the grid, or farther
    than 327 m, are left out.
    """
    fine = BevGrid(POINT_CELLS, grid.half_extent_m, grid.offset_m)
    cells, inside = fine.index(leveled.points)
    values_cm = np.column_stack([leveled.points[:, :2], leveled.height_m]) * np.float32(100)
    near = np.flatnonzero(inside & (np.abs(values_cm[:, :2]) <= _MAX_CM).all(axis=1))
    cell, height_cm = cells[near, 0] * POINT_CELLS + cells[near, 1], values_cm[near, 2]
    # Highest point of each cell, in cell order; faster than sorting all points.
    highest_cm = np.full(POINT_CELLS**2, -np.inf, np.float32)
    np.maximum.at(highest_cm, cell, height_cm)
    is_highest = height_cm == highest_cm[cell]
    point_of_cell = np.full(POINT_CELLS**2, -1, np.intp)
    point_of_cell[cell[is_highest]] = near[is_highest]
    kept = point_of_cell[point_of_cell >= 0]
    if len(kept) > MAX_POINTS:
        kept = kept[np.linspace(0, len(kept) - 1, MAX_POINTS).astype(np.intp)]
    points_cm: NDArray[np.int16] = values_cm[kept].clip(-_MAX_CM, _MAX_CM).round().astype(np.int16)
    return points_cm


def _packed_cells(estimate: FovEstimate, suspect: NDArray[np.bool_] | None) -> NDArray[np.uint8]:
    """Return state, visible, suspect and probability of each cell in a byte; separate bit planes compress worse."""
    steps = np.minimum(estimate.visible_prob * PROBABILITY_STEPS, PROBABILITY_STEPS - 1).astype(np.uint8)
    packed: NDArray[np.uint8] = estimate.state | estimate.visible() * np.uint8(1 << 2) | steps * np.uint8(1 << 4)
    return packed if suspect is None else packed | suspect * np.uint8(1 << 3)


def _deviation_top(estimate: FovEstimate) -> float | None:
    """Return the largest deviation of an estimate, or None if it has none."""
    known = np.empty(0) if estimate.std is None else estimate.std[np.isfinite(estimate.std)]
    return max(float(known.max()), 1e-3) if known.size else None


def _packed_deviation(estimate: FovEstimate, top: float) -> NDArray[np.uint8]:
    share = np.full(estimate.grid.shape, np.nan) if estimate.std is None else estimate.std / np.float32(top)
    known = np.isfinite(share)
    return np.where(known, (np.where(known, share, 0.0) * DEVIATION_STEPS).round(), NO_DEVIATION).astype(np.uint8)


def _packed_points(points_cm: NDArray[np.int16]) -> NDArray[np.uint8]:
    """Return points (M, 3) as bytes (3, 2, M); int16 differences may wrap around, as do the decoder's sums."""
    steps = points_cm.copy()
    steps[1:, :2] = points_cm[1:, :2] - points_cm[:-1, :2]
    columns = np.ascontiguousarray(steps.T).astype("<i2").view(np.uint8).reshape(3, -1, 2)
    return np.ascontiguousarray(columns.transpose(0, 2, 1))


def _about_estimate(name: str, estimate: FovEstimate) -> dict[str, Any]:
    basis, grid = estimate.basis, estimate.grid
    return {
        "name": name,
        "t_ns": None if estimate.t_ns is None else str(estimate.t_ns),  # exact in JavaScript only as text
        "agent": estimate.agent,
        "grid": {"cells": grid.cells, "half_extent_m": grid.half_extent_m, "offset_m": list(grid.offset_m)},
        "method": estimate.method,
        "target": estimate.target.name,
        "visible_m2": round(estimate.area_m2(), 2),
        "shares": [round(estimate.share(state), 4) for state in CellState],
        "basis": [] if basis is None else [basis.height_line, basis.view_line],
    }


def _about_report(report: IntegrityReport | None) -> dict[str, Any]:
    """Return score, limit, alarms and (without suspect cells) sectors; nothing without a monitor."""
    if report is None:
        return {}
    verdicts = [word for word in ("inconsistent", "degraded") if getattr(report, word)]
    reasons = report.reasons or ("no single reason stands out",)
    alarms = [{"verdict": " and ".join(verdicts), "reason": reason} for reason in reasons if verdicts]
    return {
        "score": _finite(report.score),
        "limit": _finite(report.threshold),
        "sectors": None if report.grid is not None else [len(report.suspect), *np.flatnonzero(report.suspect).tolist()],
        "alarms": alarms,
        "notes": list(report.notes),
    }


def _about_objects(frame: Frame) -> dict[str, Any]:
    """Return detections and tracks in ``level``, and the trust in agents, if there are any.

    A track is a list: ID, x, y, length, width, yaw, velocity along x and y, index in the legend, existence, reason.
    """
    about: dict[str, Any] = {}
    if frame.detections is not None:
        about["detections"] = frame.detections.boxes[:, _FROM_ABOVE].round(2).tolist()
    if frame.tracks is not None:
        tracks = frame.tracks
        rows = np.column_stack([tracks.boxes[:, _FROM_ABOVE], tracks.velocities]).round(2).tolist()
        others = zip(
            tracks.ids.tolist(), tracks.legend.tolist(), tracks.existence.tolist(), tracks.reasons, strict=True
        )
        about["tracks"] = [
            [number, *row, at, round(existence, 2), reason]
            for row, (number, at, existence, reason) in zip(rows, others, strict=True)
        ]
    if frame.trust:
        about["trust"] = [
            [one.agent, round(one.trust, 3), one.accused, one.disputed, one.forged] for one in frame.trust
        ]
    return about


_FROM_ABOVE = [0, 1, 3, 4, 6]
"""Columns of a box needed for a bird's-eye view: x, y, length, width, yaw."""


def _finite(value: float) -> float | None:
    """Return a number, or None if it is not finite, which JSON cannot represent."""
    return float(value) if np.isfinite(value) else None


def _deflated(content: bytes) -> bytes:
    """Return raw deflate data for a browser's ``DecompressionStream("deflate-raw")``."""
    deflate = zlib.compressobj(6, zlib.DEFLATED, -zlib.MAX_WBITS)  # level 9 saves 1 % and takes 15 times as long
    return deflate.compress(content) + deflate.flush()
