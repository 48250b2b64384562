"""Returns behind a surface: a beam whose eight neighbors meet one surface cannot have passed it.

A spoofer wins only a share of the beams that it aims at (.985 for a VLP-16, .44 for an OS1-32, docs/attacks.md):
through the holes of its ghost the sensor still sees what stands behind. Windows, fences and trees have holes too, but
around those the surface is rarely whole.
"""

from __future__ import annotations

from viewshed import _core
from viewshed.arrays import F32
from viewshed.monitor.evidence.base import ABSTAINS, SECTORS, MonitoredSweep, damped_share
from viewshed.monitor.evidence.return_image import return_image_of

_FEW = 30
"""Pixels that draw a share toward 0."""


def measure_behind_surface(monitored: MonitoredSweep) -> F32:
    """Return the share (SECTORS,) of the pixels within a surface that lie behind it; abstains without rings."""
    image = return_image_of(monitored.leveled)
    if image is None:
        return ABSTAINS
    return damped_share(*_core.count_holes(image.range_m, image.sector, SECTORS), _FEW)
