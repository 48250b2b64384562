"""Sample: one sweep, its truth, and the cells where that truth is known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.truth import Truth
from viewshed.sweep import Sweep
from viewshed_lab.sim.lidar.stored_sweep import StoredSweep

if TYPE_CHECKING:
    from viewshed_lab.threats.attacks.base import Tampered


@dataclass(frozen=True, eq=False)
class Sample:
    """One sweep with its truth, in memory, in archives and in studies.

    Raises:
        ValueError: ``known`` does not fit the truth's grid, or ``tampered`` has another number of returns.
    """

    # the measured range image, or points where there is none. A range image takes a tenth of the space of its points;
    # :attr:`sweep` computes the points on first use.
    measured: StoredSweep | Sweep
    truth: Truth  # what the sensor could have seen
    # (cells, cells) bool, False where no truth exists (below the vehicle itself, outside the world)
    known: NDArray[np.bool_]
    scene: str = ""  # name of the scene; a scene is in one split only
    split: str = ""  # ``train``, ``test``, …
    tampered: Tampered | None = None  # the attacked sweep with its added and removed rows, or None if unknown
    # the clean range image of an attacked sweep, or None. Archives store it with the rows that the attacker added,
    # which takes less space than all points.
    clean: StoredSweep | None = None

    def __post_init__(self) -> None:
        known = np.ascontiguousarray(self.known)
        if known.shape != self.truth.grid.shape or known.dtype != np.bool_:
            raise ValueError(f"known must be bool {self.truth.grid.shape}, got {known.dtype} {known.shape}")
        known = known.view()
        known.setflags(write=False)
        object.__setattr__(self, "known", known)
        if self.tampered is not None:
            measured = self.measured
            count = len(measured) if isinstance(measured, Sweep) else int(np.count_nonzero(measured.steps))
            if len(self.tampered.sweep) != count:
                raise ValueError(f"tampered must have {count} returns, as measured, got {len(self.tampered.sweep)}")

    @cached_property
    def sweep(self) -> Sweep:
        """The sweep, computed from the range image where there is one."""
        if self.tampered is not None:
            return self.tampered.sweep
        return self.measured if isinstance(self.measured, Sweep) else self.measured.sweep()

    def attacked(self, tampered: Tampered) -> Sample:
        """Return the sample with an attacked sweep; the truth does not change."""
        clean = None if isinstance(self.measured, Sweep) else self.measured
        return replace(self, measured=tampered.sweep, tampered=tampered, clean=clean)

    def corrupted(self, sweep: Sweep) -> Sample:
        """Return the sample with a corrupted sweep, without a record of the changed returns; the truth is the same."""
        return replace(self, measured=sweep, tampered=None, clean=None)
