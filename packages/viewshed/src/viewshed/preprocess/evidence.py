"""Beam evidence: expected returns of a target in each cell, which decide the states of every estimate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import F32, Mask
from viewshed.fov.estimate import THRESHOLD, CellState
from viewshed.fov.visibility import Beams, Target, cell_windows, poisson_table, probability_of_visible
from viewshed.grid import BevGrid
from viewshed.preprocess.leveling import OBSTACLE_HEIGHTS_M, LeveledSweep
from viewshed.preprocess.no_return import beams_by_evidence
from viewshed.preprocess.reach import reach_of_sweep

States = NDArray[np.uint8]

Counts = NDArray[np.int32]

TALLEST_BOX_M = 4.0
"""Height above ground of the tallest box; no-return beams that stay above it are ignored."""


@dataclass(frozen=True, slots=True, eq=False)
class BeamEvidence:
    """Expected returns of a target in each cell by the definition of visible; arrays are (cells, cells).

    Attributes:
        grid: grid of the cells.
        target: the target.
        measured: float32 expected returns from beams with a measured depth.
        inferred: float32 expected returns from no-return beams at their median depth.
        late: float32 expected returns from no-return beams at the depth that one in five of them exceeds.
        aimed: float32 number of measured and no-return beams aimed at the target, regardless of depth.
        counted_prob: float32 probability of at least ``target.min_returns`` returns from both kinds, averaged over the
            distributions of ground height and beam depth.
        visible_prob: float32 probability that a target in the cell is visible: a small network (fitted to exact truth
            by ``tools/fit_calibration.py``) gives the share of visible cells among cells with the same features: the
            evidence in the cell and around it, the nearest obstacle and the farthest return of its azimuth, and
            averages over all cells of the sweep. It is 0 without any beams. Beyond reach, and where too few beams
            reach a target on the estimated ground, it is below the threshold; elsewhere it reaches the threshold where
            ``counted_prob`` does.
        within_reach: bool mask of cells within ``reach_m``.
        reach_m: maximum range of a dark target.
    """

    grid: BevGrid
    target: Target
    measured: F32
    inferred: F32
    late: F32
    aimed: F32
    counted_prob: F32
    visible_prob: F32
    within_reach: Mask
    reach_m: float

    @property
    def reaching(self) -> F32:
        """(cells, cells) float32 expected returns from measured and no-return beams."""
        return self.measured + self.inferred

    def supports_claim(self) -> Mask:
        """Return the mask (cells, cells) of cells that may be called visible: they probably are.

        These are within reach, and enough beams reach a target there.
        """
        return np.asarray(self.visible_prob >= np.float32(THRESHOLD))

    def supports_denial(self) -> Mask:
        """Return the mask (cells, cells) of cells that may be called hidden.

        These are within reach, enough beams are aimed at a target there, and too few reach it on the estimated ground,
        even at the late depth of the no-return beams.
        """
        everywhere = np.ones(self.grid.shape, np.bool_)
        return np.asarray(self.states(~everywhere, everywhere, ~everywhere) == CellState.HIDDEN)

    def bounded(self, prob: F32, threshold: float) -> F32:
        """Return an estimator's probability (cells, cells), capped below its threshold in cells without support."""
        max_prob = np.nextafter(np.float32(threshold), np.float32(0.0))
        return np.where(self.supports_claim(), prob, np.minimum(prob, max_prob))

    def states(self, visible: Mask, denied: Mask, obstacle: Mask) -> States:
        """Return the states (cells, cells) uint8 of an estimator's claims and denials.

        A claim that the beams support is FREE or SURFACE, a denial that they support is HIDDEN, the rest is UNKNOWN.

        Args:
            visible: mask of the cells that the estimator calls visible.
            denied: mask of the cells that the estimator calls not visible.
            obstacle: mask of the cells with an obstacle return.
        """
        return _core.states(
            self.measured,
            self.late,
            self.aimed,
            self.visible_prob,
            self.within_reach,
            np.ascontiguousarray(visible),
            np.ascontiguousarray(denied),
            np.ascontiguousarray(obstacle),
            table=poisson_table(self.target.min_returns),
        )


def cell_features(leveled: LeveledSweep, evidence: BeamEvidence) -> F32:
    """Return the features (features, cells, cells) of the network that gives ``visible_prob``."""
    own_prob = probability_of_visible(evidence.reaching, evidence.target.min_returns)
    cells = evidence.measured, evidence.inferred, evidence.late, evidence.aimed, evidence.counted_prob, own_prob
    return _core.cell_features(
        cell_windows(evidence.grid, evidence.target.width_m), cells, _returns_of(leveled), *OBSTACLE_HEIGHTS_M,
        leveled.ground.heights_m,
    )  # fmt: skip


class Obstacles(Protocol):
    """Obstacles of earlier sweeps, at which beams end (:class:`viewshed.preprocess.history.History`)."""

    def within(self, beams: Beams) -> Beams:
        """Return the beams with depths limited to the obstacle in their direction."""
        ...


def beam_evidence(
    leveled: LeveledSweep, grid: BevGrid, target: Target, history: Obstacles | None = None
) -> BeamEvidence:
    """Return the evidence of a leveled sweep, cached per grid, target and history.

    With a history, beams end at the obstacles of earlier sweeps.
    """
    # A weak reference: a history refers to earlier sweeps, so a strong one would keep all sweeps of a stream alive.
    key = "beam_evidence", grid, target, None if history is None else ref(history)
    evidence: BeamEvidence | None = leveled.derived.get(key)
    if evidence is None:
        evidence = leveled.derived[key] = _count_beams(leveled, grid, target, history)
    return evidence


def _count_beams(leveled: LeveledSweep, grid: BevGrid, target: Target, history: Obstacles | None) -> BeamEvidence:
    beams = beams_by_evidence(leveled, target.height_m)
    measured, inferred, early, late = (
        kind if history is None else history.within(kind)
        for kind in (beams.measured, beams.inferred, beams.early, beams.late)
    )
    ground, reach_m = leveled.ground, reach_of_sweep(leveled)
    arrays = _core.beam_evidence(
        cell_windows(grid, target.width_m),
        measured.arrays,
        (*inferred.arrays, early.arrays[2], late.arrays[2]),
        _returns_of(leveled),
        ground.heights_m,
        ground.std_m,
        half_extent_m=ground.half_extent_m,
        sensor_height_m=leveled.sensor_height_m,
        target_height_m=target.height_m,
        low_m=OBSTACLE_HEIGHTS_M[0],
        high_m=OBSTACLE_HEIGHTS_M[1],
        table=poisson_table(target.min_returns),
        reach_m=reach_m,
    )
    for array in arrays:
        array.setflags(write=False)
    return BeamEvidence(grid, target, *arrays, reach_m)


def _returns_of(leveled: LeveledSweep) -> tuple[F32, F32, F32]:
    return leveled.azimuth, leveled.range_m, leveled.height_m


def expected_returns(leveled: LeveledSweep, boxes: NDArray[np.floating[Any]], *, leave_out_own: bool = True) -> Counts:
    """Return (K,) int32 the number of beams of a leveled sweep that would hit each of K boxes.

    A beam counts if its line intersects the box and its depth reaches the box (tolerance 0.1 m, the range noise). The
    depth is that of the return, or the inferred one (:func:`viewshed.preprocess.no_return.beams_by_evidence`). The
    sorted beams of a sweep are cached.

    Args:
        leveled: the sweep.
        boxes: (K, 7) center x, y, z, length, width and height in meters, and yaw in radians, in ``level``.
        leave_out_own: ignore the returns inside a box, so that their beams count as hits. If False, a return inside a
            box ends its beam, so only beams that pass through the whole box count.

    Raises:
        ValueError: the shape of the boxes is wrong, or a box is not finite or has no size.
    """
    boxes = np.ascontiguousarray(boxes, np.float32)
    if boxes.ndim != 2 or boxes.shape[1] != 7:
        raise ValueError(f"boxes must have shape (K, 7), got {boxes.shape}; give x, y, z, length, width, height, yaw")
    key = ("beams_by_azimuth",)
    if key not in leveled.derived:
        beams = beams_by_evidence(leveled, TALLEST_BOX_M)
        leveled.derived[key] = _core.BeamsByAzimuth(*(beams.measured + beams.inferred).arrays)
    beams_by_azimuth: _core.BeamsByAzimuth = leveled.derived[key]
    return beams_by_azimuth.expected_returns(boxes, leveled.sensor_height_m, leave_out_own)
