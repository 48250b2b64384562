"""Isolated returns, which no neighboring beam confirms: noise, rain and free points, not surfaces."""

from __future__ import annotations

import numpy as np

from viewshed import _core
from viewshed.arrays import F32
from viewshed.monitor.evidence.base import ABSTAINS, SECTORS, MonitoredSweep

_LEAST_RETURNS = 20
"""Returns that a sector must have for its share to mean anything."""


def measure_isolated(monitored: MonitoredSweep) -> F32:
    """Return the share of isolated returns by sector (SECTORS,); abstains where the rings are not known."""
    image = monitored.leveled.range_image
    if image is None:
        return ABSTAINS
    isolated, every = _core.count_chosen(monitored.leveled.sweep.points, image.isolated, SECTORS)
    share = isolated / np.maximum(every, 1)
    return np.where(every >= _LEAST_RETURNS, share, 0.0).astype(np.float32)
