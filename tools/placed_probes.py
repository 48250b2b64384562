"""Placed probes: put targets into a world, cast, and count the beams that meet them. The check of the exact truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed.fov.truth import Truth
from viewshed.fov.visibility import Target
from viewshed.grid import BevGrid
from viewshed_lab.sim.assets.shapes import BOX, material_index
from viewshed_lab.sim.raycast.caster import cast_world
from viewshed_lab.sim.raycast.scan import ExactScan
from viewshed_lab.sim.world import Snapshot

GAP_M = 0.05
"""A probe stands at least so far from anything else."""

SINK_M = 0.02
"""A probe reaches so far into the ground below its middle."""

_APART = 0.02
"""Least angle between two probes of one cast, so that no beam can meet both."""

_PER_CAST = 40


@dataclass(frozen=True, slots=True, eq=False)
class Boxes:
    """Upright boxes in the world."""

    cell: NDArray[np.intp]  # (N, 2) index of the cell that each stands in
    center_m: F64  # (N, 3) middle of the box
    yaw: F64  # (N,) heading of its length in the world
    half_m: F64  # (N, 3) half its length, width and height

    def select(self, keep: NDArray[np.bool_] | NDArray[np.intp]) -> Boxes:
        """Return the boxes that ``keep`` names."""
        return Boxes(self.cell[keep], self.center_m[keep], self.yaw[keep], self.half_m[keep])


@dataclass(frozen=True, slots=True, eq=False)
class Probes:
    """What placed targets gave, and what the truth expects."""

    target: Target  # what was placed
    boxes: Boxes  # where, N of them
    range_m: F64  # (N,) horizontal range of the cells' centers
    expected: NDArray[np.int64]  # (N,) returns by the truth
    met: NDArray[np.int64]  # (N,) beams whose first stop is the probe

    @property
    def agree(self) -> NDArray[np.bool_]:
        """(N,) whether truth and probe agree on *visible*."""
        least = self.target.min_returns
        same: NDArray[np.bool_] = (self.expected >= least) == (self.met >= least)
        return same


def plates(scan: ExactScan, snapshot: Snapshot, grid: BevGrid, target: Target, cells: NDArray[np.intp]) -> Boxes:
    """Return the probes of the definition: as wide and high as the target, one cell deep, across the line of sight.

    The back of each goes through the center of its cell, its front stands one cell nearer: a beam that stops on it
    reaches the center's range less one cell.
    """
    level, yaw = _world_of(scan, grid, cells)
    azimuth = np.arctan2(level[:, 1], level[:, 0]) + yaw
    away = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    center = _sensor(scan) + away * (np.hypot(level[:, 0], level[:, 1]) - grid.cell_m / 2)[:, None]
    foot = snapshot.terrain.at(center + away * grid.cell_m / 2)
    return _boxes(cells, center, foot, azimuth, (grid.cell_m, target.width_m, target.height_m))


def _sensor(scan: ExactScan) -> F64:
    return scan.world_from_sensor.translation[:2]


def _world_of(scan: ExactScan, grid: BevGrid, cells: NDArray[np.intp]) -> tuple[F64, float]:
    """Return centers (N, 2) in the ``level`` frame, and that frame's heading in the world."""
    return grid.centers[cells[:, 0], cells[:, 1]], scan.world_from_sensor.yaw


def _boxes(cells: NDArray[np.intp], center: F64, foot_m: F64, yaw: F64, sizes_m: tuple[float, float, float]) -> Boxes:
    half = np.broadcast_to(np.array([sizes_m[0], sizes_m[1], sizes_m[2] + SINK_M]) / 2, (len(cells), 3))
    middle = np.column_stack([center, foot_m - SINK_M + half[:, 2]])
    return Boxes(cells, middle, np.broadcast_to(yaw, len(cells)).astype(np.float64), half)


def free_of(snapshot: Snapshot, boxes: Boxes, period_s: float = 0.0) -> NDArray[np.bool_]:
    """Return which boxes (N,) touch no solid of the snapshot, wherever it goes within the revolution.

    Footprints are compared as oriented rectangles (separating axes, Gottschalk 1996), heights as intervals.
    """
    way = np.hypot(snapshot.velocity_mps[:, 0], snapshot.velocity_mps[:, 1]) * period_s / 2
    grow = way + GAP_M
    reach = np.abs(snapshot.rotation) @ snapshot.half_m[:, :, None]
    up = reach[:, 2, 0] + GAP_M
    heading = np.arctan2(snapshot.rotation[:, 1, 0], snapshot.rotation[:, 0, 0])[None]
    yaw, offset = boxes.yaw[:, None], boxes.center_m[:, None, :] - snapshot.center_m[None]
    clear = np.abs(offset[..., 2]) > boxes.half_m[:, 2:3] + up
    for axis in (yaw, yaw + np.pi / 2, heading, heading + np.pi / 2):
        along = np.abs(offset[..., 0] * np.cos(axis) + offset[..., 1] * np.sin(axis))
        clear |= along > _extent(boxes.half_m[:, None], axis - yaw) + _extent(snapshot.half_m, axis - heading) + grow
    return np.asarray(clear.all(axis=1))


def _extent(half_m: F64, angle: F64) -> F64:
    """Return half the extent of a rectangle along an axis at an angle from its length."""
    return np.asarray(half_m[..., 0] * np.abs(np.cos(angle)) + half_m[..., 1] * np.abs(np.sin(angle)))


def apart(scan: ExactScan, boxes: Boxes, most: int) -> NDArray[np.intp]:
    """Return rows of boxes, ``most`` at the most and the first ones first, of which no beam can meet two."""
    middle, half = _seen(scan, boxes)
    chosen: list[int] = []
    for k in range(len(middle)):
        gaps = np.abs((middle[chosen] - middle[k] + np.pi) % (2 * np.pi) - np.pi) - half[chosen] - half[k]
        if half[k] < 1.0 and (gaps > _APART).all():
            chosen.append(k)
            if len(chosen) == most:
                break
    return np.array(chosen, np.intp)


def _seen(scan: ExactScan, boxes: Boxes) -> tuple[F64, F64]:
    """Return azimuth (N,) of each box and half the azimuths (N,) that it may cover, from wherever the sensor goes."""
    offset = boxes.center_m[:, :2] - _sensor(scan)
    moved = float(np.hypot(scan.origin_m[..., 0], scan.origin_m[..., 1]).max())
    size = np.hypot(boxes.half_m[:, 0], boxes.half_m[:, 1]) + moved
    ratio = np.minimum(size / np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 1e-6), 1.0)
    return np.arctan2(offset[:, 1], offset[:, 0]), np.arcsin(ratio)


def with_boxes(snapshot: Snapshot, boxes: Boxes, first_thing: int) -> Snapshot:
    """Return the snapshot with the boxes added as things from ``first_thing`` on; what was there keeps its place."""
    count = len(boxes.yaw)
    rotation = np.zeros((count, 3, 3))
    rotation[:, 0, 0] = rotation[:, 1, 1] = np.cos(boxes.yaw)
    rotation[:, 1, 0] = np.sin(boxes.yaw)
    rotation[:, 0, 1], rotation[:, 2, 2] = -rotation[:, 1, 0], 1.0
    return Snapshot(
        snapshot.terrain,
        np.append(snapshot.kind, np.full(count, BOX, np.uint8)),
        np.concatenate([snapshot.center_m, boxes.center_m]),
        np.concatenate([snapshot.rotation, rotation]),
        np.concatenate([snapshot.half_m, boxes.half_m]),
        np.concatenate([snapshot.velocity_mps, np.zeros((count, 3))]),
        np.append(snapshot.material, np.full(count, material_index("paint"), np.uint8)),
        np.append(snapshot.thing, first_thing + np.arange(count, dtype=np.int32)),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Setting:
    """Where probes are placed: solids at one time, what was cast among them and with which seed, and its truth."""

    snapshot: Snapshot
    scan: ExactScan
    seed: int
    truth: Truth
    known: NDArray[np.bool_]


def place(setting: Setting, target: Target, count: int, rng: np.random.Generator) -> Probes:
    """Return about ``count`` probes at random cells, as many at all ranges, cast a few dozen at a time.

    Args:
        setting: where.
        target: what is placed.
        count: how many places are tried.
        rng: chooses the cells.
    """
    scan, snapshot, grid = setting.scan, setting.snapshot, setting.truth.grid
    cells = _cells(setting, count, rng)
    boxes = plates(scan, snapshot, grid, target, cells)
    free = [
        free_of(snapshot, boxes.select(part), scan.motion.period_s) for part in np.array_split(np.arange(count), 64)
    ]
    boxes = boxes.select(np.concatenate(free))
    done, met = [], []
    while len(boxes.yaw):
        rows = apart(scan, boxes, _PER_CAST)
        if not len(rows):
            break
        placed = boxes.select(rows)
        done.append(placed)
        met.append(meets(setting, placed))
        boxes = boxes.select(np.delete(np.arange(len(boxes.yaw)), rows))
    return _probes(setting, target, done, met)


def meets(setting: Setting, boxes: Boxes) -> NDArray[np.int64]:
    """Return how many beams (N,) stop first on each of some boxes, of which no beam can meet two."""
    found = _cast_among(setting, boxes)
    return np.bincount(found[found >= 0], minlength=len(boxes.yaw)).astype(np.int64)


def _cast_among(setting: Setting, boxes: Boxes) -> NDArray[np.int32]:
    """Return which of the boxes each beam (C, R) meets first, negative where it meets none."""
    scan, first = setting.scan, int(setting.snapshot.thing.max(initial=-1)) + 1
    world = with_boxes(setting.snapshot, boxes, first)
    found = cast_world(world, scan.model, scan.world_from_sensor, scan.motion, setting.seed).thing
    return np.where(found >= first, found - np.int32(first), np.int32(-1))


REASONS = ("side", "top", "ground", "fewer", "other")
"""Why a beam meets a plate's probe and the truth does not count it: it leaves the probe by its side or its top before
the plate, or would meet the ground in the last cell. ``fewer``: the truth counts beams that do not meet the probe."""


def reason(setting: Setting, box: Boxes, target: Target) -> str:
    """Return of which of ``REASONS`` most of the beams are that make a plate's probe (N = 1) and the truth differ."""
    scan = setting.scan
    met = _cast_among(setting, box).reshape(-1) == 0
    normal = np.array([np.cos(box.yaw[0]), np.sin(box.yaw[0]), 0.0])
    start, way = scan.origin_m.reshape(-1, 3)[met].astype(np.float64), scan.direction.reshape(-1, 3)[met]
    plate = box.center_m[0] + normal * box.half_m[0, 0] - scan.world_from_sensor.translation
    depth = ((plate - start) @ normal) / (way @ normal)
    beyond = start + way * depth[:, None] - plate
    aside = np.abs(beyond @ np.array([-normal[1], normal[0], 0.0])) > target.width_m / 2
    low, high = beyond[:, 2] < -box.half_m[0, 2], beyond[:, 2] > box.half_m[0, 2]
    expected = setting.truth.expected_returns[target.name][tuple(box.cell[0])]
    if expected > met.sum():
        return "fewer"
    counts = {"side": aside.sum(), "top": (high & ~aside).sum(), "ground": (low & ~aside).sum(), "other": 0.5}
    return max(counts, key=lambda name: counts[name])


def _cells(setting: Setting, count: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Draw known cells, each range as often as any other."""
    cells = np.argwhere(setting.known)
    centers = setting.truth.grid.centers[cells[:, 0], cells[:, 1]]
    weight = 1.0 / np.maximum(np.hypot(centers[:, 0], centers[:, 1]), 1.0)
    return np.asarray(cells[rng.choice(len(cells), count, p=weight / weight.sum())])


def _probes(setting: Setting, target: Target, done: list[Boxes], met: list[NDArray[np.int64]]) -> Probes:
    empty = Boxes(np.zeros((0, 2), np.intp), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)))
    columns = [
        np.concatenate(column)
        for column in zip(*((b.cell, b.center_m, b.yaw, b.half_m) for b in (*done, empty)), strict=True)
    ]
    boxes = Boxes(*columns)
    cells = boxes.cell[:, 0], boxes.cell[:, 1]
    centers = setting.truth.grid.centers[cells]
    expected = setting.truth.expected_returns[target.name][cells].astype(np.int64)
    counts = np.concatenate([*met, np.zeros(0, np.int64)])
    return Probes(target, boxes, np.hypot(centers[:, 0], centers[:, 1]), expected, counts)
