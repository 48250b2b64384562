"""The range image by hand: which pixel a return falls into, what a pixel holds, and what is left out."""

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed import Sweep
from viewshed.preprocess.range_image import RangeImage, pixels_of, range_image_by_rings
from viewshed.preprocess.ring_recovery import DEFAULT_COLUMNS, recover_rings
from viewshed.preprocess.sensor_identification import UNIDENTIFIED, SensorId
from viewshed.sensors import LidarModel

MODEL = LidarModel("two rings", np.deg2rad([-10.0, 5.0]), azimuth_columns=8, origin_m=np.array([0.1, 0.2]))
LIMITS_M = (0.5, 50.0)


def point(column: int, ring: int, range_m: float) -> tuple[float, float, float]:
    """A return in the middle of a column, at a distance from the sensor."""
    azimuth, elevation = (column + 0.5) * np.pi / 4 - np.pi, float(MODEL.elevation[ring])
    flat_m = range_m * np.cos(elevation)
    return float(flat_m * np.cos(azimuth)), float(flat_m * np.sin(azimuth)), float(range_m * np.sin(elevation))


def image_of(returns: list[tuple[int, int, float]], model: LidarModel | None = MODEL) -> RangeImage:
    """The image of returns given by column, ring and distance; of ring -1 no beam is known."""
    points = np.array([point(column, max(ring, 0), range_m) for column, ring, range_m in returns], np.float32)
    ring = np.array([ring for _, ring, _ in returns], np.int16)
    pixels = pixels_of(SensorId(ring, model))
    return pixels.image_of(points, LIMITS_M)


def test_each_return_has_the_pixel_of_its_beam_and_each_pixel_its_nearest_return() -> None:
    image = image_of([(0, 0, 10.0), (7, 1, 20.0), (3, 1, 5.0), (3, 1, 4.0), (2, -1, 3.0)])
    assert image.column.tolist() == [0, 7, 3, 3, -1]
    assert image.counts.tolist() == [[1, 0, 0, 0, 0, 0, 0, 0], [0, 0, 0, 2, 0, 0, 0, 1]]
    assert image.columns == 8
    assert image.range_m[[0, 1, 1], [0, 7, 3]] == pytest.approx([10.0, 20.0, 4.0], rel=1e-5)
    assert np.isfinite(image.range_m).sum() == 3
    assert np.array_equal(image.elevation, MODEL.elevation)
    assert image.origin_m.tolist() == [0.1, 0.2]


def test_returns_outside_the_limits_count_but_have_no_range_and_confirm_none() -> None:
    near_and_far = [(1, 0, 0.3), (2, 0, 60.0), (2, 1, 60.0), (3, 0, 5.0), (4, 0, 40.0)]
    image = image_of(near_and_far)
    assert image.counts.sum() == 5
    assert np.isfinite(image.range_m).sum() == 2
    assert image.isolated.tolist() == [False, False, False, True, True]


def test_an_isolated_return_behind_another_of_its_pixel() -> None:
    wall = [(column, ring, 10.0) for column in range(8) for ring in range(2)]
    image = image_of([*wall, (5, 0, 30.0), (6, 1, 10.5), (2, 1, 3.0)])
    assert np.flatnonzero(image.isolated).tolist() == [16, 18]
    assert np.flatnonzero(image.behind).tolist() == [16]
    assert image.clutter is None


def test_pixels_are_beams_where_the_sensor_is_known_and_its_rings_are_full() -> None:
    full = [(column, ring, 10.0) for column in range(8) for ring in range(2)]
    assert image_of(full).pixels_are_beams
    assert not image_of(full * 2).pixels_are_beams
    unknown = image_of(full, None)
    assert not unknown.pixels_are_beams
    assert unknown.counts.shape == (2, DEFAULT_COLUMNS)
    assert np.isnan(unknown.elevation).all()


def test_returns_taken_out_leave_their_pixels_and_the_image_as_it_was() -> None:
    image = image_of([(3, 1, 5.0), (3, 1, 4.0), (0, 0, 10.0)])
    column, counts = image.pixels_without(np.array([True, False, True]))
    assert column.tolist() == [-1, 3, -1]
    assert counts.sum() == counts[1, 3] == 1
    assert image.counts.sum() == 3
    arrays: list[NDArray[np.generic]] = [image.column, image.counts, image.squared_range_m2, image.isolated]
    for array in arrays:
        assert not array.flags.writeable


def test_a_pixel_holds_255_returns_at_most_and_then_stays_full() -> None:
    image = image_of([(3, 1, 5.0)] * 300)
    assert image.counts[1, 3] == 255
    assert image.pixels_without(np.arange(300) < 100)[1][1, 3] == 255


def test_without_rings_or_returns_there_is_no_image() -> None:
    assert pixels_of(UNIDENTIFIED) is None
    assert pixels_of(SensorId(np.zeros(0, np.int16), MODEL)) is None


def test_rings_that_are_bins_of_elevation_are_no_beams() -> None:
    points = np.random.default_rng(0).normal(0.0, 10.0, (200, 3)).astype(np.float32)
    rings = recover_rings(Sweep(points))
    assert rings.source == "elevation bins"
    image = range_image_by_rings(points, rings, LIMITS_M)
    assert not image.pixels_are_beams
    assert image.counts.sum() == 200
    assert np.array_equal(image.elevation, rings.elevation)
