"""Returns below the local ground, where no light comes back from: jamming, and ranges drawn at random.

Rain, fog and snow return from before the ground. Puddles and glass mirror, rarely.
"""

from __future__ import annotations

import numpy as np

from viewshed import _core
from viewshed.integrity.evidence.base import SECTORS, Floats, MonitoredSweep, damped_share

_MARGIN_M, _MARGIN_SHARE = 0.4, 0.02
"""A return lies below the ground by more than this distance and share of its range."""

_FEW = 20
"""Returns that draw a share toward 0."""


def measure_below_ground(monitored: MonitoredSweep) -> Floats:
    """Return the share (SECTORS,) of returns below the local ground, clutter included."""
    leveled = monitored.leveled
    below = leveled.height_m < -(_MARGIN_M + _MARGIN_SHARE * leveled.range_m)
    some, every = _core.count_chosen(leveled.points, below, SECTORS)
    image = leveled.range_image
    if image is not None and image.clutter is not None:
        points = leveled.level_from_sensor @ leveled.sweep.points[image.clutter]
        range_m = np.hypot(points[:, 0], points[:, 1])
        below = points[:, 2] - leveled.ground.at(points) < -(_MARGIN_M + _MARGIN_SHARE * range_m)
        more = _core.count_chosen(points.astype(np.float32), below, SECTORS)
        some, every = some + more[0], every + more[1]
    return damped_share(some, every, _FEW)
