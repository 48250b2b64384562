"""Rings without a table: sensors that nobody makes, and clouds that have no rings."""

import numpy as np
import pytest
from tests.preprocess.random_sensors import random_scene, random_sensor, right_share, rosette

from viewshed import BevGrid, Sweep
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.preprocess.beam_matching import polar
from viewshed.preprocess.elevation_clusters import find_clusters
from viewshed.preprocess.sensor_identification import identify_sensor
from viewshed.sensors import LidarModel
from viewshed_lab.sim import cast, junction

SEEDS = range(5)


def measured(seed: int) -> tuple[Sweep, np.random.Generator]:
    """Return a sweep of a random sensor in a random scene, in no order, with its true rings."""
    rng = np.random.default_rng(1000 + seed)
    model, scene = random_sensor(rng), random_scene(rng)
    sweep = cast(model, scene, float(rng.uniform(0.5, 2.5)), rng=rng)
    return sweep.select(rng.permutation(len(sweep))), rng


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("kind", ["as they are", "millimeters", "half of the returns", "one in twenty anywhere"])
def test_random_sensors_show_their_rings_whatever_is_lost_and_are_given_no_name(seed: int, kind: str) -> None:
    sweep, rng = measured(seed)
    points, ring, least = sweep.points, sweep.ring, 0.97
    if kind == "as they are":
        least = 0.99
    elif kind == "millimeters":
        points = np.round(points, 3)
    elif kind == "half of the returns":
        kept = rng.random(len(points)) < 0.5
        points, ring = points[kept], ring[kept]
    else:
        points, stray, least = points.copy(), rng.random(len(points)) < 0.05, 0.93
        points[stray] = rng.normal(0.0, 15.0, (int(stray.sum()), 3))
    sensor_id = identify_sensor(Sweep(points))
    assert sensor_id.model is None
    assert right_share(sensor_id.ring, ring) > least


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("moved_m", [(1.2, 0.0, 1.7), (0.25, 0.1, 0.0)])
def test_points_that_are_not_in_the_sensors_frame_have_no_rings_or_the_right_ones(
    seed: int, moved_m: tuple[float, ...]
) -> None:
    sweep = measured(seed)[0]
    sensor_id = identify_sensor(Sweep(sweep.points + np.array(moved_m, np.float32)))
    assert sensor_id.model is None
    assert sensor_id.ring is None or right_share(sensor_id.ring, sweep.ring) > 0.99


@pytest.mark.parametrize("seed", range(4))
def test_a_pattern_that_does_not_repeat_has_no_rings(seed: int) -> None:
    sensor_id = identify_sensor(Sweep(rosette(np.random.default_rng(seed))))
    assert (sensor_id.ring, sensor_id.model) == (None, None)


@pytest.mark.parametrize("seed", range(4))
def test_a_rolled_second_sensor_in_the_cloud_leaves_no_rings(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = (cast(random_sensor(rng), junction(), 1.8, rng=rng).points for _ in range(2))
    size = min(len(first), len(second))
    roll = np.deg2rad(25.0)
    turn = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    both = np.concatenate([rng.permutation(first)[:size], rng.permutation(second)[:size] @ turn.T])
    sensor_id = identify_sensor(Sweep(rng.permutation(both)))
    assert (sensor_id.ring, sensor_id.model) == (None, None)


def test_clusters_stand_at_the_beams_and_know_their_origin() -> None:
    elevation_deg = np.array([-24.0, -17.5, -12.0, -11.5, -8.0, -6.5, -3.0, -1.0, 0.4, 2.0, 5.0, 9.5])
    model = LidarModel("nobody's", np.deg2rad(elevation_deg), 900, origin_m=np.full(12, 0.12))
    clusters = find_clusters(*polar(cast(model, junction(), 1.8).points))
    assert np.rad2deg(clusters.elevation) == pytest.approx(elevation_deg, abs=0.02)
    assert clusters.origin_m == pytest.approx(np.full(12, 0.12), abs=0.006)
    assert clusters.sharpness > 0.99


@pytest.mark.parametrize("seed", [0, 3, 5])
def test_an_unknown_sensor_is_seen_as_well_without_its_ring_column(seed: int) -> None:
    grid = BevGrid(128, 32.0)
    rng = np.random.default_rng(seed)
    known = cast(random_sensor(rng), junction(), 1.8, rng=rng).replace(model=None, sensor_height_m=None)
    bare = known.select(rng.permutation(len(known))).replace(ring=None, azimuth=None)
    with_rings, without = (ShadowMap(grid).estimate(sweep).visible() for sweep in (known, bare))
    assert (with_rings == without).mean() > 0.99
