"""Returns beyond the ground: a beam that descends must end near the plane on which the vehicle stands.

Local ground that is estimated from the sweep follows an attacker's ground; the plane below the sensor does not. A range
that is too long by Δ puts the return of a beam that meets the ground at range r below the plane by h Δ / r, with h the
height of the sensor. A road may fall away by an eighth of the way.
"""

from __future__ import annotations

from viewshed import _core
from viewshed.arrays import F32
from viewshed.monitor.evidence.base import SECTORS, MonitoredSweep, damped_share

_MARGIN_M, _FALL = 0.25, 0.12
"""A return lies beyond the ground if it is lower than the plane by this distance and share of its range."""

_FEW = 20
"""Returns that draw a share toward 0."""


def measure_beyond_ground(monitored: MonitoredSweep) -> F32:
    """Return the share (SECTORS,) of returns far below the plane on which the sensor's vehicle stands."""
    leveled = monitored.leveled
    beyond = leveled.points[:, 2] < -(_MARGIN_M + _FALL * leveled.range_m)
    return damped_share(*_core.count_chosen(leveled.points, beyond, SECTORS), _FEW)
