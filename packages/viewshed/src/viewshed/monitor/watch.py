"""Alarms of one stream: compare each sweep's evidence with the stream's past, and latch the alarm."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from viewshed.arrays import F32, Mask
from viewshed.monitor.evidence import EARLIER_SWEEPS, EVIDENCE, SECTORS, Evidence
from viewshed.monitor.score import RARE, Past, numbers_of
from viewshed.monitor.tails import CALM_SWEEPS

if TYPE_CHECKING:
    from viewshed.monitor.calibration import Calibration

MAX_HELD_SWEEPS = 100
"""After this many sweeps of an alarm (10 s) they become the past: then the world has probably changed."""


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """Verdict on one sweep of a stream.

    Attributes:
        score: joint rarity of its changes; NaN if too few sweeps came before.
        sectors: (E, SECTORS) surprise of each kind of evidence in each sector; NaN where it abstains.
        inconsistent: the score is above the limit.
        alarm: ``inconsistent``, latched until ``CALM_SWEEPS`` sweeps in a row are below the limit.
        suspect: (SECTORS,) bool, suspect sectors of all sweeps of the alarm.
        sweeps: number of sweeps of the alarm so far.
    """

    score: float
    sectors: F32
    inconsistent: bool = False
    alarm: bool = False
    suspect: Mask = field(default_factory=lambda: np.zeros(SECTORS, np.bool_))
    sweeps: int = 0


@dataclass(slots=True, eq=False)
class Watch:
    """Checks the evidence of one stream's sweeps.

    Sweeps that score above the limit do not become part of the past; otherwise an attack would soon look normal. After
    ``MAX_HELD_SWEEPS`` sweeps of an alarm those sweeps replace the past, so the alarm of a lasting change ends.

    Attributes:
        calibration: statistics of benign changes.
        limit: score above which a sweep is inconsistent.
        kinds: of the evidence.
    """

    calibration: Calibration
    limit: float
    kinds: Mapping[str, Evidence] = field(default_factory=lambda: EVIDENCE, repr=False)
    _past: Past = field(init=False, repr=False)
    _alarm_past: Past = field(init=False, repr=False)
    _suspect: Mask = field(default_factory=lambda: np.zeros(SECTORS, np.bool_), repr=False)
    _sweeps: int = 0
    _calm: int = 0

    def __post_init__(self) -> None:
        self._past, self._alarm_past = self._empty_past(), self._empty_past()

    def _empty_past(self) -> Past:
        return Past(self.calibration.prior_scale, self.kinds)

    def check(self, evidence: F32, *, impossible: bool = False) -> Verdict:
        """Return the verdict on the evidence (E, SECTORS) of the next sweep, and remember it.

        An ``impossible`` sweep is inconsistent in all sectors, whatever its score.
        """
        onset = self._past.onset(evidence)
        # 1. Score the changes against the past.
        score, sectors = np.nan, np.full_like(evidence, np.nan)
        if self._past.sweeps >= EARLIER_SWEEPS:
            score, sectors = self.calibration.score(self._past.reference().changes(numbers_of(onset, self.kinds)))
        # 2. Begin, continue, or (after enough calm sweeps) end the alarm.
        inconsistent = impossible or score > self.limit
        self._calm = 0 if inconsistent else self._calm + 1
        if self._sweeps and self._calm >= CALM_SWEEPS:
            self._sweeps = 0
        if inconsistent or self._sweeps:
            if not self._sweeps:
                self._suspect, self._alarm_past = np.zeros(SECTORS, np.bool_), self._empty_past()
            self._sweeps += 1
        if inconsistent:
            self._suspect = self._suspect | impossible | suspect_sectors(sectors)
        # 3. Update the past.
        if not inconsistent:
            self._past.add(evidence)
        if self._sweeps and not impossible:
            self._alarm_past.add(evidence)
        if inconsistent and self._alarm_past.sweeps >= MAX_HELD_SWEEPS:
            self._past, self._alarm_past = self._alarm_past, self._empty_past()
        alarm = self._sweeps > 0
        suspect = self._suspect if alarm else np.zeros(SECTORS, np.bool_)
        return Verdict(score, sectors, inconsistent, alarm, suspect, self._sweeps)


def suspect_sectors(sectors: F32) -> Mask:
    """Return the mask (SECTORS,) of sectors whose summed surprise (E, SECTORS) is within 1 of the highest sum."""
    beyond = np.maximum(np.nan_to_num(sectors) - RARE, 0.0).sum(axis=0)
    return np.asarray(beyond > max(float(beyond.max()) - 1.0, 0.0), np.bool_)
