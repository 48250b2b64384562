"""Sample: one sweep with its truth, and where that truth is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.truth import Truth
from viewshed.sim.lidar.stored_sweep import StoredSweep
from viewshed.sweep import Sweep


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """One sweep with its truth.

    Attributes:
        sweep: what the sensor measured.
        truth: what it could have seen.
        known: (cells, cells) bool, False where no truth exists (below the vehicle itself, outside the world).
        scene: where it was measured; splits never cut through a scene.
        split: ``train``, ``test``, …
        image: the range image that the sweep was made from, or None; archives store it instead of the points.

    Raises:
        ValueError: ``known`` does not fit the truth's grid.
    """

    sweep: Sweep
    truth: Truth
    known: NDArray[np.bool_]
    scene: str = ""
    split: str = ""
    image: StoredSweep | None = None

    def __post_init__(self) -> None:
        known = np.ascontiguousarray(self.known)
        if known.shape != self.truth.grid.shape or known.dtype != np.bool_:
            raise ValueError(f"known must be bool {self.truth.grid.shape}, got {known.dtype} {known.shape}")
        known = known.view()
        known.setflags(write=False)
        object.__setattr__(self, "known", known)
