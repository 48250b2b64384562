"""Attacks on the whole cloud, and below the sensor's driver (families 18 to 21).

A shifted axis, noise of the size of the sensor's own and a blinded sensor are those of a public data set of spoofed
drives, Allenpandas/LiDAR-Spoofing-Forensics-Datasets. Mirrors are those of arXiv 2509.17253. Trojans in a driver are
those of arXiv 2303.03470: they write points into the cloud, or take them out, and no beam has to agree.
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
"""A mirrored return lies on the beam that points to it, or on the nearest one up to this angle."""

_TAKEN_M = 3.0
"""A trojan takes out what stands within this distance of the return that it is aimed at, ..."""

_LOW_M = 0.15
"""... but for the ground: what is lower than this."""


@dataclass(frozen=True, slots=True)
class ShiftedAxis(Checked):
    """Every point is moved along one axis of the sensor's frame."""

    shift_m: Annotated[float, Between(-100.0, 100.0)] = 1.0
    axis: Literal["x", "y", "z"] = "x"

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        shift_m = self.shift_m * np.eye(3)["xyz".index(self.axis)]
        return _moved(sweep, np.full(len(sweep), bool(self.shift_m)), sweep.points + shift_m)


@dataclass(frozen=True, slots=True)
class SensorNoise(Checked):
    """Every point is moved at random, by about as much as the sensor errs by itself."""

    std_m: Annotated[float, Between(0.0, 10.0)] = 0.05  # of each coordinate

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        noise_m = rng.normal(0.0, 1.0, sweep.points.shape) * self.std_m
        return _moved(sweep, np.full(len(sweep), self.std_m > 0), sweep.points + noise_m)


@dataclass(frozen=True, slots=True)
class Blinding(Checked):
    """A strong light: most returns are lost, and some beams return at random from nearby."""

    lost_share: Share = 0.9  # of all returns
    noise_share: Share = 0.3  # of the lost ones, beams that return from nearby
    noise_m: Range = 4.0  # farthest of these

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        lost = rng.random(len(sweep)) < self.lost_share
        noisy = lost & (rng.random(len(sweep)) < self.noise_share)
        range_m = np.linalg.norm(sweep.points, axis=1)
        nearby_m = rng.uniform(0.5, max(self.noise_m, 0.5), len(sweep))
        points = sweep.points * (nearby_m / np.maximum(range_m, 1e-6))[:, None]
        return _moved(sweep, noisy, points, lost & ~noisy)


@dataclass(frozen=True, slots=True)
class Mirror(Checked):
    """A plane mirror that stands upright or tilted: beams that meet it return from where they are reflected to.

    A scene seen in it is that of the sweep's own returns, so that what no beam met shows nothing. Tilted up far enough
    it shows the sky: whatever stands behind it vanishes. It is put before an obstacle drawn at random where no azimuth
    is given.
    """

    range_m: Range = 8.0
    azimuth: Azimuth = None
    width_m: Annotated[float, Between(0.01, 100.0)] = 1.5
    height_m: Annotated[float, Between(0.01, 100.0)] = 1.5
    # of its normal from the line to the sensor, about the vertical
    turn_deg: Annotated[float, Between(-89.0, 89.0)] = 35.0
    tilt_deg: Annotated[float, Between(-89.0, 89.0)] = 0.0  # of its normal upward

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        azimuth = self.azimuth
        if azimuth is None:
            azimuth = azimuth_or_random(random_obstacle_azimuth(sweep, self.range_m, 50.0, rng), rng)
        x, y, _ = position_at(sweep, azimuth, self.range_m)
        low, high = (to_sensor(sweep, np.array([x, y, ground_at(sweep, x, y) + z])) for z in (0.0, self.height_m))
        turned, tilt = azimuth + np.pi + np.deg2rad(self.turn_deg), np.deg2rad(self.tilt_deg)
        normal = np.array([np.cos(turned) * np.cos(tilt), np.sin(turned) * np.cos(tilt), np.sin(tilt)])
        center = (low + high) / 2
        points = sweep.points.astype(np.float64)
        # 1. Beams that meet the mirror before their own return.
        met = self._is_met(points, center, normal)
        # 2. Where the returns on the sensor's side of the mirror appear in it, if the line to there meets the mirror.
        before = (points - center) @ normal > 0.05
        images = points[before] - 2.0 * ((points[before] - center) @ normal)[:, None] * normal
        images = images[self._is_met(images, center, normal)]
        # 3. A beam returns from the image next to it; one without such an image is reflected to where nothing returns.
        seen = _nearest(points[met], images)
        shown = np.flatnonzero(met)[seen >= 0]
        moved = points.copy()
        if len(shown):
            image_m = np.linalg.norm(images[seen[seen >= 0]], axis=1)
            moved[shown] *= (image_m / np.linalg.norm(points[shown], axis=1))[:, None]
        is_shown = np.zeros(len(sweep), np.bool_)
        is_shown[shown] = True
        wedge = Wedge(azimuth, 2.0 * float(np.arctan2(self.width_m, self.range_m)) + 0.02)
        return _moved(sweep, is_shown, moved, met & ~is_shown, wedge)

    def _is_met(self, points: F64, center: F64, normal: F64) -> Mask:
        """Return which lines from the sensor to points (K, 3) pass through the mirror on their way."""
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
    """A driver writes the points of a car into the cloud, with no shadow behind it."""

    range_m: Range = 12.0
    azimuth: Azimuth = None
    count: Annotated[int, Between(0, 100_000)] = 200

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        x, y, facing = position_at(sweep, azimuth_or_random(self.azimuth, rng), self.range_m)
        # Its rear, which faces the sensor, and its two sides.
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
    """A driver takes the points of an object out of the cloud; what it hid stays without a return."""

    near_m: Range = 4.0
    far_m: Range = 30.0

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it; one without an obstacle stays as it is."""
        leveled = scene_of(sweep)
        height_m, range_m = leveled.height_m, leveled.range_m
        standing = (height_m > OBSTACLE_HEIGHTS_M[0]) & (height_m < OBSTACLE_HEIGHTS_M[1])
        aimed = np.flatnonzero(standing & (range_m > self.near_m) & (range_m < self.far_m))
        removed = np.zeros(len(sweep), np.bool_)
        if len(aimed):
            apart_m = leveled.points[:, :2] - leveled.points[rng.choice(aimed), :2]
            removed[leveled.rows[(np.hypot(*apart_m.T) < _TAKEN_M) & (height_m > _LOW_M)]] = True
        return _moved(sweep, np.zeros(len(sweep), np.bool_), sweep.points, removed)


def _moved(
    sweep: Sweep, moved: Mask, points: NDArray[np.floating], removed: Mask | None = None, wedge: Wedge | None = None
) -> Tampered:
    """Return a sweep some of whose returns are moved, each staying in its place among the rows, and others removed."""
    removed = np.zeros(len(sweep), np.bool_) if removed is None else removed
    kept = sweep.points.copy()
    kept[moved] = points[moved].astype(np.float32)
    return Tampered(sweep.replace(points=kept).select(~removed), moved[~removed], moved | removed, wedge)


def _nearest(beams: F64, images: F64) -> NDArray[np.intp]:
    """Return for each beam (K,) the image next to it, the nearer one of those about as near; -1 where none is near."""
    from scipy.spatial import cKDTree

    found = np.full(len(beams), -1, np.intp)
    if len(beams) and len(images):
        depth_m = np.linalg.norm(images, axis=1)
        tree = cKDTree(images / depth_m[:, None])
        near = tree.query_ball_point(beams / np.linalg.norm(beams, axis=1)[:, None], _APART_RAD)
        for row, several in enumerate(near):
            if several:
                found[row] = several[int(depth_m[several].argmin())]
    return found
