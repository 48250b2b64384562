import numpy as np
import pytest

from viewshed import BevGrid, LidarModel
from viewshed_lab.sim import Box, Scene
from viewshed_lab.studies.crossview.simulated import ExactMask, drive, view

MODEL = LidarModel("test", np.deg2rad(np.linspace(-20, 2, 24)), azimuth_columns=720)
SCENE = Scene((Box(10.0, 4.0, 0.5, 6.0, 3.0), Box(-6.0, -9.0, 4.0, 2.0, 1.5, yaw=0.3)))


def test_a_view_lies_in_the_world_where_the_scene_is() -> None:
    sweep, _ = view(SCENE, MODEL, (3.0, -2.0, 0.7), 1.8, np.random.default_rng(0))
    assert sweep.world_from_sensor is not None
    world = sweep.world_from_sensor @ sweep.points
    on_wall = world[(np.abs(world[:, 0] - 9.75) < 0.1) & (world[:, 2] > 0.5)]
    assert len(on_wall) > 50
    assert on_wall[:, 1].min() == pytest.approx(1.0, abs=0.15)
    assert on_wall[:, 1].max() == pytest.approx(7.0, abs=0.15)


def test_the_exact_mask_hides_what_the_wall_hides() -> None:
    views = drive(SCENE, MODEL, [(0.0, 0.0, 0.0), (0.0, 0.0, np.pi)], np.random.default_rng(0))
    grid = BevGrid(128, 32.0)
    exact = ExactMask(grid, {sweep.t_ns or 0: beams for sweep, beams in views})
    ahead, turned = (exact.estimate(sweep) for sweep, _ in views)
    behind_wall, before_wall = np.array([20.0, 8.0]), np.array([7.0, 2.0])
    for estimate, sign in ((ahead, 1.0), (turned, -1.0)):
        assert float(estimate.at(sign * behind_wall)) == 0.0
        assert float(estimate.at(sign * before_wall)) > 0.99
