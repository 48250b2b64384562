"""What a monitor says of one estimate: a score, an alarm and the cells it suspects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed.bev import BevGrid


@dataclass(frozen=True, slots=True, eq=False)
class IntegrityReport:
    """Doubt about one estimate. A monitor reports doubt; what is done about it is for others to say.

    Attributes:
        score: how doubtful the whole estimate is; larger is worse.
        threshold: the monitor alarms above it.
        suspect: (cells, cells) bool, the cells that raise the doubt.
        grid: where the cells are.
        monitor: who says so.

    Raises:
        ValueError: the score is not a number, or ``suspect`` does not fit the grid.
    """

    score: float
    threshold: float
    suspect: NDArray[np.bool_]
    grid: BevGrid
    monitor: str

    def __post_init__(self) -> None:
        if np.isnan(self.score) or np.isnan(self.threshold):
            raise ValueError(f"score and threshold must be numbers, got {self.score} and {self.threshold}")
        if self.suspect.dtype != np.bool_ or self.suspect.shape != self.grid.shape:
            raise ValueError(f"suspect must be bool {self.grid.shape}, got {self.suspect.dtype} {self.suspect.shape}")
        suspect = self.suspect.view()
        suspect.setflags(write=False)
        object.__setattr__(self, "suspect", suspect)

    @property
    def alarm(self) -> bool:
        """Whether the score lies above the threshold."""
        return self.score > self.threshold

    @property
    def suspect_m2(self) -> float:
        """Area of the suspect cells in square metres."""
        return float(self.suspect.sum()) * self.grid.cell_area_m2
