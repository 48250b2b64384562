"""Rings and sensors that a bare cloud tells, and when it tells none."""

import numpy as np
import pytest

from viewshed import BevGrid, Sweep
from viewshed.estimators.shadow_map import ShadowMap
from viewshed.preprocess.leveling import level
from viewshed.preprocess.ring_recovery import recover_rings
from viewshed.preprocess.sensor_identification import identify_sensor, infer_sensor
from viewshed.sensors import LidarModel, lidar_model
from viewshed_lab.sim import Box, Scene, cast

SCENE = Scene((Box(14, 6, 1, 20, 8), Box(-20, -3, 1, 60, 9), Box(6, -9, 4.2, 1.8, 1.5)))
KNOWN = cast(lidar_model("hdl32e"), SCENE, 1.8)
GRID = BevGrid(128, 32.0)


def bare(sweep: Sweep, seed: int = 1) -> Sweep:
    """The points alone, in no order."""
    return sweep.select(np.random.default_rng(seed).permutation(len(sweep))).replace(ring=None, model=None)


def ring_by_ring(sweep: Sweep) -> Sweep:
    return sweep.select(np.lexsort((np.arctan2(sweep.points[:, 1], sweep.points[:, 0]), sweep.ring)))


def test_a_cloud_in_no_order_tells_sensor_and_rings() -> None:
    assert len(KNOWN) > 16_384  # more than are looked at
    order = np.random.default_rng(1).permutation(len(KNOWN))
    sensor_id = identify_sensor(bare(KNOWN))
    assert sensor_id.model is KNOWN.model
    assert (sensor_id.ring == KNOWN.ring[order]).mean() > 0.99


def test_a_cloud_in_the_order_of_its_rings_tells_them_without_any_table() -> None:
    model = LidarModel("nobody's", np.deg2rad(np.linspace(-24, 8, 23) ** 3 / 300), azimuth_columns=720)
    sweep = cast(model, SCENE, 1.8)
    ordered = ring_by_ring(sweep)
    sensor_id = identify_sensor(ordered.replace(ring=None, model=None))
    assert sensor_id.model is None
    assert (sensor_id.ring == ordered.ring).mean() > 0.99  # a ring begins where the azimuth wraps
    shuffled = identify_sensor(bare(ordered))
    assert shuffled.model is None
    assert len(np.unique(shuffled.ring)) == 22  # two of the 23 beams lie within 0.01 degrees


def test_two_sensors_in_one_frame_are_none() -> None:
    model = lidar_model("vlp32c")
    sweep = cast(model, SCENE, 1.8)
    again = sweep.points * np.float32(1.02) + np.array([0, 0, 0.06], np.float32)
    both = np.concatenate([sweep.points, again])
    assert infer_sensor(bare(sweep).points)[0] is model
    moved = bare(sweep).points + np.random.default_rng(0).normal(0, 0.03, (len(sweep), 3)).astype(np.float32)
    assert infer_sensor(moved)[0] is model  # beside its beams, as a moving sensor's points lie
    assert infer_sensor(both[np.random.default_rng(2).permutation(len(both))])[0] is None


def test_a_bare_cloud_is_seen_as_well_as_one_with_rings() -> None:
    """Some beams return nothing: only rings tell which, and the bare cloud's are told by its sensor's table."""
    gone = (np.arctan2(KNOWN.points[:, 1], KNOWN.points[:, 0]) > 2.0) & (KNOWN.points[:, 2] < -1.7)
    sweep = KNOWN.select(~gone | (np.random.default_rng(3).random(len(KNOWN)) < 0.3))
    known, cloud = (ShadowMap(GRID).estimate(each).visible() for each in (sweep, bare(sweep)))
    assert (known == cloud).mean() > 0.98


@pytest.mark.parametrize("with_rings", [True, False])
def test_no_sensor_is_inferred_where_there_is_said_to_be_none(with_rings: bool) -> None:
    """The beams of an HDL-32E explain the points, but the sweep says that no table does."""
    sweep = KNOWN.replace(model=None) if with_rings else bare(KNOWN)
    none = sweep.replace(infer_sensor=False)
    inferred, sensor_id = identify_sensor(sweep), identify_sensor(none)
    assert inferred.model is KNOWN.model
    assert inferred.ring is sweep.ring if with_rings else inferred.ring is not None
    assert sensor_id.model is None
    assert sensor_id.ring is none.ring if with_rings else sensor_id.ring is not None
    leveled = level(none.select(np.arange(len(none))), GRID)
    assert leveled.sensor_id.model is None
    assert leveled.range_image is not None


@pytest.mark.parametrize("with_rings", [True, False])
def test_every_second_beam_of_a_table_is_another_sensor(with_rings: bool) -> None:
    """A VLP-16 whose beams stand at the even degrees gathers at beams of an XT32."""
    model = LidarModel("shifted", np.deg2rad(np.arange(-14.0, 17.0, 2.0)), azimuth_columns=1800)
    sweep = cast(model, SCENE, 1.8).replace(model=None)
    assert (
        infer_sensor(sweep.points if with_rings else bare(sweep).points, sweep.ring if with_rings else None)[0] is None
    )


@pytest.mark.parametrize("with_rings", [True, False])
@pytest.mark.parametrize("name", ["vlp16", "vlp32c", "hdl32e", "hdl64e"])
def test_a_calibration_of_its_own_is_not_the_stock_table(name: str, with_rings: bool) -> None:
    stock = lidar_model(name)
    gap = np.diff(stock.elevation, prepend=-np.pi, append=np.pi)
    away = np.minimum(0.18 * np.minimum(gap[:-1], gap[1:]), np.deg2rad(0.24))
    away *= np.random.default_rng(5).choice([-1.0, 1.0], stock.rings)
    own = LidarModel("own", stock.elevation + away, stock.azimuth_columns, origin_m=stock.origin_m)
    sweep = cast(own, SCENE, 1.8).replace(model=None)
    sensor_id = identify_sensor(sweep if with_rings else bare(sweep))
    assert sensor_id.model is None
    assert identify_sensor(cast(stock, SCENE, 1.8).replace(model=None)).model is stock


def test_fewer_rings_than_the_table_has_are_counted_as_its_beams() -> None:
    model = lidar_model("vlp32c")
    sweep = cast(model, SCENE, 1.8)
    upper = sweep.select(np.flatnonzero(sweep.ring >= 10))
    sensor_id = identify_sensor(upper.replace(model=None, ring=upper.ring - 10))
    assert sensor_id.model is model
    assert (sensor_id.ring == upper.ring).mean() > 0.999


def test_two_sensors_one_after_the_other_are_not_the_rings_of_one() -> None:
    lower, upper = (LidarModel("nobody's", np.deg2rad(np.linspace(*ends, 27)), 900) for ends in ((-22, 9), (-19, 11)))
    points = np.concatenate([cast(lower, SCENE, 1.8).points, cast(upper, SCENE, 1.5).points + np.float32(0.3)])
    assert recover_rings(Sweep(cast(lower, SCENE, 1.8).points)).source == "file order"
    assert recover_rings(Sweep(points)).source != "file order"
    assert identify_sensor(Sweep(points)).ring is None
