"""Scenes whose field of view is computed by hand; none looks the same when mirrored, turned or seen from elsewhere."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed.estimators import ESTIMATORS, PAPER_ESTIMATORS
from viewshed.estimators.first_blocker import FirstBlocker
from viewshed.estimators.ray_trace import QuantizedRayTrace
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.grid import BevGrid
from viewshed.preprocess.azimuth_bins import measured_azimuth_bins
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.sweep import Sweep

CastScene = Callable[..., Sweep]
MakeLevel = Callable[..., LeveledSweep]
GRID = BevGrid(80, 20.0)
WALL = (10.0, 10.5, -2.0, 6.0, 6.0)
CAR = (3.0, 5.0, 6.5, 8.5, 1.5)
RAYS = ["continuous", "quantized", "first_blocker", "first_blocker_median", "shadow_map", "majority_vote"]


def _iou(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> float:
    return float((a & b).sum() / (a | b).sum())


def _seen_past_wall(grid: BevGrid) -> NDArray[np.bool_]:
    """Cells whose center the wall at x = 10, y from -2 to 6, does not hide from the sensor (one cell of tolerance)."""
    x, y = grid.centers[..., 0], grid.centers[..., 1]
    at_wall = np.where(x > 0, y * 10.0 / np.where(x > 0, x, 1.0), np.inf)
    behind = (np.hypot(x, y) - grid.cell_m > np.hypot(10.0, at_wall)) & (at_wall > -2.0) & (at_wall < 6.0)
    return ~behind


def _at(estimate: FovEstimate, x: float, y: float) -> CellState:
    (i, j), inside = estimate.grid.index(np.array([x, y]))
    assert inside
    return CellState(int(estimate.state[i, j]))


@pytest.mark.parametrize("grid", [GRID, BevGrid(64, 16.0, (4.0, 3.0))], ids=["centered", "offset"])
@pytest.mark.parametrize("name", RAYS)
def test_a_wall_on_one_side_hides_what_is_behind_it(cast: CastScene, name: str, grid: BevGrid) -> None:
    estimate = ESTIMATORS[name](grid).estimate(cast([WALL]))
    assert _iou(estimate.visible(), _seen_past_wall(grid)) > 0.97
    assert _at(estimate, 14.0, 2.0) == CellState.HIDDEN
    assert _at(estimate, 8.0, 2.0) == CellState.FREE
    assert _at(estimate, 10.1, 2.1) == CellState.SURFACE


def test_the_label_about_the_centroid_is_worse_than_rays_from_the_sensor(cast: CastScene) -> None:
    # A front camera's crop of the sweep: its centroid lies meters ahead of the sensor, beside the wall's shadow.
    sweep = cast([WALL])
    sweep = sweep.select(sweep.points[:, 0] > np.abs(sweep.points[:, 1]))
    ahead = GRID.centers[..., 0] > np.abs(GRID.centers[..., 1])
    sound, label = (
        _iou(table[name](GRID).estimate(sweep).visible()[ahead], _seen_past_wall(GRID)[ahead])
        for table, name in ((ESTIMATORS, "quantized"), (PAPER_ESTIMATORS, "paper_label"))
    )
    assert sound > 0.97
    assert label < 0.9


def test_farthest_calls_the_hole_behind_a_low_car_visible(cast: CastScene) -> None:
    # The sensor is as high as the car's roof: rising beams pass over it to the tall wall, no target behind it shows.
    sweep = cast([CAR, (-15.0, 25.0, 18.0, 18.5, 5.0)], sensor_m=1.5)
    hole = (6.5, 12.5)
    estimates = {name: ESTIMATORS[name](GRID).estimate(sweep) for name in RAYS}
    assert {name for name, estimate in estimates.items() if estimate.at(np.array(hole)) >= 0.5} == {
        "continuous", "quantized"
    }  # fmt: skip
    # The beams do not support what these two claim.
    assert {name: _at(estimate, *hole) for name, estimate in estimates.items()} == {
        "continuous": CellState.UNKNOWN, "quantized": CellState.UNKNOWN, "first_blocker": CellState.HIDDEN,
        "first_blocker_median": CellState.HIDDEN, "shadow_map": CellState.HIDDEN, "majority_vote": CellState.HIDDEN,
    }  # fmt: skip
    for mirrored in ((6.5, -12.5), (12.5, 6.5), (-6.5, 12.5)):
        assert _at(ESTIMATORS["first_blocker"](GRID).estimate(sweep), *mirrored) == CellState.FREE


@pytest.mark.parametrize("name", RAYS)
def test_the_car_at_the_left_hides_only_there(cast: CastScene, name: str) -> None:
    # Sensor 1.3 m up, below the car's roof: nothing passes over it, every estimator must agree.
    estimate = ESTIMATORS[name](GRID).estimate(cast([CAR], sensor_m=1.3))
    assert _at(estimate, 7.5, 14.0) == CellState.HIDDEN
    for mirrored in ((7.5, -14.0), (14.0, 7.5), (-7.5, 14.0), (-14.0, -7.5)):
        assert _at(estimate, *mirrored) == CellState.FREE


def test_one_spoofed_point_opens_farthest_but_not_the_others(cast: CastScene) -> None:
    sweep = cast([WALL]).replace(ring=None)
    spoofed = sweep.replace(points=np.concatenate([sweep.points, [[19.5, 3.9, -1.8]]]))
    cell = (16.0, 3.3)
    seen = {
        name: bool(ESTIMATORS[name](GRID).estimate(spoofed).at(np.array(cell)) >= 0.5) for name in [*RAYS, "trimmed"]
    }
    assert seen == {
        "continuous": True, "quantized": True, "first_blocker": False, "first_blocker_median": False,
        "shadow_map": False, "majority_vote": False, "trimmed": False,
    }  # fmt: skip


def test_one_spoofed_near_point_blocks_first_blocker_but_not_rank_two_nor_the_median(cast: CastScene) -> None:
    sweep = cast([WALL]).replace(ring=None)
    spoofed = sweep.replace(points=np.concatenate([sweep.points, [[-3.9, 2.1, -0.8]]]))
    cell = np.array((-10.0, 5.05))
    seen = [
        float(estimator.estimate(spoofed).at(cell))
        for estimator in (FirstBlocker(GRID), FirstBlocker(GRID, rank=2), FirstBlocker(GRID, median_bins=5))
    ]
    assert seen == [0.0, 1.0, 1.0]


def test_range_bins_round_up_to_the_end_of_the_bin(make_level: MakeLevel) -> None:
    # 20 m in 10 bins: a return at 9.1 m is in the bin from 8 to 10 m; centers before 10 m are visible, 10.25 is not.
    leveled = make_level(np.array([[0.2, 9.1, 0.0]]))
    estimate = QuantizedRayTrace(GRID, azimuth_bins=36, range_bins=10, max_range_m=20.0).estimate(leveled)
    assert [float(estimate.at(np.array([0.3, y]))) for y in (9.6, 9.8, 10.1)] == [1.0, 1.0, 0.0]
    far = make_level(np.array([[0.2, 90.0, 0.0]]))
    estimate = QuantizedRayTrace(GRID, azimuth_bins=36, range_bins=10, max_range_m=12.0).estimate(far)
    assert [float(estimate.at(np.array([0.3, y]))) for y in (11.8, 12.2)] == [1.0, 0.0]


def _arc(range_m: float, height_m: float, azimuth_deg: float = 90.0) -> NDArray[np.float64]:
    """Returns at one range and height, half a degree apart, within 10° of an azimuth; none on a cell's border."""
    azimuth = np.deg2rad(azimuth_deg + np.arange(-10.0, 10.5, 0.5) + 0.1)
    return np.stack([range_m * np.cos(azimuth), range_m * np.sin(azimuth), np.full(len(azimuth), height_m)], axis=1)


def test_low_and_high_returns_do_not_block(make_level: MakeLevel) -> None:
    # Beams from 1.8 m: those that end on the wall at 9 m, 1 m up, aim at cars until 23.6 m.
    lines = [_arc(5.0, 0.2), _arc(6.0, 3.5), _arc(9.0, 1.0)]
    at = (7.0, 8.9, 12.0, 18.0, 24.6)
    grid = BevGrid(100, 25.0)
    estimator = FirstBlocker(grid, azimuth_bins=36)
    walled = estimator.estimate(make_level(np.concatenate(lines)))
    assert [float(walled.at(np.array([0.2, y]))) for y in at] == [1.0, 1.0, 0.0, 0.0, 0.0]
    assert [_at(walled, 0.2, y) for y in at] == [
        CellState.FREE, CellState.SURFACE, CellState.HIDDEN, CellState.HIDDEN, CellState.UNKNOWN,
    ]  # fmt: skip
    # Beams that meet the ground at 15 m, through the wall's gaps, reach what it denies at 12 m, and aim lower at 18 m.
    gaps = estimator.estimate(make_level(np.concatenate([*lines, _arc(15.0, 0.0)])))
    assert [float(gaps.at(np.array([0.2, y]))) for y in at] == [1.0, 1.0, 0.0, 0.0, 0.0]
    assert [_at(gaps, 0.2, y) for y in at] == [
        CellState.FREE, CellState.SURFACE, CellState.UNKNOWN, CellState.HIDDEN, CellState.UNKNOWN,
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("columns", "bins"), [(2000, 1080), (1080, 1080), (700, 540), (330, 216), (180, 180), (7, 360)]
)
def test_bins_follow_the_measured_step(columns: int, bins: int) -> None:
    azimuth = ((np.arange(columns) + 0.4) * 2 * np.pi / columns - np.pi).astype(np.float32)
    assert measured_azimuth_bins(np.tile(azimuth, 3)) == bins
