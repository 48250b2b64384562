"""Obstacles where earlier beams passed freely: what stands in plain view now was not there a moment ago.

A beam that ended beyond a place proves that the place was empty. What moves uncovers and covers little of it between
two sweeps: the front of a car, as wide as it drove. A spoofed object or wall stands there at once with all its
surface.
"""

from __future__ import annotations

from viewshed.arrays import F32
from viewshed.monitor.evidence.base import ABSTAINS, MonitoredSweep
from viewshed.monitor.evidence.views import around, compare


def measure_seen_through(monitored: MonitoredSweep) -> F32:
    """Return the area by sector (SECTORS,), m², of obstacles through which the last sweep looked.

    Of each sector with two on either side. Abstains without poses, earlier sweeps or rings.
    """
    comparison = compare(monitored)
    return ABSTAINS if comparison is None else around(comparison.appeared_m2)
