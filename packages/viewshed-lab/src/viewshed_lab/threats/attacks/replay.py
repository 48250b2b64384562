"""Attacks over time: an earlier sweep is replayed, and ghosts move like real objects (family 11).

Pose spoof: the returns are true, but the pose is not (family 13).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid, quaternion_from_rotation, rotation_from_quaternion
from viewshed.sweep import Sweep
from viewshed_lab._config import Angle, Ascending, Between, Budget, Checked, Sector
from viewshed_lab.threats.attacks.base import Tampered, Wedge
from viewshed_lab.threats.attacks.beam_lattice import BeamLattice, Rays, lattice_of, rays_in
from viewshed_lab.threats.attacks.ghosts import CAR_M, GhostCar
from viewshed_lab.threats.attacks.points import Mode
from viewshed_lab.threats.attacks.spoofer import (
    COLUMNS,
    FULL_CIRCLE,
    MEASURED_SPOOFER,
    NO_RETURN,
    NOISELESS_SPOOFER,
    Spoofer,
    untouched,
)

Anchor = Literal["world", "sensor"]


@dataclass(frozen=True, slots=True)
class PoseSpoof(Checked):
    """A pose that is turned, shifted and tilted by given amounts in random directions.

    The turn is about the vertical through the sensor, the shift is horizontal, the tilt is about a horizontal axis. The
    returns are unchanged.
    """

    yaw_deg: Annotated[float, Between(0.0, 180.0)] = 2.0
    shift_m: Annotated[float, Between(0.0, 10_000.0)] = 1.0
    tilt_deg: Annotated[float, Between(0.0, 90.0)] = 0.0  # also tilts the attitude

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and the record of its changes.

        Raises:
            ValueError: the sweep has no pose (for a tilt alone: neither pose nor attitude).
        """
        side, heading, axis = rng.choice([-1.0, 1.0]), rng.uniform(-np.pi, np.pi), rng.uniform(-np.pi, np.pi)
        half = np.deg2rad(self.tilt_deg) / 2
        level_axis = np.sin(half) * np.cos(axis), np.sin(half) * np.sin(axis), 0.0
        tilt = rotation_from_quaternion([np.cos(half), *level_axis])
        pose, attitude = sweep.world_from_sensor, sweep.attitude
        if pose is None and (self.yaw_deg > 0 or self.shift_m > 0 or attitude is None):
            raise ValueError("a sweep must have a pose to be spoofed, got none; give world_from_sensor")
        if pose is not None:
            turn = Rigid.from_yaw(side * np.deg2rad(self.yaw_deg)).rotation
            shift_m = self.shift_m * np.array([np.cos(heading), np.sin(heading), 0.0])
            pose = Rigid(turn @ tilt @ pose.rotation, pose.translation + shift_m)
        if attitude is not None and self.tilt_deg > 0:
            attitude = quaternion_from_rotation(tilt @ rotation_from_quaternion(attitude))
        return untouched(sweep.replace(world_from_sensor=pose, attitude=attitude))


@dataclass(frozen=True, slots=True, eq=False)
class Replay(Checked):
    """An earlier sweep of the same sensor instead of this one: looks real because it was.

    On beams, each beam of the sector reports its range in the earlier sweep, or nothing if it had none. Free-form, the
    earlier returns replace all returns. Time and pose stay those of this sweep.
    """

    earlier: Sweep  # the sweep that is replayed
    # maximum number of beams, nearest to the center of the sector first; None for all; not used in free form
    budget: Budget = None
    sector_deg: Sector = 360.0  # width of the sector
    azimuth: Angle = 0.0  # center of the sector in the sensor's frame
    mode: Mode = "beam_constrained"  # ``beam_constrained`` or ``free_form``
    spoofer: Spoofer = NOISELESS_SPOOFER  # for ``beam_constrained``

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and the record of its changes.

        Raises:
            ValueError: the beams of a sweep are unknown, or the sweeps differ in their number of rings.
        """
        if self.mode == "free_form":
            columns = {name: getattr(self.earlier, name) for name in COLUMNS}
            added, removed = np.ones(len(self.earlier), np.bool_), np.ones(len(sweep), np.bool_)
            return Tampered(sweep.replace(**columns), added, removed)
        wedge = Wedge.of_sector(self.azimuth, self.sector_deg)
        rays = rays_in(sweep, wedge, empty=True)
        earlier_m = depths_in(self.earlier, lattice_of(sweep), rays)
        changed = (rays.ring >= 0) & ~((rays.row < 0) & np.isinf(earlier_m))
        return self.spoofer.spoof_nearest(sweep, rays, changed, earlier_m, wedge, self.budget, rng)


def depths_in(earlier: Sweep, lattice: BeamLattice | None, rays: Rays) -> NDArray[np.float64]:
    """Return the depth (K,) in meters of each ray in another sweep of the sensor, by ring and firing azimuth.

    +inf where it did not return, and everywhere if the beams of a sweep are unknown. The depth of a ray without a ring
    is meaningless.

    Raises:
        ValueError: the other sweep has another number of rings.
    """
    known = lattice_of(earlier)
    if lattice is None or known is None:
        return np.full(len(rays), NO_RETURN)
    before = rays_in(earlier, FULL_CIRCLE)
    if len(known.elevation) != len(lattice.elevation):
        raise ValueError(
            f"the earlier sweep must be of the same sensor with {len(lattice.elevation)} rings, got "
            f"{len(known.elevation)}; replay a sweep of the same drive"
        )
    depth_m = np.full(known.rows.shape, NO_RETURN)
    known_pixel = (before.row >= 0) & (before.ring >= 0)
    depth_m[before.ring[known_pixel], before.column[known_pixel]] = before.depth_m[known_pixel]
    columns = len(known.firing.azimuth)
    azimuth = lattice.firing.azimuth[rays.column] - known.firing.azimuth[0]
    column = np.rint(azimuth * (columns / (2 * np.pi))).astype(np.intp) % columns
    result: NDArray[np.float64] = depth_m[rays.ring, column]
    return result


@dataclass(frozen=True, slots=True, eq=False)
class CoherentPhantom(Checked):
    """A ghost car that is static in the world, moves through it, or is fixed to the sensor.

    It is consistent over time, like a real object. It starts at ``azimuth`` and ``range_m`` from the pose ``first``,
    and is shown only within ``reach_m``.
    """

    first: Rigid | None = None  # pose at which the ghost appears; None fixes it to the sensor
    first_ns: int | None = None  # time of that pose
    budget: Budget = None  # maximum number of beams, nearest to its center first; None for all that would hit it
    range_m: Annotated[float, Between(0.1, 1000.0)] = 12.0  # its range from the first pose
    azimuth: Angle = 0.3  # its azimuth from the first pose, in the sensor's frame
    anchor: Anchor = "world"  # ``world`` or ``sensor``
    velocity_mps: tuple[float, float] = (0.0, 0.0)  # (vx, vy) of the ghost in the world, for the anchor ``world``
    # minimum and maximum range at which it is shown
    reach_m: Annotated[tuple[float, float], Ascending(0.0)] = (3.0, 50.0)
    size_m: tuple[float, float, float] = CAR_M  # length, width, height
    spoofer: Spoofer = MEASURED_SPOOFER  # success rate and range noise

    def __post_init__(self) -> None:
        Checked.__post_init__(self)
        if not np.isfinite(self.velocity_mps).all():
            raise ValueError(f"velocity_mps must be two finite numbers, got {self.velocity_mps}")
        if any(self.velocity_mps) and self.first_ns is None:
            raise ValueError("a ghost that moves must have a start, got no first_ns; give the time of the first pose")

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and the record of its changes.

        Raises:
            ValueError: the sweep lacks the pose or the time that the ghost's place depends on.
        """
        azimuth, range_m, heading = self._place(sweep)
        if not self.reach_m[0] <= range_m <= self.reach_m[1]:
            return untouched(sweep)
        ghost = GhostCar(self.budget, range_m, azimuth, heading, self.size_m, self.spoofer)
        return ghost.apply(sweep, rng)

    def _place(self, sweep: Sweep) -> tuple[float, float, float]:
        """Return azimuth and range in the sensor's frame, and the heading relative to the line of sight."""
        if self.anchor == "sensor" or self.first is None:
            return self.azimuth, self.range_m, 0.0
        pose = sweep.world_from_sensor
        if pose is None:
            raise ValueError(
                "a sweep must have a pose for a ghost that stays in the world, got none; use anchor='sensor'"
            )
        ahead_m = self.range_m * np.array([np.cos(self.azimuth), np.sin(self.azimuth), 0.0])
        world_m = self.first @ ahead_m + self._displacement_m(sweep)
        x, y, _ = pose.inverse() @ world_m
        azimuth = float(np.arctan2(y, x))
        heading = self.first.yaw + self.azimuth - pose.yaw - azimuth
        return azimuth, float(np.hypot(x, y)), heading

    def _displacement_m(self, sweep: Sweep) -> NDArray[np.float64]:
        if self.first_ns is None or not any(self.velocity_mps):
            return np.zeros(3)
        if sweep.t_ns is None:
            raise ValueError("a sweep must have a time for a ghost that moves, got none; give t_ns")
        return np.array([*self.velocity_mps, 0.0]) * ((sweep.t_ns - self.first_ns) * 1e-9)
