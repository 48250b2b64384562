"""What every estimator of both tables promises; a new one is covered by its line in the table."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed.estimators import (
    CLASSICAL,
    PAPER_ESTIMATORS,
    EstimatorFactory,
    paper_estimators,
)
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.preprocess.evidence import beam_evidence
from viewshed.preprocess.leveling import level
from viewshed.sweep import Sweep

EVERY = {**CLASSICAL, **PAPER_ESTIMATORS}
GRID = BevGrid(64, 16.0)


@pytest.fixture(params=EVERY.items(), ids=lambda item: item[0])
def named(request: pytest.FixtureRequest) -> tuple[str, EstimatorFactory]:
    item: tuple[str, EstimatorFactory] = request.param
    return item


@pytest.fixture
def make(named: tuple[str, EstimatorFactory]) -> EstimatorFactory:
    return named[1]


def same(a: FovEstimate, b: FovEstimate) -> bool:
    return all(
        np.array_equal(getattr(a, k), getattr(b, k), equal_nan=k == "std") for k in ("visible_prob", "std", "state")
    )


def _sees_nothing(estimate: FovEstimate) -> bool:
    return not estimate.visible().any() and bool((estimate.state == CellState.UNKNOWN).all())


@pytest.mark.parametrize("grid", [GRID, BevGrid(33, 12.0, (5.0, -3.0)), BevGrid(1, 4.0, (6.0, 0.0))], ids=str)
def test_an_estimate_is_on_its_own_grid(make: EstimatorFactory, street: Sweep, grid: BevGrid) -> None:
    assert make(grid).grid == make(grid).estimate(street).grid == grid


def test_free_or_surface_is_what_is_visible_and_what_the_beams_support(make: EstimatorFactory, street: Sweep) -> None:
    estimator, leveled = make(GRID), level(street, GRID)
    estimate = estimator.estimate(leveled)
    evidence = beam_evidence(leveled, GRID, estimator.target)
    supported = evidence.supports_claim()
    claimed = (estimate.state == CellState.FREE) | (estimate.state == CellState.SURFACE)
    assert claimed.any()
    assert np.array_equal(estimate.visible() & supported, claimed)
    assert np.array_equal(estimate.state == CellState.HIDDEN, ~estimate.visible() & evidence.supports_denial())
    obstacle = leveled.obstacle_cells(GRID)
    assert np.array_equal(estimate.state == CellState.SURFACE, claimed & obstacle)


def test_time_agent_and_pose_are_passed_on(make: EstimatorFactory, street: Sweep) -> None:
    pose = Rigid.from_yaw(0.5, (10.0, 20.0, 1.8))
    estimate = make(GRID).estimate(street.replace(world_from_sensor=pose))
    assert (estimate.t_ns, estimate.agent) == (5, "a")
    at_sensor = estimate.world_from_level @ np.array([[0.0, 0.0, 1.8]])
    np.testing.assert_allclose(at_sensor, [[10.0, 20.0, 1.8]], atol=1e-6)
    assert estimate.world_from_level.yaw == pytest.approx(0.5)


def test_the_sweep_is_left_as_it_was_and_gives_the_same_estimate(make: EstimatorFactory, street: Sweep) -> None:
    points, ring = street.points.copy(), np.array(street.ring)
    assert not street.points.flags.writeable
    assert same(make(GRID).estimate(street), make(GRID).estimate(street))
    np.testing.assert_array_equal(points, street.points)
    np.testing.assert_array_equal(ring, np.array(street.ring))


def _shuffled(sweep: Sweep) -> Sweep:
    return sweep.select(np.random.default_rng(3).permutation(len(sweep)))


@pytest.mark.parametrize("height_m", [None, 1.8])
def test_order_of_points_is_irrelevant(make: EstimatorFactory, street: Sweep, height_m: float | None) -> None:
    sweep = street.replace(sensor_height_m=height_m)
    assert same(make(GRID).estimate(sweep), make(GRID).estimate(_shuffled(sweep)))


def test_order_of_points_without_rings_leaves_the_mask(make: EstimatorFactory, street: Sweep) -> None:
    """Points that are stored ring after ring tell their rings; in any other order it does not matter which."""
    once = _shuffled(street.replace(ring=None))
    a, b = (make(GRID).estimate(sweep) for sweep in (once, _shuffled(once)))
    assert np.array_equal(a.visible(), b.visible())


def test_an_empty_sweep_sees_nothing_and_says_so(named: tuple[str, EstimatorFactory]) -> None:
    name, make = named
    estimate = make(GRID).estimate(Sweep(np.zeros((0, 3), np.float32)))
    assert _sees_nothing(estimate)
    assert not estimate.visible_prob.any()
    assert estimate.method == name


NO_RETURNS: dict[str, tuple[Any, Any, BevGrid, float]] = {
    "null": (-0.2, 0.2, GRID, 1.8),
    "of the own vehicle": ((-2.0, -0.9, -1.0), (2.0, 0.9, -0.3), GRID, 1.8),
    "null, of a low robot": (-0.25, 0.25, BevGrid(64, 4.0), 0.4),
    "beyond every range": (2_000, 3_000, GRID, 1.8),
}
"""Least and greatest coordinates of points, a grid, and the height of the sensor."""


@pytest.mark.parametrize("kind", NO_RETURNS)
def test_what_is_no_return_shows_nothing(make: EstimatorFactory, kind: str) -> None:
    low, high, grid, height_m = NO_RETURNS[kind]
    points = np.random.default_rng(0).uniform(low, high, (300, 3)).astype(np.float32)
    assert _sees_nothing(make(grid).estimate(Sweep(points, sensor_height_m=height_m)))


@pytest.mark.parametrize(
    "points",
    [
        [[8.0, 1.0, -1.8]],
        [[8.0, 1.0, -1.8], [3.0, 9.0, -1.8]],
        [[8.0, 1.0, -1.8]] * 500,
        np.stack([np.linspace(3, 15, 400), np.linspace(1, 5, 400), np.full(400, -1.8)], axis=1),
        np.stack([np.linspace(3, 15, 400), np.full(400, 0.25), np.full(400, -1.8)], axis=1),
        np.repeat([[8.0, 1.0, -1.8], [3.0, 9.0, -1.8], [7.0, 9.0, -1.8]], 50, axis=0),
        [[1e-30, 0.0, 0.0], [8.0, 1e-30, -1.8], [8.0, -1e-30, -1.8]],
    ],
    ids=["one", "two", "same", "line", "forward-line", "three-places", "tiny"],
)
@pytest.mark.parametrize("height_m", [None, 1.8])
def test_degenerate_points_claim_little(make: EstimatorFactory, points: NDArray[np.float64], height_m: float) -> None:
    estimate = make(GRID).estimate(Sweep(np.asarray(points, np.float32), sensor_height_m=height_m))
    assert estimate.visible().mean() < 0.1


def test_the_side_without_returns_is_not_claimed(make: EstimatorFactory, street: Sweep) -> None:
    estimate = make(GRID).estimate(street.select(street.points[:, 1] > 1.0))
    x, y = GRID.centers[..., 0], GRID.centers[..., 1]
    away = (y < -4) & (np.abs(x) < 8)
    ahead = (y > 3) & (np.abs(x) < 4) & (y < 6)
    assert not estimate.visible()[away].any()
    assert (estimate.state[away] == CellState.UNKNOWN).all()
    assert estimate.visible()[ahead].any()


def test_half_a_million_points_are_no_trouble(make: EstimatorFactory) -> None:
    rng = np.random.default_rng(1)
    azimuth, range_m = rng.uniform(-np.pi, np.pi, 500_000), 20 * np.sqrt(rng.random(500_000))
    points = np.stack([range_m * np.cos(azimuth), range_m * np.sin(azimuth), np.full(500_000, -1.8)], axis=1)
    estimate = make(GRID).estimate(Sweep(points.astype(np.float32), sensor_height_m=1.8))
    assert estimate.visible()[24:40, 24:40].mean() > 0.5


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        ("quantized", {"azimuth_bins": 3}, r"azimuth_bins must lie in \[4, 32000\], got 3"),
        ("quantized", {"max_range_m": -1.0}, r"max_range_m must be positive, got -1.0"),
        ("quantized", {"range_bins": 10}, r"range_bins need a finite max_range_m; give the range"),
        ("quantized", {"range_bins": 0, "max_range_m": 9.0}, r"range_bins must lie in \[1, 1e\+06\], got 0"),
        ("quantized", {"about_centroid": True}, r"azimuth_bins must be given with about_centroid"),
        ("continuous", {"window": 0.0}, r"window must lie in \[0.004, 1.5\], got 0.0"),
        ("continuous", {"margin_m": -1.0}, r"margin_m must lie in \[0, 100\], got -1.0"),
        ("concave_hull", {"concavity": 0.0}, r"concavity must lie in \[0.1, 1e\+06\], got 0.0"),
        ("concave_hull", {"length_threshold_m": np.nan}, r"length_threshold_m must lie in \[0, 1e\+06\], got nan"),
        ("delaunay", {"max_edge_m": 0.0}, r"max_edge_m must lie in \[0.01, 1e\+06\], got 0.0"),
        ("trimmed", {"trim": -1}, r"trim must lie in \[0, 1000\], got -1"),
        ("first_blocker", {"rank": 0}, r"rank must lie in \[1, 1000\], got 0"),
        ("first_blocker", {"median_bins": 4}, r"median_bins must be odd or 0, got 4"),
        (
            "first_blocker",
            {"obstacle_height_m": (3.0, 0.3)},
            r"must be \(low, high\) with low < high, got \(3.0, 0.3\)",
        ),
    ],
)
def test_parameters_outside_their_range_are_refused(name: str, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        CLASSICAL[name](GRID, **changes)


def test_the_paper_crop_drops_what_is_far_or_high(street: Sweep) -> None:
    high = np.stack([np.linspace(-9, 9, 50), np.full(50, 14.0), np.full(50, 3.2)], axis=1)
    far = np.stack([np.linspace(-9, 9, 50), np.full(50, 15.5), np.full(50, -1.8)], axis=1)
    near = street.select(np.hypot(street.points[:, 0], street.points[:, 1]) < 11).replace(ring=None)
    for name, make in paper_estimators(13.0).items():
        more = near.replace(points=np.concatenate([near.points, high, far]))
        assert np.array_equal(make(GRID).estimate(near).visible_prob, make(GRID).estimate(more).visible_prob), name
