"""Where each beam of a sweep started and pointed, told from the sweep and its sensor's beam table alone.

A sweep of a sensor in motion has its points in one frame. Where it carries times, the motion is that of a constant
velocity and a constant turn about the world's vertical which puts the returns on the table's beams.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import rotation_from_quaternion
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

ON_BEAM_M = 0.002
"""Three quarters of the returns must lie this near to the table's beams, or the table does not tell where they are."""
_SAMPLED = 1500
_FEWEST = 50
_ROUNDS = 4


@dataclass(frozen=True, slots=True, eq=False)
class Firing:
    """When and from where each of C columns was fired, in the sensor's reference frame.

    Attributes:
        column: (N,) int32 column of each return.
        azimuth: (C,) float64 firing azimuth in radians, by the sensor's heading at that time.
        turn: (C, 3, 3) float64 rotations of the sensor against its reference.
        shift_m: (C, 3) float64 positions of the sensor.
        time_s: (C,) float32 seconds, or None where the sweep has none.
    """

    column: Ints
    azimuth: Floats
    turn: Floats
    shift_m: Floats
    time_s: NDArray[np.float32] | None = None


def at_rest(columns: int) -> tuple[Floats, Floats]:
    """Return rotations (C, 3, 3) and positions (C, 3) of a sensor that does not move."""
    return np.broadcast_to(np.eye(3), (columns, 3, 3)), np.zeros((columns, 3))


def fitted(sweep: Sweep, model: LidarModel) -> Firing | None:
    """Return the firing that explains the returns within 2 mm, or None where none does; the sweep must have rings."""
    if len(sweep) == 0 or sweep.ring is None:
        return None
    time_s = sweep.time_s
    moving = time_s is not None and float(time_s.max()) > float(time_s.min())
    firing = _in_motion(sweep, model) if moving else _still(sweep, model)
    if firing is None:
        return None
    rows = _sample(len(sweep))
    off_m = np.linalg.norm(_misses(sweep, model, firing, rows)[0], axis=1)
    return firing if float(np.quantile(off_m, 0.75)) < ON_BEAM_M else None


def directions(azimuth: Floats, elevation: Floats) -> Floats:
    """Return unit vectors (K, 3) at azimuths (K,) and elevations (K,) in radians.

    >>> directions(np.array([np.pi / 2]), np.array([0.0])).round(6).tolist()
    [[0.0, 1.0, 0.0]]
    """
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=1)


def _sample(count: int) -> NDArray[np.intp]:
    return np.arange(0, count, max(count // _SAMPLED, 1))


def _still(sweep: Sweep, model: LidarModel) -> Firing | None:
    """Columns by azimuth, with the phase that most returns share."""
    ring, columns = _rings(sweep), model.azimuth_columns
    azimuth = np.arctan2(sweep.points[:, 1], sweep.points[:, 0]).astype(np.float64)
    position = (azimuth - model.azimuth_offset[ring] + np.pi) / model.azimuth_step
    phase = float(np.angle(np.exp(2j * np.pi * position[_sample(len(sweep))]).sum())) / (2 * np.pi) % 1.0
    column = np.rint(position - phase).astype(np.int32) % columns
    time_s = None if sweep.time_s is None else np.full(columns, sweep.time_s[0], np.float32)
    return Firing(column, even_azimuths(columns, phase), *at_rest(columns), time_s)


def even_azimuths(columns: int, phase: float) -> Floats:
    """Return (columns,) float64 azimuths in radians, the first at -π and ``phase`` steps."""
    return (np.arange(columns, dtype=np.float64) + phase) * (2 * np.pi / columns) - np.pi


def _rings(sweep: Sweep) -> NDArray[np.int16]:
    return np.zeros(len(sweep), np.int16) if sweep.ring is None else sweep.ring


def _in_motion(sweep: Sweep, model: LidarModel) -> Firing | None:
    """Columns by time, then the motion about the middle of the revolution by Gauss and Newton's method."""
    step_s = _column_time_s(sweep, model.azimuth_columns)
    if step_s is None or sweep.time_s is None:
        return None
    columns = np.arange(model.azimuth_columns)
    position = sweep.time_s.astype(np.float64) / step_s
    first = float(np.median(position % 1.0))
    column = np.rint(position - first).astype(np.int32)
    if column.min() < 0 or column.max() >= len(columns) or np.abs(position - first - column).max() > 0.2:
        return None
    azimuth = even_azimuths(len(columns), 0.5)
    firing = Firing(column, azimuth, *at_rest(len(columns)), ((columns + first) * step_s).astype(np.float32))
    motion, axis = np.zeros(4), _vertical(sweep)
    for round_ in range(_ROUNDS):
        motion = motion + _correction(sweep, model, firing, axis, 3.0 if round_ == 0 else 0.05)
        firing = _moved(firing, motion, axis)
    return firing


def _column_time_s(sweep: Sweep, columns: int) -> float | None:
    """Return the time between two columns, or None where the times do not tell."""
    times = np.unique(sweep.time_s if sweep.time_s is not None else ()).astype(np.float64)
    if len(sweep) < _FEWEST or not 8 <= len(times) <= columns:
        return None
    gaps = np.diff(times)
    return float(gaps.sum() / np.rint(gaps / gaps.min()).sum())


def _vertical(sweep: Sweep) -> Floats:
    """Return the world's vertical (3,) in the sensor's frame."""
    if sweep.world_from_sensor is not None:
        vertical: Floats = sweep.world_from_sensor.rotation[2]
        return vertical
    attitude = sweep.known_attitude
    return np.array([0.0, 0.0, 1.0]) if attitude is None else rotation_from_quaternion(attitude)[2]


def _moved(firing: Firing, motion: Floats, axis: Floats) -> Firing:
    """Return the firing of a sensor with velocity ``motion[:3]`` and turn rate ``motion[3]`` about ``axis`` (3,).

    Rotations by Rodrigues' formula.
    """
    since_s = _since_middle_s(firing)
    angle = since_s * motion[3]
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn = np.eye(3) + np.sin(angle)[:, None, None] * cross + (1 - np.cos(angle))[:, None, None] * (cross @ cross)
    return Firing(firing.column, firing.azimuth, turn, np.outer(since_s, motion[:3]), firing.time_s)


def _since_middle_s(firing: Firing) -> Floats:
    if firing.time_s is None:
        return np.zeros(len(firing.azimuth))
    since_s: Floats = firing.time_s.astype(np.float64)
    since_s -= since_s.mean()
    return since_s


def _misses(sweep: Sweep, model: LidarModel, firing: Firing, rows: NDArray[np.intp]) -> tuple[Floats, Floats, Floats]:
    """Return how far returns (n,) lie beside their beams (n, 3), the beams' directions, and points from the sensor."""
    column, ring = firing.column[rows], _rings(sweep)[rows]
    turn = firing.turn[column]
    aimed = directions(firing.azimuth[column] + model.azimuth_offset[ring], model.elevation[ring])
    way = np.einsum("nij,nj->ni", turn, aimed)
    arm = sweep.points[rows] - firing.shift_m[column]
    reach = arm - turn[:, :, 2] * model.origin_m[ring][:, None]
    beside: Floats = reach - (reach * way).sum(axis=1)[:, None] * way
    return beside, way, arm.astype(np.float64)


def _correction(sweep: Sweep, model: LidarModel, firing: Firing, axis: Floats, limit_m: float) -> Floats:
    """Return the change (4,) of velocity and turn rate that brings the returns nearest to their beams."""
    rows = _sample(len(sweep))
    miss, way, arm = _misses(sweep, model, firing, rows)
    used = np.linalg.norm(miss, axis=1) < limit_m
    if used.sum() < _FEWEST:
        return np.zeros(4)
    miss, way, arm, since_s = miss[used], way[used], arm[used], _since_middle_s(firing)[firing.column[rows[used]]]
    across = np.eye(3) - way[:, :, None] * way[:, None, :]
    columns = np.concatenate([np.broadcast_to(np.eye(3), across.shape), np.cross(axis, arm)[:, :, None]], axis=2)
    slopes = (across @ columns * since_s[:, None, None]).reshape(-1, 4)
    return np.asarray(np.linalg.lstsq(slopes, miss.reshape(-1), rcond=None)[0], np.float64)
