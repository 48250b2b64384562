"""Surfaces whose beams do not return any more: a view that is lost without a cause.

A surface that returned beams a moment ago returns them again, unless something came before it, which would be seen.
Beams that fall silent are removed, jammed, or the sensor is blocked. Dark and smooth surfaces were silent before as
well, so they are not counted.
"""

from __future__ import annotations

import numpy as np

from viewshed.arrays import F32
from viewshed.monitor.evidence.base import ABSTAINS, SECTORS, MonitoredSweep, sector_of
from viewshed.monitor.evidence.views import compare
from viewshed.sweep import Sweep

_SECTOR = 2 * np.pi / SECTORS


def measure_lost_view(monitored: MonitoredSweep) -> F32:
    """Return the share by sector (SECTORS,) of the last sweep's obstacles at whose places no beam returns now.

    A sweep of a turning sensor does not close by what it turned: where it begins nothing is lost. Abstains without
    poses, earlier sweeps or rings.
    """
    comparison = compare(monitored)
    if comparison is None:
        return ABSTAINS
    turned = np.arctan2(comparison.to_earlier[0, 1, 0], comparison.to_earlier[0, 0, 0])
    # Half of the gap to either side, and half a sector for what it cuts.
    edges = np.arange(-abs(turned) / 2 - _SECTOR / 2, abs(turned) / 2 + _SECTOR, _SECTOR / 2)
    lost = comparison.lost.copy()
    lost[sector_of(_begin(monitored.leveled.sweep) + edges)] = 0.0
    return lost


def _begin(sweep: Sweep) -> float:
    """Return the azimuth at which a sweep begins: of its first return, or straight behind where it has no times."""
    if sweep.time_s is None:
        return -np.pi
    x, y, _ = sweep.points[int(np.argmin(sweep.time_s))]
    return float(np.arctan2(y, x))
