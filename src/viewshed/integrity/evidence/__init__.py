"""Evidence that a sweep is not what it seems: a table of small parts, one file each.

To add one, write a file that measures a :class:`MonitoredSweep` and add a line to ``EVIDENCE``.
"""

from __future__ import annotations

from viewshed.integrity.evidence.base import ABSTAINS, SECTORS, Evidence, MonitoredSweep, sector_of
from viewshed.integrity.evidence.isolated import measure_isolated

__all__ = ["ABSTAINS", "EVIDENCE", "SECTORS", "Evidence", "MonitoredSweep", "sector_of"]

_ALL = (
    Evidence(
        "isolated", measure_isolated, "{value:.0%} of the returns at {degrees:.0f}° have no neighbor at a similar range"
    ),
)

EVIDENCE: dict[str, Evidence] = {evidence.name: evidence for evidence in _ALL}
"""By name."""
