"""LaserScan: messages made by hand, and the field of view in the plane that comes of them."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from viewshed import PEDESTRIAN, BevGrid, CellState, Sweep, load_estimator
from viewshed.cli import main
from viewshed.estimators.shadow_map import NO_RETURN_RULES, ShadowMap
from viewshed.io import read_sweep, write_sweep
from viewshed.io.messages.laserscan import scan_of_sweep, sweep_of_scan
from viewshed.sweep import PlanarScan

GRID = BevGrid(128, 16.0)


@dataclass
class Scan:
    """A message, of 1,080 beams over 270° unless it says otherwise."""

    ranges: NDArray[np.float32]
    angle_min: float = -0.75 * np.pi
    angle_max: float = 0.75 * np.pi
    angle_increment: float = 1.5 * np.pi / 1079
    time_increment: float = 1e-5
    range_min: float = 0.1
    range_max: float = 30.0
    intensities: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, np.float32))


def walls() -> Scan:
    """A wall across the front, 6 m ahead over ±0.3 rad, nothing else within 30 m."""
    scan = Scan(np.full(1080, np.inf, np.float32))
    angle = scan.angle_min + scan.angle_increment * np.arange(1080)
    scan.ranges[:] = np.where(np.abs(angle) < 0.3, 6.0 / np.cos(angle), np.inf)
    return scan


def states_at(estimate: Any, *places: tuple[float, float]) -> list[CellState]:
    """Return the states of the cells at places (x, y) in meters."""
    index = ((np.array(places) + GRID.half_extent_m) / GRID.cell_m).astype(int)
    return [CellState(estimate.state[i, j]) for i, j in index]


def test_a_scan_is_converted_by_hand() -> None:
    ranges = np.array([2.0, np.inf, np.nan, -np.inf, 0.05, 31.0, 30.0], np.float32)
    scan = Scan(ranges, -np.pi / 2, np.pi / 4, np.pi / 8, 0.01, intensities=np.arange(7, dtype=np.float32))
    sweep = sweep_of_scan(scan)
    np.testing.assert_allclose(sweep.points, [[0, -2, 0], [30 * np.sqrt(0.5), 30 * np.sqrt(0.5), 0]], atol=1e-5)
    assert sweep.intensity.tolist() == [0.0, 6.0]
    np.testing.assert_allclose(sweep.azimuth, [-np.pi / 2, np.pi / 4], atol=1e-6)
    np.testing.assert_allclose(sweep.time_s, [0.0, 0.06], atol=1e-6)
    np.testing.assert_allclose(sweep.planar.open_azimuth, [-3 * np.pi / 8], atol=1e-6)
    assert sweep.planar.max_range_m == 30.0


def test_beams_may_turn_clockwise_and_begin_anywhere() -> None:
    clockwise = Scan(np.array([1.0, 1.0, 1.0], np.float32), 3 * np.pi / 2, np.pi / 2, -np.pi / 2)
    assert np.allclose(sweep_of_scan(clockwise).points[:, :2], [[0, -1], [-1, 0], [0, 1]], atol=1e-6)


@settings(max_examples=60)
@given(
    ranges=st.lists(st.floats(width=32), max_size=40),
    limits=st.tuples(st.floats(0, 5), st.floats(5.5, 100) | st.just(np.inf)),
    start=st.floats(-7, 7),
)
def test_any_ranges_give_returns_within_the_limits(
    ranges: list[float], limits: tuple[float, float], start: float
) -> None:
    step = 0.1
    scan = Scan(np.array(ranges, np.float32), start, start + step * max(len(ranges) - 1, 0), step)
    sweep = sweep_of_scan(replace(scan, range_min=limits[0], range_max=limits[1]))
    assert len(sweep) + len(sweep.planar.open_azimuth) <= len(ranges)
    assert (sweep.points[:, 2] == 0).all()
    range_m = np.hypot(*sweep.points[:, :2].T)
    assert ((range_m >= limits[0] - 1e-5) & (range_m <= limits[1] * (1 + 1e-6))).all()
    assert np.isfinite(load_estimator("shadow_map", grid=GRID).estimate(sweep).visible_prob).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"angle_min": np.nan}, "angle_min must be finite, got nan"),
        ({"angle_increment": np.inf}, "angle_increment must be finite, got inf"),
        ({"angle_increment": 0.0}, "a scan must be at most one turn, got 1080 ranges every 0 rad"),
        ({"angle_increment": 0.1}, "a scan must be at most one turn, got 1080 ranges every 0.1 rad"),
        ({"angle_max": 0.0}, "ranges must be those of angle_min to angle_max, got 1080"),
        ({"time_increment": 0.1}, "a scan must take at most 2 s, got 107.9 s"),
        ({"range_min": -1.0}, "range_min and range_max must satisfy 0 ≤ range_min < range_max, got -1 and 30 m"),
        ({"range_min": 30.0}, "range_min and range_max must satisfy 0 ≤ range_min < range_max, got 30 and 30 m"),
        ({"range_max": np.nan}, "range_min and range_max must satisfy 0 ≤ range_min < range_max, got 0.1 and nan m"),
        ({"ranges": np.ones((2, 540), np.float32)}, r"ranges must be \(N,\)"),
        ({"intensities": np.ones(7, np.float32)}, "intensities must be as many as ranges, or none, got 7 of 1080"),
    ],
)
def test_a_scan_that_cannot_be_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        sweep_of_scan(replace(walls(), **changes))


@pytest.mark.parametrize("rule", NO_RETURN_RULES)
def test_the_field_of_view_in_the_plane(rule: Any) -> None:
    found = ShadowMap(GRID, no_return=rule).estimate(sweep_of_scan(walls()))
    ahead, before, behind, far_behind = (3.0, 0.1), (5.4, 0.1), (6.6, 0.1), (12.0, 0.1)
    assert states_at(found, ahead, before) == [CellState.FREE, CellState.FREE]
    assert states_at(found, behind, far_behind) == [CellState.HIDDEN, CellState.HIDDEN]
    # Beams without a return are free as far as the laser measures; where there is none, nothing is known.
    beside, blind = (2.0, 8.0), (-8.0, 0.0)
    free = CellState.UNKNOWN if rule == "unknown" else CellState.FREE
    assert states_at(found, beside, blind) == [free, CellState.UNKNOWN]
    assert found.basis.height_source == "assumed"
    assert found.basis.reach_m <= 30.0


def test_a_target_is_seen_where_enough_beams_meet_it() -> None:
    """At one beam a degree a pedestrian, 0.6 m wide, has three returns up to 11.5 m."""
    angle = np.deg2rad(np.arange(360) - 180.0)
    scan = Scan(np.full(360, np.inf, np.float32), angle[0], angle[-1], np.deg2rad(1.0))
    found = ShadowMap(BevGrid(240, 30.0), PEDESTRIAN).estimate(sweep_of_scan(scan))
    around = np.column_stack((np.cos(angle), np.sin(angle)))
    assert (found.at(around * 9.0) >= 0.5).all()
    assert (found.at(around * 18.0) < 0.5).all()


def test_a_plane_above_a_target_sees_none() -> None:
    sweep = sweep_of_scan(walls())
    assert ShadowMap(GRID).estimate(sweep.replace(sensor_height_m=1.4)).visible().any()
    assert not ShadowMap(GRID).estimate(sweep.replace(sensor_height_m=1.6)).visible().any()


def test_a_laser_that_hangs_upside_down() -> None:
    """Half a turn about x: left is right."""
    scan = walls()
    scan.ranges[:540] = 2.0  # on its right
    turned = sweep_of_scan(scan).replace(attitude=np.array([0.0, 1.0, 0.0, 0.0]))
    found = ShadowMap(GRID).estimate(turned)
    assert states_at(found, (0.2, -8.0), (0.2, 8.0)) == [CellState.FREE, CellState.HIDDEN]


def test_a_scan_without_returns_and_one_without_beams() -> None:
    empty = sweep_of_scan(Scan(np.zeros(0, np.float32), 0.0, 0.0, 0.1))
    assert not ShadowMap(GRID).estimate(empty).visible().any()
    nothing: Sweep = sweep_of_scan(Scan(np.full(1080, np.nan, np.float32)))
    assert not ShadowMap(GRID).estimate(nothing).visible().any()


def test_a_scan_in_one_plane_as_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "scan.npz"
    write_sweep(sweep_of_scan(walls()), file)
    np.testing.assert_array_equal(
        ShadowMap(GRID).estimate(read_sweep(file)).state, ShadowMap(GRID).estimate(sweep_of_scan(walls())).state
    )
    with pytest.raises(SystemExit) as stopped:
        main(["info", str(file)])
    assert stopped.value.code in (0, None)
    said = capsys.readouterr()
    assert "plane:       one; 942 beams met nothing up to 30 m\n" in said.out
    assert said.err == ""
    with pytest.raises(ValueError, match="a scan in one plane must be seen from its own sensor"):
        read_sweep(file).seen_from((0.0, 0.0, 1.0))
    with pytest.raises(ValueError, match="file_frame must be left out for a scan in one plane"):
        read_sweep(file, file_frame="nuscenes")


@pytest.mark.parametrize("azimuth", [np.array([7.0]), np.array([np.nan]), np.zeros((2, 2)), np.array(["a"])])
def test_planar_scans_are_checked(azimuth: NDArray[Any]) -> None:
    with pytest.raises(ValueError, match="open_azimuth must be"):
        PlanarScan(azimuth, 30.0)
    for range_m in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="max_range_m must be positive"):
            PlanarScan(np.zeros(1, np.float32), range_m)


@given(st.integers(0, 40), st.floats(-3.0, 0.0), st.floats(0.01, 0.07), st.integers(0, 2**32 - 1))
def test_a_planar_sweep_becomes_the_scan_that_it_came_from(count: int, first: float, step: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    ranges = rng.choice(np.array([np.inf, np.nan, 2.0, 3.5], np.float32), count)
    sweep = sweep_of_scan(Scan(ranges, first, first + step * max(count - 1, 0), step, 0.0, 0.0, 9.0))
    made = SimpleNamespace(range_min=0.0, time_increment=0.0, **scan_of_sweep(sweep))
    back = sweep_of_scan(made)
    np.testing.assert_allclose(back.points, sweep.points, atol=4e-4)
    np.testing.assert_allclose(np.sort(back.planar.open_azimuth), np.sort(sweep.planar.open_azimuth), atol=1e-4)
