"""Leveling and no-return beams in the core: bad arrays are refused, and threads change nothing."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from viewshed import BevGrid, Sweep, _core
from viewshed.preprocess.leveling import level
from viewshed.preprocess.no_return import beams_by_evidence, no_return_beams
from viewshed.sensors import lidar_model
from viewshed_lab.sim import cast, junction

GRID = BevGrid(128, 32.0)
FULL = cast(lidar_model("hdl64e"), junction(), 1.8)
SWEEP = FULL.select(np.random.default_rng(3).random(len(FULL)) > 0.1)
FLAT = np.zeros((64, 64), np.float32)
N, RINGS, COLUMNS = 6, 4, 8


@pytest.fixture(autouse=True)
def _threads() -> Iterator[None]:
    before = _core.threads()
    yield
    _core.set_threads(before)


def points_with(**changes: Any) -> dict[str, Any]:
    """Arguments of ``level_points`` for N points."""
    points = np.arange(3 * N, dtype=np.float32).reshape(N, 3)
    known = {
        "points": points, "clutter": None, "level_from_sensor": np.eye(4, dtype=np.float32)[:3].copy(), "near_m": 0.5,
        "far_m": 250.0, "heading": 0.0, "ground_m": FLAT, "half_extent_m": 32.0,
    }  # fmt: skip
    return known | changes


def beams_with(**changes: Any) -> dict[str, Any]:
    """Arguments of ``beams_by_evidence`` for N returns on an image of RINGS × COLUMNS."""
    known = {
        "ring": np.arange(N, dtype=np.int16) % RINGS, "column": np.arange(N, dtype=np.int32),
        "counts": np.ones((RINGS, COLUMNS), np.uint8), "isolated": np.zeros(N, np.bool_), "clutter": None,
        "phase": np.zeros(RINGS, np.float32), "elevation": np.linspace(-0.3, 0.0, RINGS), "origin_m": np.zeros(RINGS),
        "rotation": np.eye(3), "points": np.ones((N, 3), np.float32), "range_m": np.full(N, 5, np.float32),
        "height_m": np.zeros(N, np.float32), "rows": np.arange(N, dtype=np.int32), "sensor_height_m": 1.8,
        "ground_m": FLAT, "half_extent_m": 32.0, "top_m": 1.5, "obstacle_m": 0.3,
    }  # fmt: skip
    return known | changes


@pytest.mark.parametrize(
    "changes",
    [
        {"points": np.zeros((N, 3))},
        {"points": np.zeros((N, 2), np.float32)},
        {"clutter": np.zeros(N - 1, np.bool_)},
        {"clutter": np.zeros(N, np.uint8)},
        {"level_from_sensor": np.eye(4, dtype=np.float32)},
        {"heading": np.nan},
        {"ground_m": FLAT[:, :32].copy()},
        {"ground_m": FLAT[:1, :1].copy()},
        {"half_extent_m": 0.0},
        {"half_extent_m": np.nan},
    ],
)
def test_level_points_refuses_arrays_that_do_not_fit(changes: dict[str, Any]) -> None:
    with pytest.raises((TypeError, ValueError)):
        _core.level_points(**points_with(**changes))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30, 1e-40])
def test_level_points_answers_any_number(value: float) -> None:
    points = np.full((N, 3), value, np.float32)
    points[0] = 5.0, 0.0, -1.0
    kept, _, _, height_m, rows = _core.level_points(**points_with(points=points))
    assert rows.tolist() == [0]
    assert kept.tolist() == [[5.0, 0.0, -1.0]]
    assert height_m.tolist() == [-1.0]
    everywhere = _core.level_points(**points_with(points=points, near_m=0.0, far_m=np.inf))
    assert len({len(column) for column in everywhere}) == 1


@pytest.mark.parametrize("count", [0, 1, 1023, 1024, 1025])
def test_level_points_takes_any_number_of_points(count: int) -> None:
    points = np.tile(np.array([[5.0, 1.0, 0.0]], np.float32), (count, 1))
    level_m, range_m, azimuth, height_m, rows = _core.level_points(**points_with(points=points))
    assert level_m.shape == (count, 3)
    assert range_m.shape == azimuth.shape == height_m.shape == rows.shape == (count,)
    assert np.array_equal(rows, np.arange(count))


def test_headings_slopes_and_cells_refuse_arrays_that_do_not_fit() -> None:
    points, column = np.ones((N, 3), np.float32), np.ones(N, np.float32)
    rows, mask = np.arange(N, dtype=np.int32), np.zeros(N, np.bool_)
    rotations: tuple[Any, ...] = (np.eye(3), np.eye(2, dtype=np.float32))
    for rotation in rotations:
        with pytest.raises(TypeError):
            _core.vehicle_heading(points, rotation)
    for arguments in (
        (points, column[1:].copy(), 1.8, None, rows),
        (points, column, 1.8, mask[1:].copy(), rows),
        (points, column, 1.8, mask, rows - 1),
        (points, column, 1.8, mask[:0].copy(), rows),
        (points, column, 1.8, None, rows.astype(np.int64)),
    ):
        with pytest.raises((TypeError, ValueError)):
            _core.beam_slopes(*arguments)
    for count, cells in ((N - 1, 4), (N, 0), (N, 1 << 20)):
        with pytest.raises(ValueError):
            _core.obstacle_cells(points, column[:count].copy(), -2.0, -2.0, 1.0, 0.3, 3.0, cells)
    marked = _core.obstacle_cells(np.full((2, 3), np.nan, np.float32), column[:2].copy(), -2.0, -2.0, 1.0, 0.3, 3.0, 4)
    assert not marked.any()


@pytest.mark.parametrize(
    "changes",
    [
        {"ring": np.zeros(N, np.int32)},
        {"ring": np.full(N, RINGS, np.int16)},
        {"ring": np.full(N, -1, np.int16)},
        {"ring": np.full(N, RINGS, np.int16), "isolated": np.ones(N, np.bool_)},
        {"column": np.full(N, COLUMNS, np.int32)},
        {"column": np.zeros(N - 1, np.int32)},
        {"counts": np.ones(RINGS, np.uint8)},
        {"counts": np.ones((0, COLUMNS), np.uint8)},
        {"counts": np.ones((RINGS + 1, COLUMNS), np.uint8)},
        {"isolated": np.zeros(N + 1, np.bool_)},
        {"clutter": np.zeros(N + 1, np.bool_)},
        {"phase": np.zeros(RINGS)},
        {"elevation": np.full(RINGS, np.nan)},
        {"rotation": np.eye(3, dtype=np.float32)},
        {"rotation": np.full((3, 3), np.inf)},
        {"rows": np.arange(N, dtype=np.int32) + 1},
        {"rows": np.arange(N, dtype=np.int32) - 1},
        {"range_m": np.zeros(N - 1, np.float32)},
        {"points": np.zeros((N + 1, 3), np.float32)},
        {"ground_m": FLAT[:, :2].copy()},
        {"half_extent_m": -1.0},
    ],
)
def test_beams_by_evidence_refuses_arrays_that_do_not_fit(changes: dict[str, Any]) -> None:
    with pytest.raises((TypeError, ValueError)):
        _core.beams_by_evidence(**beams_with(**changes))


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0, 1e30, 0.0])
def test_beams_by_evidence_answers_any_number(value: float) -> None:
    column = np.full(N, value, np.float32)
    counts = np.ones((RINGS, COLUMNS), np.uint8)
    counts[1:, 2:5] = 0
    for changes in (
        {"range_m": column},
        {"height_m": column},
        {"points": np.full((N, 3), value, np.float32)},
        {"ground_m": np.full((64, 64), value, np.float32)},
        {"origin_m": np.full(RINGS, 0.1), "ground_m": np.full((2, 2), value, np.float32)},
        {"column": np.full(N, -1, np.int32)},
        {"sensor_height_m": value},
        {"top_m": value},
    ):
        slope, inferred, unresolved = _core.beams_by_evidence(**beams_with(counts=counts, **changes))
        assert slope.shape == (N,)
        for beams in (inferred, unresolved):
            assert len({len(array) for array in beams}) == 1


def test_an_image_of_one_column_and_one_without_returns_are_answered() -> None:
    one = beams_with(counts=np.array([[1], [0], [2], [255]], np.uint8), column=np.zeros(N, np.int32))
    none = beams_with(counts=np.zeros((RINGS, COLUMNS), np.uint8), column=np.full(N, -1, np.int32))
    for arguments in (one, none):
        _, inferred, unresolved = _core.beams_by_evidence(**arguments)
        assert len(inferred[0]) + len(unresolved[0]) <= 1
    known = {key: none[key] for key in ("ring", "column", "counts", "clutter", "phase", "elevation", "origin_m")}
    returns = {key: none[key] for key in ("rotation", "range_m", "height_m", "rows")}
    assert len(_core.no_return_beams(**known, **returns, fill=False)[0]) == RINGS * COLUMNS
    assert len(_core.no_return_beams(**known, **returns, fill=True)[0]) == 0


def test_a_double_return_stands_for_an_empty_column_near_it() -> None:
    counts = np.ones((1, 40), np.uint8)
    counts[0, [5, 20, 30, 39]] = 0
    counts[0, [8, 26]] = 2  # 3 columns after column 5, 6 after column 20, 4 before column 30
    ring, column = np.zeros(40, np.int16), np.arange(40, dtype=np.int32)
    azimuth, slope, depth_m = _core.no_return_beams(
        ring, column, counts, None, np.full(1, 0.5, np.float32), np.full(1, -0.1), np.zeros(1), np.eye(3),
        np.full(40, 7, np.float32), np.zeros(40, np.float32), column, True,
    )  # fmt: skip
    assert np.allclose(azimuth, (np.array([20.5, 39.5]) / 40 * 2 - 1) * np.pi, atol=1e-4)
    assert np.allclose(slope, np.tan(-0.1))
    assert depth_m.tolist() == [7.0, 7.0]


@pytest.mark.parametrize("sweep", [SWEEP, Sweep(SWEEP.points)], ids=["known", "bare"])
def test_threads_change_nothing(sweep: Sweep) -> None:
    answers = []
    for threads in (1, 2, 3):
        _core.set_threads(threads)
        leveled = level(sweep, GRID)
        beams = beams_by_evidence(leveled, 1.5)
        kinds = (beams.measured, beams.inferred, beams.unresolved, no_return_beams(leveled, fill=True))
        columns = [leveled.points, leveled.range_m, leveled.azimuth, leveled.height_m, leveled.rows]
        answers.append([*columns, *(array for kind in kinds for array in (kind.azimuth, kind.slope, kind.depth_m))])
    assert len(answers[0][0]) > 20_000
    for other in answers[1:]:
        assert all(np.array_equal(one, two) for one, two in zip(answers[0], other, strict=True))


def test_an_isolated_return_that_is_clutter_as_well_is_taken_out_of_its_pixel_once() -> None:
    # Ring 1 has two returns in column 2 and none in column 3. Without one of the two, one beam is missing; without
    # both, two would be.
    counts = np.ones((RINGS, COLUMNS), np.uint8)
    counts[1, 2], counts[1, 3] = 2, 0
    ring, column = (
        each.astype(kind) for each, kind in zip(np.indices(counts.shape), (np.int16, np.int32), strict=True)
    )
    ring, column = np.repeat(ring.ravel(), counts.ravel()), np.repeat(column.ravel(), counts.ravel())
    count = len(ring)
    noise = np.zeros(count, np.bool_)
    noise[np.flatnonzero((ring == 1) & (column == 2))[0]] = True
    sweep = {
        "ring": ring, "column": column, "counts": counts, "isolated": noise, "rows": np.arange(count, dtype=np.int32),
        "points": np.ones((count, 3), np.float32), "range_m": np.full(count, 5, np.float32),
        "height_m": np.zeros(count, np.float32),
    }  # fmt: skip
    for clutter in (None, noise):
        _, inferred, unresolved = _core.beams_by_evidence(**beams_with(**sweep, clutter=clutter))
        assert len(inferred[0]) + len(unresolved[0]) == 1
