"""Straight edges: nearly all rings break off at the same column, from the lowest to the highest.

What an attacker changes ends at the borders of its wedge, vertically and in all rings. Corners of buildings are
vertical as well, but the rings below them meet the ground and go on.
"""

from __future__ import annotations

from viewshed import _core
from viewshed.arrays import F32
from viewshed.monitor.evidence.base import ABSTAINS, SECTORS, MonitoredSweep
from viewshed.monitor.evidence.return_image import return_image_of


def measure_straight_edges(monitored: MonitoredSweep) -> F32:
    """Return the largest share of rings that jump at one column of each sector (SECTORS,); abstains without rings."""
    image = return_image_of(monitored.leveled)
    if image is None:
        return ABSTAINS
    return _core.measure_breaks(image.range_m, image.sector, SECTORS)
