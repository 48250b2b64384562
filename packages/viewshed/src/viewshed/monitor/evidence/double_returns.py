"""Two returns of one beam at different ranges: a sensor that reports one return a beam has none.

Free points are added to beams that returned already. The columns of a real sensor jitter, so that a return may fall
into its neighbor's pixel and leave its own empty: pixels beside an empty one do not count. A sensor with dual returns
has such pixels all around: only what a sector has above the sweep's median counts then.
"""

from __future__ import annotations

import numpy as np

from viewshed import _core
from viewshed.arrays import F32
from viewshed.monitor.evidence.base import ABSTAINS, SECTORS, MonitoredSweep, damped_share
from viewshed.monitor.evidence.return_image import return_image_of

_FEW = 30
"""Pixels that draw a share toward 0."""


def measure_double_returns(monitored: MonitoredSweep) -> F32:
    """Return the share (SECTORS,) of pixels with two returns above the sweep's median; abstains without beams."""
    image = return_image_of(monitored.leveled)
    known = monitored.leveled.range_image
    if image is None or known is None or not known.pixels_are_beams:
        return ABSTAINS
    share = damped_share(*_core.count_double_returns(image.range_m, image.farthest_m, image.sector, SECTORS), _FEW)
    above: F32 = np.maximum(share - np.float32(np.median(share)), np.float32(0.0))
    return above
