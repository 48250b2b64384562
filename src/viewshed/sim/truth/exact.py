"""Exact truth: which cells a sensor could see, counted on the beams of a scan without noise.

The cells of a grid in the orders in which the loops of the exact truth take them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.truth import OTHER_DEFINITIONS, Truth
from viewshed.fov.visibility import CAR, PEDESTRIAN, Target
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid, polar_of_cells
from viewshed.sim.assets.shapes import REFLECTIVITY, Shape
from viewshed.sim.raycast.scan import Scan
from viewshed.sim.terrain import Terrain
from viewshed.sim.truth._azimuth_bins import (
    BLOCKS,
    beams_of_bins,
    definition_masks,
    see_cells,
    stop_flags,
    stop_limits,
)
from viewshed.sim.truth._azimuth_bins import LANES as COLUMNS
from viewshed.sim.truth._beams import LANES, beam_lines, mark_stops, slope_bounds, sorted_tiles
from viewshed.sim.truth._counts import MANY, count_cells, states_of_cells
from viewshed.sim.world import Agent, World

_SIDE = 4

_ROUNDING = 1e-6

Floats = NDArray[np.float32]

Places = NDArray[np.int32]


@lru_cache(maxsize=2)
def ranges_of(grid: BevGrid) -> Floats:
    """Return the horizontal range of the centers (cells,) in meters."""
    return polar_of_cells(grid)[0].reshape(-1)


@lru_cache(maxsize=2)
def patches_of(grid: BevGrid) -> tuple[Floats, Places, Floats]:
    """Return the patches of 4 x 4 cells, as ``count_cells`` takes them; at the edge of a grid cells are repeated."""
    count = -(-grid.cells // _SIDE)
    rows = np.minimum(np.arange(count * _SIDE), grid.cells - 1).reshape(count, 1, _SIDE, 1)
    cells = (rows * grid.cells + rows.reshape(1, count, 1, _SIDE)).reshape(-1, LANES)
    x, y = (grid.centers[..., axis].reshape(-1) for axis in range(2))
    some = np.maximum(ranges_of(grid), 1e-6)
    lanes = np.stack([x / some, y / some, ranges_of(grid)])[:, cells].astype(np.float32).transpose(1, 0, 2)
    middle = np.arctan2(y[cells].mean(axis=1), x[cells].mean(axis=1))
    turned = np.arctan2(y[cells], x[cells]) - middle[:, None]
    spread = np.abs((turned + np.pi) % (2 * np.pi) - np.pi).max(axis=1) + _ROUNDING
    near, far = lanes[:, 2].min(axis=1), lanes[:, 2].max(axis=1)
    middles = np.stack([middle, spread, near, far], axis=1).astype(np.float32)
    return np.ascontiguousarray(lanes), cells.astype(np.int32), middles


@lru_cache(maxsize=2)
def batches_of(grid: BevGrid, bins: int) -> tuple[Places, Floats, Places]:
    """Return the cells of each bin of azimuth, as ``see_cells`` takes them; the last of a bin are repeated."""
    azimuth = polar_of_cells(grid)[1].reshape(-1)
    vehicle = ((azimuth + np.float32(np.pi)) * np.float32(bins / (2 * np.pi))).astype(np.int64).clip(0, bins - 1)
    order = np.lexsort((ranges_of(grid), vehicle))
    starts = np.flatnonzero(np.diff(vehicle[order], prepend=-1))
    counts = np.diff(starts, append=len(order))
    batches = -(-counts // COLUMNS)
    first = np.repeat(np.cumsum(batches) - batches, batches)
    step = (np.arange(len(first)) - first)[:, None] * COLUMNS + np.arange(COLUMNS)
    rows = np.repeat(starts, batches)[:, None] + np.minimum(step, np.repeat(counts, batches)[:, None] - 1)
    cells = order[rows].astype(np.int32)
    return cells, ranges_of(grid)[cells], vehicle[cells[:, 0]].astype(np.int32)


BELOW_GROUND_M = 0.02
"""A beam that meets the plate this far below the ground of its cell's center counts: the ground rises by so much over
half the width of a car at a crown of 2 %."""

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
        beams: (6, C·R) lines, see ``truth_kernels``.
        azimuth: (C·R,) of the beams.
        flags: (C·R,) what stopped them, see ``truth_bins``.
        ground: (cells,) at the centers of the cells.
        offset_m: largest horizontal distance of a beam's start from the reference position.
    """

    scan: Scan
    grid: BevGrid
    beams: NDArray[np.float32]
    azimuth: NDArray[np.float32]
    flags: NDArray[np.uint8]
    ground: NDArray[np.float32]
    offset_m: np.float32


def exact_truth(
    scan: Scan,
    world: World | Terrain,
    grid: BevGrid,
    targets: tuple[Target, ...] = (CAR, PEDESTRIAN),
    agent: Agent | None = None,
) -> tuple[Truth, Mask]:
    """Return the truth of a scan on ``grid``, and where it is known (cells, cells).

    For a cell whose center lies at horizontal range r from the sensor, the target is an upright plate of its width and
    height through the center, across the line of sight, on the ground there. A beam *aims* at it if it crosses it, and
    *reaches* it if it stops no more than a cell's side before it, measured along the line of sight. ``docs/truth.md``
    tells the states and the other definitions.

    Args:
        scan: what every beam met.
        world: where it was made, or its ground.
        grid: where the cells are, in the ``level`` frame of the scan.
        targets: what would have to be seen.
        agent: who scanned. Cells that its own vehicle covers are not known, and its own body blocks no bin.
    """
    if not targets:
        raise ValueError("targets must be at least one, got none")
    terrain = world.terrain if isinstance(world, World) else world
    ground, known = _ground(scan, terrain, grid)
    view = _view(scan, grid, ground, -3 if agent is None or agent.carrier is None else agent.carrier)
    known &= (ranges_of(grid) > view.offset_m).reshape(grid.shape)
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


def _ground(scan: Scan, terrain: Terrain, grid: BevGrid) -> tuple[NDArray[np.float32], Mask]:
    """Return the ground (cells, cells) at the centers, from the sensor's height, and where there is terrain."""
    centers = grid.centers
    return terrain.about(scan.world_from_sensor, centers[:, 0, 0].copy(), centers[0, :, 1].copy())


def _view(scan: Scan, grid: BevGrid, ground: NDArray[np.float32], vehicle: int) -> _View:
    """Return the scan over the grid; ``own`` is the thing that carries the sensor, or a number that no thing has."""
    yaw, origin = scan.world_from_sensor.yaw, scan.origin_m
    turn, max_range = (np.cos(yaw), np.sin(yaw)), np.float32(scan.model.max_range_m)
    beams, azimuth = beam_lines(origin, scan.direction, scan.depth_m, turn, max_range)
    flags = stop_flags(scan.depth_m, scan.thing, scan.material, vehicle, REFLECTIVITY)
    offset_m = np.float32(np.sqrt((origin[..., 0] ** 2 + origin[..., 1] ** 2).max()))
    return _View(scan, grid, beams, azimuth, flags, ground.reshape(-1), offset_m)


def _targets(view: _View, targets: tuple[Target, ...]) -> tuple[CountsByTarget, CountsByTarget]:
    """Return beams that reach, up to 255, and states (cells,) by target; two targets at a time."""
    scan, rings = view.scan, view.scan.model.rings
    tiles, starts = sorted_tiles(view.beams, view.azimuth, rings)
    beams = (tiles, starts, slope_bounds(view.beams[4], view.azimuth, rings))
    rise = scan.origin_m[..., 2]
    offsets = (view.offset_m, rise.min(), rise.max())
    limits = (np.float32(view.grid.cell_m), np.float32(BELOW_GROUND_M), *offsets, np.float32(scan.model.max_range_m))
    surface = _surfaces(view, targets)
    by_target = {}
    for k in range(0, len(targets), 2):
        pair = sorted((targets[k], targets[min(k + 1, len(targets) - 1)]), key=lambda t: -t.width_m)
        a, b = pair
        sizes = (a.width_m / 2, b.width_m / 2, a.height_m, b.height_m)
        plates = (*(np.float32(size) for size in sizes), min(a.min_returns, MANY), min(b.min_returns, MANY))
        counts = np.zeros(len(view.ground), np.int32)
        count_cells(beams, patches_of(view.grid), view.ground, plates, limits, counts)
        for which, target in enumerate(pair):
            by_target[target.name] = np.empty((2, len(counts)), np.uint8)
            states_of_cells(counts, which, surface[target.name], min(target.min_returns, MANY), by_target[target.name])
    return {name: both[0] for name, both in by_target.items()}, {name: both[1] for name, both in by_target.items()}


def _surfaces(view: _View, targets: tuple[Target, ...]) -> dict[str, Mask]:
    """Return where a stop on a thing lies between 0.2 m and the target's top above local ground (cells,)."""
    grid = view.grid
    tops = np.array([target.height_m for target in targets], np.float32)
    out = np.zeros((len(targets), len(view.ground)), np.bool_)
    lattice = (np.float32(grid.origin_m[0]), np.float32(grid.origin_m[1]), np.float32(1 / grid.cell_m), grid.cells)
    mark_stops(view.beams, view.flags & BLOCKS, view.ground, (lattice, np.float32(SURFACE_FROM_M), tops), out)
    return {target.name: out[k] for k, target in enumerate(targets)}


def _definitions(view: _View) -> dict[str, Mask]:
    """Return the masks (cells,) of the definitions that others use."""
    model = view.scan.model
    bins = min(model.azimuth_columns, MAX_BINS)
    limits = stop_limits(view.beams, view.flags, bins)
    table = beams_of_bins(view.beams, view.azimuth, view.flags, model.rings, bins)
    seen = np.empty(len(view.ground), np.uint8)
    shape = (np.float32(CAR.height_m), np.float32(BELOW_GROUND_M), np.float32(view.grid.cell_m))
    see_cells(limits, table, batches_of(view.grid, bins), view.ground, shape, seen)
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
