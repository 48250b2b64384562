"""Ranges that come again: a replayed sweep, or a sensor that is frozen.

Each range has noise of its own, so two sweeps of one scene differ, even from one place. Where the difference between
the two is the same for a beam and its neighbor, to less than the sensor's noise, one sweep was made of the other.
Neighbors are compared, not ranges, because undoing another motion shifts all ranges of a direction alike. Sensors
report whole steps of range, so some differences are equal by chance: about as many as differ by one step, which are
subtracted.
"""

from __future__ import annotations

import numpy as np

from viewshed.arrays import F32
from viewshed.monitor.evidence.base import ABSTAINS, SECTORS, MonitoredSweep
from viewshed.monitor.evidence.views import view_of


def measure_same_noise(monitored: MonitoredSweep) -> F32:
    """Return the share by sector (SECTORS,) of ranges that repeat an earlier sweep's, beyond what noise repeats.

    Of the earlier sweep that is most alike. Needs no poses; abstains without earlier sweeps of the same image or rings.
    """
    view = view_of(monitored.leveled)
    if view is None:
        return ABSTAINS
    shape = _shape(monitored)
    views = [
        before
        for each in monitored.earlier
        if each.range_image is not None
        and each.range_image.counts.shape == shape
        and (before := view_of(each)) is not None
    ]
    if not views:
        return ABSTAINS
    shares = view.repeats(views, SECTORS)
    alike = int(np.argmax(np.nan_to_num(shares, nan=-1.0).mean(axis=1)))
    return np.asarray(np.maximum(shares[alike], np.float32(0.0)))


def _shape(monitored: MonitoredSweep) -> tuple[int, ...] | None:
    image = monitored.leveled.range_image
    return None if image is None else image.counts.shape
