"""Starts and directions of the beams of one revolution, with and without rolling shutter."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F32
from viewshed.geometry import Rigid
from viewshed.sensors import LidarModel
from viewshed_lab.sim.raycast.scan import Motion
from viewshed_lab.sim.world import turns_of


@lru_cache(maxsize=32)
def still_firing(model: LidarModel) -> tuple[F32, F32, F32]:
    """Return start heights (R,), unit directions (C, R, 3), phases (C,) in [-1/2, 1/2); arrays are shared, read-only.

    All in the sensor's frame at the time of firing. Column c fires at azimuth -π + (c + 1/2) · ``model.azimuth_step``,
    or according to ``model.shots``. A shot that is not fired points straight up.
    """
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


def column_poses(model: LidarModel, motion: Motion, world_from_sensor: Rigid) -> tuple[F32, F32, F32]:
    """Return the sensor's pose at the firing of each column, in its reference frame; arrays are read-only.

    Rotations (C, 3, 3), positions (C, 3) in meters, times (C,) in seconds. Column c fires (c + 1/2) / C - 1/2 periods
    after the reference.
    """
    phase = still_firing(model)[2]
    if motion.period_s == 0.0:
        return _at_rest(len(phase))
    time_s = phase * np.float32(motion.period_s)
    rotation = world_from_sensor.rotation
    shift_m = np.outer(time_s, np.asarray(motion.velocity_mps) @ rotation).astype(np.float32)
    if motion.yaw_rate == 0.0:
        return _at_rest(len(phase))[0], _frozen(shift_m), _frozen(time_s)
    turns = turns_of(time_s.astype(np.float64) * motion.yaw_rate)
    turned = (turned_by(rotation.T, turns).reshape(-1, 3) @ rotation).reshape(turns.shape)
    return _frozen(turned.astype(np.float32)), _frozen(shift_m), _frozen(time_s)


def turned_by(rotation: NDArray[np.float64], matrices: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Return ``rotation @ matrices`` (C, 3, 3), computed as one large product."""
    columns = matrices.transpose(1, 0, 2).reshape(3, -1)
    return np.ascontiguousarray((rotation @ columns).reshape(3, -1, 3).transpose(1, 0, 2))


@lru_cache(maxsize=32)
def _at_rest(columns: int) -> tuple[F32, F32, F32]:
    turn = np.broadcast_to(np.eye(3, dtype=np.float32), (columns, 3, 3)).copy()
    return _frozen(turn), _frozen(np.zeros((columns, 3), np.float32)), _frozen(np.zeros(columns, np.float32))


def _frozen(array: F32) -> F32:
    array.setflags(write=False)
    return array
