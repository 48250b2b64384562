"""What the beams of a sensor meet in a world: exact first stops, without noise."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.sensors import LidarModel
from viewshed.sim.assets.shapes import PER_M
from viewshed.sim.lidar.firing import column_poses, still_firing, turned_by
from viewshed.sim.raycast._refine import measure_stops, turn_beams
from viewshed.sim.raycast._solids import DRAWS, cast_solids
from viewshed.sim.raycast._terrain import cast_terrain
from viewshed.sim.raycast._windows import BLOCK
from viewshed.sim.raycast.scan import STILL, Motion, Scan
from viewshed.sim.world import Snapshot


def cast_world(
    snapshot: Snapshot, model: LidarModel, world_from_sensor: Rigid, motion: Motion = STILL, seed: int = 0
) -> Scan:
    """Return what every beam of one revolution meets first, within 1e-5 of its depth.

    Every solid and every triangle of the ground is tested against those beams that point at its bounding box, in
    single precision; the stop is then measured again in double precision.

    Args:
        snapshot: the solids and the ground, in the world frame, at the middle of the revolution.
        model: the sensor.
        world_from_sensor: pose of the sensor at the middle of the revolution.
        motion: how it moves about that pose.
        seed: draws where beams stop in leaves, mesh and glass, for each beam and solid.
    """
    turns, starts, time_s = _moves(model, motion, world_from_sensor)
    direction, origin = np.empty((2, model.azimuth_columns, model.rings, 3), np.float32)
    beams = _blocks(model)
    rows = tuple(beams)
    turn_beams(still_firing(model)[1], turns, starts, time_s, (direction, origin), rows)
    best = (np.full(beams.shape[1], np.inf, np.float32), np.full(beams.shape[1], -1, np.int32))
    solids, lattice = _relative(snapshot, world_from_sensor.translation, seed)
    frame = _frame(model, world_from_sensor, motion)
    cast_solids(rows, solids[:4], frame, _free_paths(), best)
    cast_terrain(rows, lattice, frame, best, len(snapshot.kind))
    out = _stops(model)
    ground = (lattice, snapshot.terrain.material, _free_paths(), model.max_range_m)
    measure_stops((origin, direction), time_s, solids, ground, best, out)
    return Scan(model, world_from_sensor, motion, time_s, origin, direction, *out)


def _stops(model: LidarModel) -> tuple[NDArray[Any], ...]:
    shape = (model.azimuth_columns, model.rings)
    return tuple(np.empty(shape, dtype) for dtype in (np.float32, np.int32, np.uint8, np.float32))


def _blocks(model: LidarModel) -> NDArray[np.float32]:
    """Return room for x, y, z, rise and time of every beam; those that fill up the last block point up."""
    blocks = -(-model.rings // BLOCK)
    beams = np.empty((5, blocks * model.azimuth_columns * BLOCK), np.float32)
    if model.rings % BLOCK:
        beams[:, (blocks - 1) * model.azimuth_columns * BLOCK :] = np.array([[0], [0], [1], [0], [0]], np.float32)
    return beams


def _moves(model: LidarModel, motion: Motion, pose: Rigid) -> tuple[NDArray[np.float32], Any, NDArray[np.float32]]:
    """Return ``world_from_sensor`` (C, 3, 3), shifts of the columns (C, 3) with rises of the rings (R,), times (C,)."""
    turns, _, time_s = column_poses(model, motion, pose)
    shifts = np.outer(time_s, motion.velocity_mps).astype(np.float32)
    return turned_by(pose.rotation, turns).astype(np.float32), (shifts, still_firing(model)[0]), time_s


@lru_cache(maxsize=1)
def _free_paths() -> NDArray[np.float32]:
    """Return the quantiles of an exponential distribution of mean 1."""
    return (-np.log1p(-(np.arange(DRAWS) + 0.5) / DRAWS)).astype(np.float32)


def _relative(snapshot: Snapshot, origin: NDArray[np.float64], seed: int) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Return the solids and the ground's nodes from the sensor's position."""
    count = len(snapshot.kind)
    salts = np.random.Generator(np.random.PCG64(seed)).integers(0, 2**32, count, np.uint32)
    boxes = np.empty((count, 6, 3))
    boxes[:, 0], boxes[:, 1:4] = snapshot.center_m - origin, snapshot.rotation
    boxes[:, 4], boxes[:, 5] = snapshot.half_m, snapshot.velocity_mps
    solids = (boxes, snapshot.kind, PER_M[snapshot.material], salts, snapshot.thing, snapshot.material)
    ground = snapshot.terrain
    return solids, (ground.x_m - origin[0], ground.y_m - origin[1], ground.heights_m - origin[2])


def _frame(model: LidarModel, pose: Rigid, motion: Motion) -> tuple[Any, ...]:
    swing = abs(motion.yaw_rate) * motion.period_s / 2
    sweep = (model.azimuth_step, float(model.azimuth_offset.min()) - swing, float(model.azimuth_offset.max()) + swing)
    tilt = float(np.hypot(pose.rotation[2, 0], pose.rotation[2, 1]))
    lift = float(np.abs(model.origin_m).max())
    limits = (model.azimuth_columns, model.max_range_m, motion.period_s / 2, lift, 2.0 * swing * tilt)
    return pose.rotation, sweep, np.tan(model.elevation), limits, np.asarray(motion.velocity_mps, np.float64)
