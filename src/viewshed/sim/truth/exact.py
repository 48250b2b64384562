"""Exact truth: which cells a sensor could see, counted on the beams of a scan without noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.truth import OTHER_DEFINITIONS, Truth
from viewshed.fov.visibility import CAR, PEDESTRIAN, Target
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.sim.assets.shapes import REFLECTIVITY, Shape
from viewshed.sim.raycast.scan import ExactScan
from viewshed.sim.terrain import Terrain
from viewshed.sim.truth.beam_lines import BeamLines, stops_on_surfaces
from viewshed.sim.truth.count import BELOW_GROUND_M, MANY, count_targets, ranges_of, states_of_cells
from viewshed.sim.truth.definitions import (
    BLOCKS,
    batches_of,
    beams_of_bins,
    definition_masks,
    see_cells,
    stop_flags,
    stop_limits,
)
from viewshed.sim.world import DECK, GROUND, Agent, World

SURFACE_FROM_M = 0.2
"""Stops on things from this height above local ground on make a cell a surface."""

MAX_BINS = 1080
"""Azimuth bins of the other definitions, at most; less where the sensor has fewer columns."""

Mask = NDArray[np.bool_]

CountsByTarget = dict[str, NDArray[np.uint8]]


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """A scan over a grid, in the axes of the grid, seen from the sensor's reference position.

    Attributes:
        scan: the scan.
        grid: the grid.
        lines: the beams.
        flags: (C·R,) uint8 what stopped them, see :func:`viewshed.sim.truth.definitions.stop_flags`.
        ground: (cells²,) float32 z at the centers of the cells.
    """

    scan: ExactScan
    grid: BevGrid
    lines: BeamLines
    flags: NDArray[np.uint8]
    ground: NDArray[np.float32]


def exact_truth(
    scan: ExactScan,
    world: World | Terrain,
    grid: BevGrid,
    targets: tuple[Target, ...] = (CAR, PEDESTRIAN),
    agent: Agent | None = None,
) -> tuple[Truth, Mask]:
    """Return the truth of a scan on ``grid``, and where it is known (cells, cells).

    For a cell whose center lies at horizontal range r from the sensor, the target is an upright plate of its width and
    height through the center, across the line of sight, on the ground there. A beam *aims* at it if it crosses it, and
    *reaches* it if it stops no more than a cell's side before it, measured along the line of sight. ``docs/truth.md``
    defines the states and the other definitions.

    Args:
        scan: what every beam met.
        world: where it was made, or its ground. In a world with several levels the ground is that of ``agent``.
        grid: where the cells are, in the ``level`` frame of the scan.
        targets: what would have to be seen.
        agent: who scanned. Cells that its own vehicle covers are not known, and its own body blocks no bin.
    """
    if not targets:
        raise ValueError("targets must be at least one, got none")
    terrain = world.ground_of(agent) if isinstance(world, World) else world
    if isinstance(world, World) and terrain is world.upper:
        scan = _with_decks_as_ground(scan, world)
    ground, known = _ground(scan, terrain, grid)
    view = _view(scan, grid, ground, -3 if agent is None or agent.carrier is None else agent.carrier)
    known &= (ranges_of(grid) > view.lines.offset_m).reshape(grid.shape)
    if agent is not None and agent.carrier is not None and isinstance(world, World):
        known &= ~_covered(world.things[agent.carrier].parts, scan.world_from_sensor @ agent.mount.inverse(), view)
    reached, state = _targets(view, targets)
    shape = grid.shape
    truth = Truth(
        grid,
        {name: count.reshape(shape) for name, count in reached.items()},
        {name: values.reshape(shape) for name, values in state.items()},
        {name: mask.reshape(shape) for name, mask in _definitions(view).items()},
    )
    return truth, known


def _with_decks_as_ground(scan: ExactScan, world: World) -> ExactScan:
    """Return the scan with the decks as ground: to those on the upper level they are that."""
    decks = [k for k, one in enumerate(world.things) if one.kind == DECK]
    return replace(scan, thing=np.where(np.isin(scan.thing, decks), np.int32(GROUND), scan.thing))


def _ground(scan: ExactScan, terrain: Terrain, grid: BevGrid) -> tuple[NDArray[np.float32], Mask]:
    """Return the ground (cells, cells) at the centers, from the sensor's height, and where there is terrain."""
    centers = grid.centers
    return terrain.about(scan.world_from_sensor, centers[:, 0, 0].copy(), centers[0, :, 1].copy())


def _view(scan: ExactScan, grid: BevGrid, ground: NDArray[np.float32], vehicle: int) -> _View:
    """Return the scan over the grid; ``vehicle`` is the thing that carries the sensor, or a number of none."""
    max_range_m, yaw = scan.model.max_range_m, scan.world_from_sensor.yaw
    lines = BeamLines.of(scan.origin_m, scan.direction, scan.depth_m, max_range_m, yaw)
    flags = stop_flags(scan.depth_m, scan.thing, scan.material, vehicle, REFLECTIVITY)
    return _View(scan, grid, lines, flags, ground.reshape(-1))


def _targets(view: _View, targets: tuple[Target, ...]) -> tuple[CountsByTarget, CountsByTarget]:
    """Return beams that reach, up to 255, and states (cells²,) by target; two targets at a time."""
    tops = np.array([target.height_m for target in targets], np.float32)
    surfaces = stops_on_surfaces(view.lines, view.flags & BLOCKS, view.ground, view.grid, SURFACE_FROM_M, tops)
    surface = dict(zip((target.name for target in targets), surfaces, strict=True))
    reached, state = {}, {}
    for k in range(0, len(targets), 2):
        both = (targets[k], targets[min(k + 1, len(targets) - 1)])
        pair, counts = count_targets(view.lines, view.grid, view.ground, both)
        for which, target in enumerate(pair):
            out = np.empty((2, len(counts)), np.uint8)
            states_of_cells(counts, which, surface[target.name], min(target.min_returns, MANY), out)
            reached[target.name], state[target.name] = out
    return reached, state


def _definitions(view: _View) -> dict[str, Mask]:
    """Return the masks (cells,) of the definitions that others use."""
    model = view.scan.model
    bins = min(model.azimuth_columns, MAX_BINS)
    limits = stop_limits(view.lines.lines, view.flags, bins)
    table = beams_of_bins(view.lines.lines, view.lines.azimuth, view.flags, model.rings, bins)
    seen = np.empty(len(view.ground), np.uint8)
    high, below, cell = (np.float32(length) for length in (CAR.height_m, BELOW_GROUND_M, view.grid.cell_m))
    see_cells(limits, table, batches_of(view.grid, bins), view.ground, high, below, cell, seen)
    out = np.empty((len(OTHER_DEFINITIONS), len(seen)), np.bool_)
    definition_masks(seen, out)
    return dict(zip(OTHER_DEFINITIONS, out, strict=True))


def _covered(parts: tuple[Shape, ...], world_from_thing: Rigid, view: _View) -> Mask:
    """Return which cells (cells, cells) the upright box around a thing's solids touches."""
    grid, pose = view.grid, view.scan.world_from_sensor
    low, high = (corner + side * grid.cell_m / 2 for corner, side in zip(_footprint(parts), (-1, 1), strict=True))
    away = float(np.linalg.norm(world_from_thing.translation - pose.translation))
    near = np.flatnonzero(ranges_of(grid) <= away + np.abs([low, high]).sum())
    x, y = grid.centers.reshape(-1, 2)[near].T
    c, s = np.cos(pose.yaw), np.sin(pose.yaw)
    position = np.stack([c * x - s * y + pose.translation[0], s * x + c * y + pose.translation[1]], axis=-1)
    position = (position - world_from_thing.translation[:2]) @ Rigid.from_yaw(world_from_thing.yaw).rotation[:2, :2]
    covered = np.zeros(grid.shape, np.bool_)
    covered.reshape(-1)[near] = ((position >= low) & (position <= high)).all(axis=1)
    return covered


@lru_cache(maxsize=64)
def _footprint(parts: tuple[Shape, ...]) -> NDArray[np.float64]:
    """Return the least and the largest x and y (2, 2) of a thing's solids, in its frame."""
    corners = np.concatenate([_corners(part) for part in parts])
    return np.stack([corners.min(axis=0), corners.max(axis=0)])


def _corners(part: Shape) -> NDArray[np.float64]:
    """Return x and y (4, 2) of the corners of a solid's footprint, in the frame of its thing."""
    length, width = part.half_sizes_m[:2]
    c, s = np.cos(part.yaw), np.sin(part.yaw)
    signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    return np.asarray((signs * [length, width]) @ np.array([[c, s], [-s, c]]) + [part.x_m, part.y_m])
