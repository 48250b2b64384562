"""What the beams of a sweep say about a target in each cell: the evidence that decides every estimate's states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import F32, Mask
from viewshed.fov.estimate import THRESHOLD, CellState
from viewshed.fov.visibility import Beams, Target, cell_windows, poisson_table
from viewshed.grid import BevGrid
from viewshed.preprocess.leveling import OBSTACLE_HEIGHTS_M, LeveledSweep
from viewshed.preprocess.no_return import beams_by_evidence
from viewshed.preprocess.reach import reach_of_sweep

States = NDArray[np.uint8]

Counts = NDArray[np.int32]

TALLEST_BOX_M = 4.0
"""Beams without a return that pass higher above the ground than this, wherever they go, meet no box."""


@dataclass(frozen=True, slots=True, eq=False)
class BeamEvidence:
    """Beams at a target in each cell, counted as the definition of visible counts them; (cells, cells) each.

    Attributes:
        grid: where the cells are.
        target: what would have to be seen.
        measured: float32 expected returns by beams whose depth is measured.
        inferred: float32 expected returns by beams without a return, to where each likely went.
        late: float32 expected returns by the same beams, to where one in five went.
        aimed: float32 beams of the first two kinds that aim at the target, whatever their depth.
        visible_prob: float32 probability that both kinds give ``target.min_returns`` returns, averaged over the heights
            that the ground may have and the ends that beams may have; below the threshold where no claim is supported.
        within_reach: bool, not farther from the sensor than it sees a dark target.
        reach_m: how far that is.
    """

    grid: BevGrid
    target: Target
    measured: F32
    inferred: F32
    late: F32
    aimed: F32
    visible_prob: F32
    within_reach: Mask
    reach_m: float

    @property
    def reaching(self) -> F32:
        """(cells, cells) float32 expected returns by both kinds of beams."""
        return self.measured + self.inferred

    def supports_claim(self) -> Mask:
        """Return where a cell may be called visible (cells, cells).

        Within reach, where enough beams reach a target on the ground as it was estimated, and on average over the
        heights that the ground may have.
        """
        return np.asarray(self.visible_prob >= np.float32(THRESHOLD))

    def supports_denial(self) -> Mask:
        """Return where a cell may be called hidden (cells, cells).

        Within reach, where surely enough beams aim at a target and too few reach it on the ground as it was estimated,
        even if those without a return ended late.
        """
        every = np.ones(self.grid.shape, np.bool_)
        return np.asarray(self.states(~every, every, ~every) == CellState.HIDDEN)

    def bounded(self, prob: F32, threshold: float) -> F32:
        """Return an estimator's probability (cells, cells), below its threshold where the beams support no claim."""
        most = np.nextafter(np.float32(threshold), np.float32(0.0))
        return np.where(self.supports_claim(), prob, np.minimum(prob, most))

    def states(self, visible: Mask, denied: Mask, obstacle: Mask) -> States:
        """Return the states (cells, cells) uint8 of what an estimator calls visible, or not visible.

        FREE or SURFACE where it claims and the beams support that, HIDDEN where it denies and they support that,
        everything else UNKNOWN.

        Args:
            visible: what the estimator calls visible.
            denied: what it calls not visible.
            obstacle: cells that hold an obstacle return.
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


def calibrated_prob(leveled: LeveledSweep, evidence: BeamEvidence) -> F32:
    """Return the probability (cells, cells) that a target in each cell is visible, calibrated by exact truth.

    A small network (``tools/fit_calibration.py`` fits it) turns what the beams say of a cell, what they say around it,
    where the nearest obstacle and the farthest return of its azimuth lie, and what all cells of the sweep are like on
    average, into how often such a cell is visible.
    Each cell stays on the side of the threshold on which the beams put it.
    """
    return _core.calibrated_prob(*_seen_by_network(leveled, evidence), table=poisson_table(evidence.target.min_returns))


def cell_features(leveled: LeveledSweep, evidence: BeamEvidence) -> F32:
    """Return what that network is shown (features, cells, cells)."""
    return _core.cell_features(*_seen_by_network(leveled, evidence), table=poisson_table(evidence.target.min_returns))


class Obstacles(Protocol):
    """Obstacles at which beams end: those that earlier sweeps saw (:class:`viewshed.preprocess.history.History`)."""

    def within(self, beams: Beams) -> Beams:
        """Return the beams, none deeper than the obstacle in its direction."""
        ...


def beam_evidence(
    leveled: LeveledSweep, grid: BevGrid, target: Target, history: Obstacles | None = None
) -> BeamEvidence:
    """Return the evidence of a leveled sweep; computed once for a grid, a target and a history while they are used.

    Beams end at the obstacles that earlier sweeps saw.
    """
    # A history holds the sweeps before: a strong reference to it would keep those of a whole stream.
    key = "beam_evidence", grid, target, None if history is None else ref(history)
    known: BeamEvidence | None = leveled.derived.get(key)
    if known is None:
        known = leveled.derived[key] = _count_beams(leveled, grid, target, history)
    return known


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
        ground.heights_m,
        ground.std_m,
        half_extent_m=ground.half_extent_m,
        sensor_height_m=leveled.sensor_height_m,
        target_height_m=target.height_m,
        table=poisson_table(target.min_returns),
        reach_m=reach_m,
    )
    for array in arrays:
        array.setflags(write=False)
    return BeamEvidence(grid, target, *arrays, reach_m)


def _seen_by_network(leveled: LeveledSweep, of: BeamEvidence) -> tuple[Any, ...]:
    cells = of.measured, of.inferred, of.late, of.aimed, of.visible_prob
    returns = leveled.azimuth, leveled.range_m, leveled.height_m
    heights_m = leveled.ground.heights_m
    return cell_windows(of.grid, of.target.width_m), cells, returns, *OBSTACLE_HEIGHTS_M, heights_m


def expected_returns(leveled: LeveledSweep, boxes: NDArray[np.floating[Any]], *, leave_out_own: bool = True) -> Counts:
    """Return how many beams of a leveled sweep would meet each of K boxes (K,) int32.

    A beam counts if its straight line meets the box and it ended no nearer than there (by 0.1 m, the noise of ranges).
    Beams with a return end there, those without one where they likely did
    (:func:`viewshed.preprocess.no_return.beams_by_evidence`). The beams of a sweep are sorted when first needed.

    Args:
        leveled: the sweep.
        boxes: (K, 7) center x, y, z, length, width and height in meters, and yaw in radians, in ``level``.
        leave_out_own: count as if the returns in a box were not there, so that their beams meet it. Without it a
            return in a box ends its beam: those that go through all of the box are left.

    Raises:
        ValueError: the boxes have another shape, are not finite, or have no size.
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
