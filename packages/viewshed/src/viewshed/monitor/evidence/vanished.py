"""Obstacles that are gone in plain view: beams pass now where a surface stood a moment ago.

The reverse of what appears. A far wall, or returns pushed away, open a corridor through surfaces that the sweep before
saw; what moves opens no more than it drove.
"""

from __future__ import annotations

from viewshed.arrays import F32
from viewshed.monitor.evidence.base import ABSTAINS, MonitoredSweep
from viewshed.monitor.evidence.views import around, compare


def measure_vanished(monitored: MonitoredSweep) -> F32:
    """Return the area by sector (SECTORS,), m², of obstacles of the last sweep through which this one looks.

    Of each sector with two on either side. Abstains without poses, earlier sweeps or rings.
    """
    comparison = compare(monitored)
    return ABSTAINS if comparison is None else around(comparison.vanished_m2)
