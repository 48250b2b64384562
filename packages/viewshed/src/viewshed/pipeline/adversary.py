"""Interface of adversaries that tamper with a stream; package viewshed-lab has implementations."""

from __future__ import annotations

from typing import Protocol

from viewshed.detections import Detections
from viewshed.fov.estimate import FovEstimate
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.sweep import Sweep


class Adversary(Protocol):
    """Tampers with what some agents of a stream send and passes on the rest unchanged.

    Installed packages provide adversaries by entry points ``viewshed.adversaries``.
    """

    @property
    def agents(self) -> frozenset[str]:
        """Names of the attacked agents; empty means all."""
        ...

    def attacks(self, agent: str) -> bool:
        """Return whether an agent is attacked."""
        ...

    def unmet(self) -> frozenset[str]:
        """Return the names of attacked agents from which nothing was received."""
        ...

    def sweep(self, sweep: Sweep) -> Sweep:
        """Return the sweep that others receive."""
        ...

    def detections(self, leveled: LeveledSweep, detections: Detections) -> Detections:
        """Return the detections of a sweep that others receive."""
        ...

    def view(self, estimate: FovEstimate) -> FovEstimate:
        """Return the field of view that others receive."""
        ...
