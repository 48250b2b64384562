"""Surfaces whose beams do not return any more: a view that is lost without a cause.

A surface that returned beams a moment ago returns them again, unless something came before it, which would be seen.
Beams that fall silent are removed, jammed, or the sensor is blocked. Dark and smooth surfaces were silent before as
well, so they are not counted.
"""

from __future__ import annotations

from viewshed.integrity.evidence.base import ABSTAINS, Floats, MonitoredSweep
from viewshed.integrity.evidence.views import compare


def measure_lost_view(monitored: MonitoredSweep) -> Floats:
    """Return the share by sector (SECTORS,) of the last sweep's obstacles at whose places no beam returns now.

    Abstains without poses, earlier sweeps or rings.
    """
    comparison = compare(monitored)
    return ABSTAINS if comparison is None else comparison.lost
