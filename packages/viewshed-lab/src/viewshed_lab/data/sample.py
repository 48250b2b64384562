"""Sample: one sweep with its truth, and where that truth is known."""

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
    """One sweep with its truth: the one type for it, in memory, in archives and in studies.

    Raises:
        ValueError: ``known`` does not fit the truth's grid, or ``tampered`` is of another number of returns.
    """

    # what the sensor measured: a range image, or points where there is none. Archives store a range image in a tenth of
    # the space of its points; :attr:`sweep` computes the points when they are first needed.
    measured: StoredSweep | Sweep
    truth: Truth  # what the sensor could have seen
    # (cells, cells) bool, False where no truth exists (below the vehicle itself, outside the world)
    known: NDArray[np.bool_]
    scene: str = ""  # where it was measured; splits never cut through a scene
    split: str = ""  # ``train``, ``test``, …
    tampered: Tampered | None = None  # the attacked sweep and what was done to it, or None where it is not known
    # the range image that an attacked sweep was made from, or None. Archives store it with the rows that the attacker
    # made, which takes less memory than all points.
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
        """Return the sample after an attack on its sweep; the truth stays."""
        clean = None if isinstance(self.measured, Sweep) else self.measured
        return replace(self, measured=tampered.sweep, tampered=tampered, clean=clean)

    def corrupted(self, sweep: Sweep) -> Sample:
        """Return the sample with another sweep, of whose returns it is unknown which moved; the truth stays."""
        return replace(self, measured=sweep, tampered=None, clean=None)
