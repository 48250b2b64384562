"""Exact truth against sums over every beam, and against cases counted by hand."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed import CAR, PEDESTRIAN, BevGrid, CellState, Target
from viewshed.geometry import Rigid, rotation_from_quaternion
from viewshed.ground import Ground
from viewshed.sensors import LidarModel
from viewshed.sim.caster import cast_world
from viewshed.sim.scan import STILL, Motion, Scan
from viewshed.sim.shapes import Box
from viewshed.sim.terrain import Terrain
from viewshed.sim.truth import BELOW_GROUND_M, exact_truth
from viewshed.sim.world import Agent, Thing, World
from viewshed.visible import Beams, expected_returns

FAST = Motion((6.0, -3.0, 0.4), 0.5, 0.1)
HILLS = Terrain.of(
    np.linspace(-60, 60, 41),
    np.linspace(-50, 70, 41),
    lambda x, y: 0.6 * np.sin(x / 9) + 0.04 * y + 0.3 * np.cos(y / 7),
)
BOXES = (
    Thing("wall", (Box(0, 0, 0.6, 14, 4),), 11, 4, 0.2), Thing("car", (Box(0, 0, 4.2, 1.8, 1.5),), -7, 5, 0.7),
    Thing("sign", (Box(0, 0, 0.1, 1.2, 3.0, bottom_m=2.0),), 4, -6, 1.0),
    Thing("curtain", (Box(0, 0, 0.4, 8, 2, material="hedge"),), -3, -12, 1.4),
)  # fmt: skip
WORLD = World("test", HILLS, BOXES)


def _model(columns: int, rings: int, spread_deg: float = 0.0) -> LidarModel:
    rng = np.random.default_rng(columns)
    return LidarModel(
        "test", np.deg2rad(np.linspace(-28, 9, rings)), columns,
        azimuth_offset=np.deg2rad(rng.uniform(-spread_deg, spread_deg, rings)),
        origin_m=rng.uniform(-0.05, 0.05, rings), max_range_m=40.0,
    )  # fmt: skip


def _pose(tilt_deg: float, height_m: float, yaw: float = 0.8) -> Rigid:
    half = np.deg2rad(tilt_deg) / 2
    tilt = rotation_from_quaternion((np.cos(half), 0.3 * np.sin(half), np.sqrt(0.91) * np.sin(half), 0.0))
    ground = float(HILLS.at(np.array([[1.0, 2.0]]))[0])
    return Rigid(Rigid.from_yaw(yaw).rotation @ tilt, np.array([1.0, 2.0, ground + height_m]))


CASES = {
    "still": (_model(720, 24), _pose(0, 1.8), STILL),
    "moving, offsets": (_model(541, 16, 6.0), _pose(2, 1.8), FAST),
    "mast, tilted": (_model(360, 40), _pose(20, 6.0), STILL),
    "tilted on its side": (_model(400, 16, 2.0), _pose(75, 3.0), FAST),
    "few columns": (_model(20, 12), _pose(0, 1.2), STILL),
}


def _scan(name: str) -> Scan:
    model, pose, motion = CASES[name]
    return cast_world(WORLD.snapshot(0.0), model, pose, motion, seed=5)


def _by_hand(scan: Scan, grid: BevGrid, target: Target, slack_m: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """Aimed and reached beams of every cell in double precision, each limit moved outwards by ``slack_m``."""
    pose = scan.world_from_sensor
    place, turn = pose.translation, Rigid.from_yaw(pose.yaw).rotation
    start = scan.origin_m.reshape(-1, 3).astype(np.float64)
    way = scan.direction.reshape(-1, 3).astype(np.float64)
    stop = np.minimum(scan.depth_m.reshape(-1).astype(np.float64), scan.model.max_range_m)
    counts = np.zeros((2, *grid.shape), int)
    for cell in np.ndindex(grid.shape):
        center = turn[:2, :2] @ grid.centers[cell]
        r = np.hypot(*center)
        normal = np.append(center / r, 0.0)
        across = np.array([-normal[1], normal[0], 0.0])
        ground = float(HILLS.at((place[:2] + center)[None])[0]) - place[2]
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = (r - start @ normal) / (way @ normal)
            point = start + way * depth[:, None]
            aimed = (way @ normal > 0) & (depth > 0) & (np.abs(point @ across) <= target.width_m / 2 + slack_m)
            aimed &= (point[:, 2] >= ground - BELOW_GROUND_M - slack_m) & (
                point[:, 2] <= ground + target.height_m + slack_m
            )
            reached = aimed & ((start + way * stop[:, None]) @ normal >= r - grid.cell_m - slack_m)
        counts[0][cell], counts[1][cell] = aimed.sum(), reached.sum()
    return counts[0], counts[1]


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("target", [CAR, PEDESTRIAN, Target("bus", 12.0, 2.5, 3.2, 1)])
def test_counts_are_those_of_every_beam_tested_by_itself(name: str, target: Target) -> None:
    scan = _scan(name)
    grid = BevGrid(26, 32.0, (3.0, -2.0))
    truth, _ = exact_truth(scan, WORLD, grid, (PEDESTRIAN, target))
    found = truth.expected_returns[target.name].astype(int)
    low, high = (np.minimum(_by_hand(scan, grid, target, slack)[1], 255) for slack in (-2e-4, 2e-4))
    far = np.hypot(*np.moveaxis(grid.centers, -1, 0)) > 1.0
    assert (found >= low)[far].all()
    assert (found <= high)[far].all()
    assert (low == high).mean() > 0.9
    assert 0 < (found > 0).mean() < 1
