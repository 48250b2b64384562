"""BeamImage: origin, direction and depth of every beam of one revolution, with or without a return.

Also: the sensor's motion during a sweep, from the poses around it; selection of well-spaced sweeps of a drive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.arrays import F32
from viewshed.geometry import Rigid
from viewshed.preprocess.no_return import JITTER_COLUMNS
from viewshed.preprocess.ring_recovery import recover_rings
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep
from viewshed_lab._numba import atan2

MAX_GAP_S = 1.5
"""Largest time between neighboring poses from which motion is estimated."""

MAX_SPEED_MPS = 70.0
"""Poses that imply a higher speed do not belong to one drive."""

MAX_SPACING_S = 2.0
"""A sweep this long after the last selected one is selected even if the sensor moved little."""

_SHORT_S = 0.15
"""Uncertainty of time stamps in the test of the speed."""


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """Motion of a sensor around its reference pose, in the axes of its ``level`` frame."""

    velocity_mps: NDArray[np.float64]  # (3,) float64
    yaw_rate: float  # radians a second, counter-clockwise from above


@dataclass(frozen=True, slots=True, eq=False)
class StampedPose:
    """Pose of a sensor at a time."""

    world_from_sensor: Rigid | None  # None if unknown
    t_ns: int | None  # None if unknown

    def seconds_to(self, other: StampedPose) -> float:
        """Return the seconds from this time to the other; 0 if one is unknown."""
        return 0.0 if self.t_ns is None or other.t_ns is None else (other.t_ns - self.t_ns) * 1e-9

    def meters_to(self, other: StampedPose) -> float:
        """Return the distance to the other pose, meters; infinite if one is unknown."""
        if self.world_from_sensor is None or other.world_from_sensor is None:
            return float("inf")
        return float(np.linalg.norm(other.world_from_sensor.translation - self.world_from_sensor.translation))


AT_REST = Drift(np.zeros(3), 0.0)
"""No motion, or unknown motion."""


def drift_of(before: StampedPose | None, now: StampedPose, after: StampedPose | None) -> Drift:
    """Estimate the motion at ``now`` by differences of the neighboring poses; at rest if they are unknown."""
    posed = [one for one in (before, now, after) if one is not None and one.world_from_sensor is not None]
    pose = now.world_from_sensor
    if pose is None or len(posed) < 2 or not _reachable(posed[0], posed[-1]):
        return AT_REST
    first, last = posed[0].world_from_sensor, posed[-1].world_from_sensor
    seconds = posed[0].seconds_to(posed[-1])
    if first is None or last is None or not 1e-3 < seconds <= 2 * MAX_GAP_S:
        return AT_REST
    turned = Rigid(last.rotation @ first.rotation.T, np.zeros(3)).yaw
    velocity = (last.translation - first.translation) / seconds
    return Drift(velocity @ Rigid.from_yaw(pose.yaw).rotation, turned / seconds)


def _reachable(one: StampedPose, other: StampedPose) -> bool:
    return one.meters_to(other) <= MAX_SPEED_MPS * max(abs(one.seconds_to(other)), _SHORT_S)


def well_spaced(poses: Sequence[StampedPose | None], spacing_m: float) -> list[int]:
    """Return the indices of poses that are ``spacing_m`` meters or two seconds after the previously selected one.

    Unknown poses, and poses that imply a speed above 70 m/s, are skipped.
    """
    selected: list[int] = []
    last: StampedPose | None = None
    for index, pose in enumerate(poses):
        if pose is None or pose.world_from_sensor is None:
            continue
        if last is None or (
            _reachable(last, pose) and (last.meters_to(pose) >= spacing_m or last.seconds_to(pose) >= MAX_SPACING_S)
        ):
            selected.append(index)
            last = pose
    return selected


_SAMPLED = 4000
"""Number of returns from which the number of columns is estimated."""

_NEAR_COLUMNS = 2
"""Column counts to try on both sides of each likely one."""

_MIN_RELATIVE_FIT = 0.98
"""A likely column count is preferred if its fit is at least this share of the best fit."""


@dataclass(frozen=True, slots=True, eq=False)
class BeamImage:
    """The beams of one revolution. C columns by azimuth, R rings from the lowest up, in the axes of ``level``."""

    origin_m: F32  # (C, R, 3) float32 start of each beam from the sensor's reference position
    direction: F32  # (C, R, 3) float32 unit vectors
    depth_m: F32  # (C, R) float32 meters from start to return, 0 where there was none
    pixels: NDArray[np.int32]  # (C, R) int32 row of the return in the sweep, -1 where there was none
    max_range_m: float  # of the sensor
    model: LidarModel | None  # the sensor's beam table, or None if the pattern was estimated from the returns

    @property
    def returned(self) -> NDArray[np.bool_]:
        """Mask (C, R) of the beams with a return."""
        return self.pixels >= 0


def beam_image(sweep: Sweep, level_from_sensor: NDArray[np.float64], drift: Drift) -> BeamImage:
    """Return the beams of a sweep with the motion within the revolution undone.

    The firing pattern is that of the sweep's model, or of its rings and azimuth step. Every return is one beam;
    missing beams lie on the pattern.

    Args:
        sweep: the revolution; its points are in the sensor's frame at the middle of the revolution.
        level_from_sensor: rotation (3, 3).
        drift: motion of the sensor; ignored if the returns have no times.
    """
    seconds, model = _seconds(sweep), sweep.model
    rings = recover_rings(sweep if sweep.ring is not None else _undo_motion(sweep, level_from_sensor, drift, seconds))
    elevation, rise, offset = _tables(rings.elevation, model)
    motion = (level_from_sensor.astype(np.float32), drift.velocity_mps.astype(np.float32), np.float32(drift.yaw_rate))
    start, direction, length, azimuth = beams_of_returns(sweep.points, rings.ring, seconds, *motion, rise, offset)
    # The firing pattern: number of columns, and azimuth of the first one.
    columns = _best_column_count(azimuth, {rings.columns} if model is None else {rings.columns, model.azimuth_columns})
    column, phase = _columns(azimuth, columns)
    pixels = np.full((columns, len(elevation)), -1, np.int32)
    assign_pixels(rings.ring, column, length, pixels)
    step, times = np.float32(2 * np.pi / columns), _mean_times(column, seconds, columns)
    # All beams: the returns, and the pattern where there are none.
    origins, directions = np.empty((2, *pixels.shape, 3), np.float32)
    depth = np.empty(pixels.shape, np.float32)
    pattern = (np.float32(phase * step - np.pi), step, times, elevation, rise, offset)
    fill_image(pixels, start, direction, length, *pattern, *motion, origins, directions, depth)
    max_range_m = float(length.max(initial=0.0)) if model is None else model.max_range_m
    return BeamImage(origins, directions, depth, pixels, max_range_m, model)


def _tables(elevation: NDArray[np.float64], model: LidarModel | None) -> tuple[F32, F32, F32]:
    """Return elevation, height of the start and azimuth offset of each ring (R,)."""
    rings = len(elevation)
    if model is None or model.rings != rings:
        return elevation.astype(np.float32), np.zeros(rings, np.float32), np.zeros(rings, np.float32)
    tables = (model.elevation, model.origin_m, model.azimuth_offset)
    first, second, third = (table.astype(np.float32) for table in tables)
    return first, second, third


def _seconds(sweep: Sweep) -> F32:
    """Return the time (N,) of each return from the middle of the revolution, s; 0 if times are unknown."""
    if sweep.time_s is None or not len(sweep):
        return np.zeros(len(sweep), np.float32)
    middle = (float(sweep.time_s.min()) + float(sweep.time_s.max())) / 2
    return (sweep.time_s - np.float32(middle)).astype(np.float32)


def _undo_motion(sweep: Sweep, level_from_sensor: NDArray[np.float64], drift: Drift, seconds: F32) -> Sweep:
    """Return the sweep with each point in the sensor's frame at its firing, so that rings follow from directions."""
    if not (drift.yaw_rate or drift.velocity_mps.any()):
        return sweep
    x, y, z = (sweep.points @ level_from_sensor.T - np.outer(seconds, drift.velocity_mps)).T
    c, s = np.cos(drift.yaw_rate * seconds), np.sin(drift.yaw_rate * seconds)
    return sweep.replace(points=np.stack([c * x + s * y, c * y - s * x, z], axis=-1) @ level_from_sensor)


def _best_column_count(azimuth: F32, likely: set[int]) -> int:
    """Return the column count that firing azimuths (N,) fit best, among the likely ones and their neighbors."""
    sampled = azimuth[:: max(len(azimuth) // _SAMPLED, 1)].astype(np.float64)
    tried = sorted({columns + more for columns in likely for more in range(-_NEAR_COLUMNS, _NEAR_COLUMNS + 1)})
    fits = [abs(np.exp(1j * columns * sampled).sum()) for columns in tried]
    min_fit = _MIN_RELATIVE_FIT * max(fits)
    good = [columns for columns, fit in zip(tried, fits, strict=True) if columns in likely and fit > min_fit]
    return max(good[-1] if good else tried[int(np.argmax(fits))], 4)


def _columns(azimuth: F32, columns: int) -> tuple[NDArray[np.int64], float]:
    """Return the column (N,) of firing azimuths, and the firing phase within a column, in [0, 1).

    The phase is the circular mean of the remainders.
    """
    position = (azimuth.astype(np.float64) / (2 * np.pi) + 0.5) * columns
    turn = np.exp(2j * np.pi * position).sum() if len(position) else -1.0
    phase = round(float(np.angle(turn) / (2 * np.pi)), 6) % 1.0
    return np.floor(position - phase + 0.5).astype(np.int64) % columns, phase


def _mean_times(column: NDArray[np.int64], seconds: F32, columns: int) -> F32:
    """Return the mean time (columns,) of each column's points; an empty column takes that of the previous one."""
    total, count = np.bincount(column, seconds, columns), np.bincount(column, minlength=columns)
    last = np.maximum.accumulate(np.where(count > 0, np.arange(columns), -1))
    last[last < 0] = last[-1]
    return np.asarray(total / np.maximum(count, 1), np.float32)[last]


@njit(cache=True, nogil=True, error_model="numpy")
def beams_of_returns(
    points: Any, ring: Any, seconds: Any, turn: Any, velocity: Any, yaw_rate: Any, rise: Any, offset: Any
) -> Any:
    """Return starts (N, 3), unit directions (N, 3) in level axes, lengths (N,) and firing azimuths (N,) of beams.

    ``points`` (N, 3) are in the reference frame, with rings and times (N,). ``turn`` (3, 3) is level_from_sensor;
    velocity (3,) and yaw rate are the sensor's in level axes. ``rise`` and ``offset`` (R,) are each ring's start height
    and azimuth offset.
    """
    count = points.shape[0]
    start, direction = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    length, azimuth = np.empty(count, np.float32), np.empty(count, np.float32)
    for n in range(count):
        # Position of the sensor at the firing, and the beam's start on the sensor's axis.
        t = seconds[n]
        c, s = np.cos(yaw_rate * t), np.sin(yaw_rate * t)
        h = rise[max(ring[n], 0)]
        ox, oy, oz = turn[0, 2] * h, turn[1, 2] * h, turn[2, 2] * h
        ox, oy = c * ox - s * oy + velocity[0] * t, s * ox + c * oy + velocity[1] * t
        oz += velocity[2] * t
        # Vector from the start to the return, in level axes.
        p = points[n]
        dx = turn[0, 0] * p[0] + turn[0, 1] * p[1] + turn[0, 2] * p[2] - ox
        dy = turn[1, 0] * p[0] + turn[1, 1] * p[1] + turn[1, 2] * p[2] - oy
        dz = turn[2, 0] * p[0] + turn[2, 1] * p[1] + turn[2, 2] * p[2] - oz
        far = max(np.sqrt(dx * dx + dy * dy + dz * dz), np.float32(1e-3))
        start[n, 0], start[n, 1], start[n, 2] = ox, oy, oz
        direction[n, 0], direction[n, 1], direction[n, 2], length[n] = dx / far, dy / far, dz / far, far
        # The same vector in the rotated sensor's frame gives the firing azimuth.
        bx, by = c * dx + s * dy, c * dy - s * dx
        x = turn[0, 0] * bx + turn[1, 0] * by + turn[2, 0] * dz
        y = turn[0, 1] * bx + turn[1, 1] * by + turn[2, 1] * dz
        azimuth[n] = atan2(np.float32(y), np.float32(x)) - offset[max(ring[n], 0)]
    return start, direction, length, azimuth


@njit(cache=True, nogil=True, error_model="numpy")
def assign_pixels(ring: Any, column: Any, length: Any, pixels: Any) -> None:
    """Assign points to ``pixels`` (C, R); the nearer of two points keeps a pixel, the other takes an empty neighbor."""
    spare, spares = np.empty(ring.shape[0], np.int64), 0
    for n in range(ring.shape[0]):
        if ring[n] < 0:
            continue
        other = pixels[column[n], ring[n]]
        nearer = other < 0 or length[n] < length[other]
        if other >= 0:
            spare[spares] = other if nearer else n
            spares += 1
        if nearer:
            pixels[column[n], ring[n]] = n
    for k in range(spares):
        _assign_nearby(spare[k], column[spare[k]], ring[spare[k]], pixels)


@njit(cache=True, nogil=True, error_model="numpy")
def _assign_nearby(n: Any, column: Any, ring: Any, pixels: Any) -> None:
    for step in range(1, JITTER_COLUMNS + 1):
        for side in (-1, 1):
            c = (column + side * step) % pixels.shape[0]
            if pixels[c, ring] < 0:
                pixels[c, ring] = n
                return


@njit(cache=True, nogil=True, error_model="numpy")
def fill_image(
    pixels: Any,
    start: Any,
    direction: Any,
    length: Any,
    first: Any,
    step: Any,
    seconds: Any,
    elevation: Any,
    rise: Any,
    offset: Any,
    turn: Any,
    velocity: Any,
    yaw_rate: Any,
    origins: Any,
    directions: Any,
    depth: Any,
) -> None:
    """Fill starts, directions (C, R, 3) and depths (C, R) from the returns, and from the pattern where there is none.

    ``pixels`` (C, R) are rows of the returns; their starts, directions and lengths (N,) come from
    :func:`beams_of_returns`. The pattern is the azimuth of column 0, the step, the time of each column (C,), and each
    ring's elevation, start height and azimuth offset (R,), rotated and moved as there. A missing beam has depth 0.
    """
    for c in range(pixels.shape[0]):
        t = seconds[c]
        cos, sin = np.cos(yaw_rate * t), np.sin(yaw_rate * t)
        for r in range(pixels.shape[1]):
            n = pixels[c, r]
            if n >= 0:
                for axis in range(3):
                    origins[c, r, axis], directions[c, r, axis] = start[n, axis], direction[n, axis]
                depth[c, r] = length[n]
                continue
            # A missing beam: take the pattern, rotate it to level axes, then apply the motion.
            azimuth = first + c * step + offset[r]
            flat, z = np.cos(elevation[r]), np.sin(elevation[r])
            x, y, h = flat * np.cos(azimuth), flat * np.sin(azimuth), rise[r]
            dx = turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z
            dy = turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z
            dz = turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z
            ox, oy = turn[0, 2] * h, turn[1, 2] * h
            directions[c, r, 0], directions[c, r, 1], directions[c, r, 2] = cos * dx - sin * dy, sin * dx + cos * dy, dz
            origins[c, r, 0] = cos * ox - sin * oy + velocity[0] * t
            origins[c, r, 1] = sin * ox + cos * oy + velocity[1] * t
            origins[c, r, 2] = turn[2, 2] * h + velocity[2] * t
            depth[c, r] = np.float32(0.0)
