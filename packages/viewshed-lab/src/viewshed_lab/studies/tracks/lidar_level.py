"""Attacks on the LiDAR that make objects appear or vanish: the sweep is forged before anything is computed from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed.sweep import Sweep
from viewshed_lab.threats.attacks import ATTACKS, CLEAN_SPOOFER
from viewshed_lab.threats.attacks.base import Attack, Tampered
from viewshed_lab.threats.attacks.ghosts import FarWall, GhostCar
from viewshed_lab.threats.attacks.spoofer import MEASURED_SPOOFER, random_open_azimuth
from viewshed_lab.threats.attacks.wedge_attack import PhysicalRemoval

FORGED_FROM_S = 2.0
"""Seconds from the first sweep to the attack."""

GHOST_RANGE_M = (8.0, 20.0)
"""Minimum and maximum range of ghost cars, which move with the vehicle."""

VICTIM_RETURNS, VICTIM_WITHIN_M = 30, 25.0
"""Minimum number of returns and maximum range, at the start of the attack, of objects that are made to vanish."""

_SECTOR_DEG = 30.0

_GHOSTS = {"ghost_car": MEASURED_SPOOFER, "ghost_car_clean": CLEAN_SPOOFER}

_ON_OBJECTS: dict[str, Callable[[float], Attack]] = {
    "removal": lambda azimuth: PhysicalRemoval(azimuth=azimuth, sector_deg=_SECTOR_DEG),
    "far_wall": lambda azimuth: FarWall(azimuth=azimuth, sector_deg=_SECTOR_DEG, near_m=35.0),
}

LIDAR_ATTACKS = (*_GHOSTS, *_ON_OBJECTS)
"""Names of ``viewshed_lab.threats.attacks.ATTACKS``: an object appears, by a measured or a noiseless spoofer; an object
vanishes without a return, or is replaced by open street."""


@dataclass(slots=True)
class SweepForger:
    """Forges the sweeps of one drive: adds one ghost that moves along, or removes one object and tracks it.

    Raises:
        ValueError: there is no such attack.
    """

    name: str  # of ``LIDAR_ATTACKS``
    rng: np.random.Generator  # source of all random draws
    _victim: int = field(default=-1, repr=False)
    _ghost: GhostCar | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if self.name not in LIDAR_ATTACKS or self.name not in ATTACKS:
            raise ValueError(f"name must be among {', '.join(LIDAR_ATTACKS)}, got {self.name!r}")

    def apply(
        self, sweep: Sweep, t_s: float, numbers: NDArray[np.int32], boxes: F64, returns: NDArray[np.int32]
    ) -> Tampered:
        """Return the next sweep under attack.

        Args:
            sweep: the clean sweep, with its pose.
            t_s: time since the start of the drive.
            numbers: (N,) ids of the objects.
            boxes: (N, 7) boxes of the objects in the world.
            returns: (N,) number of returns of each object.
        """
        untouched = Tampered(sweep, np.zeros(len(sweep), np.bool_), np.zeros(len(sweep), np.bool_))
        if t_s < FORGED_FROM_S - 1e-9 or sweep.world_from_sensor is None:
            return untouched
        if self.name in _GHOSTS:
            if self._ghost is None:
                range_m = float(self.rng.uniform(*GHOST_RANGE_M))
                azimuth = random_open_azimuth(sweep, 1.3 * range_m, self.rng)
                self._ghost = GhostCar(range_m=range_m, azimuth=azimuth, spoofer=_GHOSTS[self.name])
            return self._ghost.apply(sweep, self.rng)
        centers = sweep.world_from_sensor.inverse() @ boxes[:, :3]
        if self._victim < 0:
            near = np.hypot(centers[:, 0], centers[:, 1]) < VICTIM_WITHIN_M
            candidates = numbers[near & (returns >= VICTIM_RETURNS)]
            if not len(candidates):
                return untouched
            self._victim = int(self.rng.choice(candidates))
        x_m, y_m, _ = centers[numbers == self._victim][0]
        return _ON_OBJECTS[self.name](float(np.arctan2(y_m, x_m))).apply(sweep, self.rng)

    def ghost_at(self, sweep: Sweep) -> F64 | None:
        """Return the place (2,) of the ghost in the world, None without a ghost."""
        if self._ghost is None or self._ghost.azimuth is None or sweep.world_from_sensor is None:
            return None
        range_m, azimuth = self._ghost.range_m, self._ghost.azimuth
        place = np.array([[range_m * np.cos(azimuth), range_m * np.sin(azimuth), 0.0]])
        return np.asarray((sweep.world_from_sensor @ place)[0, :2])
