"""Obstacles that must have come too fast: from where nothing was seen, or something was, no faster than things move.

What stands where a beam passed freely came from behind an obstacle, from beyond the beams, or was one of the things
near by. The distance to the nearest of them over the time between the sweeps is the least speed. Where the last sweep
found the obstacle as well, the one before it is asked: an object gives itself away for three sweeps.
"""

from __future__ import annotations

from viewshed.arrays import F32
from viewshed.monitor.evidence.base import ABSTAINS, MonitoredSweep
from viewshed.monitor.evidence.views import compare


def measure_arrival(monitored: MonitoredSweep) -> F32:
    """Return the speed by sector (SECTORS,), m/s, that obstacles need to have come from the nearest cover.

    Abstains without poses, earlier sweeps or rings.
    """
    comparison = compare(monitored)
    return ABSTAINS if comparison is None else comparison.arrival_mps
