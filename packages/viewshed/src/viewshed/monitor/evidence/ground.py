"""Evidence of the ground of one sweep: returns below and beyond it, rings at the wrong radius, steps of all rings."""

from __future__ import annotations

import numpy as np

from viewshed import _core
from viewshed.arrays import F32
from viewshed.monitor.evidence.base import ABSTAINS, SECTORS, MonitoredSweep, damped_share
from viewshed.monitor.evidence.beams import return_image_of

_MARGIN_M, _MARGIN_SHARE = 0.4, 0.02
"""A return lies below the local ground by more than this distance and share of its range."""

_PLANE_MARGIN_M, _FALL = 0.25, 0.12
"""A return lies beyond the ground if it is lower than the plane by this distance and share of its range."""

_FEW = 20
"""Returns that draw a share toward 0."""


def measure_below_ground(monitored: MonitoredSweep) -> F32:
    """Return the share (SECTORS,) of returns that lie isolated below the local ground; abstains without rings.

    No light comes back from there: jamming, and ranges drawn at random. Rain, fog and snow return from before the
    ground. A mirror shows surfaces below it: wet asphalt, paint and windows of cars do in most real sweeps, in none of
    the simulated ones. And ground may fall away where its estimate does not. Both are surfaces, which neighboring beams
    meet as well; so only returns count that no neighbor confirms (clutter is isolated), less as many as are confirmed
    in the same sector: a mirror image has edges, where a beam may meet it alone.
    """
    leveled, image = monitored.leveled, monitored.leveled.range_image
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


def measure_beyond_ground(monitored: MonitoredSweep) -> F32:
    """Return the share (SECTORS,) of returns far below the plane on which the sensor's vehicle stands.

    Local ground that is estimated from the sweep follows an attacker's ground; the plane below the sensor does not. A
    range that is too long by Δ puts the return of a beam that meets the ground at range r below the plane by h Δ / r,
    with h the height of the sensor. A road may fall away by an eighth of the way.
    """
    leveled = monitored.leveled
    beyond = leveled.points[:, 2] < -(_PLANE_MARGIN_M + _FALL * leveled.range_m)
    return damped_share(*_core.count_chosen(leveled.points, beyond, SECTORS), _FEW)


def measure_range_offset(monitored: MonitoredSweep) -> F32:
    """Return the absolute offset of range (SECTORS,) in meters that flattens the ground; NaN for too little ground.

    A relay sends the sensor's own pulses back later, so that all ranges are too long. On ground of slope s a return at
    distance x lies at height z = s x - Δ q, where Δ is the offset of range and q = (h - z) / r the descent of its beam
    a meter, h the height of the sensor. The ground below the sensor is at z = 0. Near rings descend steeply and far
    ones hardly, so slope and offset part. Each sector is fitted by itself, the returns far from the fit counting less
    (iterated least squares with Cauchy's weights).
    """
    leveled = monitored.leveled
    return np.abs(_core.measure_range_offset(leveled.points, leveled.sensor_height_m, SECTORS))


def measure_common_steps(monitored: MonitoredSweep) -> F32:
    """Return the largest common step of the ground rings against its spread (SECTORS,); abstains without rings.

    At the border of a wedge whose ranges are all too long or too short (relay) each ring steps by the same offset,
    which no ground does. A kerb, or an obstacle that stands on the ground, steps each ring by another amount, or only
    some rings. The median jump of the rings is compared with their spread.
    """
    image = return_image_of(monitored.leveled)
    return ABSTAINS if image is None else _core.measure_steps(image.range_m, image.height_m, image.sector, SECTORS)
