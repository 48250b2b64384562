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

FEWER, FEWEST = 0.8, 0.9
"""A view is worse with less than this share of the usual returns, and of the fewest that there were before, ..."""

NOISIER, LEAST_NOISE_M, NOISIEST = 1.6, 0.03, 0.9
"""... with this factor of the noise that all but a tenth of the sweeps before had, if it is more than this, ..."""

MORE_ISOLATED, LEAST_ISOLATED = 1.5, 0.003
"""... or with isolated returns, of rain, snow or leaves, beyond this many times their upper spread, and this share."""

RARE_SHARE = 0.02
"""Sweeps before, on either side, beyond which a number goes by itself: the fewest returns, and the upper spread."""

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
            # All three are of a world as well: an open road has few surfaces, and bent ones.
            before = every[:-NOW_SWEEPS]
            fewest, noisiest, most = (
                _quantile(before[:, k], share) for k, share in enumerate((RARE_SHARE, NOISIEST, 1.0 - RARE_SHARE))
            )
        reasons = []
        if now[0] < min(FEWER * past[0], FEWEST * fewest):
            reasons.append(f"there are {now[0] / past[0]:.0%} of the returns that there were before")
        if now[1] > max(NOISIER * noisiest, LEAST_NOISE_M):
            reasons.append(f"ranges are {now[1] / max(past[1], 1e-6):.1f} times as noisy as before")
        if now[2] > past[2] + max(MORE_ISOLATED * (most - past[2]), LEAST_ISOLATED):
            reasons.append(f"{now[2]:.1%} of the returns are isolated, {past[2]:.1%} were before")
        return reasons


def _quantile(numbers: F32, share: float) -> float:
    """Return a quantile of the numbers (n,) that are known; NaN where none is."""
    known = numbers[np.isfinite(numbers)]
    return float(np.quantile(known, share)) if len(known) else np.nan


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
    points = leveled.sweep.points[leveled.sweep.points.any(axis=1)]  # at the origin is none
    counts = np.bincount(sector_of(np.arctan2(points[:, 1], points[:, 0])), minlength=SECTORS)
    empty = np.append(counts == 0, (counts == 0)[:EMPTY_SECTORS])
    longest = max((len(run) for run in "".join("x" if one else " " for one in empty).split()), default=0)
    if low.any() and longest >= EMPTY_SECTORS:
        reasons.append(f"no beam returns from {min(longest, SECTORS) * 360 // SECTORS}° of azimuth")
    return reasons
