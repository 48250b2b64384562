"""Ray caster: exact first hits of a sensor's beams in a world, without noise."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.sensors import LidarModel
from viewshed_lab.sim.assets.shapes import GLOSS, PER_M
from viewshed_lab.sim.lidar.firing import column_poses, still_firing, turned_by
from viewshed_lab.sim.raycast._loops import (
    BLOCK,
    DRAWS,
    Beams,
    Ground,
    Nearest,
    Solids,
    View,
    cast_solids,
    cast_terrain,
    measure_stops,
    turn_beams,
)
from viewshed_lab.sim.raycast.scan import STILL, ExactScan, Motion
from viewshed_lab.sim.world import NOTHING, Snapshot


def cast_world(
    snapshot: Snapshot, model: LidarModel, world_from_sensor: Rigid, motion: Motion = STILL, seed: int = 0
) -> ExactScan:
    """Return the first hit of every beam of one revolution; depths have a relative error of at most 1e-5.

    Every solid and every triangle of the ground is tested in single precision against the beams that point at its
    bounding box; hits are then recomputed in double precision.

    Args:
        snapshot: solids and ground, in the world frame, at the middle of the revolution.
        model: the sensor.
        world_from_sensor: pose of the sensor at the middle of the revolution.
        motion: motion of the sensor around that pose.
        seed: for the free paths in leaves, mesh and glass, per beam and solid.
    """
    # 1. The beams of the revolution in world axes, with the motion of each column.
    turns, _, time_s = column_poses(model, motion, world_from_sensor)
    turns = turned_by(world_from_sensor.rotation, turns).astype(np.float32)
    shifts_m = np.outer(time_s, motion.velocity_mps).astype(np.float32)
    rises_m, still, _ = still_firing(model)
    direction, origin = np.empty((2, model.azimuth_columns, model.rings, 3), np.float32)
    beams = _empty_beams(model)
    turn_beams(still, turns, shifts_m, rises_m, time_s, direction, origin, beams)
    # 2. The nearest hit of each beam, in single precision.
    count = len(beams.x)
    nearest = Nearest(np.full(count, np.inf, np.float32), np.full(count, -1, np.int32))
    solids = _solids(snapshot, world_from_sensor.translation, seed)
    terrain, (x, y, z) = snapshot.terrain, world_from_sensor.translation
    ground = Ground(terrain.x_m - x, terrain.y_m - y, terrain.heights_m - z, terrain.material)
    view = _view(model, world_from_sensor, motion)
    cast_solids(beams, solids, view, _free_paths(), nearest)
    cast_terrain(beams, ground, view, nearest, len(snapshot.kind))
    # 3. The same hits in double precision, with thing, material and incidence.
    shape = (model.azimuth_columns, model.rings)
    depth, thing = np.empty(shape, np.float32), np.empty(shape, np.int32)
    material, cosine = np.empty(shape, np.uint8), np.empty(shape, np.float32)
    measure_stops(
        origin, direction, time_s, solids, ground, _planes(ground), _free_paths(), GLOSS, model.max_range_m, nearest,
        depth, thing, material, cosine,
    )  # fmt: skip
    if model.fired is not None:
        not_fired = ~model.fired
        depth[not_fired], thing[not_fired], material[not_fired], cosine[not_fired] = np.inf, NOTHING, 0, 0.0
    return ExactScan(model, world_from_sensor, motion, time_s, origin, direction, depth, thing, material, cosine)


def _empty_beams(model: LidarModel) -> Beams:
    """Return arrays for all beams; the padding beams of the last block point up."""
    blocks = -(-model.rings // BLOCK)
    beams = np.empty((5, blocks * model.azimuth_columns * BLOCK), np.float32)
    if model.rings % BLOCK:
        beams[:, (blocks - 1) * model.azimuth_columns * BLOCK :] = np.array([[0], [0], [1], [0], [0]], np.float32)
    return Beams(*beams)


@lru_cache(maxsize=1)
def _free_paths() -> NDArray[np.float32]:
    """Return the quantiles (DRAWS,) of an exponential distribution of mean 1."""
    return (-np.log1p(-(np.arange(DRAWS) + 0.5) / DRAWS)).astype(np.float32)


def _solids(snapshot: Snapshot, origin: NDArray[np.float64], seed: int) -> Solids:
    """Return the solids relative to the sensor's position (3,), with salts from the seed."""
    count = len(snapshot.kind)
    salts = np.random.Generator(np.random.PCG64(seed)).integers(0, 2**32, count, np.uint32)
    boxes = np.empty((count, 6, 3))
    boxes[:, 0], boxes[:, 1:4] = snapshot.center_m - origin, snapshot.rotation
    boxes[:, 4], boxes[:, 5] = snapshot.half_m, snapshot.velocity_mps
    return Solids(boxes, snapshot.kind, PER_M[snapshot.material], salts, snapshot.thing, snapshot.material)


def _planes(ground: Ground) -> NDArray[np.float64]:
    """Return a, b and c of z = a x + b y + c, and 1 / length of the normal, for every triangle (T, 4)."""
    x, y, z = ground.x, ground.y, ground.z
    along, across = np.diff(z, axis=0) / np.diff(x)[:, None], np.diff(z, axis=1) / np.diff(y)
    a, b = np.stack([along[:, :-1], along[:, 1:]], axis=-1), np.stack([across[1:], across[:-1]], axis=-1)
    c = z[:-1, :-1, None] - a * x[:-1, None, None] - b * y[:-1, None]
    return np.stack([a, b, c, 1.0 / np.sqrt(1.0 + a * a + b * b)], axis=-1).reshape(-1, 4)


def _view(model: LidarModel, pose: Rigid, motion: Motion) -> View:
    """Return the sensor's parameters that determine the windows of the caster."""
    swing = abs(motion.yaw_rate) * motion.period_s / 2
    tilt = float(np.hypot(pose.rotation[2, 0], pose.rotation[2, 1]))
    low_offset, high_offset, slack = _spread_of_shots(model)
    return View(
        rotation=pose.rotation,
        step=model.azimuth_step,
        low_offset=low_offset - swing,
        high_offset=high_offset + swing,
        slopes=np.tan(model.elevation),
        columns=model.azimuth_columns,
        max_range_m=model.max_range_m,
        half_period_s=motion.period_s / 2,
        lift_m=float(np.abs(model.origin_m).max()),
        slack=2.0 * swing * tilt + slack,
        velocity=np.asarray(motion.velocity_mps, np.float64),
    )


@lru_cache(maxsize=32)
def _spread_of_shots(model: LidarModel) -> tuple[float, float, float]:
    """Return the smallest and largest azimuth offset of a shot from its column, and the largest slope offset."""
    if model.shots is None:
        return float(model.azimuth_offset.min()), float(model.azimuth_offset.max()), 0.0
    columns = -np.pi + (np.arange(model.azimuth_columns) + 0.5) * model.azimuth_step
    offset = (model.shots[..., 0] - columns[:, None] + np.pi) % (2 * np.pi) - np.pi
    slack = np.nanmax(np.abs(np.tan(model.shots[..., 1]) - np.tan(model.elevation)))
    return float(np.nanmin(offset)), float(np.nanmax(offset)), float(slack)
