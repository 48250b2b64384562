"""The envelope against an independent checker and by its laws."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from tests.guarantees import brute_force, toy

from viewshed import _core
from viewshed.arrays import F32
from viewshed.fov.height_map import HeightMap
from viewshed.fov.visibility import CAR
from viewshed.geometry import rotation_from_quaternion
from viewshed.grid import GRIDS, polar_of_cells
from viewshed.guarantees.envelope import FOOT_M, SECTORS, Envelope, Given, Kind, Threat
from viewshed.sensors import LidarModel, lidar_model
from viewshed.sweep import Sweep

SEEDS = st.integers(0, 2**32 - 1)
GAP = 4


def columns_of(model: LidarModel, fired: NDArray[np.uint8] | None = None) -> _core.TargetColumns:
    range_m, azimuth = polar_of_cells(toy.GRID)
    rings, columns = model.rings, model.azimuth_columns
    return _core.TargetColumns(
        range_m, azimuth, fired, rings, columns, toy.GRID.cell_m, CAR.width_m, model.max_range_m
    )  # fmt: skip


def twice(row: NDArray[Any]) -> F32:
    """Return one turn (columns,) or (rings, columns) as the circle twice (rings, 2 · columns)."""
    return np.ascontiguousarray(np.tile(np.atleast_2d(row), (1, 2)), np.float32)


def without_gaps(row: NDArray[Any], fired: NDArray[np.uint8] | None = None) -> F32:
    model = LidarModel("one", np.array([0.0]), row.shape[-1])
    return _core.without_gaps(twice(row), columns_of(model, fired))


def checked_margins(sweep: Sweep, grade: float = 0.0) -> NDArray[Any]:
    rotation = rotation_from_quaternion(sweep.attitude)
    checker: Any = brute_force  # without types
    nearest = checker.depths(sweep.points, toy.TOY.elevation, 90, rotation)
    margins: NDArray[Any] = checker.margins(
        nearest, toy.TOY.elevation, 90, rotation, toy.HEIGHT_M, toy.GRID.cells, toy.GRID.half_extent_m, grade
    )
    return margins


@pytest.mark.parametrize(("tilt_deg", "grade"), [(0.0, 0.0), (0.0, 0.03), (4.0, 0.0)])
def test_as_the_checker_counts(tilt_deg: float, grade: float) -> None:
    half = np.deg2rad(tilt_deg) / 2
    attitude = np.array([np.cos(half), np.sin(half) * 0.6, np.sin(half) * 0.8, 0.0])
    rng = np.random.default_rng(3)
    sweep = toy.sweep_of(toy.scene(rng), rng.normal(0.0, 5.0, (60, 3)), attitude=attitude)
    ours, theirs = toy.envelope(sweep, grade).margins, checked_margins(sweep, grade)
    assert theirs.max() > 20
    # float32 against float64: a beam on the edge of a window or of a target
    assert (ours != theirs).mean() < 0.004
    assert np.abs(ours - theirs).max() <= 12


def test_by_hand() -> None:
    # Ahead at 6.5 m a car is 1.8 m wide: 16 degrees, 4 columns of 4 degrees, of which 3 or 4 surely. Rings that pass
    # between the ground and 1.5 m there: 1.7 + 6.5 tan(e) for -12, -8.5, -6, -4 degrees (.32, .73, 1.02, 1.25), not
    # -2 (1.47 passes too) nor -17 (-.29).
    empty = toy.sweep_of(np.full((90, 8), np.inf))
    i, j = toy.GRID.index(np.array([6.5, 0.5]))[0]
    firings = int(2 * np.arctan2(0.9, np.hypot(6.5, 0.5)) / (2 * np.pi) * 90)
    assert toy.envelope(empty).margins[i, j] == 5 * firings
    # A return of one of them at 3 m takes one beam, behind the cell none, and a second one on the same beam no more.
    d = toy.directions()[45, 3]
    for range_m, lost in (([3.0], 1), ([9.0], 0), ([3.0, 2.5], 1), ([3.0, 9.0], 1)):
        sweep = toy.sweep_of(np.full((90, 8), np.inf), np.outer(range_m, d))
        assert toy.envelope(sweep).margins[i, j] == 5 * firings - lost


@settings(max_examples=60, deadline=None)
@given(SEEDS, st.integers(1, 400), st.sampled_from([0.0, 0.02]))
def test_added_points_only_shrink(seed: int, count: int, grade: float) -> None:
    rng = np.random.default_rng(seed)
    depth = toy.scene(rng)
    added = rng.normal(0.0, rng.uniform(0.5, 12.0), (count, 3))
    clean, some, all_of_them = (toy.envelope(toy.sweep_of(depth, added[:n]), grade) for n in (0, count // 2, count))
    assert not (some.margins > clean.margins).any()
    assert not (all_of_them.margins > some.margins).any()
    assert not (all_of_them.closed > clean.closed).any()
    assert not (all_of_them.claim() & ~clean.claim()).any()
    assert not (clean.claim() & ~clean.open()).any()


def test_gaps_by_hand() -> None:
    # A near return, four columns without one, a farther return: the gap takes the farther range; five stay open.
    row = np.full(30, np.inf, np.float32)
    row[[3, 8, 14]] = 5.0, 9.0, 5.0
    expected = row.copy()
    expected[4:8] = 9.0
    assert np.array_equal(without_gaps(row), twice(expected))
    # Around the back of the sensor, and not where a ring is not fired.
    row = np.full(30, np.inf, np.float32)
    row[[28, 2]] = 4.0
    expected = row.copy()
    expected[[29, 0, 1]] = 4.0
    assert np.array_equal(without_gaps(row)[0, :30], expected)
    fired = np.ones((1, 30), np.uint8)
    fired[0, 0] = 0
    expected[0] = np.inf
    assert np.array_equal(without_gaps(row, fired)[0, :30], expected)


@settings(max_examples=60, deadline=None)
@given(SEEDS)
def test_gaps_close_what_both_sides_block(seed: int) -> None:
    # At every range: a column is blocked if it is, or if some stretch of GAP + 1 columns around it holds a blocked one
    # wherever that stretch lies.
    rng = np.random.default_rng(seed)
    row = np.where(rng.random(40) < 0.7, np.inf, rng.uniform(1.0, 50.0, 40)).astype(np.float32)
    closed = without_gaps(row)[0, :40]
    for near_m in (2.0, 10.0, 60.0):
        blocked = row < near_m
        for column in range(40):
            starts = range(column - GAP, column + 1)
            expected = all(any(blocked[(start + k) % 40] for k in range(GAP + 1)) for start in starts)
            assert (closed[column] < near_m) == expected


@pytest.mark.parametrize(("rings", "are_fired"), [(8, False), (16, True), (70, False), (130, True)])
def test_counts_bit_for_bit(rings: int, are_fired: bool) -> None:
    # The counts of the core, for sixteen rings at once, against the same rules written plainly in the same precision.
    rng, columns = np.random.default_rng(rings), 90
    model = LidarModel("many", np.deg2rad(np.linspace(-24.0, 3.0, rings)), columns)
    fired = (rng.random((rings, columns)) < 0.8).astype(np.uint8) if are_fired else None
    of, base = columns_of(model, fired), Given(model, np.eye(3), 1.7)
    range_m, azimuth = polar_of_cells(toy.GRID)
    low_m, high_m = np.full_like(range_m, FOOT_M), np.full_like(range_m, CAR.height_m)
    start_m = rng.uniform(1.6, 1.8, rings).astype(np.float32)
    sent = _core.SentBeams(of, low_m, high_m, base.slopes(), start_m)
    nearest_m = twice(np.where(rng.random((rings, columns)) < 0.5, np.inf, rng.uniform(0.0, 15.0, (rings, columns))))
    closed_m = _core.without_gaps(nearest_m, of)
    counts, least, most = rng.random(range_m.shape) < 0.7, 5, 40
    margins, closed = np.zeros(range_m.shape, np.int32), np.zeros(range_m.shape, np.int32)
    beams: list[tuple[tuple[int, int], NDArray[Any], NDArray[Any]]] = []
    for cell in np.ndindex(*range_m.shape):
        r, turn = range_m[cell], (float(azimuth[cell]) + np.pi) / (2 * np.pi)
        half, near_m = np.arctan2(CAR.width_m / 2, float(r)) / (2 * np.pi) * columns, r - np.float32(toy.GRID.cell_m)
        window = np.arange(np.ceil(turn * columns - half - 0.5), np.floor(turn * columns + half - 0.5) + 1).astype(int)
        z_m = start_m + r * base.slopes()[min(int(turn * SECTORS), SECTORS - 1)]
        passing = np.flatnonzero((z_m >= low_m[cell]) & (z_m <= high_m[cell]))
        if near_m <= 0.0:
            continue
        sure = np.full(len(passing), int(2 * half + 1e-6))
        window = window[:columns] % columns
        if fired is not None:
            sure = np.minimum(sure, fired[np.ix_(passing, window)].sum(axis=1))
        for found, of_beams_m in ((margins, nearest_m), (closed, closed_m)):
            blocked = of_beams_m[np.ix_(passing, window)] < near_m
            found[cell] = np.maximum(sure - blocked.sum(axis=1), 0).sum()
        ring, column = np.nonzero(nearest_m[np.ix_(passing, window)] >= near_m)
        beams.append((cell, passing[ring], window[column]))
    ours = _core.envelope_margins(sent, nearest_m)
    assert np.array_equal(ours[0], margins)
    assert np.array_equal(ours[1], closed)
    assert (closed < margins).sum() > 0
    share = np.zeros((rings, columns))
    for cell, ring, column in beams:
        needed = margins[cell] - least + 1
        if counts[cell] and 0 < needed <= most:
            share[ring, column] += 1.0 / needed
    assert share.any()
    assert np.array_equal(_core.cells_of_beams(sent, nearest_m, margins, counts, least, most, False), share)


def test_what_is_sent_is_kept_only_while_it_stays() -> None:
    half = np.deg2rad(2.0) / 2
    tilted = rotation_from_quaternion([np.cos(half), np.sin(half), 0.0, 0.0])
    base = Given(toy.TOY, np.eye(3), toy.HEIGHT_M)
    same, nearest_m = Given(toy.TOY, np.eye(3), toy.HEIGHT_M), np.full((8, 180), np.inf, np.float32)
    assert base.sent(toy.GRID, CAR) is same.sent(toy.GRID, CAR)
    shifted = LidarModel("shifted", toy.TOY.elevation + 0.02, 90)
    others = [
        Given(toy.TOY, tilted, toy.HEIGHT_M), Given(toy.TOY, np.eye(3), 1.9), Given(shifted, np.eye(3), toy.HEIGHT_M),
        Given(toy.TOY, np.eye(3), toy.HEIGHT_M, grade=0.1),
        Given(toy.TOY, np.eye(3), toy.HEIGHT_M, HeightMap.flat(12.0, 0.5)),
    ]  # fmt: skip
    before = _core.envelope_margins(base.sent(toy.GRID, CAR), nearest_m)[0]
    for other in others:
        kept, anew = other.sent(toy.GRID, CAR), other._sent(toy.GRID, CAR)
        margins = _core.envelope_margins(kept, nearest_m)[0]
        assert np.array_equal(margins, _core.envelope_margins(anew, nearest_m)[0])
        assert not np.array_equal(margins, before)


@settings(max_examples=60, deadline=None)
@given(SEEDS, st.integers(1, 60))
def test_replaced_beams_move_a_margin_by_one_each(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    depth = toy.scene(rng)
    beams = np.column_stack([rng.integers(0, 90, count), rng.integers(0, 8, count)])
    clean, after = toy.envelope(toy.sweep_of(depth)), toy.envelope(toy.attacked(rng, depth, beams))
    assert (after.margins - clean.margins).max() <= len(np.unique(beams, axis=0))


@settings(max_examples=30, deadline=None)
@given(SEEDS)
def test_dropped_returns_only_grow_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    depth = toy.scene(rng)
    dropped = np.where(rng.random(depth.shape) < 0.3, np.inf, depth)
    assert not (toy.envelope(toy.sweep_of(dropped)).margins < toy.envelope(toy.sweep_of(depth)).margins).any()


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.sampled_from(["replaced", "window", "dropped", "wedge"]), st.booleans())
def test_a_stronger_threat_may_change_more(seed: int, kind: Kind, opens: bool) -> None:
    one = toy.envelope(toy.sweep_of(toy.scene(np.random.default_rng(seed))))
    every, before = np.ones(toy.GRID.shape, bool), (0.0, np.zeros(toy.GRID.shape, bool))
    for amount in (1, 3, 10, 40, 120):
        area_m2, changes = one.changeable(Threat(kind, amount), every, opens=opens)
        assert area_m2 >= before[0] - 1e-9
        assert not (before[1] & ~changes).any()
        before = area_m2, changes


def test_the_ground_that_is_given_counts() -> None:
    sweep = toy.sweep_of(np.full((90, 8), np.inf))
    one = toy.leveled(sweep)
    high = Envelope.of(one, Given.of(one, HeightMap.flat(12.0, 1.0), 0.0), toy.GRID, CAR).margins
    i, j = toy.GRID.index(np.array([6.5, 0.5]))[0]
    firings = int(2 * np.arctan2(0.9, np.hypot(6.5, 0.5)) / (2 * np.pi) * 90)
    # Ground 1 m up: of -6, -4, -2 and +1 degrees the beams pass between 1 m and 2.5 m.
    assert high[i, j] == 4 * firings


def test_the_plane_of_the_sensor_carries_twenty_meters() -> None:
    half = np.deg2rad(4.0) / 2
    tilted = Given(toy.TOY, rotation_from_quaternion([np.cos(half), 0.0, np.sin(half), 0.0]), toy.HEIGHT_M)
    heights, grid = tilted.heights(GRIDS["road"]), GRIDS["road"]
    for x_m, y_m, along_m in ((10.25, 0.25, 10.25), (40.25, 0.25, 20.0), (-30.25, 40.25, -30.25 * 20.0 / 50.35)):
        i, j = grid.index(np.array([x_m, y_m]))[0]
        assert heights[i, j] == pytest.approx(-np.tan(2 * half) * along_m, abs=1e-3)


@pytest.mark.parametrize(
    ("words", "match"),
    [("many", "added, replaced, window"), ("added:3", "leave the number out"), ("wedge:0", "wider than 0"),
     ("replaced:2.5", "whole number"), ("window", "whole number"), ("wedge:x", "replaced:5")],
)  # fmt: skip
def test_threats_that_are_none(words: str, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        Threat.parse(words)


def test_what_cannot_be_given() -> None:
    with pytest.raises(ValueError, match="fires rings"):
        Given(lidar_model("livox_mid70"), np.eye(3), 1.8)
    tilted = rotation_from_quaternion([np.cos(0.15), np.sin(0.15), 0.0, 0.0])
    with pytest.raises(ValueError, match="within 15°"):
        Given(toy.TOY, tilted, 1.8)
    with pytest.raises(ValueError, match="height_m must be positive"):
        Given(toy.TOY, np.eye(3), 0.0)
