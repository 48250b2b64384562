"""Table of all kinds of evidence that a sweep was attacked; the files group them by the data they measure.

To add one, write a function that measures a :class:`MonitoredSweep` and add a row to ``EVIDENCE``.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from viewshed.arrays import F32
from viewshed.monitor.evidence import cells, history, sensor
from viewshed.monitor.evidence.base import ABSTAINS, EARLIER_SWEEPS, SECTORS, Evidence, MonitoredSweep, sector_of
from viewshed.monitor.evidence.cells import CellMemory

__all__ = [
    "ABSTAINS",
    "EARLIER_SWEEPS",
    "EVIDENCE",
    "SECTORS",
    "CellMemory",
    "Evidence",
    "MonitoredSweep",
    "measure_all",
    "sector_of",
]

EVIDENCE: dict[str, Evidence] = {evidence.name: evidence for evidence in (
    # Obstacles, surfaces, beams and poses against the last sweeps.
    Evidence("arrival", history.measure_arrival, 5.0,
             "an obstacle at {degrees:.0f}° must have come there at {value:.0f} m/s",
             version=4),
    Evidence("departure", history.measure_departure, 5.0,
             "an obstacle at {degrees:.0f}° must have left at {value:.0f} m/s",
             version=2),
    Evidence("same_noise", history.measure_same_noise, 0.2,
             "{value:.0%} of the ranges at {degrees:.0f}° repeat those of an earlier sweep, noise included"),
    Evidence("registration", history.measure_registration, 1.0,
             "the pose is {value:.0f} standard deviations off that of the earlier sweeps",
             version=3),
    Evidence("frame_noise", history.measure_frame_noise, 0.05,
             "surfaces at {degrees:.0f}° jump by {value:.2f} m from sweep to sweep",
             version=3),
    Evidence("nearer", history.measure_nearer, 0.1,
             "{value:.0%} of the returns at {degrees:.0f}° are nearer than everything around them was before",
             version=2),
    Evidence("farther", history.measure_farther, 0.1,
             "{value:.0%} of the returns at {degrees:.0f}° are farther than everything around them was before",
             version=2),
    Evidence("no_return", history.measure_no_return, 0.1,
             "{value:.0%} of the beams at {degrees:.0f}° that returned in all sweeps before return nothing",
             version=3),
    # Static surfaces and free cells of the last ten seconds.
    Evidence("gone", cells.measure_gone, 0.5,
             "{value:.1f} m of surfaces at {degrees:.0f}° that stood for seconds are gone, and beams pass there"),
    Evidence("out_of_nowhere", cells.measure_new, 0.5,
             "{value:.1f} m² of obstacles at {degrees:.0f}° stand where nothing did for ten seconds, and came fast",
             version=4),
    # Without rings and poses.
    Evidence("jump", sensor.measure_jump, 0.25,
             "the sensor jumped by {value:.1f} m against its own motion",
             version=2),
    # State of the sensor: meaningful only against the past of the stream.
    Evidence("sensor_height", sensor.measure_sensor_height, 1.0,
             "the sensor is {value:.2f} m above the ground, unlike before", two_sided=True, of_place=True),
    Evidence("returns", sensor.measure_returns, 10.0,
             "there are {value:.0f} returns, unlike before", two_sided=True, of_place=True),
    Evidence("near_returns", sensor.measure_near_returns, 0.01,
             "{value:.1%} of the returns lie within 2 m, unlike before", two_sided=True, of_place=True),
    Evidence("range_noise", sensor.measure_range_noise, 0.001,
             "the noise of range is {value:.3f} m, unlike before", two_sided=True),
    Evidence("ground_roughness", sensor.measure_ground_roughness, 0.003,
             "ground returns lie {value:.3f} m from the ground, unlike before", two_sided=True, of_place=True,
             version=2),
    Evidence("isolated", sensor.measure_isolated, 0.02,
             "{value:.1%} of the returns are isolated, unlike before", two_sided=True,
             version=2),
)}  # fmt: skip
"""Kinds of evidence by name, in the order of the rows (E, SECTORS) of a score."""


def measure_all(monitored: MonitoredSweep, evidence: Mapping[str, Evidence] = EVIDENCE) -> F32:
    """Return all evidence (E, SECTORS) of a sweep, in the order of ``evidence``; NaN where it abstains."""
    return np.array([one.measure(monitored) for one in evidence.values()], np.float32).reshape(-1, SECTORS)
