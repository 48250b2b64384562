"""Returns off the beams: whose elevation is not that of their ring, nor of a neighbor.

Free points lie anywhere, a sensor's returns on its beams. Motion and vibration tilt beams too, but neighbors of similar
range alike. The rings' elevations are measured in the sweep, so a sensor with a calibration of its own has none.
"""

from __future__ import annotations

from viewshed import _core
from viewshed.arrays import F32
from viewshed.monitor.evidence.base import ABSTAINS, SECTORS, MonitoredSweep, damped_share

_FEW = 20
"""Returns that draw a share toward 0."""


def measure_off_beam(monitored: MonitoredSweep) -> F32:
    """Return the share (SECTORS,) of returns that lie on no beam; abstains without rings."""
    leveled, image = monitored.leveled, monitored.leveled.range_image
    if image is None:
        return ABSTAINS
    off_beam = _core.find_off_beam(
        leveled.sweep.points, image.ring, image.column, image.origin_m, leveled.rows, image.columns
    )
    return damped_share(*_core.count_chosen(leveled.points, off_beam, SECTORS), _FEW)
