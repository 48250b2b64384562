"""Detect a degraded view, whatever its cause: against the sensor's own past, and against its beam table.

No limit comes from the noise of simulated sensors. A change counts if the median over half a second shows it.
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
"""The median over this many last sweeps is compared with the sweeps before, of which it needs this many."""

FEWER, FEWEST = 0.8, 0.9
"""Too few returns: below this share of the past median, and below this share of the past 2 % quantile."""

NOISIER, MIN_NOISE_M, NOISIEST = 1.6, 0.03, 0.9
"""Too noisy: above this factor of a past quantile of the noise, and above this noise; the last is the quantile."""

MORE_ISOLATED, MIN_ISOLATED = 1.5, 0.003
"""Too many isolated returns (rain, snow, leaves): above the past median by more than this factor of the distance from
median to 98 % quantile, and by more than this share."""

RARE_SHARE = 0.02
"""Tail share of the past quantiles of returns (lower) and of isolated returns (upper)."""

EMPTY_SECTORS = 6
"""Consecutive sectors (30°) without a return that degrade a sensor that scans all around."""

DOWNWARD = np.deg2rad(-3.0)
"""Beams below this elevation meet the ground or an obstacle."""

_WATCHED = tuple(EVIDENCE).index("returns"), tuple(EVIDENCE).index("range_noise"), tuple(EVIDENCE).index("isolated")


@dataclass(slots=True)
class SensorState:
    """The last minute of a sensor's returns, range noise and isolated returns."""

    _numbers: deque[F32] = field(default_factory=lambda: deque(maxlen=MEMORY_SWEEPS), repr=False)

    def check(self, leveled: LeveledSweep, evidence: F32) -> tuple[str, ...]:
        """Return one sentence for each way in which the view is degraded, and remember the sweep."""
        self._numbers.append(evidence[_WATCHED, 0])
        return (*self._against_past(), *against_table(leveled))

    def _against_past(self) -> list[str]:
        """Return one sentence for each way in which the last sweeps are worse than those before."""
        if len(self._numbers) < NOW_SWEEPS + PAST_SWEEPS:
            return []
        numbers = np.array(self._numbers)
        # A kind that abstained in all sweeps is NaN and compares as false.
        with np.errstate(all="ignore"):
            now, past = _median(numbers[-NOW_SWEEPS:]), _median(numbers[:-NOW_SWEEPS])
            # All three depend on the scene too (an open road has few surfaces), so past extremes count as well.
            before = numbers[:-NOW_SWEEPS]
            fewest, noisiest, most_isolated = (
                _quantile(before[:, k], share) for k, share in enumerate((RARE_SHARE, NOISIEST, 1.0 - RARE_SHARE))
            )
        reasons = []
        if now[0] < min(FEWER * past[0], FEWEST * fewest):
            reasons.append(f"the number of returns fell to {now[0] / past[0]:.0%}")
        if now[1] > max(NOISIER * noisiest, MIN_NOISE_M):
            reasons.append(f"ranges are {now[1] / max(past[1], 1e-6):.1f} times as noisy as before")
        if now[2] > past[2] + max(MORE_ISOLATED * (most_isolated - past[2]), MIN_ISOLATED):
            reasons.append(f"{now[2]:.1%} of the returns are isolated, up from {past[2]:.1%}")
        return reasons


def _quantile(numbers: F32, share: float) -> float:
    """Return a quantile of the known numbers (n,); NaN if none is known."""
    known = numbers[np.isfinite(numbers)]
    return float(np.quantile(known, share)) if len(known) else np.nan


def _median(numbers: F32) -> F32:
    """Return the median (K,) of the known numbers (n, K); NaN if none is known."""
    ordered, count = np.sort(numbers, axis=0), np.isfinite(numbers).sum(axis=0)
    return np.asarray(np.take_along_axis(ordered, np.maximum(count - 1, 0)[None] // 2, axis=0)[0], np.float32)


def against_table(leveled: LeveledSweep) -> list[str]:
    """Return one sentence for each defect against the beam table of a rotating sensor; none without a table."""
    model, image = leveled.sensor_id.model, leveled.range_image
    if model is None or model.shots is not None or image is None or leveled.sweep.planar is not None:
        return []
    reasons = []
    # 1. Downward beams without a return at any azimuth, between beams that do return.
    alive = np.asarray(image.counts.any(axis=1), np.bool_)
    low: Mask = np.less(model.elevation, DOWNWARD)
    between: Mask = np.logical_or.accumulate(alive) & np.logical_or.accumulate(alive[::-1])[::-1] & ~alive
    if len(low) == len(alive) and (dead := int((between & low).sum())):
        reasons.append(f"{dead} of {low.sum()} beams below the horizon return nothing")
    # 2. Directions in which no beam returns.
    points = leveled.sweep.points[leveled.sweep.points.any(axis=1)]  # points at the origin are no returns
    counts = np.bincount(sector_of(np.arctan2(points[:, 1], points[:, 0])), minlength=SECTORS)
    empty = np.append(counts == 0, (counts == 0)[:EMPTY_SECTORS])
    longest = max((len(run) for run in "".join("x" if one else " " for one in empty).split()), default=0)
    if low.any() and longest >= EMPTY_SECTORS:
        reasons.append(f"no beam returns from {min(longest, SECTORS) * 360 // SECTORS}° of azimuth")
    return reasons
