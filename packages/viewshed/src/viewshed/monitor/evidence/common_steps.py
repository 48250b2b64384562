"""Common steps: all ground rings jump by one amount between two columns, which no ground does.

At the border of a wedge whose ranges are all too long or too short (relay) each ring steps by the same offset. A kerb,
or an obstacle that stands on the ground, steps each ring by another amount, or only some rings. The median jump of the
rings is compared with their spread.
"""

from __future__ import annotations

from viewshed import _core
from viewshed.arrays import F32
from viewshed.monitor.evidence.base import ABSTAINS, SECTORS, MonitoredSweep
from viewshed.monitor.evidence.return_image import return_image_of


def measure_common_steps(monitored: MonitoredSweep) -> F32:
    """Return the largest common step of the ground rings against its spread (SECTORS,); abstains without rings."""
    image = return_image_of(monitored.leveled)
    if image is None:
        return ABSTAINS
    return _core.measure_steps(image.range_m, image.height_m, image.sector, SECTORS)
