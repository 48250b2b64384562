"""Obstacles that must have left too fast: a thing that drives away is still near by, no farther than things move.

The reverse of an arrival: where beams pass now through what the last sweep saw, the distance to the nearest place
where it may be now, over the time between the two.
"""

from __future__ import annotations

from viewshed.arrays import F32
from viewshed.monitor.evidence.base import ABSTAINS, MonitoredSweep
from viewshed.monitor.evidence.views import compare


def measure_departure(monitored: MonitoredSweep) -> F32:
    """Return the speed by sector (SECTORS,), m/s, that obstacles of the last sweep need to have left as they did.

    Abstains without poses, earlier sweeps or rings.
    """
    comparison = compare(monitored)
    return ABSTAINS if comparison is None else comparison.departure_mps
