"""Reach: how far a sensor sees, and what returns beyond it can do."""

import numpy as np
import pytest

from viewshed import BevGrid
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.preprocess.leveling import level
from viewshed.preprocess.reach import USUAL_REACH_M, returns_beyond, sensing_reach
from viewshed.sensors import LidarModel, lidar_model, sensor_names
from viewshed_lab.sim import Box, Scene, cast


@pytest.mark.parametrize("name", sensor_names())
def test_a_table_tells_its_reach_and_who_says_so(name: str) -> None:
    model = lidar_model(name)
    assert model.min_range_m < model.reach_m <= model.max_range_m
    assert len(model.reach_source) > 10
    assert sensing_reach(model) == model.reach_m


def test_what_is_usual_is_the_median_of_the_tables() -> None:
    assert np.median([lidar_model(name).reach_m for name in sensor_names()]) == USUAL_REACH_M


def test_the_maximum_range_of_a_table_without_a_reach_bounds_the_usual_one() -> None:
    assert sensing_reach(LidarModel("near", np.deg2rad([-10.0, 0.0]), 900, max_range_m=30.0)) == 30.0
    assert sensing_reach(LidarModel("far", np.deg2rad([-10.0, 0.0]), 900, max_range_m=300.0)) == USUAL_REACH_M
    assert sensing_reach(None) == USUAL_REACH_M


def test_returns_beyond_the_maximum_are_counted() -> None:
    points = np.array([[99.0, 0, 0], [0, 101.0, 0], [80.0, 80.0, 0]], np.float32)
    assert returns_beyond(points, lidar_model("vlp16")) == 2
    assert returns_beyond(points, None) == 0


def test_what_lies_beyond_the_maximum_of_a_known_sensor_proves_nothing() -> None:
    model = lidar_model("os0_128")
    wall = Scene((Box(25.0, 0.0, 0.2, 60.0, 8.0),))
    honest = cast(model, wall, 1.8)
    ahead = np.abs(np.arctan2(honest.points[:, 1], honest.points[:, 0])) < np.deg2rad(8)
    moved = honest.points.copy()
    moved[ahead] *= (200.0 / np.linalg.norm(moved[ahead], axis=1))[:, None]
    grid = BevGrid(128, 64.0)
    removed, spoofed = honest.select(~ahead), honest.replace(points=moved)
    assert level(spoofed, grid).points.shape == level(removed, grid).points.shape
    claimed = ShadowMap(grid).estimate(spoofed).visible() & ~ShadowMap(grid).estimate(removed).visible()
    assert claimed.sum() == 0
