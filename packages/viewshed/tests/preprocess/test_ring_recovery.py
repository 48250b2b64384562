"""Rings, columns and sensors recovered from clouds whose rings and columns are known."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from viewshed.io import read_index, read_indexed
from viewshed.preprocess.ring_recovery import RingAssignment, recover_rings
from viewshed.preprocess.sensor_identification import infer_sensor
from viewshed.sensors import LidarModel, inferable_sensors, lidar_model, sensor_names
from viewshed.sweep import Sweep


@dataclass(frozen=True)
class Cloud:
    """Points with the ring and firing azimuth that they were cast from, ring after ring."""

    points: NDArray[np.float32]
    ring: NDArray[np.int16]
    azimuth: NDArray[np.float64]

    def taken(self, order: NDArray[np.intp]) -> "Cloud":
        return Cloud(self.points[order], self.ring[order], self.azimuth[order])


def cast(model: LidarModel, seed: int = 0, columns: int = 720, jitter_deg: float = 0.0, missing: float = 0.1) -> Cloud:
    """Cast every beam of ``model``, lowest ring first, azimuth from 0 counter-clockwise, to random depths."""
    rng = np.random.default_rng(seed)
    ring, column = np.divmod(np.arange(model.rings * columns), columns)
    keep = rng.random(len(ring)) >= missing
    ring, column = ring[keep], column[keep]
    azimuth = (column + 0.5) * (2 * np.pi / columns)
    elevation = model.elevation[ring] + rng.normal(0.0, np.deg2rad(jitter_deg), len(ring))
    range_m = rng.uniform(4.0, 60.0, len(ring))
    points = np.stack(
        [range_m * np.cos(azimuth), range_m * np.sin(azimuth), model.origin_m[ring] + range_m * np.tan(elevation)],
        axis=1,
    )
    return Cloud(points.astype(np.float32), ring.astype(np.int16), azimuth)


def small_jitter_deg(model: LidarModel) -> float:
    return min(0.03, float(np.rad2deg(np.diff(model.elevation).min())) / 20)


def shuffled(cloud: Cloud, seed: int = 1) -> Cloud:
    return cloud.taken(np.random.default_rng(seed).permutation(len(cloud.ring)))


def model_of(elevations_deg: list[float], columns: int = 360) -> LidarModel:
    return LidarModel("test", np.deg2rad(elevations_deg), columns)


@pytest.mark.parametrize("name", [name for name in sensor_names() if lidar_model(name).fires_rings])
def test_beam_table_places_a_shuffled_cloud(name: str) -> None:
    model = lidar_model(name)
    cloud = shuffled(cast(model, jitter_deg=small_jitter_deg(model)))
    beams = recover_rings(Sweep(cloud.points), model)
    assert beams.source == "beam table"
    assert (beams.ring == cloud.ring).mean() >= 0.995
    assert beams.placed_share >= 0.999
    assert beams.columns == 720
    assert beams.alone_share > 0.98
    assert beams.elevation.shape == (model.rings,)


@pytest.mark.parametrize("turn", [1, -1])
@pytest.mark.parametrize("upward", [True, False])
def test_file_order_tells_rings_without_a_model(turn: int, upward: bool) -> None:
    cloud = cast(lidar_model("hdl32e"), columns=500, missing=0.3)
    azimuth = (turn * cloud.azimuth) % (2 * np.pi)
    range_m = np.hypot(cloud.points[:, 0], cloud.points[:, 1])
    points = np.stack([range_m * np.cos(azimuth), range_m * np.sin(azimuth), cloud.points[:, 2]], axis=1)
    order = np.arange(len(points)) if upward else np.lexsort((cloud.azimuth, -cloud.ring))
    beams = recover_rings(Sweep(points[order]))
    assert beams.source == "file order"
    assert (beams.ring == cloud.ring[order]).all()
    assert beams.columns == 500


def test_firing_order_is_not_taken_for_ring_order() -> None:
    model = lidar_model("vlp16")
    cloud = cast(model)
    cloud = cloud.taken(np.lexsort((cloud.ring, cloud.azimuth)))
    beams = recover_rings(Sweep(cloud.points, model=model))
    assert beams.source == "beam table"
    assert (beams.ring == cloud.ring).all()


def test_a_shuffled_cloud_of_no_beams_falls_to_bins() -> None:
    points = np.random.default_rng(1).uniform([-40, -40, -2], [40, 40, 6], (20_000, 3)).astype(np.float32)
    beams = recover_rings(Sweep(points))
    assert beams.source == "elevation bins"
    assert beams.placed_share == 1.0
    slope = points[:, 2] / np.hypot(points[:, 0], points[:, 1])
    lower, upper = beams.ring < 20, beams.ring > 20
    assert slope[lower].max() <= slope[upper].min() + 1e-6


def test_a_table_that_does_not_fit_is_not_used_as_beams() -> None:
    points = np.random.default_rng(3).normal(0, 20, (5000, 3)).astype(np.float32)
    beams = recover_rings(Sweep(points), lidar_model("vlp16"))
    assert (beams.source, beams.columns, beams.rings) == ("elevation bins", 1800, 16)


def test_rings_of_the_file_are_kept() -> None:
    cloud = shuffled(cast(lidar_model("vlp16")))
    wrong = (cloud.ring[::-1] // 2).astype(np.int16)
    beams = recover_rings(Sweep(cloud.points, ring=wrong))
    assert beams.source == "file"
    assert beams.ring.tolist() == wrong.tolist()
    assert beams.rings == 8


def test_columns_count_counter_clockwise_from_behind() -> None:
    azimuth = np.deg2rad([-179.5, -90.5, -0.5, 0.5, 44.5, 120.5, 179.5])
    points = 10 * np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=1)
    sweep = Sweep(points, ring=np.zeros(7, int), model=model_of([0.0]))
    beams = recover_rings(sweep)
    assert beams.column.tolist() == [0, 89, 179, 180, 224, 300, 359]
    centers = (beams.column + 0.5) * beams.azimuth_step - np.pi
    assert centers == pytest.approx(azimuth, abs=1e-5)


def test_stray_returns_are_not_placed() -> None:
    model = lidar_model("vlp16")
    cloud = shuffled(cast(model))
    stray = np.array([[20.0, 3.0, 0.0], [5.0, -20.0, 18.0], [0.0, 0.0, 0.0]], np.float32)  # 1° off, 41° up, no range
    beams = recover_rings(Sweep(np.concatenate([cloud.points, stray])), model)
    assert beams.ring[-3:].tolist() == [-1, -1, -1]
    assert beams.placed_share == pytest.approx(1 - 3 / len(beams.ring))


def test_elevation_is_the_median_and_gaps_are_filled() -> None:
    rng = np.random.default_rng(5)
    degrees = rng.uniform([-20, -3], [-10, 8], (501, 2)).T.ravel()
    ring = np.repeat([0, 3], 501)
    azimuth = rng.uniform(-3, 3, 1002)
    points = 20 * np.stack([np.cos(azimuth), np.sin(azimuth), np.tan(np.deg2rad(degrees))], axis=1)
    low, high = np.median(degrees[:501]), np.median(degrees[501:])
    beams = recover_rings(Sweep(points, ring=ring))
    assert np.rad2deg(beams.elevation) == pytest.approx(
        [low, (2 * low + high) / 3, (low + 2 * high) / 3, high], abs=2e-3
    )
    with_model = recover_rings(Sweep(points, ring=ring, model=model_of([-15, -7, 1, 2, 9])))
    assert np.rad2deg(with_model.elevation) == pytest.approx([low, -7, 1, high, 9], abs=2e-3)


def test_a_model_that_knows_the_step_outweighs_gaps_in_every_ring() -> None:
    azimuth = np.deg2rad(np.arange(0, 360, 0.2)[np.arange(1800) % 10 < 6])  # 1.0° of every 2° is dark
    points = 20 * np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=1)
    sweep = Sweep(points, ring=np.zeros(len(points), int))
    assert recover_rings(sweep, model_of([0.0], 1750)).columns == pytest.approx(1800, abs=2)
    assert recover_rings(sweep).columns == pytest.approx(360, abs=2)


DEGENERATE = {
    "empty": np.zeros((0, 3)),
    "one": np.array([[3.0, 4.0, -1.0]]),
    "two": np.array([[3.0, 4.0, -1.0], [-7.0, 2.0, 0.5]]),
    "same": np.tile([[3.0, 4.0, -1.0]], (500, 1)),
    "at the origin": np.zeros((50, 3)),
    "above": np.tile([[0.0, 0.0, 5.0]], (50, 1)),
    "one azimuth": np.linspace(1, 50, 400)[:, None] * np.array([[0.6, 0.8, -0.05]]),
    "one side": np.random.default_rng(0).uniform([1, -2, -1], [30, 2, 2], (400, 3)),
    "behind": np.stack([-np.arange(1.0, 100), -np.zeros(99), np.arange(99.0)], axis=1),
    "far": np.array([[3e37, 1e37, 1e37], [1e-37, 0.0, 1e37]]),
}


@pytest.mark.parametrize("name", DEGENERATE)
@pytest.mark.parametrize("kind", ["bare", "model", "ring", "both"])
def test_degenerate_clouds_are_answered(name: str, kind: str) -> None:
    points = DEGENERATE[name]
    model = lidar_model("hdl64e") if kind in ("model", "both") else None
    ring = np.full(len(points), 2) if kind in ("ring", "both") else None
    beams = recover_rings(Sweep(points, ring=ring), model)
    _is_sound(beams, len(points))
    inferred, score = infer_sensor(points, ring)
    assert 0.0 <= score <= 1.0
    assert inferred is None or len(points) > 10


def _is_sound(beams: RingAssignment, count: int) -> None:
    assert beams.ring.shape == beams.column.shape == (count,)
    assert beams.rings >= 1
    assert np.isfinite(beams.elevation).all()
    assert 4 <= beams.columns <= 36_000
    assert 0 <= beams.placed_share <= 1
    assert 0 <= beams.alone_share <= 1
    if count:
        assert -1 <= beams.ring.min() <= beams.ring.max() < beams.rings
        assert 0 <= beams.column.min() <= beams.column.max() < beams.columns
        assert beams.placed_share == pytest.approx((beams.ring >= 0).mean())


@settings(max_examples=15)
@given(yaw=st.floats(-math.pi, math.pi), seed=st.integers(0, 1000))
def test_rings_do_not_change_when_the_scene_turns(yaw: float, seed: int) -> None:
    model = lidar_model("os1_32g")
    cloud = shuffled(cast(model, seed, columns=90), seed)
    turn = np.array([[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]])
    beams = recover_rings(Sweep(cloud.points @ turn.T), model)
    assert (beams.ring == cloud.ring).all()
    expected = np.floor(((cloud.azimuth + yaw + np.pi) % (2 * np.pi)) / beams.azimuth_step)
    away = (beams.column - expected + beams.columns / 2) % beams.columns - beams.columns / 2
    assert np.abs(away).max() <= 1


@pytest.mark.parametrize("name", inferable_sensors())
def test_each_sensor_is_inferred_from_its_own_bare_points(name: str) -> None:
    model = lidar_model(name)
    inferred, score = infer_sensor(shuffled(cast(model, jitter_deg=small_jitter_deg(model))).points)
    assert inferred is model
    assert 0.9 < score <= 1.0


def test_rings_name_a_sensor_that_its_elevations_hide() -> None:
    model = lidar_model("hdl32e")
    cloud = shuffled(cast(model, jitter_deg=0.35))
    assert infer_sensor(cloud.points)[0] is None
    inferred, score = infer_sensor(cloud.points, cloud.ring)
    assert inferred is model
    assert score > 0.99


@pytest.mark.parametrize("kind", ["noise", "plane"])
def test_no_sensor_where_no_table_explains_the_cloud(kind: str) -> None:
    points = np.random.default_rng(2).normal(0, 20, (20_000, 3))
    if kind == "plane":
        points[:, 2] = -1.8
    inferred, score = infer_sensor(points)
    assert inferred is None
    assert score < 0.2


def test_kitti_file_order_gives_64_rings(real_data: object) -> None:
    entries = [entry for entry in read_index(f"{real_data}/index.json") if "kitti" in str(entry.file)]
    whole = [entry for entry in entries if entry.file.suffix == ".bin" and "cropped" not in str(entry.file)]
    assert len(whole) == 10
    for entry in whole:
        beams = recover_rings(read_indexed(entry).replace(model=None, ring=None))
        assert (beams.source, beams.rings, beams.placed_share) == ("file order", 64, 1.0)
        assert len(np.unique(beams.ring)) == 64
        assert (np.diff(beams.elevation) > 0).mean() > 0.9
        assert 1900 < beams.columns < 2100


EXPECTED = {
    "Velodyne HDL-32E": "HDL-32E", "Velodyne HDL-64E": "HDL-64E", "Velodyne VLP-16": "VLP-16",
    "Velodyne VLP-32C": "VLP-32C", "Hesai PandarXT-32": "XT32", "Hesai Pandar40P": "Pandar40P",
    "Hesai OT128": "OT128", "16-beam": "VLP-16", "32-beam": "HDL-32E", "Ouster OS0-128": "OS0-128",
    "Ouster OS1-128": "OS1-128", "Ouster OS1-32": "OS1-32 gradient", "CARLA 0.9.9": "CARLA 256",
}  # fmt: skip
UNKNOWN = ("2 x VLP-32C", "Hesai Pandar64")  # two sensors in one frame; ego frame of unknown origin


@pytest.mark.slow
def test_every_real_sweep_is_named_right_or_not_at_all(real_data: object) -> None:
    seen = 0
    for entry in read_index(f"{real_data}/index.json"):
        if entry.points is None:
            continue
        sweep = read_indexed(entry)
        model, _ = infer_sensor(sweep.points, sweep.ring)
        expected = [name for start, name in EXPECTED.items() if entry.sensor.startswith(start)]
        assert (model.name if model else None) == (expected[0] if expected else None), entry.file
        assert expected or entry.sensor.startswith(UNKNOWN)
        seen += 1
    assert seen >= 60


@pytest.mark.parametrize("start", [0.0, np.pi])
def test_rings_stored_one_after_the_other_hold_no_halves_of_two(start: float) -> None:
    rings, columns = 24, 900
    ring, column = np.mgrid[:rings, :columns]
    # The last but one point of a third of the rings lies beyond the seam.
    jitter = 0.02 * ((ring % 3 == 0) & (column == columns - 2))
    azimuth = (start + (column + 0.5) * (2 * np.pi / columns) + jitter + np.pi) % (2 * np.pi) - np.pi
    slope = np.tan(np.deg2rad(-24.0 + 1.3 * ring)) + 5e-4 * column / columns  # a sensor that is hardly level
    points = 20.0 * np.stack([np.cos(azimuth), np.sin(azimuth), slope], axis=-1).reshape(-1, 3)
    found = recover_rings(Sweep(points.astype(np.float32)))
    assert (found.source, found.rings) == ("file order", rings)
    assert (found.ring == ring.ravel()).mean() > 0.999
