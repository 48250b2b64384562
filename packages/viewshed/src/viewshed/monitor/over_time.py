"""Alarms over time: an e-detector collects the p-values of a stream until they speak against it together.

A p-value is turned into a bet, an e-value whose mean is 1 at most on benign sweeps. Bets of all starting times are
added up (Shiryaev and Roberts, as e-detector of Shin, Ramdas and Rinaldo, 2022, arXiv 2203.03532). If bets have mean 1
at most whatever came before, the mean time between two false alarms is at least the limit, in blocks of sweeps.

That *whatever came before* is more than a calibration can give: neighbors in a drive are nearly the same sweep, and a
scene that scores high does so again in the next sweep. So :func:`measure_false_alarms` counts what such a limit lets
through, and :class:`BenignRuns` gives limits that need no statement about what is between sweeps: the detector begins
anew after every run of fixed length and alarms once in it at most, and benign runs of the same length, each of a scene
of its own, say how often it does. If a run of a drive is exchangeable with these, the expected number of false alarms
an hour is at most the chosen one, however the runs of the drive depend on each other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from viewshed.arrays import F64

POWERS = (0.05, 0.2, 0.5, 0.8)
"""Exponents of the bets: small ones win on p-values near 0, large ones on p-values that are only often small."""


def e_values(p: ArrayLike) -> F64:
    """Return the e-values (N,) of p-values (N,): the mean over ``POWERS`` κ of κ p^(κ - 1) (Vovk and Wang, 2021).

    Raises:
        ValueError: a p-value lies outside (0, 1].
    """
    values = np.asarray(p, np.float64)
    if not ((values > 0.0) & (values <= 1.0)).all():
        raise ValueError("p-values must lie in (0, 1], got others; NaN and 0 are none")
    bets: F64 = np.mean([power * values ** (power - 1.0) for power in POWERS], axis=0)
    return bets


@dataclass(slots=True)
class EDetector:
    """Collects p-values, one a sweep, and alarms where together they are too small. It begins anew after an alarm.

    The bets of a block are averaged: a mean of e-values is an e-value however they depend on each other.

    Attributes:
        limit: of ``wealth``; the mean number of blocks between false alarms is at least this.
        block: sweeps of a block.
        run: sweeps after which it begins anew, having alarmed once at most; None to begin anew after alarms alone.
        wealth: the value of the e-detector after the last block; 0 at the beginning and after an alarm.
        doubtful_sweeps: sweeps since the doubt that is left began; at an alarm, its delay.

    Raises:
        ValueError: limit, block or run is below 1.
    """

    limit: float
    block: int = 1
    run: int | None = None
    wealth: float = 0.0
    doubtful_sweeps: int = 0
    _bets: list[float] = field(default_factory=list, repr=False)
    _rise: float = field(default=0.0, repr=False)
    _sweeps: int = field(default=0, repr=False)

    def __post_init__(self) -> None:
        if not (self.limit >= 1.0 and self.block >= 1 and (self.run is None or self.run >= 1)):
            raise ValueError(f"limit, block and run must be 1 at least, got {self.limit}, {self.block} and {self.run}")

    @classmethod
    def for_rate(cls, per_hour: float, hz: float, block: int = 1) -> EDetector:
        """Return the detector with ``per_hour`` false alarms an hour if the sweeps were independent.

        Args:
            per_hour: false alarms.
            hz: sweeps a second.
            block: sweeps of a block.

        Raises:
            ValueError: a rate is not positive, or would alarm at every block.
        """
        _require_rates(per_hour, hz)
        return cls(3600.0 * hz / (block * per_hour), block)

    def fresh(self) -> EDetector:
        """Return the same detector at its beginning."""
        return EDetector(self.limit, self.block, self.run)

    def add(self, p: float) -> bool:
        """Return whether it alarms with the p-value of the next sweep.

        Raises:
            ValueError: the p-value lies outside (0, 1].
        """
        bet = float(e_values([p])[0])
        has_alarmed = self.wealth >= self.limit
        if has_alarmed if self.run is None else self._sweeps == self.run:
            self.wealth = self._rise = 0.0
            self._sweeps, has_alarmed = 0, False
            self._bets.clear()
        self._sweeps += 1
        if not self._bets:
            # Where the sum of logs falls below 0 nothing is left of earlier doubt (Page's CUSUM).
            self.doubtful_sweeps = 0 if self._rise <= 1.0 else self.doubtful_sweeps
        self.doubtful_sweeps += 1
        if has_alarmed:
            return False
        self._bets.append(bet)
        if len(self._bets) < self.block:
            return False
        mean = sum(self._bets) / self.block
        self._bets.clear()
        self._rise = mean * max(self._rise, 1.0)
        self.wealth = mean * (1.0 + self.wealth)
        return self.wealth >= self.limit


@dataclass(frozen=True, slots=True, eq=False)
class BenignRuns:
    """What a detector reaches in benign runs of equal length, each of a scene of its own: its limits are from these.

    Attributes:
        wealth: (n,) the highest value of the e-detector in each run.
        sweeps: of a run.

    Raises:
        ValueError: there is no run, or one has no sweep.

    >>> runs = BenignRuns(np.arange(999.0), sweeps=36)
    >>> runs.least_per_hour(hz=10.0), runs.detector(per_hour=2.0, hz=10.0).run
    (1.0, 36)
    """

    wealth: F64
    sweeps: int

    def __post_init__(self) -> None:
        if self.wealth.ndim != 1 or not self.wealth.size or self.sweeps < 1:
            raise ValueError(
                f"benign runs must be one or more, of one or more sweeps, got {self.wealth.shape} of {self.sweeps}"
            )

    @classmethod
    def of(cls, scenes: Sequence[F64]) -> Self:
        """Return the runs that are most hours in all: of each scene that is as long its first sweeps.

        Args:
            scenes: p-values (sweeps,) of each, in the order of time.

        Raises:
            ValueError: there is no sweep, or a p-value lies outside (0, 1].
        """
        lengths = np.sort([len(p) for p in scenes])[::-1]
        sweeps = int(lengths[np.argmax(lengths * np.arange(1, len(lengths) + 1))]) if len(lengths) else 0
        highest = []
        for p in scenes:
            if 0 < sweeps <= len(p):
                detector, most = EDetector(math.inf), 0.0
                for each in p[:sweeps].tolist():
                    detector.add(each)
                    most = max(most, detector.wealth)
                highest.append(most)
        return cls(np.array(highest, np.float64), sweeps)

    def hours(self, hz: float) -> float:
        """Return the hours of all runs at ``hz`` sweeps a second."""
        return len(self.wealth) * self.sweeps / (3600.0 * hz)

    def least_per_hour(self, hz: float) -> float:
        """Return the smallest number of false alarms an hour that can be given."""
        return 3600.0 * hz / (self.sweeps * (len(self.wealth) + 1))

    def detector(self, per_hour: float, hz: float) -> EDetector:
        """Return the detector whose expected number of false alarms an hour is at most the chosen one.

        Args:
            per_hour: false alarms.
            hz: sweeps a second.

        Raises:
            ValueError: a rate is not positive, or there are too few hours of benign runs for it.
        """
        _require_rates(per_hour, hz)
        # A further run is as likely as each of these to be the highest, the second, and so on.
        allowed = math.floor((len(self.wealth) + 1) * per_hour * self.sweeps / (3600.0 * hz) + 1e-9) - 1
        if allowed < 0:
            raise ValueError(
                f"{per_hour:.3g} false alarms an hour need {1.0 / per_hour - self.sweeps / (3600.0 * hz):.3g} h of"
                f" benign runs, got {self.hours(hz):.3g} h; ask for {self.least_per_hour(hz) * 1.005:.3g} or more, or"
                " calibrate on more drives"
            )
        highest = np.sort(self.wealth)[::-1]
        limit = float(highest[allowed]) if allowed < len(highest) else 0.0
        return EDetector(max(float(np.nextafter(limit, np.inf)), 1.0), run=self.sweeps)


def _require_rates(per_hour: float, hz: float) -> None:
    if not (per_hour > 0.0 and hz > 0.0):
        raise ValueError(f"per_hour and hz must be positive, got {per_hour} and {hz}")


@dataclass(frozen=True, slots=True)
class FalseAlarms:
    """False alarms that were counted on benign drives.

    Attributes:
        alarms: how many.
        hours: of driving.
        interval_per_hour: 95 % interval of the rate, by the bootstrap over drives; three alarms where there were none.
    """

    alarms: int
    hours: float
    interval_per_hour: tuple[float, float]

    @property
    def per_hour(self) -> float:
        """False alarms an hour."""
        return self.alarms / self.hours


def measure_false_alarms(
    detector: EDetector, drives: Sequence[ArrayLike], hz: float, rng: np.random.Generator
) -> FalseAlarms:
    """Return the false alarms on benign drives, driven one after the other as one long drive.

    Args:
        detector: to be tried, from its beginning; it is not changed.
        drives: p-values (sweeps,) of each, in the order of time, of scenes that the monitor was not calibrated on.
        hz: sweeps a second.
        rng: draws drives for the interval.

    Raises:
        ValueError: there is no sweep, or a p-value lies outside (0, 1].
    """
    tried, counts, sweeps = detector.fresh(), [], []
    for drive in drives:
        p = np.asarray(drive, np.float64).tolist()
        counts.append(sum(tried.add(each) for each in p))
        sweeps.append(len(p))
    hours = np.array(sweeps) / (3600.0 * hz)
    if not hours.sum() > 0.0:
        raise ValueError("benign drives must have sweeps, got none")
    alarms = int(sum(counts))
    drawn = rng.integers(len(counts), size=(2000, len(counts)))
    low, high = np.quantile(np.array(counts)[drawn].sum(axis=1) / hours[drawn].sum(axis=1), (0.025, 0.975))
    if not alarms:
        high = 3.0 / hours.sum()
    return FalseAlarms(alarms, float(hours.sum()), (float(low), float(high)))
