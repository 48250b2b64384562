"""The report of stability: what it changes of a sweep, and what it counts, by hand."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import stability
from stability import CHANGES, Overlap, RealSweep

from viewshed import CAR, BevGrid, CellState, FovEstimate, Rigid, Sweep
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.geometry import quaternion_from_rotation
from viewshed.io import write_sweep
from viewshed.sensors import LidarModel
from viewshed.sim import Box, Scene, cast

MODEL = LidarModel("sparse", np.deg2rad(np.linspace(-24, 8, 17)), azimuth_columns=720, max_range_m=100.0)
GRID = BevGrid(64, 32.0)
VIEWS = {"shadow_map": ShadowMap(GRID)}


def sweep_of(*boxes: Box) -> Sweep:
    return cast(MODEL, Scene(boxes), 1.8).replace(sensor_height_m=1.8, t_ns=0)


@pytest.fixture(scope="module")
def sweep() -> Sweep:
    """An asymmetric scene."""
    return sweep_of(Box(12, 2, 1, 6, 3), Box(-6, 8, 4, 2, 2), Box(3, -15, 8, 1, 4))


def rng() -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(1))


def test_what_is_changed_of_a_sweep_is_what_its_name_says(sweep: Sweep) -> None:
    half, mixed, bare = (CHANGES[name](sweep, rng()) for name in ("half of the points", "shuffled", "without rings"))
    assert half is not None
    assert mixed is not None
    assert bare is not None
    assert len(half) == len(sweep) // 2
    kept = {tuple(point) for point in sweep.points.tolist()}
    assert {tuple(point) for point in half.points.tolist()} <= kept
    assert not np.array_equal(mixed.points, sweep.points)
    assert np.array_equal(np.sort(mixed.points, axis=0), np.sort(sweep.points, axis=0))
    assert bare.ring is None
    assert CHANGES["without rings"](bare, rng()) is None


TILT = Rigid.from_quaternion((np.cos(0.035), np.sin(0.035), 0.0, 0.0))
"""4° about x: a tilt that does not turn with the points is noticed."""


@pytest.mark.parametrize("known", ["attitude", "pose", "nothing"])
def test_a_turned_sweep_is_seen_as_before(sweep: Sweep, known: str) -> None:
    tilted = sweep.replace(points=(TILT.inverse() @ sweep.points).astype(np.float32))
    attitude = quaternion_from_rotation(TILT.rotation) if known == "attitude" else None
    pose = Rigid.from_yaw(0.3, (5, 1, 1.8)) @ TILT if known == "pose" else None
    real = RealSweep("a", stability.ROAD, sweep if known == "nothing" else tilted)
    real = replace(real, sweep=real.sweep.replace(attitude=attitude, world_from_sensor=pose))
    ious = stability.changed_ious(real, VIEWS, rng())
    assert ious["turned by 90°", "shadow_map"] > 0.97
    assert ious["shuffled", "shadow_map"] > 0.99
    assert ious["half of the points", "shadow_map"] < 0.99
    claimed = VIEWS["shadow_map"].estimate(real.sweep).visible()
    turned = CHANGES["turned by 90°"](real.sweep, rng())
    assert turned is not None
    assert stability.iou(claimed, VIEWS["shadow_map"].estimate(turned).visible()) < 0.9


def test_scans_of_a_static_sensor_are_held_against_the_next(sweep: Sweep) -> None:
    other = sweep_of(Box(12, 2, 1, 6, 3))
    found = stability.static_ious([sweep, sweep, other], VIEWS)
    same, changed = found[stability.ALONE, "shadow_map"]
    assert same == 1.0
    assert found[stability.STREAM, "shadow_map"][0] == 1.0
    one, two = (VIEWS["shadow_map"].estimate(each).visible() for each in (sweep, other))
    assert changed == (one & two).sum() / (one | two).sum()
    assert np.isnan(stability.iou(np.zeros((2, 2), np.bool_), np.zeros((2, 2), np.bool_)))


def _estimate(states: list[list[CellState]]) -> FovEstimate:
    state = np.array(states, np.uint8)
    prob = np.isin(state, (CellState.FREE, CellState.SURFACE)).astype(np.float32)
    return FovEstimate(BevGrid(2, 1.0), prob, state, target=CAR)


def test_views_that_overlap_are_compared_where_the_other_ones_cells_lie() -> None:
    free, hidden, unknown, surface = CellState.FREE, CellState.HIDDEN, CellState.UNKNOWN, CellState.SURFACE
    side = _estimate([[free, hidden], [surface, unknown]])
    roof = _estimate([[free, free], [hidden, free]])
    here = Overlap.of(side, roof, Rigid.identity(), 1.7)
    assert (here.both_speak_m2, here.confirmed) == (3.0, 0.5)
    assert here.contradicted == pytest.approx(2 / 3)
    # A meter ahead the side's first row lies on the roof's second, and its second one outside.
    ahead = Overlap.of(side, roof, Rigid.from_yaw(0.0, (1, 0, 0)), 1.7)
    assert ahead == Overlap(2.0, 1.0, 0.0, 1.7)
    left, *_ = stability.extrinsics_of("device_id: 1\n(Roll,Pitch,Yaw,tx,ty,tz): 0 0 90 -0.5 0.6 -0.3\n")
    assert left.yaw == pytest.approx(np.pi / 2)
    assert left.translation.tolist() == [-0.5, 0.6, -0.3]


def test_a_line_has_the_median_and_the_worst_by_name() -> None:
    ious = [("a", 0.99), ("b", 0.5), ("c", float("nan")), ("d", 0.98), ("e", 0.97), ("f", 1.0)]
    row = stability.summary("without rings", "m", ious)
    assert row == ["without rings", "m", "5", "0.980", "≥ 0.97", "met", "0.500 b, 0.970 e, 0.980 d"]
    assert stability.summary("turned by 90°", "m", ious)[5] == "**missed**"


def test_the_report_reads_an_index_and_says_what_it_cannot_read(
    sweep: Sweep, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_sweep(sweep, tmp_path / "a.npz")
    (tmp_path / "b.json").write_text("{}")
    entries = [{"file": name, "sensor": "sparse", "environment": "road"} for name in ("a.npz", "b.json")]
    (tmp_path / "index.json").write_text(json.dumps(entries))
    text = stability.report(tmp_path / "index.json", None)
    assert "| turned by 90° | shadow_map | 1 |" in text
    assert "b.json: " in capsys.readouterr().err
