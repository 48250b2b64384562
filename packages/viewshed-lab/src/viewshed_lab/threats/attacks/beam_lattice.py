"""The beams of a sweep: pixel (ring, column) of each return, empty pixels, start and direction of each beam.

They are computed from the sweep and its sensor's beam table alone. A sweep of a moving sensor has its points in one
frame. If it has times, the motion is estimated: constant velocity and turn rate about the world's vertical, fitted so
that the returns lie on the table's beams. Rays: beams as straight lines.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.arrays import F64, Mask
from viewshed.geometry import rotation_from_quaternion
from viewshed.preprocess.no_return import JITTER_COLUMNS
from viewshed.preprocess.ring_recovery import RingAssignment, recover_rings
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep
from viewshed_lab.sim.lidar.optics import step_of
from viewshed_lab.threats.attacks.base import Wedge

Ints = NDArray[np.int32]

ON_BEAM_M = 0.002
"""Maximum distance of three quarters of the returns from the table's beams; else the table is not used."""

_FITTED = 1500
"""Approximate number of returns sampled for the fit; a revolution has tens of thousands."""

_MIN_RETURNS = 50

_LIMITS_M = (3.0, 0.05, 0.05)
"""Outlier limit of each round of the fit: distance of a return from its beam."""


@dataclass(frozen=True, slots=True, eq=False)
class Firing:
    """Azimuth, time and sensor pose of each of the C firing columns, in the sensor's reference frame."""

    column: Ints  # (N,) int32 column of each return
    azimuth: F64  # (C,) float64 firing azimuth in radians, relative to the sensor's heading at that time
    turn: F64  # (C, 3, 3) float64 rotations of the sensor relative to the reference frame
    shift_m: F64  # (C, 3) float64 positions of the sensor
    time_s: NDArray[np.float32] | None = None  # (C,) float32 seconds, or None if the sweep has no times

    @classmethod
    def at_rest(cls, column: Ints, columns: int, phase: float, time_s: NDArray[np.float32] | None = None) -> Firing:
        """Return the firing of a static sensor, with equal azimuth steps from -π plus ``phase`` steps on."""
        azimuth = (np.arange(columns, dtype=np.float64) + phase) * (2 * np.pi / columns) - np.pi
        return cls(column, azimuth, np.tile(np.eye(3), (columns, 1, 1)), np.zeros((columns, 3)), time_s)


def fit_firing(sweep: Sweep, model: LidarModel) -> Firing | None:
    """Return the firing that fits 75 % of the returns within 2 mm, or None without one; the sweep must have rings."""
    if len(sweep) == 0 or sweep.ring is None:
        return None
    time_s = sweep.time_s
    moving = time_s is not None and float(time_s.max()) > float(time_s.min())
    return _fit_in_motion(sweep, model) if moving else _fit_at_rest(sweep, model)


def _fit_at_rest(sweep: Sweep, model: LidarModel) -> Firing | None:
    """Fit columns by azimuth, with a common phase (circular mean)."""
    ring, columns = _rings(sweep), model.azimuth_columns
    azimuth = np.arctan2(sweep.points[:, 1], sweep.points[:, 0]).astype(np.float64)
    position = (azimuth - model.azimuth_offset[ring] + np.pi) / model.azimuth_step
    phase = float(np.angle(np.exp(2j * np.pi * position[_sample(sweep)]).sum())) / (2 * np.pi) % 1.0
    column = np.rint(position - phase).astype(np.int32) % columns
    time_s = None if sweep.time_s is None else np.full(columns, sweep.time_s[0], np.float32)
    firing = Firing.at_rest(column, columns, phase, time_s)
    off_m, *_ = _fit_step(sweep, model, firing, np.zeros(4), np.inf)
    return firing if np.quantile(off_m, 0.75) < ON_BEAM_M else None


def _fit_in_motion(sweep: Sweep, model: LidarModel) -> Firing | None:
    """Fit columns by time, then the motion relative to the middle of the revolution by the Gauss-Newton method."""
    step_s = _column_time_s(sweep, model.azimuth_columns)
    if step_s is None or sweep.time_s is None:
        return None
    columns = np.arange(model.azimuth_columns)
    position = sweep.time_s.astype(np.float64) / step_s
    first = float(np.median(position[_sample(sweep)] % 1.0))
    column = np.rint(position - first).astype(np.int32)
    if column.min() < 0 or column.max() >= len(columns) or np.abs(position - first - column).max() > 0.2:
        return None
    time_s = ((columns + first) * step_s).astype(np.float32)
    firing = Firing.at_rest(column, len(columns), 0.5, time_s)
    motion = np.zeros(4)
    for limit_m in _LIMITS_M:
        _, matrix, right, used = _fit_step(sweep, model, firing, motion, limit_m)
        if used < _MIN_RETURNS:
            return None
        motion = motion + np.linalg.lstsq(matrix, right, rcond=None)[0]
    off_m, *_ = _fit_step(sweep, model, firing, motion, np.inf)
    return _moved(firing, motion, _vertical(sweep)) if np.quantile(off_m, 0.75) < ON_BEAM_M else None


def _sample(sweep: Sweep) -> slice:
    return slice(None, None, max(len(sweep) // _FITTED, 1))


def _rings(sweep: Sweep) -> NDArray[np.int16]:
    return np.zeros(len(sweep), np.int16) if sweep.ring is None else sweep.ring


def _fit_step(
    sweep: Sweep, model: LidarModel, firing: Firing, motion: F64, limit_m: float
) -> tuple[F64, F64, F64, int]:
    """Return residuals (n,) of sampled returns, normal equations of a Gauss-Newton step, and the number of inliers."""
    rows = _sample(sweep)
    step: tuple[F64, F64, F64, int] = _residuals(
        sweep.points[rows], _rings(sweep)[rows], firing.column[rows], firing.azimuth, _since_middle_s(firing),
        model.elevation, model.azimuth_offset, model.origin_m, motion, _vertical(sweep), limit_m,
    )  # fmt: skip
    return step


def _column_time_s(sweep: Sweep, columns: int) -> float | None:
    """Return the time between two columns in seconds, or None if the times do not determine it."""
    time_s = np.zeros(0) if sweep.time_s is None else sweep.time_s.astype(np.float64)
    gaps = np.diff(time_s)
    if len(gaps) and gaps.min() < 0:
        gaps = np.diff(np.unique(time_s))
    gaps = gaps[gaps > 0]
    if len(sweep) < _MIN_RETURNS or not 8 <= len(gaps) + 1 <= columns:
        return None
    return float(gaps.sum() / np.rint(gaps / gaps.min()).sum())


def _vertical(sweep: Sweep) -> F64:
    """Return the world's vertical (3,) in the sensor's frame."""
    if sweep.world_from_sensor is not None:
        return np.array(sweep.world_from_sensor.rotation[2])
    attitude = sweep.known_attitude
    return np.array([0.0, 0.0, 1.0] if attitude is None else rotation_from_quaternion(attitude)[2])


def _since_middle_s(firing: Firing) -> F64:
    if firing.time_s is None:
        return np.zeros(len(firing.azimuth))
    since_s: F64 = firing.time_s.astype(np.float64)
    since_s -= since_s.mean()
    return since_s


def _moved(firing: Firing, motion: F64, axis: F64) -> Firing:
    """Return the firing of a sensor with velocity ``motion[:3]`` and turn rate ``motion[3]`` about ``axis`` (3,).

    Rotations by Rodrigues' formula.
    """
    since_s = _since_middle_s(firing)
    angle = since_s * motion[3]
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn = np.eye(3) + np.sin(angle)[:, None, None] * cross + (1 - np.cos(angle))[:, None, None] * (cross @ cross)
    return replace(firing, turn=turn, shift_m=np.outer(since_s, motion[:3]))


@njit(cache=True, nogil=True, error_model="numpy")
def _residuals(
    points: Any,
    ring: Any,
    column: Any,
    azimuth: Any,
    since_s: Any,
    elevation: Any,
    offset: Any,
    origin_m: Any,
    motion: Any,
    axis: Any,
    limit_m: float,
) -> Any:
    """Return the distances of returns from their beams (n,) in meters, and the normal equations of a Gauss-Newton step.

    ``motion`` (4,) is a velocity and a turn rate about ``axis`` (3,). The normal equations, a matrix (4, 4) and a right
    side (4,), are summed over the returns less than ``limit_m`` from their beam; the number of these comes last.
    Per return: points (n, 3), ring and column (n,). Per column: azimuth and time from the middle of the revolution
    (C,). Per ring: elevation, azimuth offset and height of the beam's start (R,).
    """
    off_m = np.empty(points.shape[0])
    matrix, right, used = np.zeros((4, 4)), np.zeros(4), 0
    miss, slope = np.empty(3), np.empty((4, 3))
    for n in range(points.shape[0]):
        # The table's beam, turned and moved with the sensor to the time of its column.
        r, s = ring[n], since_s[column[n]]
        angle, flat = azimuth[column[n]] + offset[r], np.cos(elevation[r])
        direction = _rotate((flat * np.cos(angle), flat * np.sin(angle), np.sin(elevation[r])), axis, motion[3] * s)
        start = _rotate((0.0, 0.0, origin_m[r]), axis, motion[3] * s)
        arm = (points[n, 0] - motion[0] * s, points[n, 1] - motion[1] * s, points[n, 2] - motion[2] * s)
        reach = (arm[0] - start[0], arm[1] - start[1], arm[2] - start[2])
        # The residual: the part of the vector to the return that is perpendicular to the beam.
        along = reach[0] * direction[0] + reach[1] * direction[1] + reach[2] * direction[2]
        for k in range(3):
            miss[k] = reach[k] - along * direction[k]
        off_m[n] = np.sqrt(miss[0] ** 2 + miss[1] ** 2 + miss[2] ** 2)
        # J'J and J'r of the inliers.
        if off_m[n] < limit_m:
            used += 1
            _residual_slopes(direction, _cross(axis, arm), s, slope)
            for i in range(4):
                right[i] += slope[i, 0] * miss[0] + slope[i, 1] * miss[1] + slope[i, 2] * miss[2]
                for j in range(4):
                    matrix[i, j] += slope[i, 0] * slope[j, 0] + slope[i, 1] * slope[j, 1] + slope[i, 2] * slope[j, 2]
    return off_m, matrix, right, used


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _residual_slopes(direction: Any, sideways: Any, s: Any, slope: Any) -> None:
    """Fill ``slope`` (4, 3): the negative derivative of one return's residual by velocity and turn rate.

    It is the motion perpendicular to the beam times the time ``s``; ``sideways`` (3,) is that per radian of turn.
    """
    turning = sideways[0] * direction[0] + sideways[1] * direction[1] + sideways[2] * direction[2]
    for k in range(3):
        for i in range(3):
            slope[i, k] = s * ((1.0 if i == k else 0.0) - direction[i] * direction[k])
        slope[3, k] = s * (sideways[k] - turning * direction[k])


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _cross(a: Any, b: Any) -> Any:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _rotate(v: Any, axis: Any, angle: Any) -> Any:
    """Rodrigues' rotation of v (3,) about a unit axis (3,)."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = _cross(axis, v)
    along = (1.0 - c) * (axis[0] * v[0] + axis[1] * v[1] + axis[2] * v[2])
    return c * v[0] + s * x + along * axis[0], c * v[1] + s * y + along * axis[1], c * v[2] + s * z + along * axis[2]


_SAMPLED = 4000
"""Approximate number of returns sampled to estimate the phase of the columns."""

_EDGE = 1e-6
"""Margin in radians at the edges of a wedge, larger than rounding errors."""


@dataclass(frozen=True, slots=True, eq=False)
class BeamLattice:
    """The beams of one sweep, R rings by C columns."""

    ring: NDArray[np.int16]  # (N,) int16 ring of each return, -1 if unknown
    elevation: F64  # (R,) float64 radians
    azimuth_offset: F64  # (R,) float64 radians relative to the firing azimuth
    origin_m: F64  # (R,) float64 height of the start of each beam
    firing: Firing  # azimuth, time and sensor pose of each column
    rows: NDArray[np.int32]  # (R, C) int32 row of the first return of each pixel, -1 for none
    empty: NDArray[np.bool_]  # (R, C) bool, beams that were fired and did not return
    step_m: float  # range resolution of the sensor, 0 if unknown
    by_column: bool  # whether the sweep is stored column by column, not ring by ring
    sense: int  # +1 if ring (or column) ascends within a stored column (or ring), else -1
    seam: int  # first column of the stored rings, if the sweep is stored ring by ring

    def of_returns(self, points: NDArray[np.float32], row: NDArray[np.intp]) -> tuple[F64, F64, F64]:
        """Return starts (K, 3) in meters, directions (K, 3) and depths (K,) in meters of the beams of some returns.

        A beam starts at its ring's ``origin_m`` on the sensor's axis at the time of its column; a return without a ring
        starts at the sensor's origin.
        """
        ring, column = self.ring[row], self.firing.column[row]
        lift_m = np.where(ring >= 0, self.origin_m[ring], 0.0)[:, None]
        start_m = np.take(self.firing.shift_m, column, 0) + np.take(self.firing.turn[:, :, 2], column, 0) * lift_m
        return start_m, *_towards(np.take(points, row, 0) - start_m)

    def nearest_pixels(self, points: NDArray[Any]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return ring (K,) and column (K,) of the beams nearest to points (K, 3), as seen from the sensor."""
        x, y, z = points.astype(np.float64).T
        rings = np.argsort(self.elevation, kind="stable")
        ascending = self.elevation[rings]
        elevation = np.arctan2(z - float(np.median(self.origin_m)), np.hypot(x, y))
        ring = rings[np.searchsorted((ascending[1:] + ascending[:-1]) / 2, elevation)]
        step = 2 * np.pi / len(self.firing.azimuth)
        column = np.rint((np.arctan2(y, x) - self.azimuth_offset[ring] - self.firing.azimuth[0]) / step)
        return ring, column.astype(np.intp) % len(self.firing.azimuth)

    def storage_keys(self, ring: NDArray[Any], column: NDArray[Any]) -> tuple[NDArray[np.int64], F64]:
        """Return the row of the nearest return (K,) and a key (K,) that sorts pixels among the sweep's rows.

        A key is the row plus or minus less than one half, by the order of storage. Without any return, the row is -1
        and the key N.
        """
        rows = self.rows if self.by_column else np.roll(self.rows, -self.seam, axis=1)
        column = column if self.by_column else (column - self.seam) % rows.shape[1]
        nearest, ahead = nearest_rows(rows, ring, column, self.by_column)
        # Before or after the neighbor's row, by 0.25 plus up to 0.2 that grows with the distance of the neighbor.
        side = np.where(ahead >= 0, self.sense, -self.sense)
        key = nearest + side * (0.25 + 0.2 * np.minimum(np.abs(ahead) / self.rows.size, 1.0))
        return nearest, np.where(nearest >= 0, key, float(len(self.ring)))


@lru_cache(maxsize=2)
def lattice_of(sweep: Sweep) -> BeamLattice | None:
    """Return the beams of ``sweep``, or None if it has no rings and its order of points does not reveal them.

    Exact if the returns lie within 2 mm of the beams of the sweep's model. Otherwise columns are estimated from the
    returns, and empty beams have the estimated elevation of their ring.
    """
    model = sweep.model
    if model is not None and sweep.ring is not None:
        firing = fit_firing(sweep, model)
        if firing is not None:
            table = (model.elevation, model.azimuth_offset, model.origin_m)
            return _lattice(sweep.ring, *table, firing, step_of(model))
    beams = recover_rings(sweep)
    if beams.source == "elevation bins" or len(sweep) == 0:
        return None
    none = np.zeros(beams.rings)
    elevation, origin_m = beams.elevation, none
    if model is not None and model.rings == beams.rings:
        elevation, origin_m = model.elevation, model.origin_m
    return _lattice(beams.ring, elevation, none, origin_m, _recovered_firing(sweep, beams), 0.0)


def _lattice(
    ring: NDArray[np.int16], elevation: F64, azimuth_offset: F64, origin_m: F64, firing: Firing, step_m: float
) -> BeamLattice:
    exact = step_m > 0.0
    columns = len(firing.azimuth)
    rows, several = _pixel_rows(ring, firing.column, (len(elevation), columns))
    by_column, sense, ends = _storage_order(ring, firing.column)
    if not exact and not by_column:
        several[ring[ends], firing.column[ends]] = True  # the ends of a ring are as uncertain as its azimuths
    empty = _empty_pixels(rows, several, 0 if exact else JITTER_COLUMNS, exact)
    # The column at which rings begin: the circular mean of the columns at their ends.
    turn = np.angle(np.exp(2j * np.pi * firing.column[ends] / columns).sum()) / (2 * np.pi)
    seam = 0 if by_column or len(ends) == 0 else int(np.ceil(turn * columns)) % columns
    return BeamLattice(ring, elevation, azimuth_offset, origin_m, firing, rows, empty, step_m, by_column, sense, seam)


def _recovered_firing(sweep: Sweep, beams: RingAssignment) -> Firing:
    """Return columns estimated from the azimuths of the returns, with their common phase (circular mean)."""
    position = (np.arctan2(sweep.points[:, 1], sweep.points[:, 0]) + np.float32(np.pi)) / np.float32(beams.azimuth_step)
    sampled = position[:: max(len(position) // _SAMPLED, 1)].astype(np.float64)
    phase = float(np.angle(np.exp(2j * np.pi * sampled).sum())) / (2 * np.pi) % 1.0
    column = np.rint(position - np.float32(phase)).astype(np.int32) % beams.columns
    return Firing.at_rest(column, beams.columns, phase)


def _storage_order(ring: NDArray[np.int16], column: NDArray[np.int32]) -> tuple[bool, int, NDArray[np.intp]]:
    """Return whether returns are stored column by column, the sense (+1 or -1), and the rows at the ends of rings."""
    up, along = np.diff(ring), np.diff(column)
    changes = up != 0
    by_column = bool(changes.sum() * 2 > len(up))
    steps = np.sign(up[along == 0]) if by_column else np.sign(along[~changes])
    last = np.flatnonzero(changes)
    return by_column, -1 if int(steps.sum()) < 0 else 1, np.concatenate([last, last + 1])


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """K beams in the sensor's frame: first those with returns, in the order of the sweep, then those without."""

    row: NDArray[np.intp]  # (K,) row of the return in the sweep, -1 for none
    ring: NDArray[np.intp]  # (K,) ring, -1 if unknown
    column: NDArray[np.intp]  # (K,) azimuth column, -1 if unknown
    start_m: F64  # (K, 3) float64 meters
    direction: F64  # (K, 3) float64 unit vectors
    depth_m: F64  # (K,) float64 meters from the start to the return, +inf for none

    def __len__(self) -> int:
        return len(self.row)

    def select(self, keep: NDArray[Any]) -> Rays:
        """Return the rays that ``keep`` (mask (K,) or indices) selects."""
        return Rays(*(getattr(self, f.name)[keep] for f in fields(self)))

    def at(self, depth_m: F64) -> NDArray[np.float32]:
        """Return the points (K, 3) float32 at depths (K,) in meters."""
        return (self.start_m + depth_m[:, None] * self.direction).astype(np.float32)


def within(points: NDArray[Any], wedge: Wedge) -> Mask:
    """Return the mask (K,) of points (K, 3) in the wedge, with a small margin at its edges against rounding."""
    if wedge.width >= 2 * np.pi:
        return np.ones(len(points), np.bool_)
    x, y = points[:, 0].astype(np.float64), points[:, 1].astype(np.float64)
    range_m = np.sqrt(x * x + y * y)
    forward = x * np.cos(wedge.azimuth) + y * np.sin(wedge.azimuth)
    inside: Mask = (forward >= np.cos(max(wedge.width / 2 - _EDGE, 0.0)) * range_m) & (range_m > 0)
    return inside


def rays_in(sweep: Sweep, wedge: Wedge, *, empty: bool = False) -> Rays:
    """Return the beams of ``sweep`` with returns in the wedge and, with ``empty``, also those without.

    Raises:
        ValueError: ``empty`` is requested and the sweep's beams are unknown.
    """
    lattice = lattice_of(sweep)
    if empty and lattice is None and len(sweep):
        raise ValueError(
            f"the beams of this sweep must be known, got {len(sweep)} points without rings; name the sensor, give "
            "rings, or use an attack that places points freely"
        )
    returned = _returned_rays(sweep, lattice, np.flatnonzero(within(sweep.points, wedge)))
    if not empty or lattice is None:
        return returned
    missing = _empty_rays(lattice, wedge)
    return Rays(*(np.concatenate([getattr(returned, f.name), getattr(missing, f.name)]) for f in fields(Rays)))


def _returned_rays(sweep: Sweep, lattice: BeamLattice | None, row: NDArray[np.intp]) -> Rays:
    if lattice is not None:
        ring, column = lattice.ring[row].astype(np.intp), lattice.firing.column[row].astype(np.intp)
        return Rays(row, ring, column, *lattice.of_returns(sweep.points, row))
    unknown = np.full(len(row), -1)
    return Rays(row, unknown, unknown, np.zeros((len(row), 3)), *_towards(sweep.points[row].astype(np.float64)))


def _towards(reach: F64) -> tuple[F64, F64]:
    """Return unit directions (K, 3) and lengths (K,) of vectors (K, 3)."""
    x, y, z = reach.T
    depth_m = np.sqrt(x * x + y * y + z * z)
    return reach / np.maximum(depth_m, 1e-9)[:, None], depth_m


def _empty_rays(lattice: BeamLattice, wedge: Wedge) -> Rays:
    ring, column = np.nonzero(lattice.empty)
    firing = lattice.firing
    start_m, direction = beams_of_pixels(
        ring, column, lattice.elevation, lattice.azimuth_offset, lattice.origin_m,
        firing.azimuth, firing.turn, firing.shift_m,
    )  # fmt: skip
    none = np.full(len(ring), -1)
    missing = Rays(none, ring, column, start_m, direction, np.full(len(ring), np.inf))
    return missing if wedge.width >= 2 * np.pi else missing.select(within(direction, wedge))


def _pixel_rows(
    ring: NDArray[np.int16], column: NDArray[np.int32], shape: tuple[int, int]
) -> tuple[NDArray[np.int32], Mask]:
    """Return the first row of each pixel (R, C), -1 for none, and the mask (R, C) of pixels with several returns.

    ``ring`` and ``column`` (N,) are those of the returns; returns with ring -1 have no pixel.
    """
    known = np.flatnonzero(ring >= 0)
    pixel = ring[known].astype(np.intp) * shape[1] + column[known]
    rows = np.full(shape, -1, np.int32)
    rows.reshape(-1)[pixel[::-1]] = known[::-1]  # reversed, so that the first row of a pixel is written last
    return rows, (np.bincount(pixel, minlength=rows.size) > 1).reshape(shape)


def _empty_pixels(rows: NDArray[np.int32], several: Mask, jitter: int, all_rings: bool) -> Mask:
    """Return the mask (R, C) of beams that were fired and did not return.

    Columns without any return were not fired; rings without any count only with ``all_rings``. A second return in a
    pixel belongs to a neighbor within ``jitter`` columns, whose pixel only looks empty.
    """
    returned = rows >= 0
    empty: Mask = ~returned & returned.any(axis=0)
    if not all_rings:
        empty &= returned.any(axis=1, keepdims=True)
    for offset in range(-jitter, jitter + 1):
        empty &= ~np.roll(several, offset, axis=1)
    return empty


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_rows(rows: Any, ring: Any, column: Any, by_column: bool) -> Any:
    """Return for each pixel (K,) the row of the nearest return, and by how many pixels the return precedes it.

    The search starts in the pixel's column (or ring, if the sweep is stored ring by ring) and goes on to the next
    ones. The row is -1 if there is no return at all.
    """
    row, ahead = np.full(ring.shape[0], -1, np.int64), np.zeros(ring.shape[0], np.int64)
    for k in range(ring.shape[0]):
        if by_column:
            row[k], ahead[k] = _nearest_by_columns(rows, ring[k], column[k])
        else:
            row[k], ahead[k] = _nearest_by_rings(rows, ring[k], column[k])
    return row, ahead


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest_by_columns(rows: Any, r: Any, c: Any) -> Any:
    """Search the pixel's own column, then the earlier columns, which are stored before it."""
    rings, columns = rows.shape
    for away in range(columns):
        row, ahead = _nearest_in_line(rows[:, (c - away) % columns], r)
        if row >= 0:
            return row, ahead + away * rings
    return -1, 0


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest_by_rings(rows: Any, r: Any, c: Any) -> Any:
    """Search the pixel's own ring, then the rings below and above it at growing distance."""
    rings, columns = rows.shape
    for away in range(rings):
        for side in (r - away, r + away):
            if 0 <= side < rings:
                row, ahead = _nearest_in_line(rows[side], c)
                if row >= 0:
                    return row, ahead + (r - side) * columns
    return -1, 0


@njit(cache=True, nogil=True, error_model="numpy")
def _nearest_in_line(rows: Any, at: Any) -> Any:
    """Search a column or a ring; it does not wrap around."""
    for away in range(rows.shape[0]):
        if at - away >= 0 and rows[at - away] >= 0:
            return rows[at - away], away
        if at + away < rows.shape[0] and rows[at + away] >= 0:
            return rows[at + away], -away
    return -1, 0


@njit(cache=True, nogil=True, error_model="numpy")
def beams_of_pixels(
    ring: Any, column: Any, elevation: Any, offset: Any, origin_m: Any, azimuth: Any, turn: Any, shift_m: Any
) -> Any:
    """Return starts (K, 3) and unit directions (K, 3) of the beams of pixels (K,), by the beam table and the motion.

    Per ring: ``elevation``, azimuth ``offset`` and ``origin_m`` (R,). Per column: firing ``azimuth`` (C,), rotations
    ``turn`` (C, 3, 3) and positions ``shift_m`` (C, 3).
    """
    start, direction = np.empty((ring.shape[0], 3)), np.empty((ring.shape[0], 3))
    flat, upward = np.cos(elevation), np.sin(elevation)
    for k in range(ring.shape[0]):
        r, c = ring[k], column[k]
        angle = azimuth[c] + offset[r]
        x, y, z = flat[r] * np.cos(angle), flat[r] * np.sin(angle), upward[r]
        for i in range(3):
            start[k, i] = shift_m[c, i] + turn[c, i, 2] * origin_m[r]
            direction[k, i] = turn[c, i, 0] * x + turn[c, i, 1] * y + turn[c, i, 2] * z
    return start, direction
