"""The one definition of *visible*: a cell is visible to a sweep if a target standing there would have given
at least ``min_returns`` returns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Target:
    """What would have to be seen: an upright box on the local ground.

    Attributes:
        name: what it is.
        length_m: longer side.
        width_m: shorter side, the one that beams must fall on.
        height_m: height above local ground.
        min_returns: returns from which on it counts as seen.
    """

    name: str
    length_m: float
    width_m: float
    height_m: float
    min_returns: int

    def __post_init__(self) -> None:
        for key in ("length_m", "width_m", "height_m"):
            value = getattr(self, key)
            if not (np.isfinite(value) and 0 < value <= 100):
                raise ValueError(f"{key} must lie in (0, 100], got {value}")
        if not 1 <= self.min_returns <= 10_000:
            raise ValueError(f"min_returns must lie in [1, 10000], got {self.min_returns}")


CAR = Target("car", 4.2, 1.8, 1.5, 5)
PEDESTRIAN = Target("pedestrian", 0.6, 0.6, 1.7, 3)
TARGETS: dict[str, Target] = {target.name: target for target in (CAR, PEDESTRIAN)}
"""The targets by name."""
