"""Defenses: what drops or reports returns that look wrong, without knowing the attack."""

from __future__ import annotations

from collections.abc import Callable

from viewshed_lab.threats.defenses.base import Defended, Defense
from viewshed_lab.threats.defenses.beam_checks import EmptySectorCheck, OneReturnPerBeam, RangeValidation
from viewshed_lab.threats.defenses.outlier_removal import (
    ClusteringOutlierRemoval,
    RadiusOutlierRemoval,
    StatisticalOutlierRemoval,
)
from viewshed_lab.threats.defenses.seen_through import TemporalConsistency

__all__ = [
    "DEFENSES", "ClusteringOutlierRemoval", "Defended", "Defense", "EmptySectorCheck", "OneReturnPerBeam",
    "RadiusOutlierRemoval", "RangeValidation", "StatisticalOutlierRemoval", "TemporalConsistency",
]  # fmt: skip

DEFENSES: dict[str, Callable[[], Defense]] = {
    "statistical": StatisticalOutlierRemoval,
    "radius": RadiusOutlierRemoval,
    "clustering": ClusteringOutlierRemoval,
    "range": RangeValidation,
    "one_return": OneReturnPerBeam,
    "empty_sector": EmptySectorCheck,
    "temporal": TemporalConsistency,
}
"""By name, with the published parameters: ``DEFENSES[name]().apply(sweep)``. ``temporal`` drops nothing until it is
made with earlier sweeps: ``TemporalConsistency(earlier)``."""
