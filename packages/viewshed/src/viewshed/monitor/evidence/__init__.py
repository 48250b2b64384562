"""Evidence that a sweep is not what it seems: a table of measures, in files by what they look at.

To add one, write a function that measures a :class:`MonitoredSweep` and add a row to ``EVIDENCE``.
"""

from __future__ import annotations

from viewshed.monitor.evidence import beams, estimates, ground, history, noise
from viewshed.monitor.evidence.base import ABSTAINS, SECTORS, Evidence, MonitoredSweep, sector_of

__all__ = ["ABSTAINS", "EVIDENCE", "SECTORS", "Evidence", "MonitoredSweep", "sector_of"]

EVIDENCE: dict[str, Evidence] = {evidence.name: evidence for evidence in (
    Evidence("isolated", beams.measure_isolated,
             "{value:.0%} of the returns at {degrees:.0f}° have no neighbor at a similar range"),
    Evidence("behind_surface", beams.measure_behind_surface,
             "{value:.1%} of the beams at {degrees:.0f}° pass through a surface"),
    Evidence("before_surface", beams.measure_before_surface,
             "{value:.1%} of the returns at {degrees:.0f}° stand alone in the air at one range"),
    Evidence("double_returns", beams.measure_double_returns,
             "{value:.1%} of the beams at {degrees:.0f}° returned from two ranges"),
    Evidence("below_ground", ground.measure_below_ground,
             "{value:.1%} of the returns at {degrees:.0f}° lie below the ground, no neighbor near them"),
    Evidence("beyond_ground", ground.measure_beyond_ground,
             "{value:.1%} of the returns at {degrees:.0f}° lie beyond where their beams meet the ground"),
    Evidence("empty_runs", beams.measure_empty_runs,
             "{value:.0f}° around {degrees:.0f}° hardly returned anything"),
    Evidence("ground_noise", noise.measure_ground_noise,
             "ground at {degrees:.0f}° is {value:.1f} times as noisy as all around"),
    Evidence("near_noise", noise.measure_near_noise,
             "surfaces within 20 m at {degrees:.0f}° are {value:.1f} times as noisy as the smoothest"),
    Evidence("surface_noise", noise.measure_surface_noise,
             "surfaces at {degrees:.0f}° are {value:.1f} times as noisy as the smoothest"),
    Evidence("off_beam", beams.measure_off_beam,
             "{value:.1%} of the returns at {degrees:.0f}° lie on no beam"),
    Evidence("range_offset", ground.measure_range_offset,
             "ground at {degrees:.0f}° is flat only if ranges are {value:.1f} m off"),
    Evidence("common_steps", ground.measure_common_steps,
             "the ground at {degrees:.0f}° steps in all rings at once, by {value:.0f} times what rings differ"),
    Evidence("straight_edges", beams.measure_straight_edges,
             "{value:.0%} of the rings break off together at {degrees:.0f}°"),
    Evidence("disagreement", estimates.measure_disagreement,
             "network and shadow map differ in {value:.0%} of the cells at {degrees:.0f}°"),
    Evidence("deviation", estimates.measure_deviation,
             "the network deviates by {value:.2f} in the mean cell at {degrees:.0f}°"),
    Evidence("seen_through", history.measure_seen_through,
             "{value:.1f} m² of obstacles at {degrees:.0f}° stand where the last sweep looked through", over_time=True),
    Evidence("arrival", history.measure_arrival,
             "an obstacle at {degrees:.0f}° must have come there at {value:.0f} m/s", over_time=True),
    Evidence("vanished", history.measure_vanished,
             "{value:.1f} m² of obstacles at {degrees:.0f}° are gone since the last sweep, and beams pass there",
             over_time=True),
    Evidence("departure", history.measure_departure,
             "an obstacle at {degrees:.0f}° must have left at {value:.0f} m/s", over_time=True),
    Evidence("same_noise", noise.measure_same_noise,
             "{value:.0%} of the ranges at {degrees:.0f}° repeat those of an earlier sweep, noise included",
             over_time=True),
    Evidence("registration", history.measure_registration,
             "the pose is {value:.0f} standard deviations off that of the earlier sweeps", over_time=True),
    Evidence("phantom_shadow", history.measure_phantom_shadow,
             "beams pass through {value:.0%} of the surfaces at {degrees:.0f}° and end there beside them",
             over_time=True),
    Evidence("lost_view", history.measure_lost_view,
             "at {degrees:.0f}° beams do not return any more from {value:.0%} of the surfaces", over_time=True),
    Evidence("frame_noise", noise.measure_frame_noise,
             "surfaces at {degrees:.0f}° jump by {value:.2f} m from sweep to sweep", over_time=True),
)}  # fmt: skip
"""By name, in the order of a score's rows."""
