"""Beams that would meet a box: against lines followed step by step, and against what the simulator's beams meet."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from viewshed import BevGrid, Sweep, _core
from viewshed.fov.visibility import Beams
from viewshed.preprocess.evidence import expected_returns
from viewshed.preprocess.leveling import level
from viewshed.sensors import LidarModel
from viewshed_lab.sim import Box, Scene, cast

HEIGHT_M = 1.8
NOISE_M = 0.1
MODEL = LidarModel("test", np.deg2rad(np.linspace(-20, 6, 40)), azimuth_columns=1800, max_range_m=100.0)
GRID = BevGrid(128, 32.0)


def random_beams(rng: np.random.Generator, count: int) -> Beams:
    depth_m = rng.uniform(1, 30, count).astype(np.float32)
    depth_m[rng.random(count) < 0.1] = np.inf
    azimuth = rng.uniform(-np.pi, np.pi, count).astype(np.float32)
    return Beams(azimuth, rng.uniform(-0.4, 0.1, count).astype(np.float32), depth_m)


def random_boxes(rng: np.random.Generator, count: int) -> NDArray[np.float32]:
    """Boxes around, some across the seam behind the sensor, some far above or below."""
    range_m, azimuth = rng.uniform(2, 20, count), rng.choice([0.0, np.pi, 1.0, -2.0], count) + rng.normal(0, 0.2, count)
    boxes = np.column_stack([
        range_m * np.cos(azimuth), range_m * np.sin(azimuth), rng.uniform(-0.5, 2.0, count),
        rng.uniform(0.5, 5, count), rng.uniform(0.5, 3, count), rng.uniform(0.5, 2.5, count),
        rng.uniform(-4, 4, count),
    ])  # fmt: skip
    return boxes.astype(np.float32)


def follow(beams: Beams, box: NDArray[np.float32], larger_m: float, leave_out_own: bool) -> int:
    """Beams that are inside a box, made larger on every side, at a range that they reach, one step after another."""
    steps = np.arange(0.0, 30.0, 0.02)
    azimuth, slope, depth_m = (array.astype(np.float64) for array in beams.arrays)
    x, y = np.outer(np.cos(azimuth), steps) - box[0], np.outer(np.sin(azimuth), steps) - box[1]
    z = HEIGHT_M + np.outer(slope, steps) - box[2]
    along, across = x * np.cos(box[6]) + y * np.sin(box[6]), y * np.cos(box[6]) - x * np.sin(box[6])
    half = box[3:6] / 2 + larger_m
    inside = (np.abs(along) <= half[0]) & (np.abs(across) <= half[1]) & (np.abs(z) <= half[2])
    meets = inside.any(axis=1)
    enters, leaves = steps[inside.argmax(axis=1)], steps[len(steps) - 1 - inside[:, ::-1].argmax(axis=1)]
    needed_m = enters - NOISE_M - larger_m if leave_out_own else leaves + NOISE_M - larger_m
    return int((meets & (depth_m >= needed_m)).sum())


@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_beams_that_meet_a_box_are_those_that_enter_it_step_by_step(seed: int, leave_out_own: bool) -> None:
    rng = np.random.default_rng(seed)
    beams, boxes = random_beams(rng, 200), random_boxes(rng, 6)
    found = _core.BeamsByAzimuth(*beams.arrays).expected_returns(boxes, HEIGHT_M, leave_out_own)
    for box, count in zip(boxes, found, strict=True):
        # Beams that graze an edge, or end there, are not sure.
        least, most = (follow(beams, box, larger_m, leave_out_own) for larger_m in (-0.06, 0.06))
        if leave_out_own:
            assert least <= count <= most
        else:
            assert abs(count - follow(beams, box, 0.0, False)) <= most - least + 2 + 0.1 * most


def car_at(x: float, y: float, yaw: float) -> tuple[Box, NDArray[np.float32]]:
    return Box(x, y, 4.2, 1.8, 1.5, yaw=yaw), np.array([[x, y, 0.75, 4.2, 1.8, 1.5, yaw]], np.float32)


def returns_on(sweep: Sweep, box: NDArray[np.float32]) -> int:
    """Returns on the sides and the top of a box that stands on the ground."""
    [[x, y, _, length, width, height, yaw]] = box
    points = level(sweep, GRID).points.astype(np.float64) - [x, y, 0.0]
    along = points[:, 0] * np.cos(yaw) + points[:, 1] * np.sin(yaw)
    across = points[:, 1] * np.cos(yaw) - points[:, 0] * np.sin(yaw)
    near = (np.abs(along) <= length / 2 + 0.05) & (np.abs(across) <= width / 2 + 0.05)
    return int((near & (points[:, 2] > 0.02) & (points[:, 2] < height + 0.05)).sum())


WALL = Box(20.0, 2.0, 1.0, 30.0, 5.0)


@pytest.mark.parametrize(("x", "y", "yaw"), [(10, 0, 0.3), (-9, 1, 1.2), (5, -7, -0.5), (-14, 0.2, 0.0), (12, 9, 2.0)])
def test_a_box_in_a_world_gets_the_returns_that_were_expected(x: float, y: float, yaw: float) -> None:
    car, box = car_at(x, y, yaw)
    empty, full = (
        cast(MODEL, Scene(solids), HEIGHT_M).replace(sensor_height_m=HEIGHT_M) for solids in ((WALL,), (WALL, car))
    )
    got = returns_on(full, box)
    assert got > 60
    # Expected before it stood there, and from the sweep in which it does, with its own returns left out.
    for sweep in (empty, full):
        [expected] = expected_returns(level(sweep, GRID), box)
        assert abs(expected - got) <= 0.06 * got + 5
    [through] = expected_returns(level(full, GRID), box, leave_out_own=False)
    assert through <= 0.05 * got + 5


@pytest.mark.parametrize(
    ("boxes", "match"),
    [
        (np.ones((2, 6)), r"boxes must have shape \(K, 7\)"), (np.ones(7), r"boxes must have shape \(K, 7\)"),
        (np.full((1, 7), np.nan), "boxes must be finite"), (np.full((1, 7), 1e9), "less than 1e6"),
        (np.array([[1, 1, 1, 0, 1, 1, 0]]), "must be positive"),
    ],
)  # fmt: skip
def test_other_boxes_are_refused(boxes: NDArray[np.float64], match: str) -> None:
    sweep = cast(MODEL, Scene((WALL,)), HEIGHT_M).replace(sensor_height_m=HEIGHT_M)
    with pytest.raises(ValueError, match=match):
        expected_returns(level(sweep, GRID), boxes)


def test_a_sensor_height_that_is_no_number_is_refused() -> None:
    beams = _core.BeamsByAzimuth(*(np.zeros(3, np.float32),) * 3)
    with pytest.raises(ValueError, match="sensor_height_m must be finite"):
        beams.expected_returns(np.ones((1, 7), np.float32), np.nan, True)


@pytest.mark.parametrize("azimuth", [*np.linspace(-np.pi, np.pi, 25), 1e-4, -1e-4, np.pi - 1e-4])
def test_each_beam_between_the_edges_of_a_box_counts_wherever_the_box_stands(azimuth: float) -> None:
    # Ten beams for each of the 2048 columns by which beams are sorted, level, at the height of the middle of the box.
    beams = (np.arange(20_480) + 0.5) * (2 * np.pi / 20_480) - np.pi
    level_beams = Beams(beams.astype(np.float32), np.zeros(20_480, np.float32), np.full(20_480, 50.0, np.float32))
    box = np.array([[12 * np.cos(azimuth), 12 * np.sin(azimuth), HEIGHT_M, 4, 3.025, 1, azimuth]], np.float32)
    # Its near face, 10 m away, spans 97.9 columns: nearly always parts of 99.
    away = np.abs(np.remainder(beams - azimuth + np.pi, 2 * np.pi) - np.pi)
    between = int((away < np.arctan2(1.5125, 10.0)).sum())
    assert between > 900
    [found] = _core.BeamsByAzimuth(*level_beams.arrays).expected_returns(box, HEIGHT_M, True)
    assert abs(int(found) - between) <= 1  # a beam may graze an edge
