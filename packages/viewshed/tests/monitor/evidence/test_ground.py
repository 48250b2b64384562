"""Evidence of the ground: returns below and beyond it, offsets and steps of its rings, empty runs, noise, edges."""

import numpy as np
import pytest
from tests.monitor.evidence.by_hand import (
    COLUMNS,
    ELEVATION,
    GROUND_RINGS,
    HEIGHT_M,
    columns_at,
    measured,
    sector_at,
    street,
    wall,
)

from viewshed import _core
from viewshed.monitor.evidence import SECTORS
from viewshed.monitor.evidence.beams import measure_empty_runs, measure_straight_edges
from viewshed.monitor.evidence.ground import (
    measure_below_ground,
    measure_beyond_ground,
    measure_common_steps,
    measure_range_offset,
)
from viewshed.monitor.evidence.noise import measure_ground_noise, measure_near_noise, measure_surface_noise

BEHIND, AHEAD = sector_at(-178.0), sector_at(2.0)


def relayed(offset_m: float) -> np.ndarray:
    """Return the ranges of the street with an offset in a wedge of 30 degrees ahead."""
    return street() + np.where(columns_at(-15.0, 15.0), offset_m, 0.0)


def test_ranges_drawn_at_random_end_below_the_ground() -> None:
    range_m = street()
    column = int(np.flatnonzero(columns_at(2.0, 2.6))[0])
    range_m[2, column] = 40.0  # where its ring meets the ground at 6.5 m
    found = measured(measure_below_ground, range_m)
    assert found[AHEAD] == pytest.approx(1 / (16 * 10 + 20))
    assert np.count_nonzero(found) == 1


def test_surfaces_below_the_ground_are_mirror_images_or_lower_ground_and_no_evidence() -> None:
    """A car's door shows a patch of the street: on neighboring beams, behind it and below the ground."""
    range_m, columns = street(), np.flatnonzero(columns_at(2.0, 4.0))
    range_m[2:5, columns] = 40.0
    assert measured(measure_below_ground, range_m).max() == 0.0
    range_m[0, columns[3]] = 15.0  # at its edge, where one beam alone meets something else
    assert measured(measure_below_ground, range_m).max() == 0.0


def test_clutter_below_the_ground_counts_as_well() -> None:
    rng, range_m = np.random.default_rng(0), street()
    jammed = rng.random(range_m.shape) < 0.3
    range_m[jammed] = rng.uniform(2.0, 90.0, jammed.sum())
    below = (range_m * np.sin(ELEVATION)[:, None] < -HEIGHT_M - 0.5 - 0.02 * range_m) & jammed
    found = measured(measure_below_ground, range_m)
    assert found.mean() == pytest.approx(below.mean(), rel=0.2)


def test_a_relay_moves_near_rings_beyond_the_ground() -> None:
    found = measured(measure_beyond_ground, relayed(5.0))
    # Rings at 20, 18 and 16 degrees meet the ground at 5.3, 5.8 and 6.5 m; 5 m more: at z = -1.71, -1.55 and -1.38 m,
    # lower than -(.25 + .12 x) = -1.41, -1.48, -1.58: two of sixteen rings.
    assert found[AHEAD] == pytest.approx(2 * 10 / (16 * 10 + 20))
    assert found[BEHIND] == 0.0


@pytest.mark.parametrize("offset_m", [1.0, 5.0, -1.0])
def test_the_offset_of_a_relay_is_measured(offset_m: float) -> None:
    found = measured(measure_range_offset, relayed(offset_m))
    assert found[AHEAD] == pytest.approx(abs(offset_m), rel=0.15)
    assert found[BEHIND] == pytest.approx(0.0, abs=0.02)


def test_a_slope_is_no_offset_of_range() -> None:
    slope = 0.05
    range_m = np.minimum(
        street(), (HEIGHT_M / np.maximum(slope * np.cos(ELEVATION) - np.sin(ELEVATION), 1e-9))[:, None]
    )
    found = measured(measure_range_offset, range_m)
    assert np.nanmax(found) < 0.05


def test_without_ground_the_offset_abstains() -> None:
    range_m = np.full((len(ELEVATION), COLUMNS), np.nan)
    range_m[-3:] = 20.0
    assert np.isnan(measured(measure_range_offset, range_m)).all()


def test_all_ground_rings_step_together_at_the_borders_of_a_relay() -> None:
    found = measured(measure_common_steps, relayed(5.0))
    # 5 m against no spread at all, and the .1 m that is always allowed.
    assert found.max() == pytest.approx(50.0, rel=1e-3)
    assert set(np.flatnonzero(found)) <= {sector_at(degrees) for degrees in (-16.0, -14.0, 14.0, 16.0)}
    assert not measured(measure_common_steps, street()).any()


def test_an_obstacle_steps_its_rings_by_different_amounts() -> None:
    found = measured(measure_common_steps, wall(street(), -15.0, 15.0, 5.1))
    assert found.max() < 5.0


def test_an_empty_run_is_as_long_as_the_sector_that_is_gone() -> None:
    range_m = street()
    assert not measured(measure_empty_runs, range_m).any()
    range_m[:, columns_at(-12.0, 13.0)] = np.nan
    found = measured(measure_empty_runs, range_m)
    assert found[AHEAD] == pytest.approx(25.0)
    assert found[BEHIND] == 0.0
    assert np.count_nonzero(found) == 6  # from -12 to 13 degrees


def test_an_empty_run_goes_on_behind_the_sensor() -> None:
    range_m = street()
    range_m[:, columns_at(170.0, 180.0) | columns_at(-180.0, -175.0)] = np.nan
    found = measured(measure_empty_runs, range_m)
    assert found[sector_at(-178.0)] == pytest.approx(15.0)
    assert found[sector_at(172.0)] == pytest.approx(15.0)


def noisy(low: int, high: int, sigma_m: float) -> np.ndarray:
    """Return the ranges of the street with .02 m of noise, and more in a wedge ahead on rings from low to high."""
    rng, range_m = np.random.default_rng(1), street()
    sigma = np.full(range_m.shape, 0.02)
    sigma[low:high, columns_at(-15.0, 15.0)] = sigma_m
    return range_m + sigma * rng.standard_normal(range_m.shape)


def test_noise_of_a_spoofer_on_the_ground() -> None:
    found = measured(measure_ground_noise, noisy(0, GROUND_RINGS, 0.1))
    # .1 m against .02 m, with .01 m added to the latter: the lower quartiles are about four fifths of both.
    assert found[AHEAD] == pytest.approx(0.1 / 0.03, rel=0.25)
    assert np.nanmedian(found) < 1.0


def test_noise_of_the_whole_sweep_is_none_of_a_spoofer() -> None:
    rng, range_m = np.random.default_rng(1), street()
    found = measured(measure_ground_noise, range_m + 0.1 * rng.standard_normal(range_m.shape))
    assert np.nanmax(found) < 1.5


def test_noise_of_a_spoofed_wall_is_that_of_surfaces() -> None:
    found = measured(measure_surface_noise, noisy(GROUND_RINGS, 16, 0.1))
    assert found[AHEAD] > 2.5
    assert found[BEHIND] < 1.5
    assert np.nanmax(measured(measure_ground_noise, noisy(GROUND_RINGS + 1, 16, 0.1))) < 2.0


def test_noise_of_near_surfaces_alone() -> None:
    rng = np.random.default_rng(1)
    near = wall(street(), -60.0, 60.0, 8.0)
    forged = near + np.where(columns_at(-15.0, 15.0), 0.1, 0.02) * rng.standard_normal(near.shape)
    found = measured(measure_near_noise, forged)
    assert found[AHEAD] > 2.5
    assert found[sector_at(40.0)] < 1.5
    # The same noise at the wall at 40 m is too far away.
    far = measured(measure_near_noise, noisy(GROUND_RINGS, 16, 0.1))
    assert not np.nanmax(far) > 2.0


def test_a_bend_without_noise_has_none() -> None:
    """Ranges along the rings on a parabola, to the millimeter that float32 leaves of its squares."""
    column = np.arange(-60, 60)
    range_m = np.tile(30.0 + 0.01 * column**2, (8, 1)).astype(np.float32)
    sector = np.zeros(column.size, np.int16)
    noise_m = _core.measure_noise(range_m, np.ones_like(range_m), sector, 1, 1)
    assert noise_m[2, 0, 0] == pytest.approx(0.0, abs=2e-3)


def test_leaves_are_too_rough_to_be_noise() -> None:
    assert not np.nanmax(measured(measure_surface_noise, noisy(GROUND_RINGS, 16, 1.0))) > 2.0


def test_edges_in_all_rings() -> None:
    found = measured(measure_straight_edges, relayed(5.0))
    border = found[[sector_at(-14.0), sector_at(14.0), sector_at(-16.0), sector_at(16.0)]].max()
    # Rings whose range grows by more than a tenth and .3 m: all, 40 m grow to 45 m; of 16 and two that are added.
    assert border == pytest.approx(16 / 18)
    assert not measured(measure_straight_edges, street()).any()
    corner = measured(measure_straight_edges, wall(street(), -15.0, 15.0, 12.0, 30.0))
    assert corner.max() < 0.65
    assert found.shape == (SECTORS,)
