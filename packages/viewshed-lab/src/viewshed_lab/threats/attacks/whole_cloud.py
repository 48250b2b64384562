"""Attacks on the whole cloud, and below the sensor's driver (families 18 to 21).

Shifted axis, sensor-like noise and blinding are those of a public data set of spoofed drives,
Allenpandas/LiDAR-Spoofing-Forensics-Datasets. Mirrors are those of arXiv 2509.17253. Trojans in a driver are those of
arXiv 2303.03470: they add points to the cloud or remove them, without being tied to beams.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64, Mask
from viewshed.preprocess.leveling import OBSTACLE_HEIGHTS_M
from viewshed.sweep import Sweep
from viewshed_lab._config import Azimuth, Between, Checked, Range, Share
from viewshed_lab.threats.attacks.base import Tampered, Wedge
from viewshed_lab.threats.attacks.spoofer import (
    add_points,
    azimuth_or_random,
    ground_at,
    position_at,
    random_obstacle_azimuth,
    scene_of,
    to_sensor,
)

_CAR_M = (4.2, 1.8, 1.5)
_APART_RAD = 0.01
"""Maximum angle between a beam and the mirror image that it returns from."""

_TAKEN_M = 3.0
"""A trojan removes returns within this horizontal distance of its target, ..."""

_LOW_M = 0.15
"""... except those lower than this above ground."""


@dataclass(frozen=True, slots=True)
class ShiftedAxis(Checked):
    """Every point is shifted along one axis of the sensor's frame."""

    shift_m: Annotated[float, Between(-100.0, 100.0)] = 1.0
    axis: Literal["x", "y", "z"] = "x"

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and the record of its changes."""
        shift_m = self.shift_m * np.eye(3)["xyz".index(self.axis)]
        return _moved(sweep, np.full(len(sweep), bool(self.shift_m)), sweep.points + shift_m)


@dataclass(frozen=True, slots=True)
class SensorNoise(Checked):
    """Every point gets normal noise of about the size of the sensor's own."""

    std_m: Annotated[float, Between(0.0, 10.0)] = 0.05  # of each coordinate

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and the record of its changes."""
        noise_m = rng.normal(0.0, 1.0, sweep.points.shape) * self.std_m
        return _moved(sweep, np.full(len(sweep), self.std_m > 0), sweep.points + noise_m)


@dataclass(frozen=True, slots=True)
class Blinding(Checked):
    """A strong light: most returns are lost, and some beams return at random from nearby."""

    lost_share: Share = 0.9  # of all returns
    noise_share: Share = 0.3  # of the lost returns; these beams return from random short ranges
    noise_m: Range = 4.0  # maximum of these ranges

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and the record of its changes."""
        lost = rng.random(len(sweep)) < self.lost_share
        noisy = lost & (rng.random(len(sweep)) < self.noise_share)
        range_m = np.linalg.norm(sweep.points, axis=1)
        nearby_m = rng.uniform(0.5, max(self.noise_m, 0.5), len(sweep))
        points = sweep.points * (nearby_m / np.maximum(range_m, 1e-6))[:, None]
        return _moved(sweep, noisy, points, lost & ~noisy)


@dataclass(frozen=True, slots=True)
class Mirror(Checked):
    """A plane mirror that stands upright or tilted: beams that hit it return from where they are reflected to.

    The mirrored scene consists of the sweep's own returns; surfaces without a return have no image. Tilted up far
    enough, the mirror shows the sky, and everything behind it vanishes. Without an azimuth it is put in front of a
    random obstacle.
    """

    range_m: Range = 8.0
    azimuth: Azimuth = None
    width_m: Annotated[float, Between(0.01, 100.0)] = 1.5
    height_m: Annotated[float, Between(0.01, 100.0)] = 1.5
    # yaw of its normal relative to the line to the sensor
    turn_deg: Annotated[float, Between(-89.0, 89.0)] = 35.0
    tilt_deg: Annotated[float, Between(-89.0, 89.0)] = 0.0  # elevation of its normal

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and the record of its changes."""
        azimuth = self.azimuth
        if azimuth is None:
            azimuth = azimuth_or_random(random_obstacle_azimuth(sweep, self.range_m, 50.0, rng), rng)
        x, y, _ = position_at(sweep, azimuth, self.range_m)
        low, high = (to_sensor(sweep, np.array([x, y, ground_at(sweep, x, y) + z])) for z in (0.0, self.height_m))
        turned, tilt = azimuth + np.pi + np.deg2rad(self.turn_deg), np.deg2rad(self.tilt_deg)
        normal = np.array([np.cos(turned) * np.cos(tilt), np.sin(turned) * np.cos(tilt), np.sin(tilt)])
        center = (low + high) / 2
        points = sweep.points.astype(np.float64)
        # 1. Beams that hit the mirror before their own return.
        hit = self._is_crossed(points, center, normal)
        # 2. Mirror images of the returns on the sensor's side, if the line to the image crosses the mirror.
        front = (points - center) @ normal > 0.05
        images = points[front] - 2.0 * ((points[front] - center) @ normal)[:, None] * normal
        images = images[self._is_crossed(images, center, normal)]
        # 3. A beam returns from the image nearest to its direction; without a near image it does not return.
        nearest = _nearest(points[hit], images)
        rows = np.flatnonzero(hit)[nearest >= 0]
        moved = points.copy()
        if len(rows):
            image_m = np.linalg.norm(images[nearest[nearest >= 0]], axis=1)
            moved[rows] *= (image_m / np.linalg.norm(points[rows], axis=1))[:, None]
        reflected = np.zeros(len(sweep), np.bool_)
        reflected[rows] = True
        wedge = Wedge(azimuth, 2.0 * float(np.arctan2(self.width_m, self.range_m)) + 0.02)
        return _moved(sweep, reflected, moved, hit & ~reflected, wedge)

    def _is_crossed(self, points: F64, center: F64, normal: F64) -> Mask:
        """Return which lines from the sensor to points (K, 3) cross the mirror, (K,) bool."""
        along = points @ normal
        share = np.divide(center @ normal, along, out=np.full(len(points), np.inf), where=np.abs(along) > 1e-9)
        side = np.array([-normal[1], normal[0], 0.0]) / max(float(np.hypot(*normal[:2])), 1e-9)
        share[~np.isfinite(share)] = -1.0
        offset = share[:, None] * points - center
        up = np.cross(normal, side)
        across, upward = np.abs(offset @ side) <= self.width_m / 2, np.abs(offset @ up) <= self.height_m / 2
        return np.asarray((share > 0) & (share < 1) & across & upward)


@dataclass(frozen=True, slots=True)
class TrojanInjects(Checked):
    """A driver adds the points of a car to the cloud, without a shadow behind it."""

    range_m: Range = 12.0
    azimuth: Azimuth = None
    count: Annotated[int, Between(0, 100_000)] = 200

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and the record of its changes."""
        x, y, facing = position_at(sweep, azimuth_or_random(self.azimuth, rng), self.range_m)
        # The rear, which faces the sensor, and the two sides.
        along, across, up = (
            size * (rng.random(self.count) - shift) for size, shift in zip(_CAR_M, (0, 0.5, 0), strict=True)
        )
        side = rng.integers(0, 3, self.count)
        along = np.where(side == 0, 0.0, along)
        across = np.choose(side, [across, np.full_like(across, -_CAR_M[1] / 2), np.full_like(across, _CAR_M[1] / 2)])
        c, s = np.cos(facing), np.sin(facing)
        points = np.column_stack([x + c * along - s * across, y + s * along + c * across, up + ground_at(sweep, x, y)])
        return add_points(sweep, to_sensor(sweep, points), rng)


@dataclass(frozen=True, slots=True)
class TrojanSuppresses(Checked):
    """A driver removes the points of an object from the cloud; its beams have no return then."""

    near_m: Range = 4.0
    far_m: Range = 30.0

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and the record of its changes; without an obstacle it is unchanged."""
        leveled = scene_of(sweep)
        height_m, range_m = leveled.height_m, leveled.range_m
        standing = (height_m > OBSTACLE_HEIGHTS_M[0]) & (height_m < OBSTACLE_HEIGHTS_M[1])
        candidates = np.flatnonzero(standing & (range_m > self.near_m) & (range_m < self.far_m))
        removed = np.zeros(len(sweep), np.bool_)
        if len(candidates):
            offset_m = leveled.points[:, :2] - leveled.points[rng.choice(candidates), :2]
            removed[leveled.rows[(np.hypot(*offset_m.T) < _TAKEN_M) & (height_m > _LOW_M)]] = True
        return _moved(sweep, np.zeros(len(sweep), np.bool_), sweep.points, removed)


def _moved(
    sweep: Sweep, moved: Mask, points: NDArray[np.floating], removed: Mask | None = None, wedge: Wedge | None = None
) -> Tampered:
    """Return a sweep with the returns ``moved`` (N,) at new points and those ``removed`` (N,) gone; order is kept."""
    removed = np.zeros(len(sweep), np.bool_) if removed is None else removed
    kept = sweep.points.copy()
    kept[moved] = points[moved].astype(np.float32)
    return Tampered(sweep.replace(points=kept).select(~removed), moved[~removed], moved | removed, wedge)


def _nearest(beams: F64, images: F64) -> NDArray[np.intp]:
    """Return the image (K,) of each beam: of those within ``_APART_RAD`` of it the one of least depth; -1 for none."""
    from scipy.spatial import cKDTree

    nearest = np.full(len(beams), -1, np.intp)
    if len(beams) and len(images):
        depth_m = np.linalg.norm(images, axis=1)
        tree = cKDTree(images / depth_m[:, None])
        near = tree.query_ball_point(beams / np.linalg.norm(beams, axis=1)[:, None], _APART_RAD)
        for row, several in enumerate(near):
            if several:
                nearest[row] = several[int(depth_m[several].argmin())]
    return nearest
