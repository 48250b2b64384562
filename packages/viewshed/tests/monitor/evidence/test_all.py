"""Contracts of all evidence: odd sweeps, threads, sentences."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.monitor.evidence.drives import HEIGHT_M, INTERVAL_NS, YARD, leveled, look, sector_at

from viewshed import Sweep, _core
from viewshed.geometry import Rigid
from viewshed.monitor.evidence import EVIDENCE, SECTORS, MonitoredSweep
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.sensors import lidar_model
from viewshed_lab.sim import Scene, cast

every_evidence = pytest.mark.parametrize("name", EVIDENCE)


def odd_sweeps() -> list[Sweep]:
    rng = np.random.default_rng(0)

    def noise(scale_m: float, count: int) -> NDArray[np.float32]:
        return rng.normal(0.0, scale_m, (count, 3)).astype(np.float32)

    usual = look(YARD)
    azimuth = np.arctan2(usual.points[:, 1], usual.points[:, 0])
    return [
        Sweep(np.zeros((0, 3), np.float32)),
        Sweep(np.array([[5.0, 1.0, -1.0]], np.float32)),
        Sweep(np.zeros((3, 3), np.float32)),  # at the origin
        Sweep(np.full((7, 3), np.nan, np.float32)),
        Sweep(np.full((500, 3), 7.0, np.float32), ring=np.zeros(500, np.int16)),  # one direction
        Sweep(noise(9.0, 800), ring=np.zeros(800, np.int16), infer_sensor=False),  # one ring
        Sweep(noise(30.0, 5000), ring=rng.integers(0, 40, 5000).astype(np.int16)),
        usual.select(np.flatnonzero(np.abs(azimuth - 0.5) < 2e-3)),  # one column
        Sweep(usual.points),
        cast(lidar_model("vlp16"), Scene(YARD), HEIGHT_M),
        usual.replace(world_from_sensor=Rigid(np.eye(3), np.array([1e7, -1e7, 3.0]))),
        usual.replace(world_from_sensor=Rigid(np.diag([1.0, -1.0, -1.0]), np.zeros(3))),  # upside down
    ]


@cache
def among_usual_ones() -> list[LeveledSweep]:
    """Each odd sweep after a usual one, all with a pose, a tenth of a second apart."""
    pose = Rigid(np.eye(3), np.array([0.0, 0.0, HEIGHT_M]))
    made = [sweep for odd in odd_sweeps() for sweep in (look(YARD), odd)]
    return [
        leveled(sweep.replace(world_from_sensor=sweep.world_from_sensor or pose, t_ns=number * INTERVAL_NS))
        for number, sweep in enumerate(made)
    ]


@every_evidence
def test_odd_sweeps_are_measured_or_abstained_from_before_and_after_usual_ones(name: str) -> None:
    sweeps = among_usual_ones()
    for number, sweep in enumerate(sweeps):
        found = EVIDENCE[name].measure(MonitoredSweep(sweep, tuple(sweeps[max(number - 5, 0) : number])))
        assert found.shape == (SECTORS,)
        assert found.dtype == np.float32
        assert not np.isinf(found).any()


@every_evidence
def test_one_and_two_threads_measure_the_same(name: str) -> None:
    rng, before, found = np.random.default_rng(0), _core.threads(), []
    sweeps = [look(YARD, number, 0.5 * number, rng) for number in range(4)]
    try:
        for count in (1, 2):
            _core.set_threads(count)
            fresh = [leveled(sweep) for sweep in sweeps]
            found.append(EVIDENCE[name].measure(MonitoredSweep(fresh[-1], tuple(fresh[:-1]))))
    finally:
        _core.set_threads(before)
    np.testing.assert_array_equal(found[0], found[1])


@pytest.mark.parametrize("name", [name for name, kind in EVIDENCE.items() if "{degrees" in kind.sentence])
def test_the_sentence_has_the_strongest_sector(name: str) -> None:
    values = np.full(SECTORS, np.nan, np.float32)
    values[sector_at(42.0)], values[sector_at(-42.0)] = 0.75, 0.25
    assert "42°" in EVIDENCE[name].reason(values)
