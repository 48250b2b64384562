"""Protocol of attacks, the attacker's knowledge and wedge, and the record of the changed returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.estimate import FovEstimator
from viewshed.sweep import Sweep

ROAD_EXTENT_M = 64.0
"""Half extent in meters of the road grid, for which the ranges of attacks are set."""


@dataclass(frozen=True, slots=True)
class Wedge:
    """Azimuth interval that an attacker reaches, in the sensor's frame."""

    azimuth: float  # center, radians counter-clockwise from forward
    width: float  # full opening in radians, up to 2π

    def __post_init__(self) -> None:
        if not (np.isfinite(self.azimuth) and 0.0 < self.width <= 2 * np.pi):
            raise ValueError(f"a wedge must have a finite azimuth and a width in (0, 2π], got {self}")

    @classmethod
    def of_sector(cls, azimuth: float, sector_deg: float) -> Wedge:
        """Return the wedge centered at ``azimuth`` (radians) with a width of ``sector_deg``.

        >>> Wedge.of_sector(0.0, 180.0).width == np.pi
        True
        """
        return cls(azimuth, min(float(np.deg2rad(sector_deg)), 2 * np.pi))

    def holds(self, azimuth: NDArray[Any]) -> NDArray[np.bool_]:
        """Return which azimuths (…) lie in the wedge.

        >>> Wedge(np.pi, 0.2).holds(np.array([-3.1, 3.1, 0.0])).tolist()
        [True, True, False]
        """
        apart = np.abs((np.asarray(azimuth) - self.azimuth + np.pi) % (2 * np.pi) - np.pi)
        mask: NDArray[np.bool_] = apart <= self.width / 2
        return mask


@dataclass(frozen=True, slots=True, eq=False)
class Tampered:
    """A sweep after an attack, with the record of its changes. A moved return counts as one removed and one added.

    Raises:
        ValueError: the masks do not match: as many rows must be not added as are not removed.
    """

    sweep: Sweep  # what the sensor reports under attack
    added: NDArray[np.bool_]  # (N,) bool, forged rows of ``sweep``
    removed: NDArray[np.bool_]  # (M,) bool, removed rows of the clean sweep
    wedge: Wedge | None = None  # attacked wedge, or None if the attack is not limited to one

    def __post_init__(self) -> None:
        for name in ("added", "removed"):
            mask = np.array(getattr(self, name), np.bool_)
            mask.setflags(write=False)
            object.__setattr__(self, name, mask)
        if self.added.shape != (len(self.sweep),) or self.removed.ndim != 1:
            raise ValueError(f"added must have shape {(len(self.sweep),)}, got {self.added.shape}")
        if (~self.added).sum() != (~self.removed).sum():
            raise ValueError(f"{(~self.added).sum()} rows were kept, but {(~self.removed).sum()} were not removed")


class Attack(Protocol):
    """An attack on a sweep. The clean sweep is never modified; equal generators give equal bytes."""

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and the record of its changes."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Knowledge:
    """What an attacker knows besides the attacked sweep."""

    # earlier sweeps of the same sensor, the oldest first: phantoms appear at the first, replay plays the last
    earlier: tuple[Sweep, ...] = ()
    estimator: FovEstimator | None = None  # the victim's estimator, for adaptive attacks
    # half extent of the victim's grid; ranges of attacks are proportional to it, 64 m on roads
    half_extent_m: float = ROAD_EXTENT_M

    @property
    def scale(self) -> float:
        """Factor on an attack's ranges, 1 on roads."""
        return self.half_extent_m / ROAD_EXTENT_M


NOTHING = Knowledge()


class AttackFactory(Protocol):
    """Makes an attack with at most ``budget`` returns; None for the attack's own default."""

    def __call__(self, budget: int | None = None, knowledge: Knowledge = NOTHING) -> Attack:
        """Return the attack."""
        ...
