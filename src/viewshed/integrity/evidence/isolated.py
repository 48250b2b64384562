"""Isolated returns, which no neighboring beam confirms: noise, rain and free points, not surfaces."""

from __future__ import annotations

import numpy as np

from viewshed.integrity.evidence.base import ABSTAINS, Floats, MonitoredSweep, sector_of, share_by_sector

_LEAST_RETURNS = 20
"""Returns that a sector must have for its share to mean anything."""


def measure_isolated(monitored: MonitoredSweep) -> Floats:
    """Return the share of isolated returns by sector (SECTORS,); abstains where the rings are not known."""
    leveled = monitored.leveled
    image, points = leveled.range_image, leveled.sweep.points
    if image is None:
        return ABSTAINS
    return share_by_sector(image.isolated, sector_of(np.arctan2(points[:, 1], points[:, 0])), _LEAST_RETURNS)
