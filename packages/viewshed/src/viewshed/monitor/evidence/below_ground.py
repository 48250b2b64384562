"""Isolated returns below the local ground, where no light comes back from: jamming, and ranges drawn at random.

Rain, fog and snow return from before the ground. A mirror shows surfaces below it: wet asphalt, paint and windows of
cars do in most real sweeps, in none of the simulated ones. And ground may fall away where its estimate does not. Both
are surfaces, which neighboring beams meet as well; so only returns count that no neighbor confirms, and of these as
many less as are confirmed in the same sector: a mirror image has edges, where a beam may meet it alone.
"""

from __future__ import annotations

import numpy as np

from viewshed import _core
from viewshed.arrays import F32
from viewshed.monitor.evidence.base import ABSTAINS, SECTORS, MonitoredSweep, damped_share

_MARGIN_M, _MARGIN_SHARE = 0.4, 0.02
"""A return lies below the ground by more than this distance and share of its range."""

_FEW = 20
"""Returns that draw a share toward 0."""


def measure_below_ground(monitored: MonitoredSweep) -> F32:
    """Return the share (SECTORS,) of returns that lie isolated below the local ground; abstains without rings.

    Of more than lie there confirmed; clutter is isolated.
    """
    leveled = monitored.leveled
    image = leveled.range_image
    if image is None:
        return ABSTAINS
    below = leveled.height_m < -(_MARGIN_M + _MARGIN_SHARE * leveled.range_m)
    isolated = image.isolated[leveled.rows]
    some, every = _core.count_chosen(leveled.points, below & isolated, SECTORS)
    confirmed, _ = _core.count_chosen(leveled.points, below & ~isolated, SECTORS)
    if image.clutter is not None:
        points = leveled.level_from_sensor @ leveled.sweep.points[image.clutter]
        range_m = np.hypot(points[:, 0], points[:, 1])
        below = points[:, 2] - leveled.ground.at(points) < -(_MARGIN_M + _MARGIN_SHARE * range_m)
        more = _core.count_chosen(points.astype(np.float32), below, SECTORS)
        some, every = some + more[0], every + more[1]
    return damped_share(np.maximum(some - confirmed, 0), every, _FEW)
