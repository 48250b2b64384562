"""The role of a defense, and what it hands back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from viewshed.sweep import Sweep


@dataclass(frozen=True, slots=True, eq=False)
class Defended:
    """A sweep after a defense.

    Raises:
        ValueError: the mask does not fit the sweep.
    """

    sweep: Sweep  # the returns that are kept, in their order, with their columns
    dropped: NDArray[np.bool_]  # (N,) bool, rows of the sweep that was handed in that are gone
    alarm: bool | None  # whether the defense says that something is wrong, or None where it only drops returns
    # the defense's doubt in [0, 1]: the share of the returns that it dropped, or what its alarm is raised on
    score: float

    def __post_init__(self) -> None:
        dropped = np.array(self.dropped, np.bool_)
        dropped.setflags(write=False)
        object.__setattr__(self, "dropped", dropped)
        if dropped.ndim != 1 or (~dropped).sum() != len(self.sweep):
            raise ValueError(f"dropped must keep {len(self.sweep)} rows, got {dropped.shape} with {(~dropped).sum()}")


class Defense(Protocol):
    """Anything that mends or judges a sweep without a map of the attack. The sweep is never modified."""

    def apply(self, sweep: Sweep) -> Defended:
        """Return what is kept, what was dropped, and whether to worry. The order of the points does not matter."""
        ...


def without(sweep: Sweep, dropped: NDArray[np.bool_]) -> Defended:
    """Return ``sweep`` without the rows ``dropped`` (N,), scored by their share, with no alarm.

    >>> without(Sweep(np.eye(3)), np.array([True, False, False])).score
    0.3333333333333333
    """
    return Defended(sweep.select(~dropped), dropped, None, float(dropped.mean()) if len(dropped) else 0.0)
