"""A calibration holds for the numbers that evidence gave then: other numbers need another version."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed import BevGrid, Sweep, read_sweep
from viewshed.geometry import Rigid
from viewshed.io.samples import junction_path
from viewshed.monitor.evidence import EVIDENCE, CellMemory, MonitoredSweep
from viewshed.preprocess.leveling import LeveledSweep, level

GRID = BevGrid(128, 64.0)

NUMBERS: dict[str, tuple[int, float, float]] = {
    "arrival": (4, 1.03028, 30.6493),
    "departure": (2, 0, 0),
    "same_noise": (1, 0.0660463, 1),
    "registration": (3, 0.348679, 0.348679),
    "frame_noise": (3, 0.00592699, 0.043272),
    "nearer": (2, 0.0125579, 0.180833),
    "farther": (2, 0.0161076, 0.117917),
    "no_return": (3, 0.0638889, 0.893333),
    "gone": (1, 0, 0),
    "out_of_nowhere": (4, 0.0191847, 0.598959),
    "jump": (2, 0, 0),
    "sensor_height": (1, 1.84533, 1.84533),
    "returns": (1, 30504, 30504),
    "near_returns": (1, 0, 0),
    "range_noise": (1, 0.014347, 0.014347),
    "ground_roughness": (2, 0.0119014, 0.0119014),
    "isolated": (2, 0.00347279, 0.00347279),
}
"""Of each evidence its version, and the mean and the largest number of all sectors where it does not abstain."""


def _between(azimuth: NDArray[np.float32], low: float, high: float) -> NDArray[np.bool_]:
    return (azimuth > low) & (azimuth < high)


@cache
def _monitored() -> MonitoredSweep:
    """The junction six times, with the noise of ranges; in wedges of the last one something else is forged each."""
    sweep, rng = read_sweep(junction_path()), np.random.default_rng(0)
    points, count = sweep.points, len(sweep)
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    seen = list[LeveledSweep]()
    noise = rng.normal(1.0, 0.001, (6, count)).astype(np.float32)
    wedge = _between(azimuth, -2.6, -2.2)
    noise[5, wedge] = noise[4, wedge]  # noise repeats
    for number in range(6):
        xyz, rows = points * noise[number, :, None], np.arange(count)
        if number < 5:
            xyz[_between(azimuth, -1.2, -0.9)] *= 0.5  # vanishes
        else:
            mixed = rng.random(count)
            xyz[_between(azimuth, 0.5, 0.8) & (mixed < 0.3)] *= 0.6  # before and behind surfaces
            xyz[_between(azimuth, 1.2, 1.5) & (mixed < 0.2)] *= 1.5  # below the ground
            xyz[_between(azimuth, 1.7, 1.9), 2] += 0.05  # off their beams
            xyz[_between(azimuth, -0.6, -0.3)] *= rng.normal(1.0, 0.02, (1, 3))
            rows = np.flatnonzero(~_between(azimuth, 2.0, 2.4))
        made = Sweep(
            xyz, ring=sweep.ring, model=sweep.model, sensor_height_m=sweep.sensor_height_m, t_ns=number * 100_000_000,
            world_from_sensor=Rigid.identity(),
        )  # fmt: skip
        seen.append(level(made.select(rows), GRID))
    memory = CellMemory()
    for number in range(-15, 5):  # what came before, as the first five
        sweep = seen[number % 5].sweep
        memory.add(level(sweep.replace(t_ns=number * 100_000_000), GRID))
    return MonitoredSweep(seen[-1], tuple(seen[:-1]), memory)


@pytest.mark.parametrize("name", EVIDENCE)
def test_numbers_of_evidence_change_with_its_version_alone(name: str) -> None:
    measured = EVIDENCE[name].measure(_monitored())
    known = measured[np.isfinite(measured)]
    version, mean, most = NUMBERS[name]
    found = (float(known.mean()), float(known.max())) if known.size else (np.nan, np.nan)
    assert EVIDENCE[name].version == version, "store the numbers of the new version here"
    assert found == pytest.approx((mean, most), rel=1e-3, abs=1e-6, nan_ok=True), (
        "other numbers void what is calibrated on them: raise `version` of this evidence, calibrate the monitor in the"
        " box anew, and store the numbers here"
    )
