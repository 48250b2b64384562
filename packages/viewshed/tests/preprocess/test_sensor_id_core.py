"""The core of sensor identification: arrays that are not what they should be, odd points, and any number of threads."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from tests.preprocess.random_sensors import rosette

from viewshed import _core
from viewshed.sensors import lidar_model
from viewshed_lab.sim import cast, junction

MODEL = lidar_model("vlp16")
SWEEP = cast(MODEL, junction(), 1.8)
TABLE = (MODEL.elevation, MODEL.origin_m)
TABLES = (*TABLE, np.array([16]), np.array([1800]))
POINTS = np.ones((5, 3), np.float32)
RING = np.zeros(5, np.int16)
COLUMN = np.zeros(5, np.float32)

CALLS: dict[str, Callable[[Any], Any]] = {
    "identify_by_points": lambda points: _core.identify_by_points(points, *TABLES, 0),
    "identify_by_rings": lambda points: _core.identify_by_rings(points, np.zeros(len(points), np.int16), *TABLES, 0),
    "infer_sensor": lambda points: _core.infer_sensor(points, None, *TABLES),
    "rings_of_points": _core.rings_of_points,
    "beams_of_sensor": lambda points: _core.beams_of_sensor(points, *TABLE),
    "recover_rings": lambda points: _core.recover_rings(points, None, np.zeros(0), np.zeros(0), 0),
    "recover_rings by a table": lambda points: _core.recover_rings(points, None, *TABLE, 1800),
    "find_clusters": lambda points: _core.find_clusters(*_core.polar(points)),
    "find_motion": _core.find_motion,
    "undo_motion": lambda points: _core.undo_motion(points, 1.0, 0.1, 0.0, 0.0, 0.5),
}


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30, 1e-40, 0.0])
@pytest.mark.parametrize("share", [1.0, 0.1])
def test_points_that_are_no_place_have_an_answer(name: str, value: float, share: float) -> None:
    points = SWEEP.points[:6000].copy()
    points[np.random.default_rng(0).random(points.shape) < share] = value
    CALLS[name](points)


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("count", [0, 1, 2, 255, 256, 257])
def test_few_points_have_an_answer(name: str, count: int) -> None:
    CALLS[name](SWEEP.points[:count].copy())


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("points", [np.ones((5, 3)), np.ones((5, 4), np.float32), np.ones((3, 5), np.float32).T])
def test_points_of_another_kind_are_a_type_error(name: str, points: object) -> None:
    with pytest.raises(TypeError):
        CALLS[name](points)


BAD: dict[str, tuple[str, Callable[[], Any]]] = {
    "rings that are fewer": (
        "ring must have one row for each point",
        lambda: _core.identify_by_rings(POINTS, RING[:4], *TABLES, -1),
    ),
    "a ring too high": (
        r"ring must lie in \[-1, 4095\], got 4096",
        lambda: _core.recover_rings(POINTS, RING + np.int16(4096), np.zeros(0), np.zeros(0), 0),
    ),
    "a ring too low": (
        r"ring must lie in \[-1, 4095\], got -2",
        lambda: _core.infer_sensor(POINTS, RING - np.int16(2), *TABLES),
    ),
    "origins that are fewer": (
        "origin_m must have one value for each beam",
        lambda: _core.beams_of_sensor(POINTS, TABLE[0], TABLE[1][:3]),
    ),
    "tables of more beams than there are": (
        "one value for each beam of the tables",
        lambda: _core.identify_by_points(POINTS, *TABLE, np.array([16, 1]), np.array([1800, 1800]), -1),
    ),
    "a table of none": (
        "one value for each beam of the tables",
        lambda: _core.identify_by_points(POINTS, *TABLE, np.array([0]), np.array([1800]), -1),
    ),
    "columns that are fewer": (
        "rings and columns must have one value for each table",
        lambda: _core.identify_by_points(POINTS, *TABLE, np.array([8, 8]), np.array([1800]), -1),
    ),
    "no columns": (
        r"columns must lie in \[1, 65536\]",
        lambda: _core.recover_rings(POINTS, RING, *TABLE, 0),
    ),
    "beams that fall": (
        "elevations must ascend",
        lambda: _core.match_beams(COLUMN, COLUMN, TABLE[0][::-1].copy(), TABLE[1]),
    ),
    "a table that is none of them": (
        "expected must be the number of a table, or -1",
        lambda: _core.identify_by_points(POINTS, *TABLES, 1),
    ),
    "beams that are no number": (
        "elevations and origins must be finite",
        lambda: _core.match_beams(COLUMN, COLUMN, np.array([0.0, np.nan]), np.zeros(2)),
    ),
    "beams beyond the zenith": (
        "elevations must lie within a quarter of a turn",
        lambda: _core.match_beams(COLUMN, COLUMN, np.array([0.0, 2.0]), np.zeros(2)),
    ),
    "a range that is shorter": (
        "slope and range_m must be as long",
        lambda: _core.match_beams(COLUMN, COLUMN[:4], *TABLE),
    ),
    "an azimuth that is shorter": (
        "azimuth, slope and range_m must be as long",
        lambda: _core.find_clusters(COLUMN[:4], COLUMN, COLUMN),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_values_that_do_not_go_together_are_a_value_error(name: str) -> None:
    message, call = BAD[name]
    with pytest.raises(ValueError, match=message):
        call()


@pytest.fixture
def threads_as_before() -> Iterator[None]:
    before = _core.threads()
    yield
    _core.set_threads(before)


@pytest.mark.usefixtures("threads_as_before")
@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("cloud", ["rings in order", "shuffled", "no rings"])
def test_the_answer_is_the_same_on_any_number_of_threads(name: str, cloud: str) -> None:
    rng = np.random.default_rng(1)
    points = rosette(rng, 70_000) if cloud == "no rings" else np.concatenate([SWEEP.points] * 3)
    points = rng.permutation(points) if cloud == "shuffled" else points
    answers = []
    for count in (1, 2, 3):
        _core.set_threads(count)
        answers.append(CALLS[name](points))
    for other in answers[1:]:
        np.testing.assert_equal(other, answers[0])


def test_the_returns_that_are_looked_at_are_those_that_numpy_draws() -> None:
    points = np.random.default_rng(3).permutation(SWEEP.points)
    rows = np.random.default_rng(0).integers(len(points), size=4096)
    moved = points.copy()
    moved[np.setdiff1d(np.arange(len(points)), rows)] = 0.0
    assert _core.find_motion(moved) == _core.find_motion(points)
