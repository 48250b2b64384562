"""Ground of several sweeps: by hand, and against the terrain."""

import numpy as np
import pytest
from tests.data.labeling.scene import GRID, TERRAIN, Shot

from viewshed.geometry import Rigid
from viewshed.preprocess.leveling import level
from viewshed_lab.data.labeling.ground_map import Patch, lows_of, patch_of
from viewshed_lab.data.labeling.labeler import LabelRules, lows_of_sweep

RULES = LabelRules(GRID)


def test_the_two_lowest_and_the_highest_of_a_node_are_kept_in_the_world() -> None:
    points = np.array([[0.2, 0.1, 3.0], [0.3, 0.2, 1.0], [0.1, 0.3, 2.0], [0.2, 5.1, 9.0], [80.0, 0, 0]], np.float32)
    lows = lows_of(points, Rigid.from_yaw(np.pi / 2, (100.0, 50.0, 10.0)), 1.0, 20.0)
    assert lows.node.tolist() == [[94, 50], [99, 50]]
    assert lows.points[1].round(4).tolist() == [[99.8, 50.3, 11.0], [99.7, 50.1, 12.0]]
    assert lows.points[0, 0].round(4).tolist() == [94.9, 50.2, 19.0]
    assert np.isnan(lows.points[0, 1]).all()
    assert lows.top_m[1] == pytest.approx(13.0)
    assert np.isnan(lows.top_m[0])


def _errors(patch: Patch, one: Shot) -> np.ndarray:
    """Return how far the ground is wrong in the outer half of the grid (cells,)."""
    pose, xy = one.scan.world_from_sensor, GRID.centers.reshape(-1, 2)
    far = xy[np.hypot(*xy.T) > GRID.half_extent_m / 2]
    world = pose @ np.concatenate([far, np.zeros((len(far), 1))], axis=1)
    wrong: np.ndarray = np.abs(patch.at(far) - (TERRAIN.at(world) - pose.translation[2]))
    return wrong


def test_neighbors_in_time_show_the_far_ground(drive: list[Shot]) -> None:
    lows = [lows_of_sweep(one.sweep, RULES) for one in drive]
    leveled = level(drive[4].sweep, GRID)
    alone = _errors(patch_of(leveled, [lows[4]], GRID.half_extent_m, RULES.node_m), drive[4])
    together = _errors(patch_of(leveled, lows, GRID.half_extent_m, RULES.node_m), drive[4])
    assert together.mean() < 0.7 * alone.mean()
    assert np.quantile(together, 0.9) < 0.25
