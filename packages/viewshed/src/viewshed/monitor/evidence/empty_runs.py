"""Empty runs: neighboring columns in which most rings that return elsewhere do not. A sector is removed, or was lost.

Returns that are pushed inside the minimum range are dropped by the sensor (physical removal); a lost packet looks
alike. So this is evidence of a worse view, whatever its cause.
"""

from __future__ import annotations

import numpy as np

from viewshed import _core
from viewshed.arrays import F32
from viewshed.monitor.evidence.base import ABSTAINS, SECTORS, MonitoredSweep
from viewshed.monitor.evidence.return_image import return_image_of


def measure_empty_runs(monitored: MonitoredSweep) -> F32:
    """Return the longest run of empty columns through each sector (SECTORS,) in degrees; abstains without rings."""
    image = return_image_of(monitored.leveled)
    if image is None:
        return ABSTAINS
    return np.rad2deg(_core.measure_empty_runs(image.range_m, image.sector, SECTORS))
