"""Where each beam of a sweep started and pointed, from the sweep and its sensor's beam table alone.

A sweep of a sensor in motion has its points in one frame. Where it carries times, the motion is that of a constant
velocity and a constant turn about the world's vertical which puts the returns on the table's beams.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed.geometry import rotation_from_quaternion
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep

Ints = NDArray[np.int32]

ON_BEAM_M = 0.002
"""Three quarters of the returns must lie this near to the table's beams, or the table does not say where they are."""

_SAMPLED = 1500
"""Returns that the fit looks at; a revolution has some ten thousand."""

_FEWEST = 50

_LIMITS_M = (3.0, 0.05, 0.05)
"""Rounds of the fit: returns farther beside their beams than this do not count."""


@dataclass(frozen=True, slots=True, eq=False)
class Firing:
    """When and from where each of C columns was fired, in the sensor's reference frame."""

    column: Ints  # (N,) int32 column of each return
    azimuth: F64  # (C,) float64 firing azimuth in radians, by the sensor's heading at that time
    turn: F64  # (C, 3, 3) float64 rotations of the sensor against its reference
    shift_m: F64  # (C, 3) float64 positions of the sensor
    time_s: NDArray[np.float32] | None = None  # (C,) float32 seconds, or None where the sweep has none


def at_rest(columns: int) -> tuple[F64, F64]:
    """Return rotations (C, 3, 3) and positions (C, 3) of a sensor that does not move."""
    return np.tile(np.eye(3), (columns, 1, 1)), np.zeros((columns, 3))


def even_azimuths(columns: int, phase: float) -> F64:
    """Return (columns,) float64 azimuths in radians, the first at -π and ``phase`` steps."""
    return (np.arange(columns, dtype=np.float64) + phase) * (2 * np.pi / columns) - np.pi


def fit_firing(sweep: Sweep, model: LidarModel) -> Firing | None:
    """Return the firing that explains the returns within 2 mm, or None where none does; the sweep must have rings."""
    if len(sweep) == 0 or sweep.ring is None:
        return None
    time_s = sweep.time_s
    moving = time_s is not None and float(time_s.max()) > float(time_s.min())
    return _fit_in_motion(sweep, model) if moving else _fit_at_rest(sweep, model)


def _fit_at_rest(sweep: Sweep, model: LidarModel) -> Firing | None:
    """Columns by azimuth, with the phase that most returns share."""
    ring, columns = _rings(sweep), model.azimuth_columns
    azimuth = np.arctan2(sweep.points[:, 1], sweep.points[:, 0]).astype(np.float64)
    position = (azimuth - model.azimuth_offset[ring] + np.pi) / model.azimuth_step
    phase = float(np.angle(np.exp(2j * np.pi * position[_sample(sweep)]).sum())) / (2 * np.pi) % 1.0
    column = np.rint(position - phase).astype(np.int32) % columns
    time_s = None if sweep.time_s is None else np.full(columns, sweep.time_s[0], np.float32)
    firing = Firing(column, even_azimuths(columns, phase), *at_rest(columns), time_s)
    off_m, *_ = _fit_step(sweep, model, firing, np.zeros(4), np.inf)
    return firing if np.quantile(off_m, 0.75) < ON_BEAM_M else None


def _fit_in_motion(sweep: Sweep, model: LidarModel) -> Firing | None:
    """Columns by time, then the motion about the middle of the revolution by Gauss and Newton's method."""
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
    firing = Firing(column, even_azimuths(len(columns), 0.5), *at_rest(len(columns)), time_s)
    motion = np.zeros(4)
    for limit_m in _LIMITS_M:
        _, matrix, right, used = _fit_step(sweep, model, firing, motion, limit_m)
        if used < _FEWEST:
            return None
        motion = motion + np.linalg.lstsq(matrix, right, rcond=None)[0]
    off_m, *_ = _fit_step(sweep, model, firing, motion, np.inf)
    return _moved(firing, motion, _vertical(sweep)) if np.quantile(off_m, 0.75) < ON_BEAM_M else None


def _sample(sweep: Sweep) -> slice:
    return slice(None, None, max(len(sweep) // _SAMPLED, 1))


def _rings(sweep: Sweep) -> NDArray[np.int16]:
    return np.zeros(len(sweep), np.int16) if sweep.ring is None else sweep.ring


def _fit_step(
    sweep: Sweep, model: LidarModel, firing: Firing, motion: F64, limit_m: float
) -> tuple[F64, F64, F64, int]:
    """Return the residuals (n,) of a sample of the returns, and the normal equations for a better motion."""
    rows = _sample(sweep)
    step: tuple[F64, F64, F64, int] = _residuals(
        sweep.points[rows], _rings(sweep)[rows], firing.column[rows], firing.azimuth, _since_middle_s(firing),
        model.elevation, model.azimuth_offset, model.origin_m, motion, _vertical(sweep), limit_m,
    )  # fmt: skip
    return step


def _column_time_s(sweep: Sweep, columns: int) -> float | None:
    """Return the time between two columns, or None where the times do not give it."""
    time_s = np.zeros(0) if sweep.time_s is None else sweep.time_s.astype(np.float64)
    gaps = np.diff(time_s)
    if len(gaps) and gaps.min() < 0:
        gaps = np.diff(np.unique(time_s))
    gaps = gaps[gaps > 0]
    if len(sweep) < _FEWEST or not 8 <= len(gaps) + 1 <= columns:
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
    """Return how far returns lie beside their beams (n,) meters, and one step of Gauss and Newton towards the motion.

    ``motion`` (4,) is a velocity and a turn rate about ``axis`` (3,). The step's normal equations, a matrix (4, 4) and
    a right side (4,), are summed over the returns less than ``limit_m`` beside their beam; their number comes last.
    Points (n, 3), ring and column (n,) are the returns'; azimuth and time from the middle of the revolution (C,) the
    columns'; elevation, azimuth offset and height of the start (R,) the rings'.
    """
    off_m = np.empty(points.shape[0])
    matrix, right, used = np.zeros((4, 4)), np.zeros(4), 0
    miss, slope = np.empty(3), np.empty((4, 3))
    for n in range(points.shape[0]):
        # The beam as the table has it, turned and moved with the sensor by the time of its column.
        r, s = ring[n], since_s[column[n]]
        angle, flat = azimuth[column[n]] + offset[r], np.cos(elevation[r])
        direction = _rotate((flat * np.cos(angle), flat * np.sin(angle), np.sin(elevation[r])), axis, motion[3] * s)
        start = _rotate((0.0, 0.0, origin_m[r]), axis, motion[3] * s)
        arm = (points[n, 0] - motion[0] * s, points[n, 1] - motion[1] * s, points[n, 2] - motion[2] * s)
        reach = (arm[0] - start[0], arm[1] - start[1], arm[2] - start[2])
        # The residual: the part of the way to the return that is across the beam.
        along = reach[0] * direction[0] + reach[1] * direction[1] + reach[2] * direction[2]
        for k in range(3):
            miss[k] = reach[k] - along * direction[k]
        off_m[n] = np.sqrt(miss[0] ** 2 + miss[1] ** 2 + miss[2] ** 2)
        # J'J and J'r of the returns that are no outliers.
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
    """Fill ``slope`` (4, 3): how the residual of one return follows velocity and turn rate.

    Their part across the beam, times the time; ``sideways`` is what a turn of one radian moves the return by.
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
