"""What the scores say of drives that they were not trained on: limits, areas, detections, one family unseen each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64, Mask
from viewshed.monitor.calibration import (
    Calibration,
    Group,
    alarm_limit,
    p_values,
    tail_p_values,
    tail_p_values_among_others,
)
from viewshed.monitor.over_time import BenignRuns, EDetector
from viewshed.monitor.score import STATISTICS, EvidenceScore
from viewshed_lab.studies.cases import generator
from viewshed_lab.studies.monitor.archive import SweepTable
from viewshed_lab.studies.monitor.plan import FRAMES, ONSET
from viewshed_lab.studies.records import BENIGN

INCONSISTENT, DEGRADED = 0, 1
"""Columns of scores."""

RATE, LOW_RATE = 0.01, 0.001
"""False alarms that limits are set for."""

DRAWS = 1000

PER_HOUR = (1.0, 10.0, 100.0)
"""Numbers of false alarms an hour for which limits of runs are computed."""

NOTHING = (float("nan"), float("nan"))


@dataclass(frozen=True, slots=True, eq=False)
class Scored:
    """Sweeps of a table with the scores of one model."""

    table: SweepTable  # of the sweeps
    scores: NDArray[np.float32]  # (N, 2) what is inconsistent and what is degraded

    @classmethod
    def of(cls, score: EvidenceScore, table: SweepTable, silent: Mask | None = None) -> Scored:
        """Return the sweeps of a table scored.

        Args:
            score: the model.
            table: of the sweeps.
            silent: (E,) evidence that is made to abstain; none if not given.

        Raises:
            ValueError: the model does not judge whole sweeps.
        """
        numbers = (table if table.statistics is not None else table.with_statistics()).statistics
        if score.whole is None or numbers is None:
            raise ValueError("score must judge whole sweeps, got one of sectors alone; train it again")
        if silent is not None:
            numbers = np.where(np.tile(silent, STATISTICS), np.nan, numbers)
        return cls(table, score.whole.of_statistics(numbers))

    def rows(self, mask: Mask) -> Scored:
        """Return those of a mask (N,)."""
        return Scored(self.table.rows(mask), self.scores[mask])

    @property
    def sensors(self) -> NDArray[np.str_]:
        """Sensor (N,) of each sweep."""
        return np.array([drive.sensor for drive in self.table.drives])[self.table.drive]

    @property
    def is_clear(self) -> Mask:
        """Which sweeps (N,) are of drives in clear weather."""
        return np.array([drive.conditions == BENIGN for drive in self.table.drives])[self.table.drive]

    def of_drives(self) -> Scored:
        """Return one row for each drive and case: the largest scores of frames ``ONSET`` to the last."""
        late = self.rows(self.table.frame >= ONSET)
        key = late.table.drive.astype(np.int64) * len(self.table.cases) + late.table.case
        _, first, place = np.unique(key, return_index=True, return_inverse=True)
        largest = np.full((len(first), 2), -np.inf, np.float32)
        np.maximum.at(largest, place, late.scores)
        chosen = np.zeros(len(key), np.bool_)
        chosen[first] = True
        order = np.argsort(first)
        one = late.rows(chosen)
        return Scored(one.table, largest[order])


@dataclass(frozen=True, slots=True, eq=False)
class Limits:
    """Limits of alarms by sensor, from one benign sweep of each scene."""

    by_sensor: Mapping[str, float]  # limit of each sensor with enough scenes for the rate
    others: float  # limit of all others, from all scenes together; NaN where even these are too few
    scenes: Mapping[str, int]  # number of scenes of each sensor

    @classmethod
    def of(cls, benign: Scored, verdict: int, rate: float) -> Limits:
        """Return the limits of a verdict from scored benign sweeps, one of each scene."""
        values, sensors = benign.scores[:, verdict].astype(np.float64), benign.sensors
        names, counts = np.unique(sensors, return_counts=True)
        needed = int(np.ceil(1 / rate - 1e-9)) - 1
        by_sensor = {
            str(name): alarm_limit(values[sensors == name], rate)
            for name, count in zip(names, counts, strict=True)
            if count >= needed
        }
        others = alarm_limit(values, rate) if len(values) >= needed else float("nan")
        return cls(by_sensor, others, dict(zip(map(str, names), map(int, counts), strict=True)))

    def alarms(self, scored: Scored, verdict: int) -> F64:
        """Return 1 where a sweep (N,) alarms, 0 where not, NaN where there is no limit."""
        limit = np.array([self.by_sensor.get(str(sensor), self.others) for sensor in scored.sensors])
        return np.where(np.isnan(limit), np.nan, scored.scores[:, verdict] > limit)


@dataclass(frozen=True, slots=True)
class Rate:
    """A share of sweeps, and its 95 % interval over scenes."""

    value: float  # the share; NaN of none
    interval: tuple[float, float] = NOTHING  # its bounds
    scenes: int = 0  # number of scenes
    sweeps: int = 0  # number of sweeps

    @classmethod
    def of(cls, values: NDArray[np.floating[Any]], scenes: NDArray[np.integer[Any]]) -> Rate:
        """Return the mean of values (N,) of scenes (N,), by a bootstrap over scenes; NaN is left out."""
        known = np.isfinite(values)
        if not known.any():
            return cls(float("nan"))
        _, place = np.unique(scenes[known], return_inverse=True)
        total, count = np.bincount(place, values[known]), np.bincount(place)
        rng = np.random.Generator(np.random.PCG64(len(count)))
        weights = rng.multinomial(len(count), np.full(len(count), 1 / len(count)), DRAWS)
        low, high = np.quantile((weights @ total) / (weights @ count), (0.025, 0.975))
        return cls(float(total.sum() / count.sum()), (float(low), float(high)), len(count), int(known.sum()))


def placements(benign: Scored, attacked: Scored, verdict: int) -> F64:
    """Return the share of benign sweeps of the same sensor that score below each attacked one (N,), ties half.

    Their mean is the area under the ROC curve, each sensor by itself; NaN where a sensor has no benign sweep.
    """
    found = np.full(len(attacked.scores), np.nan)
    benign_sensors, sensors = benign.sensors, attacked.sensors
    for sensor in np.unique(sensors):
        known = np.sort(benign.scores[benign_sensors == sensor, verdict])
        mine = sensors == sensor
        if len(known):
            values = attacked.scores[mine, verdict]
            below = np.searchsorted(known, values, "left") + np.searchsorted(known, values, "right")
            found[mine] = below / (2.0 * len(known))
    return found


@dataclass(frozen=True, eq=False)
class Evaluation:
    """One model, calibrated and tried on the test drives."""

    model: EvidenceScore  # the score
    calibration: SweepTable  # benign sweeps that limits are from
    test: SweepTable  # sweeps that it is reported on
    silent: Mask | None = None  # (E,) evidence that is made to abstain, or None
    seed: int = 0  # draws one sweep of each calibration scene

    @cached_property
    def benign_calibration(self) -> Scored:
        """All benign sweeps of the calibration drives before which enough was measured."""
        table = self.calibration
        benign = table.rows((table.case == 0) & (table.frame >= ONSET))
        return Scored.of(self.model, benign, self.silent)

    @cached_property
    def one_of_each_scene(self) -> Scored:
        """A random one of them for each scene."""
        scored = self.benign_calibration
        rng = generator(self.seed, "one sweep a scene")
        order = rng.permutation(len(scored.table.drive))
        _, first = np.unique(scored.table.drive[order], return_index=True)
        chosen = np.zeros(len(order), np.bool_)
        chosen[order[first]] = True
        return scored.rows(chosen)

    @cached_property
    def tested(self) -> Scored:
        """All sweeps of the test drives."""
        return Scored.of(self.model, self.test, self.silent)

    @cached_property
    def benign(self) -> Scored:
        """Benign sweeps of the test drives before which enough was measured."""
        return self.tested.rows((self.test.case == 0) & (self.test.frame >= ONSET))

    def p_values(self, scored: Scored, verdict: int) -> F64:
        """Return the p-values (N,) of sweeps among one benign sweep of each calibration scene of the same sensor.

        Those of *degraded* are among clear drives alone.
        """
        benign = self.one_of_each_scene
        benign = benign.rows(benign.is_clear) if verdict == DEGRADED else benign
        sensors, benign_sensors, p = scored.sensors, benign.sensors, np.ones(len(scored.scores))
        for sensor in np.unique(sensors):
            known, mine = benign.scores[benign_sensors == sensor, verdict], sensors == sensor
            if len(known):
                p[mine] = p_values(known, scored.scores[mine, verdict])
        return p

    def tail_p_values(self, scored: Scored) -> F64:
        """Return the p-values (N,) of what is inconsistent that go on beyond the calibration scenes, by sensor."""
        benign, p = self.one_of_each_scene, np.ones(len(scored.scores))
        for sensor in np.unique(scored.sensors):
            known = np.sort(benign.scores[benign.sensors == sensor, INCONSISTENT].astype(np.float64))
            if len(known):
                mine = scored.sensors == sensor
                p[mine] = tail_p_values(known, scored.scores[mine, INCONSISTENT])
        return p

    @cached_property
    def runs(self) -> BenignRuns:
        """The calibration drives as runs, each judged by all other drives of its sensor."""
        scored, one = self.benign_calibration, self.one_of_each_scene
        streams = list[F64]()
        for sensor in np.unique(one.sensors):
            mine = one.sensors == sensor
            sweeps = [scored.scores[scored.table.drive == drive, INCONSISTENT] for drive in one.table.drive[mine]]
            streams += tail_p_values_among_others(one.scores[mine, INCONSISTENT].astype(np.float64), sweeps)
        return BenignRuns.of(streams)

    def detectors(self, hz: float) -> dict[float, EDetector | None]:
        """Return a detector for each number of false alarms an hour, ascending; None where there are too few runs.

        The numbers are ``PER_HOUR`` and the least that the runs support, if it is more than the first of these.
        """
        least = self.runs.least_per_hour(hz)
        return {
            per_hour: self.runs.detector(per_hour, hz) if per_hour >= least else None
            for per_hour in sorted({max(PER_HOUR[0], least), *PER_HOUR})
        }

    def limits(self, verdict: int, rate: float, *, five: bool = False) -> Limits:
        """Return the limits of a verdict; of *degraded* from clear drives alone, for rain is no false alarm there.

        Args:
            verdict: ``INCONSISTENT`` or ``DEGRADED``.
            rate: of false alarms.
            five: of the largest of the last five sweeps of a drive, not of single ones.
        """
        scored = self.benign_calibration.of_drives() if five else self.one_of_each_scene
        return Limits.of(scored.rows(scored.is_clear) if verdict == DEGRADED else scored, verdict, rate)


@dataclass(frozen=True, slots=True, eq=False)
class RecordedScores:
    """Measured sweeps by their p-values among simulated ones."""

    table: SweepTable  # of the sweeps
    scores: F64  # (N,) what is inconsistent
    groups: tuple[Group, ...]  # (N,) sensor and history of each sweep
    calibration: Calibration  # of simulated scenes
    p: F64  # (N,) p-values among these

    @classmethod
    def of(cls, table: SweepTable, alone: Evaluation) -> RecordedScores:
        """Return the sweeps of a table by the limits of simulated sweeps before which nothing was measured."""
        benign: dict[Group, F64] = {}
        scored = alone.one_of_each_scene
        for sensor in np.unique(scored.sensors):
            mine = scored.sensors == sensor
            if mine.sum() >= 1 / RATE - 1:
                benign[Group(str(sensor), "none")] = scored.scores[mine, INCONSISTENT].astype(np.float64)
        calibration = Calibration(benign, RATE)
        rows = Scored.of(alone.model, table)
        groups = tuple(Group(str(sensor), "none") for sensor in rows.sensors)
        scores = rows.scores[:, INCONSISTENT].astype(np.float64)
        p = np.array([calibration.p_value(*each) for each in zip(scores, groups, strict=True)])
        return cls(table, scores, groups, calibration, p)

    @property
    def sensors(self) -> NDArray[np.str_]:
        """Sensor (N,) of each sweep."""
        return np.array([group.sensor for group in self.groups])

    def corrected_p_values(self) -> F64:
        """Return p-values (N,) corrected by one sweep of each drive of the other half; NaN where too few."""
        corrected = np.full(len(self.p), np.nan)
        half = self.table.drive % 2
        for fold in (0, 1):
            others = (half != fold) & (self.table.case == 0)
            _, first = np.unique(self.table.drive[others], return_index=True)
            real = [(self.groups[k], self.scores[k]) for k in np.flatnonzero(others)[first]]
            try:
                calibration = self.calibration.corrected(real)
            except ValueError:
                continue
            for k in np.flatnonzero(half == fold):
                corrected[k] = calibration.p_value(self.scores[k], self.groups[k])
        return corrected


@dataclass(frozen=True, slots=True)
class Detection:
    """How well one attack is found."""

    area: Rate  # under the ROC curve of single sweeps
    area_alone: Rate  # the same of sweeps before which nothing was measured
    area_five: Rate  # of the mean over five sweeps
    caught: Rate  # share of the single sweeps above the limit for 1 %
    caught_five: Rate  # of five sweeps together
    caught_low: Rate  # as ``caught`` at .1 %
    caught_low_five: Rate  # as ``caught_five`` at .1 %
    degraded: Rate  # share of the sweeps that are called degraded
    delay: float  # median number of sweeps from the onset to the first alarm for .1 %, 6 for more than five
    idle: float  # share of the sweeps on which the attack touched nothing; not among the others


def detect(chosen: Evaluation, alone: Evaluation, mask: Mask) -> Detection:
    """Return how well the sweeps of a mask (N,) of the test table are found."""
    touched = chosen.test.touched.any(axis=1)
    attacked = chosen.tested.rows(mask & touched)
    drives, benign_drives = attacked.of_drives(), chosen.benign.of_drives()

    def caught(scored: Scored, rate: float, *, five: bool = False, verdict: int = INCONSISTENT) -> Rate:
        return Rate.of(chosen.limits(verdict, rate, five=five).alarms(scored, verdict), scored.table.drive)

    return Detection(
        area=Rate.of(placements(chosen.benign, attacked, INCONSISTENT), attacked.table.drive),
        area_alone=Rate.of(
            placements(alone.benign, alone.tested.rows(mask & touched), INCONSISTENT), attacked.table.drive
        ),
        area_five=Rate.of(placements(benign_drives, drives, INCONSISTENT), drives.table.drive),
        caught=caught(attacked, RATE),
        caught_five=caught(drives, RATE, five=True),
        caught_low=caught(attacked, LOW_RATE),
        caught_low_five=caught(drives, LOW_RATE, five=True),
        degraded=caught(attacked, RATE, verdict=DEGRADED),
        delay=_delay(attacked, chosen.limits(INCONSISTENT, LOW_RATE).alarms(attacked, INCONSISTENT)),
        idle=float((mask & ~touched).sum() / max(mask.sum(), 1)),
    )


def _delay(attacked: Scored, alarms: F64) -> float:
    """Return the median over drives of the number of sweeps until the first alarm, 1 at once."""
    if not len(alarms) or np.isnan(alarms).all():
        return float("nan")
    table = attacked.table
    late = FRAMES - ONSET + 1
    first = np.where(alarms == 1, table.frame - ONSET + 1, late)
    key, place = np.unique(
        table.drive.astype(np.int64) * len(table.cases) + table.case, return_inverse=True
    )  # fmt: skip
    soonest = np.full(len(key), late)
    np.minimum.at(soonest, place, first)
    return float(np.median(soonest))


@dataclass(frozen=True, slots=True, eq=False)
class AttackedSweeps:
    """Attacked sweeps, each by a score that was trained without its family."""

    attack: NDArray[np.str_]  # (N,) name of the attack
    domain: NDArray[np.str_]  # (N,) of the drive
    sensor: NDArray[np.str_]  # (N,) of the drive
    number: NDArray[np.int64]  # (N,) of the drive
    frame: NDArray[np.int64]  # (N,) in the drive
    area: F64  # (N,) share of the benign sweeps of the same sensor that score below
    caught: F64  # (N,) 1 above the limit for 1 %
    caught_low: F64  # (N,) 1 above that for .1 %
    p: F64  # (N,) p-value among the calibration scenes of the sensor
    tail_p: F64  # (N,) the same, going on beyond them
    run_limits: F64  # (N, K) of its score's detectors, see :meth:`Evaluation.detectors`; NaN for none

    @classmethod
    def of(cls, chosen: Evaluation, mask: Mask, hz: float) -> AttackedSweeps:
        """Return those of a mask (N,) of the test table that an attack touched, at ``hz`` sweeps a second."""
        scored = chosen.tested.rows(mask & chosen.test.touched.any(axis=1))
        table = scored.table
        drives = [table.drives[drive] for drive in table.drive]
        limits = [np.nan if one is None else one.limit for one in chosen.detectors(hz).values()]
        return cls(
            np.array([table.cases[case].name for case in table.case]), np.array([drive.domain for drive in drives]),
            scored.sensors, np.array([drive.number for drive in drives]), table.frame.astype(np.int64),
            placements(chosen.benign, scored, INCONSISTENT),
            chosen.limits(INCONSISTENT, RATE).alarms(scored, INCONSISTENT),
            chosen.limits(INCONSISTENT, LOW_RATE).alarms(scored, INCONSISTENT), chosen.p_values(scored, INCONSISTENT),
            chosen.tail_p_values(scored), np.tile(limits, (len(drives), 1)),
        )  # fmt: skip

    @classmethod
    def joined(cls, several: Sequence[AttackedSweeps]) -> AttackedSweeps:
        """Return those of several scores together."""
        return cls(*(np.concatenate([getattr(one, name) for one in several]) for name in cls.__slots__))

    def streams(self, mask: Mask) -> list[NDArray[np.intp]]:
        """Return the rows of a mask (N,) drive by drive, in the order of time."""
        rows = np.flatnonzero(mask)
        names = [(self.attack[row], self.domain[row], int(self.number[row])) for row in rows]
        found: dict[tuple[str, str, int], list[int]] = {}
        for name, row in zip(names, rows, strict=True):
            found.setdefault(name, []).append(int(row))
        return [np.array(sorted(own, key=lambda row: int(self.frame[row]))) for own in found.values()]

    def delays(self, mask: Mask, place: int) -> NDArray[np.int64]:
        """Return :func:`delays_of` the drives of a mask (N,) by the detectors at a place of ``run_limits``.

        Empty if one of them has none.
        """
        limits = [float(self.run_limits[rows[0], place]) for rows in self.streams(mask)]
        if np.isnan(limits).any():
            return np.zeros(0, np.int64)
        run = FRAMES - ONSET
        return delays_of([
            (EDetector(limit, run=run), self.tail_p[rows])
            for limit, rows in zip(limits, self.streams(mask), strict=True)
        ])  # fmt: skip


def delays_of(streams: Sequence[tuple[EDetector, F64]]) -> NDArray[np.int64]:
    """Return how many sweeps it takes until each detector alarms on its attacked sweeps, 0 for never.

    A detector that begins anew after runs may be anywhere in one at the onset: each place counts once, the sweeps
    before being as usual as can be.
    """
    found = []
    for detector, p in streams:
        for before in range(detector.run or 1):
            one = detector.fresh()
            for _ in range(before):
                one.add(1.0)
            found.append(next((number for number, each in enumerate(p.tolist(), 1) if one.add(each)), 0))
    return np.array(found)


def mean_rate(rates: Sequence[Rate]) -> float:
    """Return the mean of the values of those rates that are known."""
    known = [rate.value for rate in rates if not np.isnan(rate.value)]
    return float(np.mean(known)) if known else float("nan")
