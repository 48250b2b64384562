"""Rings from laser numbers in any order."""

import numpy as np
import pytest

from viewshed import LidarModel
from viewshed.io._rings import rings_by_elevation

ELEVATIONS = np.deg2rad([-20.0, -12.0, -7.0, -1.0, 2.0, 9.0])


def cloud(beams: list[int], columns: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Return points (N, 3) of these beams at changing ranges, and the true beam (N,)."""
    beam = np.repeat(beams, columns)
    rng = np.random.default_rng(3)
    azimuth, distance = rng.uniform(-3, 3, beam.size), rng.uniform(3, 40, beam.size)
    elevation = ELEVATIONS[beam]
    xyz = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=1
    )
    return (distance[:, None] * xyz).astype(np.float32), beam


@pytest.mark.parametrize("order", [[0, 1, 2, 3, 4, 5], [5, 4, 3, 2, 1, 0]])
def test_a_beam_without_returns_keeps_its_place(order: list[int]) -> None:
    points, beam = cloud([0, 1, 3, 5])
    assert rings_by_elevation(np.array(order)[beam], points).tolist() == beam.tolist()


def test_a_model_places_the_beams_of_a_scrambled_order() -> None:
    points, beam = cloud([0, 1, 3, 4])
    order = np.array([3, 0, 5, 1, 4, 2])
    model = LidarModel("six", ELEVATIONS, 40)
    assert rings_by_elevation(order[beam], points, model).tolist() == beam.tolist()
