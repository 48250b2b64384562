"""Scenes whose field of view is computed by hand; none looks the same when mirrored, turned or seen from elsewhere."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed.estimators import ESTIMATORS, PAPER_ESTIMATORS
from viewshed.estimators.first_blocker import FirstBlocker
from viewshed.estimators.ray_trace import ContinuousRayTrace, QuantizedRayTrace, TrimmedRayTrace
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


def test_hull_and_polygon_fit_follow_the_returns(cast: CastScene) -> None:
    sweep = cast([WALL], reach_m=14.0)
    for name in ("concave_hull", "delaunay"):
        estimate = ESTIMATORS[name](GRID).estimate(sweep)
        assert _at(estimate, -9.0, -6.0) == CellState.FREE, name
        assert _at(estimate, 16.0, 2.0) == CellState.HIDDEN, name
        assert _at(estimate, -17.0, -6.0) == CellState.UNKNOWN, name
        assert _at(estimate, 9.0, 3.0) in (CellState.FREE, CellState.SURFACE), name
    assert (
        ESTIMATORS["delaunay"](GRID).estimate(sweep).area_m2()
        < ESTIMATORS["concave_hull"](GRID).estimate(sweep).area_m2()
    )


def test_polygon_fit_breaks_up_where_rings_lie_apart(make_level: MakeLevel) -> None:
    azimuth = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    rings = [np.stack([r * np.cos(azimuth), r * np.sin(azimuth), 0 * azimuth], axis=1) for r in (4, 6, 8, 15)]
    leveled = make_level(np.concatenate(rings))
    fit = ESTIMATORS["delaunay"](GRID).estimate(leveled)
    seen = {r: float(fit.at(np.array([0.3, r]))) for r in (5.0, 7.0, 11.0)}
    assert seen == {5.0: 1.0, 7.0: 1.0, 11.0: 0.0}


def test_range_bins_round_up_to_the_end_of_the_bin(make_level: MakeLevel) -> None:
    # 20 m in 10 bins: a return at 9.1 m is in the bin from 8 to 10 m; centers before 10 m are visible, 10.25 is not.
    leveled = make_level(np.array([[0.2, 9.1, 0.0]]))
    estimate = QuantizedRayTrace(GRID, azimuth_bins=36, range_bins=10, max_range_m=20.0).estimate(leveled)
    assert [float(estimate.at(np.array([0.3, y]))) for y in (9.6, 9.8, 10.1)] == [1.0, 1.0, 0.0]
    far = make_level(np.array([[0.2, 90.0, 0.0]]))
    estimate = QuantizedRayTrace(GRID, azimuth_bins=36, range_bins=10, max_range_m=12.0).estimate(far)
    assert [float(estimate.at(np.array([0.3, y]))) for y in (11.8, 12.2)] == [1.0, 0.0]


def test_trimmed_drops_exactly_the_farthest(make_level: MakeLevel) -> None:
    y = np.arange(2.0, 12.0)
    leveled = make_level(np.stack([0 * y - 0.05, y, 0 * y], axis=1))
    grid = BevGrid(65, 16.25)
    assert grid.cell_m == 0.5
    for trim, last in ((0, 11.5), (3, 8.5), (9, 2.5), (10, None)):
        estimate = TrimmedRayTrace(grid, trim=trim, azimuth_bins=36).estimate(leveled)
        seen = [float(r) for r in np.arange(0.5, 14.0, 0.5) if estimate.at(np.array([0.0, r])) == 1.0]
        assert (max(seen) if seen else None) == last


def test_first_blocker_without_farthest_limit_sees_to_the_reach(make_level: MakeLevel) -> None:
    # Without a table, and with returns as near as here, the reach is 85 m, and a cell's center may lie one cell of
    # 0.5 m beyond it.
    grid = BevGrid(360, 90.0)
    leveled = make_level(np.array([[0.1, 5.0, 0.0], [9.0, 0.1, 0.0], [-12.0, -0.1, 0.0]]))
    limited, open_ = (
        FirstBlocker(grid, azimuth_bins=36, limit_farthest=limit).estimate(leveled) for limit in (True, False)
    )
    assert [float(e.at(np.array([0.3, 9.0]))) for e in (limited, open_)] == [0.0, 1.0]
    assert [float(open_.at(np.array([0.3, y]))) for y in (85.3, 85.8)] == [1.0, 0.0]
    assert not open_.visible()[:, : grid.cells // 2 - 30].any()
    # One beam is too few to support what either says.
    assert (limited.state == CellState.UNKNOWN).all()
    assert (open_.state == CellState.UNKNOWN).all()


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


def test_beyond_the_farthest_return_is_hidden_by_an_obstacle_and_unknown_on_ground(make_level: MakeLevel) -> None:
    # A beam that ends at 6 m, 1 m up, is .23 m up at 11.8 m; one that meets the ground there would be far below it.
    points = np.concatenate([_arc(6.0, 1.0), _arc(6.0, 0.0, 0.0), _arc(15.0, 0.0, 180.0)])
    for estimator in (QuantizedRayTrace(GRID, azimuth_bins=36), ESTIMATORS["continuous"](GRID)):
        estimate = estimator.estimate(make_level(points))
        assert _at(estimate, 0.2, 11.8) == CellState.HIDDEN
        assert _at(estimate, 11.8, 0.2) == CellState.UNKNOWN
        assert _at(estimate, -17.9, 0.2) == CellState.UNKNOWN
        assert _at(estimate, 0.2, -11.8) == CellState.UNKNOWN


@pytest.mark.parametrize(
    ("columns", "bins"), [(2000, 1080), (1080, 1080), (700, 540), (330, 216), (180, 180), (7, 360)]
)
def test_bins_follow_the_measured_step(columns: int, bins: int) -> None:
    azimuth = ((np.arange(columns) + 0.4) * 2 * np.pi / columns - np.pi).astype(np.float32)
    assert measured_azimuth_bins(np.tile(azimuth, 3)) == bins


def test_the_window_reaches_across_the_back(make_level: MakeLevel) -> None:
    # The cell's center is at (-9.75, 0.25), 0.02564 rad before half a turn; returns stand on the other side of it.
    cell = np.array([-9.75, 0.25])
    for turn, seen in ((0.049, 1.0), (0.051, 0.0)):
        azimuth = np.arctan2(cell[1], cell[0]) + turn
        leveled = make_level(np.array([[12 * np.cos(azimuth), 12 * np.sin(azimuth), 0.0]]))
        assert leveled.azimuth[0] < -3
        assert float(ContinuousRayTrace(GRID, window=0.05).estimate(leveled).at(cell)) == seen


def test_the_median_leaves_out_azimuths_without_returns(make_level: MakeLevel) -> None:
    leveled = make_level(np.array([[0.2, 5.0, 1.0], [0.2, 12.0, 0.0]]))
    estimate = FirstBlocker(GRID, azimuth_bins=36, median_bins=5).estimate(leveled)
    assert [float(estimate.at(np.array([0.2, y]))) for y in (4.0, 9.0)] == [1.0, 0.0]


def test_bins_of_a_cropped_sweep_follow_its_step() -> None:
    azimuth = (np.arange(330)[:80] * 2 * np.pi / 330).astype(np.float32)
    assert measured_azimuth_bins(azimuth) == 216
