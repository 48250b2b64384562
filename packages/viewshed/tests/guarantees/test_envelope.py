"""The envelope against an independent checker and by its laws."""

from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.guarantees import brute_force, toy

from viewshed import _core
from viewshed.arrays import F32
from viewshed.fov.height_map import HeightMap
from viewshed.fov.visibility import CAR
from viewshed.geometry import rotation_from_quaternion
from viewshed.grid import GRIDS, BevGrid
from viewshed.guarantees.envelope import Envelope, Given, Kind, Threat
from viewshed.sensors import LidarModel, lidar_model, sensor_names

SEEDS = st.integers(0, 2**32 - 1)
GAP = 4
MANY = LidarModel("many", np.deg2rad(np.linspace(-24.0, 3.0, 70)), 90)
WIDE = BevGrid(16, 32.0)
"""So far that a sensor's own plane ends before it does."""


def tilted(deg: float) -> Any:
    half = np.deg2rad(deg) / 2
    return np.array([np.cos(half), np.sin(half) * 0.6, np.sin(half) * 0.8, 0.0])


def without_gaps(nearest_m: F32) -> F32:
    """At every range a column is blocked if every stretch of GAP + 1 columns around it holds a blocked one."""
    turn = nearest_m[:, : nearest_m.shape[1] // 2]
    least = np.min([np.roll(turn, -k, axis=1) for k in range(GAP + 1)], axis=0)
    return np.tile(np.max([np.roll(least, k, axis=1) for k in range(GAP + 1)], axis=0), (1, 2))


@pytest.mark.parametrize(
    ("tilt_deg", "grade", "model", "grid"),
    [(0.0, 0.0, toy.TOY, toy.GRID), (0.0, 0.03, toy.TOY, toy.GRID), (4.0, 0.0, toy.TOY, toy.GRID),
     (3.0, 0.01, MANY, WIDE), (0.0, 0.0, MANY, toy.GRID)],
)  # fmt: skip
def test_as_the_checker_counts(tilt_deg: float, grade: float, model: LidarModel, grid: BevGrid) -> None:
    rng, checker = np.random.default_rng(3), cast(Any, brute_force)  # without types
    sweep = toy.sweep_of(toy.scene(rng, model), rng.normal(0.0, 5.0, (60, 3)), attitude=tilted(tilt_deg), model=model)
    one, rotation = toy.leveled(sweep), rotation_from_quaternion(sweep.attitude)
    ours = Envelope.of(one, Given.of(one, grade=grade), grid, CAR)
    nearest = checker.depths(sweep.points, model.elevation, 90, rotation)
    theirs = checker.margins(
        nearest, model.elevation, 90, rotation, toy.HEIGHT_M, grid.cells, grid.half_extent_m, grade
    )
    assert theirs.max() >= 20
    # float32 against float64: a beam on the edge of a window or of a target
    assert (ours.margins != theirs).mean() < 0.016
    assert np.abs(ours.margins - theirs).max() <= 12
    assert np.array_equal(ours.claim, Envelope.within(grid, CAR, ours.sent, without_gaps(ours.nearest_m)).open())
    assert (ours.claim != ours.open()).any() or grid is WIDE


@settings(max_examples=60, deadline=None)
@given(SEEDS, st.integers(1, 400), st.sampled_from([0.0, 0.02]))
def test_added_points_only_shrink(seed: int, count: int, grade: float) -> None:
    rng = np.random.default_rng(seed)
    depth = toy.scene(rng)
    added = rng.normal(0.0, rng.uniform(0.5, 12.0), (count, 3))
    clean, some, all_of_them = (toy.envelope(toy.sweep_of(depth, added[:n]), grade) for n in (0, count // 2, count))
    assert not (some.margins > clean.margins).any()
    assert not (all_of_them.margins > some.margins).any()
    assert not (all_of_them.claim & ~clean.claim).any()
    assert not (clean.claim & ~clean.open()).any()


@settings(max_examples=60, deadline=None)
@given(SEEDS)
def test_gaps_close_what_both_sides_block(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one = toy.envelope(toy.sweep_of(toy.scene(rng)))
    turn = one.nearest_m[:, : one.nearest_m.shape[1] // 2]
    nearest_m = np.tile(np.where(rng.random(turn.shape) < 0.5, np.inf, turn).astype(np.float32), (1, 2))
    closed = Envelope.within(toy.GRID, CAR, one.sent, without_gaps(nearest_m))
    assert np.array_equal(Envelope.within(toy.GRID, CAR, one.sent, nearest_m).claim, closed.open())


@settings(max_examples=40, deadline=None)
@given(SEEDS, st.booleans())
def test_a_beam_has_its_share_in_every_cell_that_it_decides(seed: int, opens: bool) -> None:
    rng = np.random.default_rng(seed)
    one, least, most = toy.envelope(toy.sweep_of(toy.scene(rng))), CAR.min_returns, 20
    counts = rng.random(toy.GRID.shape) < 0.7
    share = _core.cells_of_beams(one.sent, one.nearest_m, one.margins, counts, least, most, opens)
    needed = least - one.margins if opens else one.margins - least + 1
    for beam in zip(*(rng.integers(0, size, 6) for size in share.shape), strict=True):
        nearest_m = one.nearest_m.copy()
        nearest_m[beam[0], beam[1] :: 90] = np.inf if opens else 0.1
        decides = counts & (needed > 0) & (needed <= most) & (
            Envelope.within(toy.GRID, CAR, one.sent, nearest_m).margins != one.margins
        )  # fmt: skip
        assert share[beam] >= (1.0 / needed[decides]).sum() - 1e-9
    assert not opens or not share[np.isinf(one.nearest_m[:, :90])].any()


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


def test_what_is_sent_is_kept_only_while_it_stays() -> None:
    def margins(given: Given, anew: bool = False) -> Any:
        sent = given._sent(toy.GRID, CAR) if anew else given.sent(toy.GRID, CAR)
        return Envelope.within(toy.GRID, CAR, sent, np.full((8, 180), np.inf, np.float32)).margins

    level, shifted = np.eye(3), LidarModel("shifted", toy.TOY.elevation + 0.02, 90)
    base = Given(toy.TOY, level, toy.HEIGHT_M)
    assert base.sent(toy.GRID, CAR) is Given(toy.TOY, np.eye(3), toy.HEIGHT_M).sent(toy.GRID, CAR)
    others = [
        Given(toy.TOY, rotation_from_quaternion(tilted(2.0)), toy.HEIGHT_M), Given(toy.TOY, level, toy.HEIGHT_M + 0.2),
        Given(shifted, level, toy.HEIGHT_M), Given(toy.TOY, level, toy.HEIGHT_M, grade=0.1),
        Given(toy.TOY, level, toy.HEIGHT_M, HeightMap.flat(12.0, 0.5)),
    ]  # fmt: skip
    for other in others:
        assert np.array_equal(margins(other), margins(other, anew=True))
        assert not np.array_equal(margins(other), margins(base))
    # Ground that is given half a meter up is like a sensor half a meter lower.
    assert np.array_equal(margins(others[-1]), margins(Given(toy.TOY, level, toy.HEIGHT_M - 0.5)))


@pytest.mark.parametrize("name", sensor_names())
def test_no_rings_of_a_sensor_cross(name: str) -> None:
    model, rotation = lidar_model(name), rotation_from_quaternion(tilted(14.0))
    if model.fires_rings:
        sent = Given(model, rotation, 1.8).sent(GRIDS["indoor"], CAR)
        nearest_m = np.full((model.rings, 2 * model.azimuth_columns), np.inf, np.float32)
        assert Envelope.within(GRIDS["indoor"], CAR, sent, nearest_m).claim.any()


@pytest.mark.parametrize(
    ("words", "match"),
    [("many", "added, replaced, window"), ("added:3", "leave the number out"), ("wedge:0", "wider than 0"),
     ("replaced:2.5", "whole number"), ("window", "whole number"), ("wedge:x", "replaced:5")],
)  # fmt: skip
def test_threats_that_are_none(words: str, match: str) -> None:
    with pytest.raises(ValueError, match=match):
        Threat.parse(words)


def test_what_cannot_be_given() -> None:
    half = LidarModel("half", np.zeros(1), 4, shots=np.array([[[0.0, 0.0]], [[1.0, 0.0]], *[[[np.nan] * 2]] * 2]))
    for model in (lidar_model("livox_mid70"), half):
        with pytest.raises(ValueError, match="fires every ring in every column"):
            Given(model, np.eye(3), 1.8)
    with pytest.raises(ValueError, match="within 15°"):
        Given(toy.TOY, rotation_from_quaternion(tilted(17.0)), 1.8)
    with pytest.raises(ValueError, match="height_m must be positive"):
        Given(toy.TOY, np.eye(3), 0.0)
    crossed = LidarModel("crossed", np.deg2rad([-10.0, -9.0]), 90, origin_m=np.array([1.0, 0.0]))
    with pytest.raises(ValueError, match="each ring must be above the one before"):
        Given(crossed, np.eye(3), 1.8).sent(toy.GRID, CAR)
