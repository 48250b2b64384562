"""The exact truth against placed probes: boxes are put into a world and cast, and the beams that meet them counted.

A probe is what the definition of *visible* asks about: as wide and high as the target, one cell deep, across the line
of sight, its back through the center of its cell. The caster, which brute force checks, says what beams meet; nothing
here calls the code of the truth.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed import CAR, PEDESTRIAN, BevGrid, Target
from viewshed.arrays import F64
from viewshed.fov.truth import Truth
from viewshed.geometry import Rigid
from viewshed.sensors import LidarModel
from viewshed_lab.sim.assets.shapes import BOX, Box, Cylinder, Ellipsoid, material_index
from viewshed_lab.sim.raycast.caster import cast_world
from viewshed_lab.sim.raycast.scan import ExactScan, Motion
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.truth.exact import exact_truth
from viewshed_lab.sim.world import Snapshot, Thing, World

MODEL = LidarModel("test", np.deg2rad(np.linspace(-24, 6, 32)), azimuth_columns=900, max_range_m=80.0)
GROUND = Terrain.of(np.linspace(-60, 60, 25), np.linspace(-60, 60, 25), lambda x, y: 0.3 * np.sin(x / 8) + 0.02 * y)
WORLD = World(
    "test", GROUND,
    (
        Thing("wall", (Box(0, 0, 0.6, 14, 5),), 12, 3, 0.2), Thing("car", (Box(0, 0, 4.2, 1.8, 1.5),), -6, 6, 0.7),
        Thing("pole", (Cylinder(0, 0, 0.15, 6),), 6, -9), Thing("bus", (Box(0, 0, 11, 2.5, 3),), -14, -9, 1.1),
        Thing("tree", (Ellipsoid(0, 0, 3, 3, 5, 2), Cylinder(0, 0, 0.2, 2.5)), 9, 16),
    ),
)  # fmt: skip
GRID = BevGrid(128, 32.0)
MOVING = Motion((5.0, 1.0, 0.0), 0.2, 0.1)
SEED, PER_CAST = 3, 40
GAP_M = 0.1  # between a probe and anything else
SINK_M = 0.02  # how far a probe reaches into the ground below its middle
APART = 0.02  # least angle between two probes of one cast, so that no beam can meet both


@dataclass(frozen=True, eq=False)
class Probes:
    """Upright boxes (N) across the line of sight."""

    cell: NDArray[np.intp]  # (N, 2) that each stands in
    center_m: F64  # (N, 3) middle
    yaw: F64  # (N,) heading of the line of sight
    half_m: F64  # (3,) half of depth, width and height

    def __getitem__(self, keep: NDArray[np.bool_] | NDArray[np.intp]) -> "Probes":
        return Probes(self.cell[keep], self.center_m[keep], self.yaw[keep], self.half_m)


@lru_cache(maxsize=1)
def _scene() -> tuple[Snapshot, ExactScan, Truth, NDArray[np.bool_]]:
    """Return the solids, what was cast among them, the truth of it, and its known cells."""
    height = float(GROUND.at(np.array([[1.0, -1.0]]))[0]) + 1.8
    snapshot = WORLD.snapshot(0.0)
    scan = cast_world(snapshot, MODEL, Rigid.from_yaw(0.4, (1.0, -1.0, height)), MOVING, seed=SEED)
    return snapshot, scan, *exact_truth(scan, WORLD, GRID)


def _plates(pose: Rigid, target: Target, cells: NDArray[np.intp]) -> Probes:
    level = GRID.centers[cells[:, 0], cells[:, 1]]
    yaw = np.arctan2(level[:, 1], level[:, 0]) + pose.yaw
    away = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    back = pose.translation[:2] + away * np.hypot(level[:, 0], level[:, 1])[:, None]
    half = np.array([GRID.cell_m, target.width_m, target.height_m + SINK_M]) / 2
    return Probes(cells, np.column_stack([back - away * half[0], GROUND.at(back) - SINK_M + half[2]]), yaw, half)


def _free(snapshot: Snapshot, probes: Probes) -> NDArray[np.bool_]:
    """Return which probes (N,) stand clear of every solid, by the circles about both."""
    reach = np.hypot(snapshot.half_m[:, 0], snapshot.half_m[:, 1]) + np.hypot(*probes.half_m[:2]) + GAP_M
    offset = probes.center_m[:, None, :2] - snapshot.center_m[None, :, :2]
    return np.asarray((np.hypot(offset[..., 0], offset[..., 1]) > reach).all(axis=1))


def _apart(scan: ExactScan, probes: Probes) -> NDArray[np.intp]:
    """Return rows of probes of which no beam can meet two, wherever the sensor goes within its revolution."""
    offset = probes.center_m[:, :2] - scan.world_from_sensor.translation[:2]
    moved = float(np.hypot(scan.origin_m[..., 0], scan.origin_m[..., 1]).max())
    size = np.hypot(*probes.half_m[:2]) + moved
    middle, half = np.arctan2(offset[:, 1], offset[:, 0]), np.arcsin(size / np.hypot(offset[:, 0], offset[:, 1]))
    chosen: list[int] = []
    for k in range(len(middle)):
        gaps = np.abs((middle[chosen] - middle[k] + np.pi) % (2 * np.pi) - np.pi) - half[chosen] - half[k]
        if (gaps > APART).all() and len(chosen) < PER_CAST:
            chosen.append(k)
    return np.array(chosen, np.intp)


def _with(snapshot: Snapshot, probes: Probes, first_thing: int) -> Snapshot:
    """Return the snapshot with probes as things from ``first_thing`` on; what was there keeps its place."""
    count = len(probes.yaw)
    rotation = np.stack([Rigid.from_yaw(float(yaw), (0, 0, 0)).rotation for yaw in probes.yaw])
    added: tuple[NDArray[Any], ...] = (
        np.full(count, BOX, np.uint8), probes.center_m, rotation, np.broadcast_to(probes.half_m, (count, 3)),
        np.zeros((count, 3)), np.full(count, material_index("paint"), np.uint8),
        first_thing + np.arange(count, dtype=np.int32),
    )  # fmt: skip
    there: tuple[NDArray[Any], ...] = (
        snapshot.kind, snapshot.center_m, snapshot.rotation, snapshot.half_m, snapshot.velocity_mps, snapshot.material,
        snapshot.thing,
    )  # fmt: skip
    return Snapshot(snapshot.terrain, *(np.concatenate(pair) for pair in zip(there, added, strict=True)))


def _met(probes: Probes) -> NDArray[np.int64]:
    """Return how many beams (N,) stop first on each probe; all other beams must be as they were."""
    snapshot, scan, *_ = _scene()
    first = int(snapshot.thing.max()) + 1
    found = cast_world(_with(snapshot, probes, first), scan.model, scan.world_from_sensor, scan.motion, SEED)
    others = found.thing < first
    np.testing.assert_array_equal(found.depth_m[others], scan.depth_m[others])
    return np.bincount(found.thing[~others] - first, minlength=len(probes.yaw))


def _placed(target: Target, count: int) -> tuple[Probes, NDArray[np.int64]]:
    """Return probes in known cells drawn at random, each range as often as any other, and the beams that meet each."""
    snapshot, scan, _, known = _scene()
    cells = np.argwhere(known)
    range_m = np.hypot(*GRID.centers[cells[:, 0], cells[:, 1]].T)
    weight = (range_m > 2.0) / np.maximum(range_m, 1.0)
    drawn = cells[np.random.default_rng(0).choice(len(cells), count, p=weight / weight.sum())]
    waiting = _plates(scan.world_from_sensor, target, drawn)
    waiting = waiting[_free(snapshot, waiting)]
    done, met = list[NDArray[np.intp]](), list[NDArray[np.int64]]()
    while len(waiting.yaw):
        rows = _apart(scan, waiting)
        done.append(waiting.cell[rows])
        met.append(_met(waiting[rows]))
        waiting = waiting[np.delete(np.arange(len(waiting.yaw)), rows)]
    cell = np.concatenate(done)
    return Probes(cell, np.empty((0, 3)), np.empty(0), np.empty(3)), np.concatenate(met)


@pytest.mark.parametrize("target", [CAR, PEDESTRIAN])
def test_truth_and_placed_probes_say_the_same(target: Target) -> None:
    probes, met = _placed(target, 900)
    truth = _scene()[2]
    expected = truth.expected_returns[target.name][probes.cell[:, 0], probes.cell[:, 1]].astype(np.int64)
    seen, few = met >= target.min_returns, met < 200  # the truth counts up to 255
    assert len(met) > 400
    assert 0.1 < seen.mean() < 0.95
    assert ((expected >= target.min_returns) == seen).mean() >= 0.985
    assert 0.9 < expected[few].sum() / met[few].sum() < 1.0  # a probe is met on its sides and its top as well
    mirrored = truth.visible(target)[:, ::-1]
    assert (mirrored[probes.cell[:, 0], probes.cell[:, 1]] == seen).mean() < 0.95


def test_probes_of_one_cast_never_share_a_beam() -> None:
    snapshot, scan, _, known = _scene()
    probes = _plates(scan.world_from_sensor, CAR, np.argwhere(known)[::37])
    probes = probes[_free(snapshot, probes)]
    rows = _apart(scan, probes)[:8]
    alone = [int(_met(probes[np.array([row])])[0]) for row in rows]
    assert max(alone) > 10
    assert _met(probes[rows]).tolist() == alone
