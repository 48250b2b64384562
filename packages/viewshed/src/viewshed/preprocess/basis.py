"""Computation of the Basis of an estimate, the same for every estimator."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.fov.estimate import Basis, HeightSource
from viewshed.fov.height_map import positions_of_cells
from viewshed.fov.visibility import poisson_table
from viewshed.preprocess.evidence import BeamEvidence
from viewshed.preprocess.leveling import LeveledSweep


def basis_of(leveled: LeveledSweep, evidence: BeamEvidence, state: NDArray[np.uint8]) -> Basis:
    """Return the basis of an estimate.

    Args:
        leveled: the sweep of the estimate.
        evidence: the beam evidence of that sweep.
        state: (cells, cells) :class:`~viewshed.fov.estimate.CellState` of the estimate.
    """
    # The ground's standard deviation is looked up at the lattice node preceding each claimed cell.
    ground, target = leveled.ground, evidence.target
    nodes = positions_of_cells(evidence.grid, ground.half_extent_m, len(ground.std_m)).node
    claimed, over_unsure_ground, inferred = _core.claims(
        state, evidence.measured, nodes, ground.std_m, table=poisson_table(target.min_returns)
    )  # fmt: skip
    return Basis(
        sensor_height_m=leveled.sensor_height_m,
        height_source=_height_source(leveled),
        ground_support=min(ground.support, 1.0),  # a sum of float32 weights can exceed it
        unsure_ground_share=over_unsure_ground / max(claimed, 1),
        inferred_share=inferred / max(claimed, 1),
        reach_m=evidence.reach_m,
    )


def _height_source(leveled: LeveledSweep) -> HeightSource:
    if leveled.sweep.sensor_height_m is not None:
        return "given"
    if leveled.held is not None and leveled.held.is_height_held:
        return "held"
    return "estimated" if leveled.ground.support > 0 else "assumed"
