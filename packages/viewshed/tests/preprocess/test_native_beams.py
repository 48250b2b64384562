"""Leveling and no-return beams in the core: any numbers and any number of them are answered."""

import numpy as np
import pytest
from tests.test_core_arrays import COLUMNS, GOOD, RINGS, N, call

from viewshed import _core

BEAMS = GOOD["beams_by_evidence"]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30, 1e-40])
def test_level_points_answers_any_number(value: float) -> None:
    points = np.full((N, 3), value, np.float32)
    points[0] = 5.0, 0.0, -1.0
    kept, _, _, height_m, rows = call("level_points", points=points)
    assert rows.tolist() == [0]
    assert kept.tolist() == [[5.0, 0.0, -1.0]]
    assert height_m.tolist() == [-1.0]
    everywhere = call("level_points", points=points, near_m=0.0, far_m=np.inf)
    assert len({len(column) for column in everywhere}) == 1


@pytest.mark.parametrize("count", [0, 1, 1023, 1024, 1025])
def test_level_points_takes_any_number_of_points(count: int) -> None:
    points = np.tile(np.array([[5.0, 1.0, 0.0]], np.float32), (count, 1))
    level_m, range_m, azimuth, height_m, rows = call("level_points", points=points)
    assert level_m.shape == (count, 3)
    assert range_m.shape == azimuth.shape == height_m.shape == rows.shape == (count,)
    assert np.array_equal(rows, np.arange(count))


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
        slope, *beams = call("beams_by_evidence", counts=counts, **changes)
        assert slope.shape == (N,)
        assert len({len(array) for array in beams}) == 1


def test_an_image_of_one_column_and_one_without_returns_are_answered() -> None:
    one = BEAMS | {"counts": np.array([[1], [0], [2], [255]], np.uint8), "column": np.zeros(N, np.int32)}
    none = BEAMS | {"counts": np.zeros((RINGS, COLUMNS), np.uint8), "column": np.full(N, -1, np.int32)}
    for arguments in (one, none):
        assert len(_core.beams_by_evidence(**arguments)[1]) <= 1
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
        assert len(call("beams_by_evidence", clutter=clutter, **sweep)[1]) == 1
