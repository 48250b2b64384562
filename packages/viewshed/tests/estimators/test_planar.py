"""A 2-D laser in a simulated warehouse: the field of view in its plane against the exact truth."""

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.io.messages.test_laserscan import Scan

from viewshed import CAR, GRIDS, PEDESTRIAN, LidarModel, Rigid, Target
from viewshed.estimators import CLASSICAL
from viewshed.fov.truth import Truth
from viewshed.io.messages.laserscan import sweep_of_scan
from viewshed.metrics import ConfusionCounts
from viewshed.sweep import Sweep
from viewshed_lab.sim import cast_world
from viewshed_lab.sim.raycast.scan import ExactScan
from viewshed_lab.sim.truth.exact import exact_truth
from viewshed_lab.sim.world import AgentPlan
from viewshed_lab.sim.worlds import WORLDS

GRID = GRIDS["indoor"]
LASER = LidarModel("2-D laser", np.zeros(1), 1440, min_range_m=0.1, max_range_m=30.0)
STEP = 2 * np.pi / LASER.azimuth_columns


def message_of(scan: ExactScan, noise_m: float) -> Scan:
    """Return the message that the laser would send."""
    x, y, _ = (scan.direction[:, 0].astype(np.float64) @ scan.world_from_sensor.rotation).T
    azimuth = np.arctan2(y, x)
    order = np.argsort(azimuth)
    noise = np.random.default_rng(0).normal(0.0, noise_m, len(order))
    ranges = (scan.depth_m[order, 0] + noise[order]).astype(np.float32)
    return Scan(ranges, azimuth[order[0]], azimuth[order[-1]], STEP, 0.0, LASER.min_range_m, LASER.max_range_m)


@pytest.fixture(scope="module")
def observed() -> tuple[Sweep, Truth, NDArray[np.bool_]]:
    world = WORLDS["warehouse"](np.random.default_rng(1), AgentPlan(sensor_height_m=0.3))
    agent = world.agents[0]
    x, y, _ = world.world_from_sensor(agent, 0.0).translation
    floor_m = float(world.ground_of(agent).at(np.array([[x, y]]))[0])
    pose = Rigid.from_yaw(0.4, (x, y, floor_m + 0.3))
    scan = cast_world(world.snapshot(0.0), LASER, pose)
    return sweep_of_scan(message_of(scan, 0.01)), *exact_truth(scan, world, GRID, agent=agent)


@pytest.mark.parametrize("target", [CAR, PEDESTRIAN], ids=lambda target: target.name)
@pytest.mark.parametrize(
    ("name", "precision", "recall"),
    [("shadow_map", 0.985, 0.985), ("first_blocker", 0.96, 0.5), ("continuous", 0.9, 0.5), ("quantized", 0.96, 0.5)],
)
def test_the_view_of_a_laser_is_true(
    name: str, precision: float, recall: float, target: Target, observed: tuple[Sweep, Truth, NDArray[np.bool_]]
) -> None:
    """The others know no beams that met nothing, nor how many beams a target needs."""
    sweep, truth, known = observed
    found = CLASSICAL[name](GRID, target).estimate(sweep)
    cells = ConfusionCounts.of(found.visible(), truth.visible(target), known, GRID.cell_area_m2)
    assert cells.both / (cells.both + cells.over) > precision
    assert cells.both / (cells.both + cells.under) > recall
