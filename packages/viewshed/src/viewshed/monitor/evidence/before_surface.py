"""Returns before all their neighbors, in line with each other: what is left of a surface that was taken away.

A spoofer that removes a wall, or pushes it away, loses some beams (docs/attacks.md), and these still return from the
wall: single returns in the air, at one range. Points that are added in a wedge at one range look the same. Rain and
snow return from anywhere along the beam, so few are in line; posts and leaves are, but there are few of them.
"""

from __future__ import annotations

from viewshed import _core
from viewshed.arrays import F32
from viewshed.monitor.evidence.base import ABSTAINS, SECTORS, MonitoredSweep, damped_share
from viewshed.monitor.evidence.return_image import return_image_of

_FEW = 30
"""Pixels that draw a share toward 0."""


def measure_before_surface(monitored: MonitoredSweep) -> F32:
    """Return the share (SECTORS,) of pixels before their neighbors and in line; abstains without rings."""
    image = return_image_of(monitored.leveled)
    if image is None:
        return ABSTAINS
    return damped_share(*_core.count_specks(image.range_m, image.sector, SECTORS), _FEW)
