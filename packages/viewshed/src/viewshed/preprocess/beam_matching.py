"""Matching of returns to the beams of a table; azimuth, slope and range of points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import F32
from viewshed.sensors import LidarModel


def polar(points: NDArray[np.float32]) -> tuple[F32, F32, F32]:
    """Return azimuth (N,) in [-π, π), slope z / range (N,) and horizontal range (N,) in meters; slope 0 at range 0."""
    return _core.polar(points)


class BeamMatch(NamedTuple):
    """Fit of a beam table: nearest beam of each point, points close to each beam, their share minus chance level."""

    ring: NDArray[np.int16]
    hits: NDArray[np.int64]
    excess: float


def match_beams(slope: F32, range_m: F32, model: LidarModel) -> BeamMatch:
    """Return the nearest beam of each point, and how much better than chance the points match the beams.

    A point farther than 0.15° and 5 cm from all beams has none (-1). It is close if within a quarter of the gap to the
    next beam, and within 0.1° and 1.5 cm; the chance level is the share of the gap that this covers. Returns nearer
    than 1 m are ignored.

    Args:
        slope: (N,) z over horizontal range.
        range_m: (N,) horizontal range in meters.
        model: beam table of the sensor.
    """
    return BeamMatch(*_core.match_beams(slope, range_m, model.elevation, model.origin_m))
