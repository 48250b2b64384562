"""The envelope against an independent checker and by its laws."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from tests.guarantees import brute_force, toy

from viewshed.fov.height_map import HeightMap
from viewshed.fov.visibility import CAR
from viewshed.geometry import rotation_from_quaternion
from viewshed.guarantees.envelope import GAP, Envelope, Given, Kind, Threat, without_gaps
from viewshed.sensors import lidar_model
from viewshed.sweep import Sweep

SEEDS = st.integers(0, 2**32 - 1)


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
    assert np.array_equal(without_gaps(np.tile(row, (1, 2))), np.tile(expected, (1, 2)))
    # Around the back of the sensor, and not where a ring is not fired.
    row = np.full(30, np.inf, np.float32)
    row[[28, 2]] = 4.0
    expected = row.copy()
    expected[[29, 0, 1]] = 4.0
    assert np.array_equal(without_gaps(np.tile(row, (1, 2)))[0, :30], expected)
    fired = np.ones((1, 30), np.uint8)
    fired[0, 0] = 0
    expected[0] = np.inf
    assert np.array_equal(without_gaps(np.tile(row, (1, 2)), fired)[0, :30], expected)


@settings(max_examples=60, deadline=None)
@given(SEEDS)
def test_gaps_close_what_both_sides_block(seed: int) -> None:
    # At every range: a column is blocked if it is, or if some stretch of GAP + 1 columns around it holds a blocked one
    # wherever that stretch lies.
    rng = np.random.default_rng(seed)
    row = np.where(rng.random(40) < 0.7, np.inf, rng.uniform(1.0, 50.0, 40)).astype(np.float32)
    closed = without_gaps(np.tile(row, (1, 2)))[0, :40]
    for near_m in (2.0, 10.0, 60.0):
        blocked = row < near_m
        for column in range(40):
            starts = range(column - GAP, column + 1)
            expected = all(any(blocked[(start + k) % 40] for k in range(GAP + 1)) for start in starts)
            assert (closed[column] < near_m) == expected


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
