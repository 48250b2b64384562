"""What a tracker asks a field of view: could this be seen, would it be found, and could it have come unseen."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class View(Protocol):
    """What one sensor could see at the time of one sweep; boxes (K, 7) are in the tracks' frame."""

    @property
    def t_s(self) -> float:
        """Time of the sweep."""
        ...

    @property
    def in_world(self) -> bool:
        """True where the tracks' frame is the world; False where the sweep has no pose and it is ``level``."""
        ...

    def visible(self, boxes: Floats) -> Floats:
        """Return the probability (K,) that an object in each box could be seen."""
        ...

    def detectable(self, boxes: Floats, kinds: NDArray[np.uint8]) -> Floats:
        """Return the probability (K,) that the detector finds an object in each box where it can be seen."""
        ...

    def hides_near(self, boxes: Floats, within_m: Floats) -> Floats:
        """Return the probability (K,) that some place within (K,) meters of each box could not be seen.

        An object may appear at the box if it came from there; the border of the grid counts as such a place.
        """
        ...
