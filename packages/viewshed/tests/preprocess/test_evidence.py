"""Evidence decides the states: contracts over every estimator, beams counted one by one, and cases made by hand."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import poisson
from tests.preprocess.test_unseen_ground import level_points, rings

from viewshed import CAR, GRIDS, PEDESTRIAN, BevGrid, CellState, Rigid, Sweep, _core
from viewshed.arrays import Mask
from viewshed.estimators import CLASSICAL, ESTIMATORS, load_estimator
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.estimators.unet import LEARNED
from viewshed.fov.height_map import HeightMap
from viewshed.fov.visibility import Target, poisson_table
from viewshed.grid import polar_of_cells
from viewshed.preprocess.evidence import BeamEvidence, beam_evidence
from viewshed.preprocess.history import History
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.preprocess.reach import reach_of_sweep
from viewshed.sensors import LidarModel, lidar_model
from viewshed_lab.data.presets import preset_named
from viewshed_lab.data.simulated import ScenePlan, simulate_frame
from viewshed_lab.sim import Box, Scene, cast
from viewshed_lab.threats.attacks import ATTACKS

ROAD = GRIDS["road"]
SENSOR_M = 1.8
UNKNOWN, FREE, SURFACE, HIDDEN = CellState.UNKNOWN, CellState.FREE, CellState.SURFACE, CellState.HIDDEN

# Contracts over every estimator.


def simulated() -> Sweep:
    return simulate_frame(ScenePlan(preset_named("nuscenes"), 0, 2), 4).sweep


def attacked(name: str) -> Sweep:
    return ATTACKS[name](200).apply(simulated(), np.random.default_rng(7)).sweep


SWEEPS: dict[str, Callable[[], Sweep]] = {
    "simulated": simulated,
    "bare cloud": lambda: Sweep(np.random.default_rng(1).permutation(simulated().points)),
    "open field": lambda: cast(lidar_model("hdl64e"), Scene(), SENSOR_M),
    "far wall": lambda: attacked("far_wall"),
    "removed": lambda: attacked("removal"),
    "empty": lambda: Sweep(np.zeros((0, 3), np.float32), sensor_height_m=SENSOR_M),
}


@lru_cache(maxsize=len(SWEEPS))
def leveled_sweep(kind: str) -> LeveledSweep:
    return level(SWEEPS[kind](), ROAD)


def claimed_in(state: NDArray[np.uint8]) -> Mask:
    return np.isin(state, [FREE, SURFACE])


@pytest.mark.parametrize("kind", SWEEPS)
@pytest.mark.parametrize("name", ESTIMATORS)
def test_states_are_told_only_where_the_beams_support_them(name: str, kind: str) -> None:
    leveled, estimator = leveled_sweep(kind), load_estimator(name, passes=2 if name == "mc_dropout" else None)
    estimate, evidence = estimator.estimate(leveled), beam_evidence(leveled, ROAD, CAR)
    claimed, hidden = claimed_in(estimate.state), estimate.state == HIDDEN
    assert not (claimed & ~evidence.supports_claim()).any()
    assert not (hidden & ~evidence.supports_denial()).any()
    beyond = np.hypot(*np.moveaxis(ROAD.centers, -1, 0)) > reach_of_sweep(leveled) + 1e-3
    assert (estimate.state[beyond] == UNKNOWN).all()
    assert beyond.any() or kind == "open field"  # an HDL-64E reaches beyond the grid
    if kind == "empty":
        assert (estimate.state == UNKNOWN).all()
        return
    assert claimed.any()
    assert hidden.any() or kind == "open field"
    # What it claims is also what it calls visible; those that ask the beams call nothing else visible.
    assert not (claimed & ~estimate.visible()).any()
    if name == "shadow_map" or name in LEARNED:
        assert np.array_equal(estimate.visible(), claimed)
        assert (estimate.visible_prob[beyond] < estimator.threshold).all()


@pytest.mark.parametrize("name", ["shadow_map", "majority_vote"])
def test_nothing_is_claimed_beyond_the_reach(name: str) -> None:
    leveled, estimator = leveled_sweep("simulated"), load_estimator(name)
    near = replace(lidar_model("hdl32e"), reach_m=20.0)
    short = replace(leveled, sweep=leveled.sweep.replace(model=near), sensor_id=replace(leveled.sensor_id, model=near))
    beyond = polar_of_cells(ROAD)[0] > 20.0
    assert claimed_in(estimator.estimate(leveled).state)[beyond].any()
    estimate = estimator.estimate(short)
    assert (estimate.state[beyond] == UNKNOWN).all()
    assert claimed_in(estimate.state)[~beyond].any()


@pytest.mark.parametrize("kind", SWEEPS)
def test_no_cell_may_be_claimed_and_denied(kind: str) -> None:
    evidence = beam_evidence(leveled_sweep(kind), ROAD, CAR)
    assert not (evidence.supports_claim() & evidence.supports_denial()).any()
    assert not (evidence.supports_claim() & (evidence.reaching < CAR.min_returns - 0.5)).any()
    assert not (evidence.supports_denial() & (evidence.aimed < CAR.min_returns - 0.5)).any()
    assert evidence.visible_prob.min() >= 0
    assert evidence.visible_prob.max() <= 1 + 1e-6


# Beams counted one by one, from the definition of visible.


def made_level(points: NDArray[np.float32], ground: HeightMap) -> LeveledSweep:
    """A level sweep of points (M, 3) in the level frame."""
    x, y = points[:, 0].astype(np.float64), points[:, 1].astype(np.float64)
    return LeveledSweep(
        Sweep(points - np.array([0, 0, SENSOR_M], np.float32), sensor_height_m=SENSOR_M), points,
        np.hypot(x, y).astype(np.float32), np.arctan2(y, x).astype(np.float32), points[:, 2].copy(),
        np.arange(len(points), dtype=np.int32), Rigid(np.eye(3), np.array([0.0, 0.0, SENSOR_M])), ground,
    )  # fmt: skip


def count_one_by_one(
    leveled: LeveledSweep, grid: BevGrid, target: Target, ground_m: float, widen: float, depths: bool
) -> NDArray[np.int64]:
    """Beams (cells, cells) whose azimuth falls inside the target's width at a cell's range, ``widen`` radians more on
    either side, whose height there is that of the target (or 0.3 m below ground), and whose depth reaches it less one
    cell."""
    counts = np.zeros(grid.shape, np.int64)
    azimuth, depth_m = leveled.azimuth.astype(np.float64), leveled.range_m.astype(np.float64)
    slope = (leveled.points[:, 2].astype(np.float64) - SENSOR_M) / depth_m
    for i, j in np.ndindex(*grid.shape):
        x, y = grid.centers[i, j]
        r = (np.floor(np.hypot(x, y) / grid.cell_m) + 0.5) * grid.cell_m  # ranges are told apart by cells
        away = np.abs(np.angle(np.exp(1j * (azimuth - np.arctan2(y, x)))))
        height_m = SENSOR_M + slope * r - ground_m
        meets = (away <= np.arctan2(target.width_m / 2, r) + widen) & (height_m >= -0.3) & (height_m <= target.height_m)
        counts[i, j] = (meets & ((depth_m >= r - grid.cell_m) | (not depths))).sum()
    return counts


@pytest.mark.parametrize("target", [CAR, PEDESTRIAN], ids=lambda target: target.name)
@pytest.mark.parametrize("grid", [BevGrid(20, 10.0), BevGrid(12, 15.0, (4.0, 2.0))], ids=str)
@pytest.mark.parametrize("std_m", [0.0, 0.4])
def test_evidence_is_the_definition_beam_by_beam(target: Target, grid: BevGrid, std_m: float) -> None:
    rng = np.random.default_rng(5)
    azimuth, depth_m = rng.uniform(-np.pi, np.pi, 500), 22.0 * np.sqrt(rng.random(500))
    height_m = np.where(rng.random(500) < 0.5, rng.uniform(-0.2, 0.2, 500), rng.uniform(0.2, 2.5, 500))
    points = np.stack([depth_m * np.cos(azimuth), depth_m * np.sin(azimuth), height_m], axis=1).astype(np.float32)
    leveled = made_level(points, HeightMap.flat(40.0, 0.0, std_m))
    evidence = beam_evidence(leveled, grid, target)
    # Windows end within a column of azimuth: cells in which a beam does, at any height of the ground, are not sure.
    column = 2 * np.pi / _core.AZIMUTH_COLUMNS
    steps = [(0.0, 0.4), (-1.22, 0.3), (1.22, 0.3)]
    prob, sure = np.zeros(grid.shape), np.ones(grid.shape, np.bool_)
    for deviations, weight in steps:
        least, most = (
            count_one_by_one(leveled, grid, target, deviations * std_m, way * column, True) for way in (-1.0, 1.0)
        )
        sure &= least == most
        prob += weight * poisson.sf(target.min_returns - 1, most)
        if deviations == 0.0:
            assert (evidence.measured >= least - 1e-3).all()
            assert (evidence.measured <= most + 1e-3).all()
            enough = most >= target.min_returns
    assert sure.mean() > 0.3
    assert not evidence.inferred.any()
    assert (evidence.late <= evidence.inferred).all()
    within = np.hypot(*np.moveaxis(grid.centers, -1, 0)) <= reach_of_sweep(leveled)
    assert np.array_equal(evidence.within_reach, within)
    # The mean over the heights, but no claim by other heights alone; what the mean claims as well, is claimed.
    assert np.abs(evidence.counted_prob - prob)[sure].max() < 1e-5
    clear, claimed = sure & (np.abs(prob - 0.5) > 1e-3), evidence.supports_claim()
    assert not (claimed & ~(enough & within))[clear].any()
    assert claimed[clear & enough & within & (prob > 0.5)].all()
    assert 0 < claimed[clear].mean() < 1
    if std_m:
        assert (enough & (prob < 0.5) & within)[clear].any()


def test_beams_that_aim_are_counted_whatever_their_depth() -> None:
    # Rings of 360 beams at slopes that lie between two slopes of the histogram, all stopped at 3 m.
    slopes, azimuth = np.array([-0.30, -0.22, -0.15, -0.10, -0.05, -0.02, 0.1]), np.deg2rad(np.arange(-180, 180) + 0.5)
    xy = 3.0 * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    points = np.concatenate([np.column_stack([xy, np.full(360, SENSOR_M + 3.0 * slope)]) for slope in slopes])
    leveled, grid = made_level(points.astype(np.float32), HeightMap.flat(40.0)), BevGrid(36, 18.0)
    near = LidarModel("near", np.arctan(slopes), 360, max_range_m=20.0)
    leveled = replace(leveled, sensor_id=replace(leveled.sensor_id, model=near))
    evidence = beam_evidence(leveled, grid, CAR)
    r = (np.floor(np.hypot(*np.moveaxis(grid.centers, -1, 0)) / grid.cell_m) + 0.5) * grid.cell_m
    # A slope within a bin of the histogram (1/256) of the foot or the top may count in part.
    low, high = (-SENSOR_M - 0.3) / r, (CAR.height_m - SENSOR_M) / r
    clear = (np.abs(slopes[:, None, None] - np.stack([low, high])[:, None]) > 0.004).all(axis=(0, 1))
    rings_aimed = ((slopes[:, None, None] >= low) & (slopes[:, None, None] <= high)).sum(axis=0)
    expected = rings_aimed * 360 * 2 * np.arctan2(CAR.width_m / 2, r) / (2 * np.pi)
    assert clear.mean() > 0.4
    assert np.abs(evidence.aimed - expected)[clear].max() < 0.6 * rings_aimed.max()
    # Nothing reaches beyond 3 m: hidden wherever enough aim, within a reach of 20 m.
    far = clear & (r > 4.5) & (np.abs(expected - CAR.min_returns) > 0.6 * rings_aimed.max())
    denied = (expected >= CAR.min_returns) & (np.hypot(*np.moveaxis(grid.centers, -1, 0)) <= 20.0)
    assert np.array_equal(evidence.supports_denial()[far], denied[far])
    assert 0 < denied[far].mean() < 1
    assert not evidence.supports_claim()[far].any()


# Cases by hand: five expected returns show a car with P .56, four with P .37; seven beams that aim are enough with
# P .83, nine with P .95.

CASES = (
    # measured, inferred, aimed, P, within reach: visible, denied, neither
    ((9, 0, 9, 0.94, True), FREE, UNKNOWN),
    ((0, 5, 9, 0.56, True), FREE, UNKNOWN),
    ((3, 2, 9, 0.56, True), FREE, UNKNOWN),
    ((4, 0, 9, 0.37, True), UNKNOWN, HIDDEN),
    ((0, 0, 9, 0.00, True), UNKNOWN, HIDDEN),
    ((0, 0, 7, 0.00, True), UNKNOWN, UNKNOWN),
    ((0, 0, 0, 0.00, True), UNKNOWN, UNKNOWN),
    ((9, 0, 9, 0.45, True), UNKNOWN, UNKNOWN),
    ((9, 0, 9, 0.00, False), UNKNOWN, UNKNOWN),
    ((0, 0, 9, 0.00, False), UNKNOWN, UNKNOWN),
)


EVERY, NONE = np.ones((4, 4), np.bool_), np.zeros((4, 4), np.bool_)


def evidence_by_hand() -> BeamEvidence:
    grid, columns = BevGrid(4, 8.0), np.zeros((5, 16), np.float32)
    columns[:, : len(CASES)] = np.array([case for case, *_ in CASES], np.float32).T
    measured, inferred, aimed, prob, within = columns.reshape(5, 4, 4)
    return BeamEvidence(grid, CAR, measured, inferred, inferred, aimed, prob, prob, within == 1.0, 80.0)


def test_each_state_needs_its_beams() -> None:
    evidence, every, none = evidence_by_hand(), EVERY, NONE
    claimed, denied, doubted, on_obstacles = (
        evidence.states(*masks).reshape(-1)[: len(CASES)].tolist()
        for masks in ((every, none, none), (none, every, none), (none, none, every), (every, none, every))
    )
    assert claimed == [wanted for _, wanted, _ in CASES]
    assert denied == [wanted for *_, wanted in CASES]
    assert doubted == [UNKNOWN] * len(CASES)
    assert on_obstacles == [SURFACE if wanted == FREE else UNKNOWN for _, wanted, _ in CASES]


def test_cells_that_late_ends_would_show_are_not_hidden() -> None:
    evidence, every, none = evidence_by_hand(), EVERY, NONE
    late = replace(evidence, late=evidence.late + np.float32(5.0))
    assert (evidence.states(none, every, none) == HIDDEN).any()
    assert not (late.states(none, every, none) == HIDDEN).any()
    assert np.array_equal(late.states(every, none, none), evidence.states(every, none, none))


def test_claims_that_rest_on_inferred_beams_or_on_unsure_ground_are_counted() -> None:
    evidence, every, none = evidence_by_hand(), EVERY, NONE
    first = np.arange(16).reshape(4, 4) == 0
    node = np.arange(16, dtype=np.int32).reshape(4, 4)
    std_m = np.where(np.arange(16) == 1, 0.6, 0.1).astype(np.float32).reshape(4, 4)
    for visible, counted in ((every, (3, 1, 2)), (first, (1, 0, 0)), (none, (0, 0, 0))):
        state = evidence.states(visible, none, none)
        table = poisson_table(evidence.target.min_returns)
        counts = _core.claims(state, evidence.measured, node, std_m, table=table)
        assert counts == counted


# Ground that no beam met.


def quarry(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Level, and from 6 m to the left on 6 m deep: beams from 1.8 m over its edge meet the floor from 26 m on.

    The beam over the edge passes at 1.8 - 0.3 y. It meets a car on the floor from 21 m on; a car halfway between the
    floor and the beam from 16 m on.
    """
    return np.where((y > 6.0) & (np.abs(x) < 40.0), -6.0, 0.0)


def embankment(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Level to 10 m at the left, then fields 5 m lower: the beam over the edge passes at 1.8 - 0.18 y.

    It meets a car in the fields from 29.4 m on, one halfway between the fields and the beam from 21.1 m on.
    """
    return np.where(y > 10.0, -5.0, 0.0) + 0.0 * x


@pytest.mark.parametrize(
    ("relief", "edge_m", "beyond_m"), [(quarry, 6.0, 15.0), (embankment, 10.0, 18.5)], ids=["quarry", "embankment"]
)
def test_ground_that_no_beam_met_is_a_guess_that_says_so(relief: Any, edge_m: float, beyond_m: float) -> None:
    """Behind an edge a bank is likelier than a wall: some meters are claimed, with doubt, and nothing beyond them."""
    leveled = _relief_level(relief)
    estimate = ShadowMap(ROAD).estimate(leveled)
    x, y = ROAD.centers[..., 0], ROAD.centers[..., 1]
    ahead = np.abs(x) < 5.0
    behind, far = (ahead & (y > low_m) & (y < beyond_m + 0.5) for low_m in (edge_m + 4.0, beyond_m))
    std_m = replace(leveled.ground, heights_m=leveled.ground.std_m).at(ROAD.centers)
    assert std_m[behind].min() > 0.3
    assert estimate.visible_prob[behind].max() < 0.9
    for method in CLASSICAL.values():
        assert not claimed_in(method(ROAD).estimate(leveled).state[far]).any()
    assert claimed_in(estimate.state[ahead & (y > -12.0) & (y < -4.0)]).mean() > 0.95


@lru_cache(maxsize=2)
def _relief_level(relief: Any) -> LeveledSweep:
    return level_points(rings(relief))


# Once for a sweep.


def street_at(x_m: float) -> LeveledSweep:
    model = LidarModel("test", np.deg2rad(np.linspace(-25, 5, 24)), azimuth_columns=360, max_range_m=150.0)
    sweep = cast(model, Scene((Box(12.0 - x_m, 3, 0.5, 10, 4), Box(-8.0 - x_m, -6, 4.2, 1.8, 1.5))), SENSOR_M)
    return level(sweep.replace(world_from_sensor=Rigid(np.eye(3), np.array([x_m, 0.0, SENSOR_M]))), BevGrid(32, 16.0))


def test_evidence_is_computed_once_for_a_sweep_a_grid_a_target_and_a_history() -> None:
    grid, leveled, before = BevGrid(32, 16.0), street_at(1.0), street_at(0.0)
    alone = beam_evidence(leveled, grid, CAR)
    history = History.of(leveled, [before])
    with_history = beam_evidence(leveled, grid, CAR, history)
    assert beam_evidence(leveled, BevGrid(32, 16.0), CAR) is alone
    assert beam_evidence(leveled, grid, CAR, history) is with_history
    for other in (
        beam_evidence(leveled, BevGrid(16, 16.0), CAR), beam_evidence(leveled, grid, PEDESTRIAN),
        beam_evidence(leveled, grid, CAR, History.of(leveled, [before])), beam_evidence(before, grid, CAR),
        beam_evidence(before, grid, CAR, history),
    ):  # fmt: skip
        assert other is not alone
        assert other is not with_history
    with pytest.raises(ValueError, match="read-only"):
        alone.measured[0, 0] = 1.0
