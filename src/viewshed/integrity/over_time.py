"""Alarms over time: an e-detector collects the p-values of a stream until they speak against it together.

A p-value is turned into a bet, an e-value whose mean is 1 at most on benign sweeps. Bets of all starting times are
added up (Shiryaev and Roberts, as e-detector of Shin, Ramdas and Rinaldo, 2022, arXiv 2203.03532). If bets have mean 1
at most whatever came before, the mean time between two false alarms is at least the limit, in blocks of sweeps.

That *whatever came before* is more than a calibration can give: neighbors in a drive are nearly the same sweep, and a
scene that scores high does so again in the next sweep. So the statement is measured on benign drives
(:func:`measure_false_alarms`), or the limit is taken from whole drives (:func:`limit_per_drive`), which needs no
statement about what is between sweeps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from viewshed.integrity.calibration import alarm_limit

Floats = NDArray[np.float64]

POWERS = (0.05, 0.2, 0.5, 0.8)
"""Exponents of the bets: small ones win on p-values near 0, large ones on p-values that are only often small."""


def e_values(p: ArrayLike) -> Floats:
    """Return the e-values (N,) of p-values (N,): the mean over ``POWERS`` κ of κ p^(κ - 1) (Vovk and Wang, 2021).

    Raises:
        ValueError: a p-value lies outside (0, 1].
    """
    values = np.asarray(p, np.float64)
    if not ((values > 0.0) & (values <= 1.0)).all():
        raise ValueError("p-values must lie in (0, 1], got others; NaN and 0 are none")
    bets: Floats = np.mean([power * values ** (power - 1.0) for power in POWERS], axis=0)
    return bets


@dataclass(slots=True)
class EDetector:
    """Collects p-values, one a sweep, and alarms where together they are too small. It begins anew after an alarm.

    The bets of a block are averaged: a mean of e-values is an e-value however they depend on each other.

    Attributes:
        limit: of the wealth; the mean number of blocks between false alarms is at least this.
        block: sweeps of a block.
        wealth: at the end of the last block; 0 at the beginning and after an alarm.
        doubtful_sweeps: sweeps since the doubt that is left began; at an alarm, its delay.

    Raises:
        ValueError: limit or block is below 1.
    """

    limit: float
    block: int = 1
    wealth: float = 0.0
    doubtful_sweeps: int = 0
    _bets: list[float] = field(default_factory=list, repr=False)
    _rise: float = field(default=0.0, repr=False)

    def __post_init__(self) -> None:
        if not (self.limit >= 1.0 and self.block >= 1):
            raise ValueError(f"limit and block must be 1 at least, got {self.limit} and {self.block}")

    @classmethod
    def for_rate(cls, per_hour: float, hz: float, block: int = 1) -> EDetector:
        """Return the detector that states so many false alarms an hour at so many sweeps a second.

        Raises:
            ValueError: a rate is not positive, or would alarm at every block.
        """
        if not (per_hour > 0.0 and hz > 0.0):
            raise ValueError(f"per_hour and hz must be positive, got {per_hour} and {hz}")
        return cls(3600.0 * hz / (block * per_hour), block)

    def stated_per_hour(self, hz: float) -> float:
        """Return the stated number of false alarms an hour at so many sweeps a second."""
        return 3600.0 * hz / (self.block * self.limit)

    def fresh(self) -> EDetector:
        """Return the same detector at its beginning."""
        return EDetector(self.limit, self.block)

    def add(self, p: float) -> bool:
        """Return whether it alarms with the p-value of the next sweep.

        Raises:
            ValueError: the p-value lies outside (0, 1].
        """
        bet = float(e_values([p])[0])
        if self.wealth >= self.limit:
            self.wealth = self._rise = 0.0
        if not self._bets:
            # Where the sum of logs falls below 0 nothing is left of earlier doubt (Page's CUSUM).
            self.doubtful_sweeps = 0 if self._rise <= 1.0 else self.doubtful_sweeps
        self._bets.append(bet)
        self.doubtful_sweeps += 1
        if len(self._bets) < self.block:
            return False
        mean = sum(self._bets) / self.block
        self._bets.clear()
        self._rise = mean * max(self._rise, 1.0)
        self.wealth = mean * (1.0 + self.wealth)
        return self.wealth >= self.limit


@dataclass(frozen=True, slots=True)
class FalseAlarms:
    """False alarms that were counted on benign drives, beside the stated ones.

    Attributes:
        alarms: how many.
        hours: of driving.
        stated_per_hour: what the detector states.
        interval_per_hour: 95 % interval of the rate, by the bootstrap over drives; three alarms where there were none.
    """

    alarms: int
    hours: float
    stated_per_hour: float
    interval_per_hour: tuple[float, float]

    @property
    def per_hour(self) -> float:
        """False alarms an hour."""
        return self.alarms / self.hours

    def __str__(self) -> str:
        """Return the count and the statement in a line."""
        low, high = self.interval_per_hour
        return (
            f"{self.alarms} false alarms in {self.hours:.3g} h, {self.per_hour:.3g} an hour ({low:.3g} to {high:.3g}); "
            f"stated are {self.stated_per_hour:.3g} at most, were sweeps independent"
        )


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
    return FalseAlarms(alarms, float(hours.sum()), detector.stated_per_hour(hz), (float(low), float(high)))


def limit_per_drive(detector: EDetector, drives: Sequence[ArrayLike], rate: float) -> EDetector:
    """Return the detector with the limit that a further benign drive passes with probability ``rate`` at most.

    Drives are exchangeable, whatever the dependence between their sweeps, if each is a scene of its own; they must be
    as long as the further one, and none of the scenes that the p-values were calibrated on.

    Raises:
        ValueError: there are too few drives for the rate, or a p-value lies outside (0, 1].
    """
    highest = []
    for drive in drives:
        tried, most = replace(detector.fresh(), limit=np.inf), 0.0
        for p in np.asarray(drive, np.float64).tolist():
            tried.add(p)
            most = max(most, tried.wealth)
        highest.append(most)
    limit = alarm_limit(highest, rate, unit="drives")
    return EDetector(max(float(np.nextafter(limit, np.inf)), 1.0), detector.block)
