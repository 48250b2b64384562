"""Adversary: what a stream requires of who forges it; the laboratory has those of the package."""

from __future__ import annotations

from typing import Protocol

from viewshed.detections import Detections
from viewshed.fov.estimate import FovEstimate
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.sweep import Sweep


class Adversary(Protocol):
    """Forges what some agents of a stream send; the rest passes as it is.

    Installed packages bring them by entry points ``viewshed.adversaries``.
    """

    @property
    def agents(self) -> frozenset[str]:
        """Names of those that are attacked; all where none is named."""
        ...

    def attacks(self, agent: str) -> bool:
        """Return whether an agent is one of those that are attacked."""
        ...

    def unmet(self) -> frozenset[str]:
        """Return the names of those attacked agents that were not heard of."""
        ...

    def sweep(self, sweep: Sweep) -> Sweep:
        """Return a sweep as the adversary lets others see it."""
        ...

    def detections(self, leveled: LeveledSweep, detections: Detections) -> Detections:
        """Return the detections of a sweep as the adversary lets others see them."""
        ...

    def view(self, estimate: FovEstimate) -> FovEstimate:
        """Return a field of view as the adversary lets others see it."""
        ...
