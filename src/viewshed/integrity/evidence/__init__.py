"""Evidence that a sweep is not what it seems: a table of small parts, one file each.

To add one, write a file that measures a :class:`MonitoredSweep` and add a line to ``EVIDENCE``.
"""

from __future__ import annotations

from viewshed.integrity.evidence.arrival import measure_arrival
from viewshed.integrity.evidence.base import ABSTAINS, SECTORS, Evidence, MonitoredSweep, sector_of
from viewshed.integrity.evidence.departure import measure_departure
from viewshed.integrity.evidence.frame_noise import measure_frame_noise
from viewshed.integrity.evidence.isolated import measure_isolated
from viewshed.integrity.evidence.lost_view import measure_lost_view
from viewshed.integrity.evidence.phantom_shadow import measure_phantom_shadow
from viewshed.integrity.evidence.registration import measure_registration
from viewshed.integrity.evidence.same_noise import measure_same_noise
from viewshed.integrity.evidence.seen_through import measure_seen_through
from viewshed.integrity.evidence.vanished import measure_vanished

__all__ = ["ABSTAINS", "EVIDENCE", "SECTORS", "Evidence", "MonitoredSweep", "sector_of"]

_ALL = (
    Evidence(
        "isolated", measure_isolated, "{value:.0%} of the returns at {degrees:.0f}° have no neighbor at a similar range"
    ),
    Evidence(
        "seen_through",
        measure_seen_through,
        "{value:.1f} m² of obstacles at {degrees:.0f}° stand where the last sweep looked through",
    ),
    Evidence(
        "arrival",
        measure_arrival,
        "an obstacle at {degrees:.0f}° must have come there at {value:.0f} m/s",
    ),
    Evidence(
        "vanished",
        measure_vanished,
        "{value:.1f} m² of obstacles at {degrees:.0f}° are gone since the last sweep, and beams pass there",
    ),
    Evidence(
        "departure",
        measure_departure,
        "an obstacle at {degrees:.0f}° must have left at {value:.0f} m/s",
    ),
    Evidence(
        "same_noise",
        measure_same_noise,
        "{value:.0%} of the ranges at {degrees:.0f}° repeat those of an earlier sweep, noise included",
    ),
    Evidence(
        "registration",
        measure_registration,
        "the pose is {value:.0f} standard deviations off that of the earlier sweeps",
    ),
    Evidence(
        "phantom_shadow",
        measure_phantom_shadow,
        "beams pass through {value:.0%} of the surfaces at {degrees:.0f}° and end there beside them",
    ),
    Evidence(
        "lost_view",
        measure_lost_view,
        "at {degrees:.0f}° beams do not return any more from {value:.0%} of the surfaces",
    ),
    Evidence(
        "frame_noise",
        measure_frame_noise,
        "surfaces at {degrees:.0f}° jump by {value:.2f} m from sweep to sweep",
    ),
)

EVIDENCE: dict[str, Evidence] = {evidence.name: evidence for evidence in _ALL}
"""By name."""
