"""Leveling and no-return beams in the core: any numbers and any number of them are answered."""

import numpy as np
import pytest
from tests.test_core_arrays import COLUMNS, RINGS, N, call

from viewshed import _core


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
