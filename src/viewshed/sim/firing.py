"""Where the beams of one revolution start and point, with and without rolling shutter."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.sensors import LidarModel
from viewshed.sim.scan import Motion

Floats = NDArray[np.float32]


def firing(model: LidarModel, motion: Motion, world_from_sensor: Rigid) -> tuple[Floats, Floats, Floats]:
    """Return starts (C, R, 3), unit directions (C, R, 3) in the sensor's reference frame, and times (C,) in seconds.

    Column c fires at azimuth -π + (c + 1/2) · ``model.azimuth_step``, at time (c + 1/2) / C - 1/2 of the period from
    the reference. Positions are metres; the arrays are read-only and shared.
    """
    origin, direction, phase = _still(model)
    if motion.period_s == 0.0:
        return origin, direction, _frozen(np.zeros_like(phase))
    time_s = phase * np.float32(motion.period_s)
    rotation = world_from_sensor.rotation
    shift = np.outer(time_s, np.asarray(motion.velocity_mps) @ rotation)
    if motion.yaw_rate != 0.0:
        turns = _turned(rotation, time_s * motion.yaw_rate)
        origin, direction = origin @ turns, direction @ turns
    moved = (origin + shift[:, None, :]).astype(np.float32)
    return _frozen(moved), _frozen(np.ascontiguousarray(direction, dtype=np.float32)), _frozen(time_s)


def _turned(rotation: NDArray[np.float64], angle: NDArray[np.float32]) -> Floats:
    """Return (C, 3, 3) transposed rotations by ``angle`` about the world's z, in the sensor's axes."""
    c, s = np.cos(angle.astype(np.float64)), np.sin(angle.astype(np.float64))
    turns = np.zeros((len(angle), 3, 3))
    turns[:, 0, 0], turns[:, 1, 1], turns[:, 1, 0], turns[:, 0, 1], turns[:, 2, 2] = c, c, s, -s, 1.0
    return np.transpose(rotation.T @ turns @ rotation, (0, 2, 1)).astype(np.float32)


@lru_cache(maxsize=32)
def _still(model: LidarModel) -> tuple[Floats, Floats, Floats]:
    columns = np.arange(model.azimuth_columns) + 0.5
    azimuth = (-np.pi + columns * model.azimuth_step)[:, None] + model.azimuth_offset[None, :]
    flat = np.cos(model.elevation)[None, :]
    upward = np.broadcast_to(np.sin(model.elevation)[None, :], azimuth.shape)
    direction = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), upward], axis=-1)
    origin = np.zeros(direction.shape)
    origin[..., 2] = model.origin_m[None, :]
    phase = columns / model.azimuth_columns - 0.5
    return _frozen(origin.astype(np.float32)), _frozen(direction.astype(np.float32)), _frozen(phase.astype(np.float32))


def _frozen(array: Floats) -> Floats:
    array.setflags(write=False)
    return array
