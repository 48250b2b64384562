"""Whether a sensor sees less or worse than it did, or than its beam table says: whatever the cause.

Nothing is held against the noise of simulated units. A change counts if it lasts for half a second, in the median.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from viewshed.arrays import F32, Mask
from viewshed.monitor.evidence import EVIDENCE, SECTORS, sector_of
from viewshed.monitor.score import MEMORY_SWEEPS
from viewshed.preprocess.leveling import LeveledSweep

NOW_SWEEPS, PAST_SWEEPS = 5, 20
"""Sweeps whose median is compared, and those before them that it needs."""

FEWER, NOISIER, MORE_ISOLATED = 0.7, 1.6, 0.08
"""A view is worse with less than this share of the returns, this factor of the noise, or so many more isolated."""

LEAST_NOISE_M, NOISIEST = 0.05, 0.9
"""Noise of range below this makes no view worse, nor below that of this share of the sweeps before."""

EMPTY_SECTORS = 6
"""Sectors in a row, 30°, of a sensor that turns all around, without any return."""

DOWNWARD = np.deg2rad(-3.0)
"""Beams below this meet the ground, or what stands before it."""

_WATCHED = tuple(EVIDENCE).index("returns"), tuple(EVIDENCE).index("range_noise"), tuple(EVIDENCE).index("isolated")


@dataclass(slots=True)
class SensorState:
    """What a sensor showed in the last minute."""

    _numbers: deque[F32] = field(default_factory=lambda: deque(maxlen=MEMORY_SWEEPS), repr=False)

    def check(self, leveled: LeveledSweep, evidence: F32) -> tuple[str, ...]:
        """Return how the view is worse, a sentence each; none where it is not. The sweep is kept."""
        self._numbers.append(evidence[_WATCHED, 0])
        return (*self._against_past(), *against_table(leveled))

    def _against_past(self) -> list[str]:
        """Return how the median of the last sweeps is worse than that of those before."""
        if len(self._numbers) < NOW_SWEEPS + PAST_SWEEPS:
            return []
        every = np.array(self._numbers)
        # A kind that abstained in all sweeps compares as false.
        with np.errstate(all="ignore"):
            now, past = _median(every[-NOW_SWEEPS:]), _median(every[:-NOW_SWEEPS])
            # Noise is a world's as well: an open road has few surfaces, and bent ones.
            noisiest = np.nanquantile(every[:-NOW_SWEEPS, 1], NOISIEST) if np.isfinite(past[1]) else np.nan
        reasons = []
        if now[0] < FEWER * past[0]:
            reasons.append(f"there are {now[0] / past[0]:.0%} of the returns that there were before")
        if now[1] > max(NOISIER * noisiest, LEAST_NOISE_M):
            reasons.append(f"ranges are {now[1] / max(past[1], 1e-6):.1f} times as noisy as before")
        if now[2] > past[2] + MORE_ISOLATED:
            reasons.append(f"{now[2]:.0%} of the returns are isolated, {past[2]:.0%} were before")
        return reasons


def _median(numbers: F32) -> F32:
    """Return the median (K,) of numbers (n, K) that are known; NaN where none is."""
    ordered, count = np.sort(numbers, axis=0), np.isfinite(numbers).sum(axis=0)
    return np.asarray(np.take_along_axis(ordered, np.maximum(count - 1, 0)[None] // 2, axis=0)[0], np.float32)


def against_table(leveled: LeveledSweep) -> list[str]:
    """Return what the beam table of a sensor that turns all around says that a sweep lacks; nothing without a table."""
    model, image = leveled.sensor_id.model, leveled.range_image
    if model is None or model.shots is not None or image is None or leveled.sweep.planar is not None:
        return []
    reasons = []
    # 1. Beams that meet the ground, or what stands before it, and return nothing all around while those beside them do.
    alive = np.asarray(image.counts.any(axis=1), np.bool_)
    low: Mask = np.less(model.elevation, DOWNWARD)
    between: Mask = np.logical_or.accumulate(alive) & np.logical_or.accumulate(alive[::-1])[::-1] & ~alive
    if len(low) == len(alive) and (dead := int((between & low).sum())):
        reasons.append(f"{dead} of {low.sum()} beams below the horizon return nothing")
    # 2. Directions in which not one beam returns.
    points = leveled.sweep.points
    counts = np.bincount(sector_of(np.arctan2(points[:, 1], points[:, 0])), minlength=SECTORS)
    empty = np.append(counts == 0, (counts == 0)[:EMPTY_SECTORS])
    longest = max((len(run) for run in "".join("x" if one else " " for one in empty).split()), default=0)
    if low.any() and longest >= EMPTY_SECTORS:
        reasons.append(f"no beam returns from {min(longest, SECTORS) * 360 // SECTORS}° of azimuth")
    return reasons
