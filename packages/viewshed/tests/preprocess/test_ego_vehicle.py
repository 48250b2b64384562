"""The own vehicle: its returns are left out, however the sensor is turned on it, and those of others are not."""

import numpy as np
import pytest

from viewshed import BevGrid, Sweep, _core
from viewshed.arrays import F32
from viewshed.estimators.first_blocker import FirstBlocker
from viewshed.io import read_index, read_indexed
from viewshed.preprocess.leveling import level
from viewshed.sensors import lidar_model
from viewshed_lab.sim import cast, junction

GRID = BevGrid(128, 32.0)
LEVEL = np.eye(3, dtype=np.float32)
STREET = cast(lidar_model("vlp16"), junction(), 1.8)


def own_car(seed: int = 0) -> F32:
    """Return returns of roof, hood and trunk of a car along x, seen from a sensor 0.3 m above its roof."""
    rng = np.random.default_rng(seed)
    roof = np.column_stack([rng.uniform(-1.2, 1.2, 400), rng.uniform(-0.8, 0.8, 400), np.full(400, -0.3)])
    ends = np.column_stack([rng.uniform(1.3, 2.4, 300), rng.uniform(-0.85, 0.85, 300), np.full(300, -0.9)])
    ends[::2, 0] *= -1
    return np.concatenate([roof, ends]).astype(np.float32)


def turned(points: F32, degrees: float) -> F32:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.asarray(points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]), np.float32)


def off_deg(heading: float, degrees: float) -> float:
    """Return how far a heading lies from the given one; front and back are not told apart."""
    return float(abs((np.rad2deg(heading) - degrees + 90) % 180 - 90))


@pytest.mark.parametrize("degrees", [0, 30, 45, 90, 120, -60])
def test_the_heading_follows_the_vehicle(degrees: float) -> None:
    points = np.concatenate([turned(own_car(), degrees), STREET.points])
    assert off_deg(_core.vehicle_heading(points, LEVEL), degrees) < 8


@pytest.mark.parametrize("degrees", [0, 45, 90])
def test_returns_of_the_own_vehicle_are_left_out_and_hide_nothing(degrees: float) -> None:
    street = STREET.replace(ring=None, azimuth=None, model=None, infer_sensor=False, sensor_height_m=None)
    free = street.points[np.hypot(*street.points[:, :2].T) > 3.2]
    sweep = Sweep(np.concatenate([free, turned(own_car(), degrees)]), infer_sensor=False)
    leveled = level(sweep, GRID)
    assert (leveled.rows < len(free)).all()
    assert abs(leveled.sensor_height_m - 1.8) < 0.1
    alone, carried = (FirstBlocker(GRID).estimate(s).visible() for s in (Sweep(free, infer_sensor=False), sweep))
    assert (alone & carried).sum() / (alone | carried).sum() > 0.98


def test_a_heading_that_is_told_is_believed() -> None:
    points = np.concatenate([STREET.points[np.hypot(*STREET.points[:, :2].T) > 3.2], [[0.0, 2.0, -1.0]]])
    kept, left_out = (level(Sweep(points, vehicle_yaw=yaw), GRID).rows for yaw in (0.0, np.pi / 2))
    assert len(points) - 1 in kept
    assert len(points) - 1 not in left_out


def beside(x_m: tuple[float, float], y_m: tuple[float, float], z_m: tuple[float, float], count: int = 400) -> F32:
    rng = np.random.default_rng(1)
    return np.column_stack([rng.uniform(*x_m, count), rng.uniform(*y_m, count), rng.uniform(*z_m, count)]).astype(
        np.float32
    )


PERSON = beside((-0.2, 0.2), (1.5, 1.8), (-1.1, -0.1))
OTHERS = {
    "a car beside": [beside((-2.5, 2.5), (1.4, 2.6), (-1.1, -0.3))],
    "cars on both sides": [beside((-2.5, 2.5), y_m, (-1.1, -0.3)) for y_m in ((1.4, 2.6), (-2.6, -1.4))],
    "gate posts on both sides": [beside((-0.9, 0.9), y_m, (-1.1, 1.5)) for y_m in ((2.0, 2.1), (-2.1, -2.0))],
    "a person beside": [PERSON],
    "a person beside the roof that is seen": [beside((-1.0, 1.0), (-0.6, 0.6), (-0.35, -0.3)), PERSON],
}


@pytest.mark.parametrize("name", OTHERS)
def test_others_beside_are_not_the_own_vehicle(name: str) -> None:
    assert _core.vehicle_heading(np.concatenate([*OTHERS[name], STREET.points]), LEVEL) == 0.0


def test_no_real_sweep_is_turned_and_nuscenes_turned_is_noticed(real_data: object) -> None:
    seen = 0
    for entry in read_index(f"{real_data}/index.json"):
        if entry.points is None or entry.file.suffix in {".pcap", ".feather"}:
            continue
        points = read_indexed(entry).points
        assert _core.vehicle_heading(points, LEVEL) == 0.0, entry.file
        if "LIDAR_TOP" in entry.file.name:
            seen += 1
            assert off_deg(_core.vehicle_heading(np.ascontiguousarray(turned(points, 90)), LEVEL), 90) < 3
    assert seen == 5
