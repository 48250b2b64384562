"""The role of an attack, what the attacker knows and reaches, and the record of what was touched."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.estimate import FovEstimator
from viewshed.sweep import Sweep

ROAD_EXTENT_M = 64.0
"""Half the side of the grid on roads, for which the ranges of attacks are set."""


@dataclass(frozen=True, slots=True)
class Wedge:
    """The azimuths that an attacker reaches, in the sensor's frame."""

    azimuth: float  # middle, radians counter-clockwise from forward
    width: float  # whole opening in radians, up to 2π

    def __post_init__(self) -> None:
        if not (np.isfinite(self.azimuth) and 0.0 < self.width <= 2 * np.pi):
            raise ValueError(f"a wedge must have a finite azimuth and a width in (0, 2π], got {self}")

    @classmethod
    def of_sector(cls, azimuth: float, sector_deg: float) -> Wedge:
        """Return the wedge about ``azimuth`` (radians) that is ``sector_deg`` wide.

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
    """A sweep after an attack, with what the attacker did to it. A moved return is one removed and one added.

    Raises:
        ValueError: the masks do not fit: rows of ``sweep`` that are not added must be those left of the clean one.
    """

    sweep: Sweep  # what the sensor reports under attack
    added: NDArray[np.bool_]  # (N,) bool, rows of ``sweep`` that the attacker made
    removed: NDArray[np.bool_]  # (M,) bool, rows of the clean sweep that are gone
    wedge: Wedge | None = None  # where the attacker works, or None if anywhere

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
    """Anything that tampers with a sweep. The clean sweep is never modified; the same generator, the same bytes."""

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Knowledge:
    """What an attacker has beside the sweep that is attacked."""

    # sweeps of the same sensor before this one, the oldest first; the first is where phantoms appear, the last is what
    # is replayed
    earlier: tuple[Sweep, ...] = ()
    estimator: FovEstimator | None = None  # what the victim runs, for attackers that adapt to it
    # half the side of the victim's grid; ranges are in proportion to it, 64 m on roads
    half_extent_m: float = ROAD_EXTENT_M

    @property
    def scale(self) -> float:
        """Ranges of an attack as a multiple of those on roads."""
        return self.half_extent_m / ROAD_EXTENT_M


NOTHING = Knowledge()


class AttackFactory(Protocol):
    """Makes an attack with at most ``budget`` returns; None for the attack's own default."""

    def __call__(self, budget: int | None = None, knowledge: Knowledge = NOTHING) -> Attack:
        """Return the attack."""
        ...
