"""Where the beams of one revolution start and point, with and without rolling shutter."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed.arrays import F32
from viewshed.geometry import Rigid
from viewshed.sensors import LidarModel
from viewshed_lab.sim.raycast.scan import Motion


def firing(model: LidarModel, motion: Motion, world_from_sensor: Rigid) -> tuple[F32, F32, F32]:
    """Return starts (C, R, 3), unit directions (C, R, 3) in the sensor's reference frame, and times (C,) in seconds.

    Column c fires at azimuth -π + (c + 1/2) · ``model.azimuth_step``, or as ``model.shots`` says, at time
    (c + 1/2) / C - 1/2 of the period from the reference. A shot that is not fired points straight up. Positions are
    meters; the arrays are read-only and shared.
    """
    start_m, direction, _ = still_firing(model)
    turn, shift_m, time_s = column_poses(model, motion, world_from_sensor)
    if motion.period_s == 0.0:
        return _still_starts(model), direction, time_s
    starts, turned = np.empty_like(direction), np.empty_like(direction)
    _fire(start_m, direction, turn, shift_m, starts, turned)
    return _frozen(starts), _frozen(turned), time_s


def still_firing(model: LidarModel) -> tuple[F32, F32, F32]:
    """Return heights (R,) of the starts, unit directions (C, R, 3), and phase (C,) in [-1/2, 1/2), read-only, shared.

    All in the sensor's frame at the time of firing.
    """
    return _still(model)


def column_poses(model: LidarModel, motion: Motion, world_from_sensor: Rigid) -> tuple[F32, F32, F32]:
    """Return where the sensor is when each column fires, in its reference frame, read-only.

    Rotations (C, 3, 3), positions (C, 3) in meters and times (C,) in seconds.
    """
    phase = _still(model)[2]
    if motion.period_s == 0.0:
        return _at_rest(len(phase))
    time_s = phase * np.float32(motion.period_s)
    rotation = world_from_sensor.rotation
    shift_m = np.outer(time_s, np.asarray(motion.velocity_mps) @ rotation).astype(np.float32)
    if motion.yaw_rate == 0.0:
        return _at_rest(len(phase))[0], _frozen(shift_m), _frozen(time_s)
    angle = time_s.astype(np.float64) * motion.yaw_rate
    turns = np.zeros((len(angle), 3, 3))
    turns[:, 0, 0] = turns[:, 1, 1] = np.cos(angle)
    turns[:, 1, 0] = np.sin(angle)
    turns[:, 0, 1], turns[:, 2, 2] = -turns[:, 1, 0], 1.0
    turned = (turned_by(rotation.T, turns).reshape(-1, 3) @ rotation).reshape(turns.shape)
    return _frozen(turned.astype(np.float32)), _frozen(shift_m), _frozen(time_s)


def turned_by(rotation: NDArray[np.float64], matrices: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return ``rotation @ matrices`` (C, 3, 3) as one product instead of C small ones."""
    columns = matrices.transpose(1, 0, 2).reshape(3, -1)
    return np.ascontiguousarray((rotation @ columns).reshape(3, -1, 3).transpose(1, 0, 2))


@njit(cache=True, nogil=True, error_model="numpy")
def _fire(start_m: Any, direction: Any, turn: Any, shift_m: Any, starts: Any, turned: Any) -> None:
    for c in range(direction.shape[0]):
        for r in range(direction.shape[1]):
            x, y, z, up = direction[c, r, 0], direction[c, r, 1], direction[c, r, 2], start_m[r]
            for axis in range(3):
                turned[c, r, axis] = turn[c, axis, 0] * x + turn[c, axis, 1] * y + turn[c, axis, 2] * z
                starts[c, r, axis] = turn[c, axis, 2] * up + shift_m[c, axis]


@lru_cache(maxsize=32)
def _still(model: LidarModel) -> tuple[F32, F32, F32]:
    columns = np.arange(model.azimuth_columns) + 0.5
    azimuth = (-np.pi + columns * model.azimuth_step)[:, None] + model.azimuth_offset[None, :]
    elevation = model.elevation[None, :]
    if model.shots is not None:
        azimuth = np.nan_to_num(model.shots[..., 0], nan=0.0)
        elevation = np.nan_to_num(model.shots[..., 1], nan=np.pi / 2)
    flat = np.cos(elevation)
    upward = np.broadcast_to(np.sin(elevation), azimuth.shape)
    direction = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), upward], axis=-1).astype(np.float32)
    phase = columns / model.azimuth_columns - 0.5
    return _frozen(model.origin_m.astype(np.float32)), _frozen(direction), _frozen(phase.astype(np.float32))


@lru_cache(maxsize=32)
def _still_starts(model: LidarModel) -> F32:
    starts = np.zeros((model.azimuth_columns, model.rings, 3), np.float32)
    starts[..., 2] = model.origin_m
    return _frozen(starts)


@lru_cache(maxsize=32)
def _at_rest(columns: int) -> tuple[F32, F32, F32]:
    turn = np.broadcast_to(np.eye(3, dtype=np.float32), (columns, 3, 3)).copy()
    return _frozen(turn), _frozen(np.zeros((columns, 3), np.float32)), _frozen(np.zeros(columns, np.float32))


def _frozen(array: F32) -> F32:
    array.setflags(write=False)
    return array
