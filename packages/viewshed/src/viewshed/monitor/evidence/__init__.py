"""Evidence that a sweep is not what it seems: a table of small parts, one file each.

To add one, write a file that measures a :class:`MonitoredSweep` and add a line to ``EVIDENCE``.
"""

from __future__ import annotations

from viewshed.monitor.evidence.arrival import measure_arrival
from viewshed.monitor.evidence.base import ABSTAINS, SECTORS, Evidence, MonitoredSweep, sector_of
from viewshed.monitor.evidence.before_surface import measure_before_surface
from viewshed.monitor.evidence.behind_surface import measure_behind_surface
from viewshed.monitor.evidence.below_ground import measure_below_ground
from viewshed.monitor.evidence.beyond_ground import measure_beyond_ground
from viewshed.monitor.evidence.common_steps import measure_common_steps
from viewshed.monitor.evidence.departure import measure_departure
from viewshed.monitor.evidence.double_returns import measure_double_returns
from viewshed.monitor.evidence.empty_runs import measure_empty_runs
from viewshed.monitor.evidence.estimates import measure_deviation, measure_disagreement
from viewshed.monitor.evidence.frame_noise import measure_frame_noise
from viewshed.monitor.evidence.isolated import measure_isolated
from viewshed.monitor.evidence.lost_view import measure_lost_view
from viewshed.monitor.evidence.off_beam import measure_off_beam
from viewshed.monitor.evidence.phantom_shadow import measure_phantom_shadow
from viewshed.monitor.evidence.range_noise import measure_ground_noise, measure_near_noise, measure_surface_noise
from viewshed.monitor.evidence.range_offset import measure_range_offset
from viewshed.monitor.evidence.registration import measure_registration
from viewshed.monitor.evidence.same_noise import measure_same_noise
from viewshed.monitor.evidence.seen_through import measure_seen_through
from viewshed.monitor.evidence.straight_edges import measure_straight_edges
from viewshed.monitor.evidence.vanished import measure_vanished

__all__ = ["ABSTAINS", "EVIDENCE", "SECTORS", "Evidence", "MonitoredSweep", "sector_of"]

_ALL = (
    Evidence(
        "isolated", measure_isolated, "{value:.0%} of the returns at {degrees:.0f}° have no neighbor at a similar range"
    ),
    Evidence(
        "behind_surface", measure_behind_surface, "{value:.1%} of the beams at {degrees:.0f}° pass through a surface"
    ),
    Evidence(
        "before_surface",
        measure_before_surface,
        "{value:.1%} of the returns at {degrees:.0f}° stand alone in the air at one range",
    ),
    Evidence(
        "double_returns", measure_double_returns, "{value:.1%} of the beams at {degrees:.0f}° returned from two ranges"
    ),
    Evidence(
        "below_ground",
        measure_below_ground,
        "{value:.1%} of the returns at {degrees:.0f}° lie below the ground, no neighbor near them",
    ),
    Evidence(
        "beyond_ground",
        measure_beyond_ground,
        "{value:.1%} of the returns at {degrees:.0f}° lie beyond where their beams meet the ground",
    ),
    Evidence("empty_runs", measure_empty_runs, "{value:.0f}° around {degrees:.0f}° hardly returned anything"),
    Evidence(
        "ground_noise", measure_ground_noise, "ground at {degrees:.0f}° is {value:.1f} times as noisy as all around"
    ),
    Evidence(
        "near_noise",
        measure_near_noise,
        "surfaces within 20 m at {degrees:.0f}° are {value:.1f} times as noisy as the smoothest",
    ),
    Evidence(
        "surface_noise",
        measure_surface_noise,
        "surfaces at {degrees:.0f}° are {value:.1f} times as noisy as the smoothest",
    ),
    Evidence("off_beam", measure_off_beam, "{value:.1%} of the returns at {degrees:.0f}° lie on no beam"),
    Evidence(
        "range_offset", measure_range_offset, "ground at {degrees:.0f}° is flat only if ranges are {value:.1f} m off"
    ),
    Evidence(
        "common_steps",
        measure_common_steps,
        "the ground at {degrees:.0f}° steps in all rings at once, by {value:.0f} times what rings differ",
    ),
    Evidence("straight_edges", measure_straight_edges, "{value:.0%} of the rings break off together at {degrees:.0f}°"),
    Evidence(
        "disagreement",
        measure_disagreement,
        "network and shadow map differ in {value:.0%} of the cells at {degrees:.0f}°",
    ),
    Evidence("deviation", measure_deviation, "the network deviates by {value:.2f} in the mean cell at {degrees:.0f}°"),
    Evidence(
        "seen_through",
        measure_seen_through,
        "{value:.1f} m² of obstacles at {degrees:.0f}° stand where the last sweep looked through",
        over_time=True,
    ),
    Evidence(
        "arrival",
        measure_arrival,
        "an obstacle at {degrees:.0f}° must have come there at {value:.0f} m/s",
        over_time=True,
    ),
    Evidence(
        "vanished",
        measure_vanished,
        "{value:.1f} m² of obstacles at {degrees:.0f}° are gone since the last sweep, and beams pass there",
        over_time=True,
    ),
    Evidence(
        "departure",
        measure_departure,
        "an obstacle at {degrees:.0f}° must have left at {value:.0f} m/s",
        over_time=True,
    ),
    Evidence(
        "same_noise",
        measure_same_noise,
        "{value:.0%} of the ranges at {degrees:.0f}° repeat those of an earlier sweep, noise included",
        over_time=True,
    ),
    Evidence(
        "registration",
        measure_registration,
        "the pose is {value:.0f} standard deviations off that of the earlier sweeps",
        over_time=True,
    ),
    Evidence(
        "phantom_shadow",
        measure_phantom_shadow,
        "beams pass through {value:.0%} of the surfaces at {degrees:.0f}° and end there beside them",
        over_time=True,
    ),
    Evidence(
        "lost_view",
        measure_lost_view,
        "at {degrees:.0f}° beams do not return any more from {value:.0%} of the surfaces",
        over_time=True,
    ),
    Evidence(
        "frame_noise",
        measure_frame_noise,
        "surfaces at {degrees:.0f}° jump by {value:.2f} m from sweep to sweep",
        over_time=True,
    ),
)

EVIDENCE: dict[str, Evidence] = {evidence.name: evidence for evidence in _ALL}
"""By name."""
