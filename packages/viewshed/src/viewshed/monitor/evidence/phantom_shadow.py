"""Surfaces with holes in their shadow: a beam passes through while beams on both sides of it end there.

What stands between the sensor and the ground behind it hides that ground from all beams that meet it, also when the
sensor has moved a little and others meet it than before. A phantom hides only what its maker's beams won: the others
report what lies behind it, in other places in each sweep.
"""

from __future__ import annotations

from viewshed.arrays import F32
from viewshed.monitor.evidence.base import ABSTAINS, MonitoredSweep
from viewshed.monitor.evidence.views import compare


def measure_phantom_shadow(monitored: MonitoredSweep) -> F32:
    """Return the share by sector (SECTORS,) of the last sweep's obstacles that are pierced now.

    Abstains without poses, earlier sweeps or rings.
    """
    comparison = compare(monitored)
    return ABSTAINS if comparison is None else comparison.pierced
