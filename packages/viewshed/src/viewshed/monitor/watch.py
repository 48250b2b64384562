"""Alarms of one stream: each sweep's evidence against the stream's past, and what is latched."""

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

MOST_HELD_SWEEPS = 100
"""After this many sweeps of an alarm, 10 s, they become the past: the world changed, or nobody can tell."""


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """What the evidence of a sweep says against its stream.

    Attributes:
        score: how rare its changes are together; NaN where too few sweeps came before.
        sectors: (E, SECTORS) how rare the change of each kind of evidence is in each sector; NaN where it abstains.
        inconsistent: whether the score is above the limit.
        alarm: the same, latched until ``CALM_SWEEPS`` sweeps in a row are below it.
        suspect: (SECTORS,) bool, where, of all sweeps of the alarm.
        sweeps: of the alarm so far.
    """

    score: float
    sectors: F32
    inconsistent: bool = False
    alarm: bool = False
    suspect: Mask = field(default_factory=lambda: np.zeros(SECTORS, np.bool_))
    sweeps: int = 0


@dataclass(slots=True, eq=False)
class Watch:
    """Watches one stream by the evidence of its sweeps.

    Sweeps that score above the limit do not become part of the past, or an attack would soon be usual. After
    ``MOST_HELD_SWEEPS`` of an alarm its sweeps are the past: what lasts is usual then, and the alarm ends once.

    Attributes:
        calibration: says how rare a change is.
        limit: score above which a sweep is inconsistent.
        kinds: of the evidence.
    """

    calibration: Calibration
    limit: float
    kinds: Mapping[str, Evidence] = field(default_factory=lambda: EVIDENCE, repr=False)
    _past: Past = field(init=False, repr=False)
    _of_alarm: Past = field(init=False, repr=False)
    _suspect: Mask = field(default_factory=lambda: np.zeros(SECTORS, np.bool_), repr=False)
    _sweeps: int = 0
    _calm: int = 0

    def __post_init__(self) -> None:
        self._past, self._of_alarm = self._nothing(), self._nothing()

    def _nothing(self) -> Past:
        return Past(self.calibration.prior_scale, self.kinds)

    def check(self, evidence: F32, *, impossible: bool = False) -> Verdict:
        """Return what the evidence (E, SECTORS) of the next sweep says, and keep it.

        A sweep that is ``impossible`` is inconsistent in all sectors, whatever its score.
        """
        onset = self._past.onset(evidence)
        # 1. Changes against the past.
        score, sectors = np.nan, np.full_like(evidence, np.nan)
        if self._past.sweeps >= EARLIER_SWEEPS:
            score, sectors = self.calibration.score(self._past.reference().changes(numbers_of(onset, self.kinds)))
        # 2. The alarm begins, goes on, or ends after enough calm sweeps.
        inconsistent = impossible or score > self.limit
        self._calm = 0 if inconsistent else self._calm + 1
        if self._sweeps and self._calm >= CALM_SWEEPS:
            self._sweeps = 0
        if inconsistent or self._sweeps:
            if not self._sweeps:
                self._suspect, self._of_alarm = np.zeros(SECTORS, np.bool_), self._nothing()
            self._sweeps += 1
        if inconsistent:
            self._suspect = self._suspect | impossible | suspect_sectors(sectors)
        # 3. What is usual from now on.
        if not inconsistent:
            self._past.add(evidence)
        if self._sweeps and not impossible:
            self._of_alarm.add(evidence)
        if inconsistent and self._of_alarm.sweeps >= MOST_HELD_SWEEPS:
            self._past, self._of_alarm = self._of_alarm, self._nothing()
        alarm = self._sweeps > 0
        suspect = self._suspect if alarm else np.zeros(SECTORS, np.bool_)
        return Verdict(score, sectors, inconsistent, alarm, suspect, self._sweeps)


def suspect_sectors(sectors: F32) -> Mask:
    """Return the mask (SECTORS,) of sectors whose surprises (E, SECTORS) add up to nearly as much as the highest's."""
    beyond = np.maximum(np.nan_to_num(sectors) - RARE, 0.0).sum(axis=0)
    return np.asarray(beyond > max(float(beyond.max()) - 1.0, 0.0), np.bool_)
