"""Rings of sensors that moved while they measured: points in one frame, each measured from another place."""

from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.preprocess.random_sensors import random_sensor, right_share, rosette

from viewshed import Sweep
from viewshed.arrays import F32
from viewshed.preprocess.sensor_identification import identify_sensor
from viewshed.sensors import LidarModel

SEAMS = (-np.pi, -np.pi / 2, 0.0, np.pi / 2)

Rings = NDArray[np.int16]


class SensorMotion(NamedTuple):
    """An even motion during a revolution, in the frame of the points."""

    way_m: NDArray[np.float64]  # (3,) meters from its beginning to its end
    seam: float  # azimuth in radians at which it begins and ends
    reference: float  # part of the turn, counter-clockwise, at which the sensor was at the origin


def measured(model: LidarModel, motion: SensorMotion, rng: np.random.Generator) -> tuple[F32, Rings]:
    """Return points (N, 3) in one frame and their rings: walls at 6 to 40 m, seen by a sensor that moves evenly."""
    azimuth = -np.pi + (np.arange(model.azimuth_columns) + 0.5) * (2 * np.pi / model.azimuth_columns)
    wall_m = 18.0 + 9.0 * np.sin(3.0 * azimuth) + 4.0 * np.cos(7.0 * azimuth)
    ring, column = (each.ravel() for each in np.mgrid[: model.rings, : model.azimuth_columns])
    elevation, angle = model.elevation[ring], azimuth[column]
    # The ground 1.8 m below the sensor, or a wall.
    range_m = np.where(
        elevation < 0, np.minimum(1.8 / np.tan(np.maximum(-elevation, 1e-3)), wall_m[column]), wall_m[column]
    )
    seen = range_m[:, None] * np.stack([np.cos(angle), np.sin(angle), np.tan(elevation)], axis=1)
    seen[:, 2] += model.origin_m[ring]
    turn = ((angle - motion.seam) / (2 * np.pi)) % 1.0 - motion.reference
    points = (seen + turn[:, None] * motion.way_m).astype(np.float32)
    order = rng.permutation(len(points))
    return points[order], ring[order].astype(np.int16)


def uneven(rings: int = 24) -> LidarModel:
    steps = np.random.default_rng(rings).uniform(0.5, 1.5, rings - 1)
    elevation_deg = -26.0 + np.append(0.0, np.cumsum(steps)) * 34.0 / steps.sum()
    return LidarModel("nobody's", np.deg2rad(elevation_deg), 900)


@pytest.mark.parametrize(("seam", "reference"), list(zip(SEAMS, (0.0, 0.5, 1.0, 0.5), strict=True)))
@pytest.mark.parametrize("way_m", [(1.4, 0.1, 0.02), (-0.3, 2.1, -0.06), (1.8, 0.0, 0.2)])
def test_a_motion_is_found_and_undone(seam: float, reference: float, way_m: tuple[float, ...]) -> None:
    true = SensorMotion(np.array(way_m), seam, reference)
    points, ring = measured(uneven(), true, np.random.default_rng(1))
    inferred = identify_sensor(Sweep(points)).ring
    assert right_share(inferred, ring) > 0.96  # near the seam a point may be of either end of the revolution


def test_random_sensors_that_move_show_their_rings_or_none_and_are_given_no_name() -> None:
    shown = 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        motion = SensorMotion(np.append(rng.uniform(-1.5, 1.5, 2), rng.uniform(-0.05, 0.05)), -np.pi, 0.5)
        points, ring = measured(random_sensor(rng), motion, rng)
        sensor_id = identify_sensor(Sweep(points))
        assert sensor_id.model is None
        if sensor_id.ring is not None:
            assert right_share(sensor_id.ring, ring) > 0.95
            shown += 1
    assert shown >= 5


@pytest.mark.parametrize("seed", range(4))
def test_no_motion_makes_rings_of_a_pattern_that_has_none(seed: int) -> None:
    assert identify_sensor(Sweep(rosette(np.random.default_rng(seed)))).ring is None
