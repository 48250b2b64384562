"""Contracts of all evidence: odd sweeps, threads, sentences; and what the estimates say."""

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.monitor.by_hand import estimate_of
from tests.monitor.evidence.by_hand import GRID, columns_at, leveled, monitored, sector_at, street, sweep_of

from viewshed import Sweep, _core
from viewshed.monitor.evidence import ABSTAINS, EVIDENCE, SECTORS, MonitoredSweep
from viewshed.monitor.evidence.estimates import measure_deviation, measure_disagreement
from viewshed.preprocess.leveling import level

every_evidence = pytest.mark.parametrize("name", EVIDENCE)


def odd_sweeps() -> dict[str, Sweep]:
    rng = np.random.default_rng(0)

    def noise(scale_m: float, count: int) -> NDArray[np.float32]:
        return rng.normal(0.0, scale_m, (count, 3)).astype(np.float32)

    column = street()
    column[:, 1:] = np.nan
    return {
        "empty": Sweep(np.zeros((0, 3), np.float32)),
        "one point": Sweep(np.array([[5.0, 1.0, -1.0]], np.float32)),
        "the origin": Sweep(np.zeros((3, 3), np.float32)),
        "one column": sweep_of(column),
        "one ring": Sweep(noise(9.0, 800), ring=np.zeros(800, np.int16), infer_sensor=False),
        "random": Sweep(noise(30.0, 5000), ring=rng.integers(0, 40, 5000).astype(np.int16)),
        "no numbers": Sweep(np.full((7, 3), np.nan, np.float32)),
    }


@every_evidence
def test_odd_sweeps_are_measured_or_abstained_from(name: str) -> None:
    for sweep in odd_sweeps().values():
        found = EVIDENCE[name].measure(MonitoredSweep(level(sweep, GRID)))
        assert found.shape == (SECTORS,)
        assert found.dtype == np.float32
        assert not np.isinf(found).any()


@every_evidence
def test_one_and_two_threads_measure_the_same(name: str) -> None:
    rng, range_m = np.random.default_rng(0), street()
    range_m = range_m * rng.choice([1.0, 1.0, 1.0, 0.5, 1.5], range_m.shape) + rng.normal(0.0, 0.05, range_m.shape)
    sweep, before, found = sweep_of(range_m), _core.threads(), []
    try:
        for count in (1, 2):
            _core.set_threads(count)
            found.append(EVIDENCE[name].measure(monitored(sweep)))
    finally:
        _core.set_threads(before)
    np.testing.assert_array_equal(found[0], found[1])


@pytest.mark.parametrize("name", [name for name, kind in EVIDENCE.items() if "{degrees" in kind.sentence])
def test_the_sentence_has_the_strongest_sector(name: str) -> None:
    values = np.full(SECTORS, np.nan, np.float32)
    values[sector_at(42.0)], values[sector_at(-42.0)] = 0.75, 0.25
    assert "42°" in EVIDENCE[name].reason(values)


def test_columns_look_into_level_sectors() -> None:
    # A sensor that is turned by a quarter looks to the left where it looks ahead.
    range_m = street()
    range_m[:, columns_at(-12.0, 13.0)] = np.nan
    turned = sweep_of(range_m).replace(attitude=np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]))
    found = EVIDENCE["empty_runs"].measure(MonitoredSweep(leveled(turned)))
    assert found[sector_at(92.0)] == pytest.approx(25.0)


def test_disagreement_and_deviation_by_sector() -> None:
    left = np.zeros(GRID.shape, np.float32)
    left[GRID.centers[..., 1] > 0] = 0.25
    sure, doubtful = estimate_of(0.0, method="shadow_map", grid=GRID), estimate_of(left, method="viewnet", grid=GRID)
    blind = estimate_of(0.0, method="viewnet", grid=GRID)
    now = leveled(sweep_of(street()))
    assert measure_disagreement(MonitoredSweep(now, (), {"viewnet": blind})) is ABSTAINS
    assert not measure_disagreement(MonitoredSweep(now, (), {"viewnet": blind, "shadow_map": sure})).any()
    found = measure_deviation(MonitoredSweep(now, (), {"viewnet": doubtful}))
    np.testing.assert_allclose(found[[sector_at(42.0), sector_at(-42.0)]], [0.25, 0.0])
    assert measure_deviation(MonitoredSweep(now)) is ABSTAINS


IMAGE = np.full((4, 8), 5.0, np.float32)
SECTOR = np.zeros(8, np.int16)
POINTS = np.ones((3, 3), np.float32)
RING, COLUMN, ROWS = np.zeros(3, np.int16), np.zeros(3, np.int32), np.arange(3, dtype=np.int32)


@pytest.mark.parametrize(
    ("function", "arguments", "rule"),
    [
        ("beam_image", (POINTS, RING[:2], COLUMN, ROWS, np.zeros(3, np.float32), 4, 8), "must be as long"),
        ("beam_image", (POINTS, RING + 9, COLUMN, ROWS, np.zeros(3, np.float32), 4, 8), "ring must lie in"),
        ("beam_image", (POINTS, RING, COLUMN + 8, ROWS, np.zeros(3, np.float32), 4, 8), "column must lie in"),
        ("beam_image", (POINTS, RING, COLUMN, ROWS + 1, np.zeros(3, np.float32), 4, 8), "rows must lie in"),
        ("beam_image", (POINTS, RING, COLUMN, ROWS, np.zeros(2, np.float32), 4, 8), "rows and height_m"),
        ("count_chosen", (POINTS, np.ones(2, np.bool_), 72), "chosen must have"),
        ("count_chosen", (POINTS, np.ones(3, np.bool_), 0), "sectors must lie in"),
        ("count_holes", (IMAGE, SECTOR[:3], 72), "sector must have"),
        ("count_holes", (IMAGE, SECTOR - 1, 72), "sector must lie in"),
        ("count_specks", (IMAGE, SECTOR + 72, 72), "sector must lie in"),
        ("count_double_returns", (IMAGE, IMAGE[:2], SECTOR, 72), "farthest_m must have the shape"),
        ("measure_noise", (IMAGE, IMAGE[:2], SECTOR, 72, 8), "height_m must have the shape"),
        ("measure_noise", (IMAGE, IMAGE, SECTOR, 72, 0), "bands must lie in"),
        ("measure_steps", (IMAGE, IMAGE[:2], SECTOR, 72), "height_m must have the shape"),
        ("measure_breaks", (IMAGE[:, :0], SECTOR[:0], 72), "1 to 65536 columns"),
        ("measure_empty_runs", (IMAGE, SECTOR, 0), "sectors must lie in"),
        ("find_off_beam", (POINTS, RING, COLUMN, np.zeros(0), ROWS, 8), "rings must lie in"),
        ("measure_range_offset", (POINTS, 0.0, 72), "sensor_height_m must be positive"),
    ],
)
def test_arrays_that_disagree_are_refused(function: str, arguments: tuple[object, ...], rule: str) -> None:
    with pytest.raises(ValueError, match=rule):
        getattr(_core, function)(*arguments)


def test_images_of_few_pixels_are_measured() -> None:
    for rings, columns in ((0, 1), (1, 1), (2, 2), (3, 3), (1, 8), (5, 1)):
        image, sector = np.full((rings, columns), 5.0, np.float32), np.zeros(columns, np.int16)
        assert _core.count_holes(image, sector, 3)[0].sum() == 0
        assert _core.count_specks(image, sector, 3)[0].sum() == 0
        assert _core.count_double_returns(image, image, sector, 3)[0].sum() == 0
        assert np.isnan(_core.measure_noise(image, image, sector, 3, 2)).all()
        assert not _core.measure_steps(image, image, sector, 3).any()
        assert not _core.measure_breaks(image, sector, 3).any()
        assert _core.measure_empty_runs(image, sector, 3).shape == (3,)
