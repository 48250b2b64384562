"""Exact truth: which cells a sensor could see, counted on the beams of a scan without noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from viewshed.bev import BevGrid, polar_of_cells
from viewshed.estimate import CellState
from viewshed.geometry import Rigid
from viewshed.sim.materials import REFLECTIVITY
from viewshed.sim.scan import Scan
from viewshed.sim.shapes import Shape
from viewshed.sim.terrain import Terrain
from viewshed.sim.truth_bins import beams_of_bins, see_cells, stop_limits, what_stopped
from viewshed.sim.truth_kernels import (
    MANY,
    beam_lines,
    count_cells,
    mark_stops,
    slope_bounds,
    sorted_tiles,
    tile_reaches,
)
from viewshed.sim.world import GROUND, Agent, World
from viewshed.truth import OTHER_DEFINITIONS, Truth
from viewshed.visible import CAR, PEDESTRIAN, Target

BELOW_GROUND_M = 0.02
"""A beam that meets the plate this far below the ground of its cell's centre counts: the ground rises by so much over
half the width of a car at a crown of 2 %."""
SURFACE_FROM_M = 0.2
"""Stops on things from this height above local ground on make a cell a surface."""
MAX_BINS = 1080
"""Azimuth bins of the other definitions, at most; less where the sensor has fewer columns."""
Mask = NDArray[np.bool_]
Counts = dict[str, NDArray[np.uint8]]


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """A scan over a grid, in the axes of the grid, seen from the sensor's reference position.

    Attributes:
        scan: the scan.
        grid: the grid.
        beams: (6, C·R) lines, see ``truth_kernels``.
        azimuth: (C·R,) of the beams.
        cells: (5, cells) unit vector, range, azimuth and ground of the cells' centres.
        world: (cells, 2) their places in the world.
        own: the thing that carries the sensor, or a number that no thing has.
    """

    scan: Scan
    grid: BevGrid
    beams: NDArray[np.float32]
    azimuth: NDArray[np.float32]
    cells: NDArray[np.float32]
    world: NDArray[np.float64]
    own: int

    @property
    def offset_m(self) -> np.float32:
        """Largest horizontal distance of a beam's start from the reference position."""
        origin = self.scan.origin_m
        return np.float32(np.sqrt((origin[..., 0] ** 2 + origin[..., 1] ** 2).max()))


def exact_truth(
    scan: Scan,
    world: World | Terrain,
    grid: BevGrid,
    targets: tuple[Target, ...] = (CAR, PEDESTRIAN),
    agent: Agent | None = None,
) -> tuple[Truth, Mask]:
    """Return the truth of a scan on ``grid``, and where it is known (cells, cells).

    For a cell whose centre lies at horizontal range r from the sensor, the target is an upright plate of its width and
    height through the centre, across the line of sight, on the ground there. A beam *aims* at it if it crosses it, and
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
    view = _view(scan, terrain, grid, -3 if agent is None or agent.carrier is None else agent.carrier)
    aimed, reached = _counts(view, targets)
    surface = _surfaces(view, targets)
    state = {t.name: _state(aimed[t.name], reached[t.name], surface[t.name], t.min_returns) for t in targets}
    known = _inside(terrain, view.world) & (view.cells[2] > view.offset_m)
    if agent is not None and agent.carrier is not None and isinstance(world, World):
        known &= ~_covered(world.things[agent.carrier].parts, scan.world_from_sensor @ agent.mount.inverse(), view)
    shape = grid.shape
    truth = Truth(
        grid,
        {name: count.reshape(shape) for name, count in reached.items()},
        {name: values.reshape(shape) for name, values in state.items()},
        {name: mask.reshape(shape) for name, mask in _definitions(view).items()},
    )
    return truth, known.reshape(shape)


def _view(scan: Scan, terrain: Terrain, grid: BevGrid, own: int) -> _View:
    pose = scan.world_from_sensor
    turn = (np.cos(pose.yaw), np.sin(pose.yaw))
    beams, azimuth = beam_lines(scan.origin_m, scan.direction, scan.depth_m, turn, np.float32(scan.model.max_range_m))
    cells = _polar(grid).copy()
    x, y = grid.centers[..., 0].ravel(), grid.centers[..., 1].ravel()
    world = np.empty((x.size, 2))
    world[:, 0] = turn[0] * x - turn[1] * y + pose.translation[0]
    world[:, 1] = turn[1] * x + turn[0] * y + pose.translation[1]
    cells[4] = terrain.at(world) - pose.translation[2]
    return _View(scan, grid, beams, azimuth, cells, world, own)


@lru_cache(maxsize=8)
def _polar(grid: BevGrid) -> NDArray[np.float32]:
    """Return (5, cells): unit vector, range and azimuth of the centres, and room for the ground."""
    range_m, azimuth = polar_of_cells(grid)
    some = np.maximum(range_m, 1e-6)
    unit = (grid.centers[..., 0] / some, grid.centers[..., 1] / some)
    return np.stack([*unit, range_m, azimuth, range_m]).astype(np.float32).reshape(5, -1)


def _counts(view: _View, targets: tuple[Target, ...]) -> tuple[Counts, Counts]:
    """Return beams that aim and that reach, up to 255 (cells,), by target; two targets at a time."""
    scan, rings = view.scan, view.scan.model.rings
    tiles, starts = sorted_tiles(view.beams, view.azimuth, rings)
    beams = (tiles, tile_reaches(tiles), starts, slope_bounds(view.beams[4], view.azimuth, rings))
    rise = scan.origin_m[..., 2]
    offsets = (view.offset_m, rise.min(), rise.max())
    limits = (np.float32(view.grid.cell_m), np.float32(BELOW_GROUND_M), *offsets, np.float32(scan.model.max_range_m))
    aimed: Counts = {}
    reached: Counts = {}
    for k in range(0, len(targets), 2):
        a, b = sorted((targets[k], targets[min(k + 1, len(targets) - 1)]), key=lambda t: -t.width_m)
        sizes = (a.width_m / 2, b.width_m / 2, a.height_m, b.height_m)
        plates = (*(np.float32(size) for size in sizes), min(a.min_returns, MANY), min(b.min_returns, MANY))
        out = np.empty((4, view.cells.shape[1]), np.uint8)
        count_cells(beams, view.cells, plates, limits, out)
        aimed |= {a.name: out[0], b.name: out[2]}
        reached |= {a.name: out[1], b.name: out[3]}
    return aimed, reached


def _surfaces(view: _View, targets: tuple[Target, ...]) -> dict[str, Mask]:
    """Return where a stop on a thing lies between 0.2 m and the target's top above local ground (cells,)."""
    grid = view.grid
    things = (view.scan.thing.reshape(-1) > GROUND) & (view.scan.thing.reshape(-1) != view.own)
    tops = np.array([target.height_m for target in targets], np.float32)
    out = np.zeros((len(targets), view.cells.shape[1]), np.bool_)
    lattice = (np.float32(grid.origin_m[0]), np.float32(grid.origin_m[1]), np.float32(1 / grid.cell_m), grid.cells)
    mark_stops(view.beams, things, view.cells[4], (lattice, np.float32(SURFACE_FROM_M), tops), out)
    return {target.name: out[k] for k, target in enumerate(targets)}


def _state(aimed: NDArray[np.uint8], reached: NDArray[np.uint8], surface: Mask, least: int) -> NDArray[np.uint8]:
    seen, hidden = reached >= min(least, MANY), aimed >= min(least, MANY)
    state = np.where(hidden, np.uint8(CellState.HIDDEN), np.uint8(CellState.UNKNOWN))
    state[seen] = CellState.FREE
    state[seen & surface] = CellState.SURFACE
    return state


def _definitions(view: _View) -> dict[str, Mask]:
    """Return the masks (cells,) of the definitions that others use."""
    scan, bins = view.scan, min(view.scan.model.azimuth_columns, MAX_BINS)
    flags = what_stopped(scan.depth_m, scan.thing, scan.material, view.own, REFLECTIVITY)
    limits = stop_limits(view.beams, flags, bins)
    table = beams_of_bins(view.beams, view.azimuth, flags, scan.model.rings, bins)
    out = np.empty((3, view.cells.shape[1]), np.bool_)
    shape = (np.float32(CAR.height_m), np.float32(BELOW_GROUND_M), np.float32(view.grid.cell_m))
    see_cells(limits, table, view.cells, shape, out)
    return dict(zip(OTHER_DEFINITIONS, out, strict=True))


def _inside(terrain: Terrain, xy: NDArray[np.float64]) -> Mask:
    """Return which points (N, 2) of the world lie over the terrain's lattice."""
    x, y = xy[:, 0], xy[:, 1]
    inside: Mask = (x >= terrain.x_m[0]) & (x <= terrain.x_m[-1]) & (y >= terrain.y_m[0]) & (y <= terrain.y_m[-1])
    return inside


def _covered(parts: tuple[Shape, ...], world_from_thing: Rigid, view: _View) -> Mask:
    """Return which cells the upright box around a thing's solids touches (cells,)."""
    corners = np.concatenate([_corners(part) for part in parts])
    low, high = corners.min(axis=0) - view.grid.cell_m / 2, corners.max(axis=0) + view.grid.cell_m / 2
    away = float(np.linalg.norm(world_from_thing.translation - view.scan.world_from_sensor.translation))
    near = np.flatnonzero(view.cells[2] <= away + np.abs([low, high]).sum())
    offset = view.world[near] - world_from_thing.translation[:2]
    place = offset @ Rigid.from_yaw(world_from_thing.yaw).rotation[:2, :2]
    covered = np.zeros(len(view.world), np.bool_)
    covered[near] = ((place >= low) & (place <= high)).all(axis=1)
    return covered


def _corners(part: Shape) -> NDArray[np.float64]:
    """Return x and y (4, 2) of the corners of a solid's footprint, in the frame of its thing."""
    length, width = part.half_sizes_m[:2]
    c, s = np.cos(part.yaw), np.sin(part.yaw)
    signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    return np.asarray((signs * [length, width]) @ np.array([[c, s], [-s, c]]) + [part.x_m, part.y_m])
