"""Exact truth: the cells that a sensor can see, counted on the beams of a noise-free scan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import Mask
from viewshed.fov.truth import OTHER_DEFINITIONS, Truth
from viewshed.fov.visibility import CAR, PEDESTRIAN, Target
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.sensors import LidarModel
from viewshed_lab.sim.assets.shapes import REFLECTIVITY
from viewshed_lab.sim.assets.street import extent
from viewshed_lab.sim.raycast.scan import ExactScan
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.truth.beam_lines import BeamLines
from viewshed_lab.sim.truth.count import BELOW_GROUND_M, ranges_of, reached_and_states
from viewshed_lab.sim.truth.definitions import (
    BLOCKER,
    BLOCKS,
    FARTHEST,
    SIGHT,
    batches_of,
    beams_of_bins,
    see_cells,
    stop_flags,
    stop_limits,
)
from viewshed_lab.sim.world import DECK, GROUND, Agent, Thing, World

MAX_BINS = 1080
"""Largest number of azimuth bins of the other definitions; the number of columns if that is smaller."""


def exact_truth(
    scan: ExactScan,
    world: World | Terrain,
    grid: BevGrid,
    targets: tuple[Target, ...] = (CAR, PEDESTRIAN),
    agent: Agent | None = None,
) -> tuple[Truth, Mask]:
    """Return the truth of a scan on ``grid``, and the mask (cells, cells) bool where it is known.

    The target of a cell is an upright plate of the target's width and height through the cell's center, perpendicular
    to the line of sight, on the ground there. A beam *aims* at the plate if it crosses it, and *reaches* it if it ends
    no more than a cell's side before it, measured along the line of sight. It may cross up to 2 cm below the ground of
    the center, as at a crown of 2 %. A beam without a hit ends at the maximum range.

    FREE: at least ``min_returns`` beams reach. SURFACE: the same, and a hit on a thing lies in the cell, from 0.2 m
    above its ground up to the target's top. HIDDEN: enough beams aim, fewer reach. UNKNOWN: fewer aim. The truth is not
    known for cells outside the terrain, closer than the sensor moves within the revolution, and of the own vehicle.

    Args:
        scan: exact hits of the beams.
        world: the scanned world, or its ground. In a world with several levels the ground is that of ``agent``.
        grid: of the truth, in the ``level`` frame of the scan.
        targets: object types whose visibility is determined.
        agent: the scanning agent. Cells that its vehicle covers are not known, and its vehicle blocks no bin.
    """
    if not targets:
        raise ValueError("targets must be at least one, got none")
    terrain = world.ground_of(agent) if isinstance(world, World) else world
    if isinstance(world, World) and terrain is world.upper:
        decks = [k for k, one in enumerate(world.things) if one.kind == DECK]  # the upper level's ground
        scan = replace(scan, thing=np.where(np.isin(scan.thing, decks), np.int32(GROUND), scan.thing))
    centers = grid.centers
    ground, known = terrain.about(scan.world_from_sensor, centers[:, 0, 0].copy(), centers[0, :, 1].copy())
    ground, pose, vehicle = ground.reshape(-1), scan.world_from_sensor, None if agent is None else agent.carrier
    # The beams as lines in the axes of the grid, and their flags; no thing has the index -3.
    lines = BeamLines.of(scan.origin_m, scan.direction, scan.depth_m, scan.model.max_range_m, pose.yaw)
    flags = stop_flags(scan.depth_m, scan.thing, scan.material, -3 if vehicle is None else vehicle, REFLECTIVITY)
    known &= (ranges_of(grid) > lines.offset_m).reshape(grid.shape)
    if agent is not None and vehicle is not None and isinstance(world, World):
        known &= ~_covered(world.things[vehicle], pose @ agent.mount.inverse(), grid, pose)
    reached, state = reached_and_states(lines, flags & BLOCKS, ground, grid, targets)
    return Truth(grid, reached, state, _definitions(lines, flags, ground, grid, scan.model)), known


def _definitions(
    lines: BeamLines, flags: NDArray[np.uint8], ground: NDArray[np.float32], grid: BevGrid, model: LidarModel
) -> dict[str, Mask]:
    """Return the masks (cells, cells) of the other definitions of visibility."""
    bins = min(model.azimuth_columns, MAX_BINS)
    limits = stop_limits(lines.lines, flags, bins)
    table = beams_of_bins(lines.lines, lines.azimuth, flags, model.rings, bins)
    seen = np.empty(grid.shape, np.uint8)
    high, below, cell = (np.float32(length) for length in (CAR.height_m, BELOW_GROUND_M, grid.cell_m))
    see_cells(limits, table, batches_of(grid, bins), ground, high, below, cell, seen.reshape(-1))
    return {name: seen & flag != 0 for name, flag in zip(OTHER_DEFINITIONS, (FARTHEST, BLOCKER, SIGHT), strict=True)}


def _covered(vehicle: Thing, world_from_thing: Rigid, grid: BevGrid, pose: Rigid) -> Mask:
    """Return the cells (cells, cells) of a grid at ``pose`` that the upright bounding box of a thing touches."""
    rear, front, right, left = extent(vehicle, np.inf)
    low, high = np.array([rear, right]) - grid.cell_m / 2, np.array([front, left]) + grid.cell_m / 2
    distance_m = float(np.linalg.norm(world_from_thing.translation - pose.translation))
    near = np.flatnonzero(ranges_of(grid) <= distance_m + np.abs([low, high]).sum())
    x, y = grid.centers.reshape(-1, 2)[near].T
    c, s = np.cos(pose.yaw), np.sin(pose.yaw)
    position = np.stack([c * x - s * y + pose.translation[0], s * x + c * y + pose.translation[1]], axis=-1)
    c, s = np.cos(world_from_thing.yaw), np.sin(world_from_thing.yaw)
    position = (position - world_from_thing.translation[:2]) @ np.array([[c, -s], [s, c]])
    covered = np.zeros(grid.shape, np.bool_)
    covered.reshape(-1)[near] = ((position >= low) & (position <= high)).all(axis=1)
    return covered
