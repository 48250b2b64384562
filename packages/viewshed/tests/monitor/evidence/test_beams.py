"""Evidence of beams: what passes through a surface, stands before it, returns twice, or lies on no beam."""

import numpy as np
import pytest
from tests.monitor.evidence.by_hand import (
    COLUMNS,
    ELEVATION,
    FAR_M,
    HEIGHT_M,
    MODEL,
    RINGS,
    columns_at,
    measured,
    monitored,
    points_at,
    sector_at,
    street,
    sweep_of,
    wall,
)

from viewshed import _core
from viewshed.monitor.evidence import ABSTAINS, EVIDENCE, SECTORS
from viewshed.monitor.evidence.beams import (
    measure_before_surface,
    measure_behind_surface,
    measure_double_returns,
    measure_isolated,
    measure_off_beam,
    return_image_of,
)

AHEAD = sector_at(2.0)
COLUMN = int(np.flatnonzero(columns_at(2.0, 2.6))[0])
"""A column in the middle of the sector ahead."""


def test_the_image_has_the_nearest_and_the_farthest_return_and_its_height() -> None:
    range_m = street()
    near = points_at(np.where(np.arange(COLUMNS) == COLUMN, 5.0, np.nan) * np.ones((RINGS, 1)))[0][12:13]
    image = return_image_of(monitored(sweep_of(range_m, near, ring=12)).leveled)
    assert image is not None
    assert image.range_m.shape == (RINGS, COLUMNS)
    np.testing.assert_allclose(image.range_m[3], HEIGHT_M / -np.sin(ELEVATION[3]), atol=1e-4)
    assert image.range_m[12, COLUMN] == pytest.approx(5.0, abs=1e-4)
    assert image.farthest_m[12, COLUMN] == pytest.approx(FAR_M / np.cos(ELEVATION[12]), abs=1e-3)
    assert image.height_m[12, COLUMN] == pytest.approx(HEIGHT_M + 5.0 * np.sin(ELEVATION[12]), abs=0.05)
    np.testing.assert_array_equal(image.sector, np.arange(COLUMNS) * SECTORS // COLUMNS)


def test_rings_without_returns_are_left_out_of_the_image() -> None:
    range_m = street()
    range_m[[2, 9]] = np.nan
    image = return_image_of(monitored(sweep_of(range_m)).leveled)
    assert image is not None
    assert len(image.range_m) == RINGS - 2


def test_a_hole_in_a_wall_through_which_a_beam_passes() -> None:
    range_m = wall(street(), -10.0, 10.0, 8.0)
    whole = measured(measure_behind_surface, range_m)
    assert whole[AHEAD] == 0.0
    range_m[9, COLUMN] = FAR_M
    found = measured(measure_behind_surface, range_m)
    # The eight neighbors of the hole are not surrounded by one surface themselves.
    image = return_image_of(monitored(sweep_of(range_m)).leveled)
    assert image is not None
    holes, surrounded = _core.count_holes(image.range_m, image.sector, SECTORS)
    assert holes[AHEAD] == 1
    assert holes.sum() == 1
    assert found[AHEAD] == pytest.approx(1 / (surrounded[AHEAD] + 30))
    range_m[9, COLUMN] = np.nan  # a beam without a return proves nothing
    assert measured(measure_behind_surface, range_m)[AHEAD] == 0.0


def test_returns_in_line_before_a_wall_are_left_from_another_one() -> None:
    range_m = street()
    assert not measured(measure_before_surface, range_m).any()
    range_m[11, COLUMN] = 8.0
    alone = measured(measure_before_surface, range_m)
    assert not alone.any()
    range_m[12, COLUMN + 3] = 8.1
    pair = measured(measure_before_surface, range_m)
    # 16 rings by 10 columns: the lowest and the highest ring have no neighbor on one side.
    assert pair[AHEAD] == pytest.approx(2 / (14 * 10 + 30))
    range_m[12, COLUMN + 3] = 12.0  # another range: rain
    assert not measured(measure_before_surface, range_m).any()


def test_two_returns_of_a_beam_unless_a_neighbor_lost_one() -> None:
    range_m = street()
    near = points_at(np.where(np.arange(COLUMNS) == COLUMN, 20.0, np.nan) * np.ones((RINGS, 1)))[0][12:13]
    found = measured(measure_double_returns, range_m, more=near, ring=12)
    assert found[AHEAD] == pytest.approx(1 / (16 * 10 + 30))
    assert np.count_nonzero(found) == 1
    range_m[12, COLUMN + 1] = np.nan
    assert not measured(measure_double_returns, range_m, more=near, ring=12).any()


def test_a_sensor_with_dual_returns_has_two_all_around() -> None:
    near = points_at(np.full((RINGS, COLUMNS), 20.0))[0].reshape(COLUMNS, RINGS, 3)[np.arange(COLUMNS) % 10 < 5, 12]
    assert not measured(measure_double_returns, street(), more=near, ring=12).any()


def test_a_point_between_the_beams_is_on_none() -> None:
    range_m = street()
    assert not measured(measure_off_beam, range_m).any()
    # Ring 12 rises by 4 degrees; the point is half a degree higher.
    azimuth, elevation = np.deg2rad(2.3), np.deg2rad(4.5)
    point = 15.0 * np.array(
        [[np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]]
    )
    found = measured(measure_off_beam, range_m, more=point, ring=12)
    assert found[AHEAD] == pytest.approx(1 / (16 * 10 + 1 + 20))
    assert np.count_nonzero(found) == 1


def test_beams_that_a_motion_tilts_together_are_no_points_between_them() -> None:
    points, rings = points_at(street())
    ahead = np.abs(np.arctan2(points[:, 1], points[:, 0])) < 0.6
    tilted = points + np.where(ahead, 0.05 * np.hypot(points[:, 0], points[:, 1]), 0.0)[:, None] * [0.0, 0.0, 1.0]
    sweep = sweep_of(street()).replace(points=tilted.astype(np.float32))
    found = measure_off_beam(monitored(sweep))
    assert found[AHEAD] == 0.0
    assert rings.shape == (len(sweep),)


def test_isolated_returns_are_counted_where_they_are() -> None:
    range_m = street()
    range_m[14, COLUMN] = 10.0
    found = measured(measure_isolated, range_m)
    assert found[AHEAD] == pytest.approx(1 / (16 * 10))
    assert np.count_nonzero(found) == 1


def test_without_rings_evidence_of_beams_abstains() -> None:
    points = np.random.default_rng(3).normal(0.0, 10.0, (500, 3))
    sweep = sweep_of(street()).replace(points=points.astype(np.float32), ring=None, model=None, infer_sensor=False)
    without = monitored(sweep)
    assert without.leveled.range_image is None
    for name in ("isolated", "behind_surface", "before_surface", "double_returns", "below_ground", "empty_runs",
                 "ground_noise", "near_noise", "surface_noise", "off_beam", "common_steps",
                 "straight_edges"):  # fmt: skip
        assert EVIDENCE[name].measure(without) is ABSTAINS


def test_the_sensor_of_these_tests_is_what_it_says() -> None:
    assert MODEL.rings == RINGS
    assert np.isfinite(ELEVATION).all()
