"""Contracts of all evidence: odd sweeps, threads, sentences."""

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.monitor.evidence.by_hand import GRID, monitored, sector_at, street, sweep_of

from viewshed import Sweep, _core
from viewshed.monitor.evidence import EVIDENCE, SECTORS, MonitoredSweep
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
    odd = [level(sweep, GRID) for sweep in odd_sweeps().values()]
    for number, sweep in enumerate(odd):
        found = EVIDENCE[name].measure(MonitoredSweep(sweep, tuple(odd[:number])))
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
