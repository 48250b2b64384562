"""Surfaces that jump: nearer in one sweep, farther in the next, while the world stands still.

A spoofer times all its pulses by one clock, which is off by some decimeters in each sweep anew; so what it shows jumps
to and fro as a whole, along the beams. Things that move at a constant speed do not: their second difference is zero.
"""

from __future__ import annotations

from viewshed.arrays import F32
from viewshed.monitor.evidence.base import ABSTAINS, SECTORS, MonitoredSweep
from viewshed.monitor.evidence.views import compare

_SWEEPS = 2


def measure_frame_noise(monitored: MonitoredSweep) -> F32:
    """Return the median second difference of range by sector (SECTORS,), m, over this sweep and the two before it.

    Abstains without poses, two earlier sweeps or rings.
    """
    comparison = compare(monitored)
    if comparison is None or len(comparison.earlier) < _SWEEPS:
        return ABSTAINS
    earlier = comparison.earlier[:_SWEEPS]
    return comparison.view.jumps(earlier, comparison.to_earlier[:_SWEEPS], comparison.gaps_s[:_SWEEPS], SECTORS)
