"""The detector tried: fitted and calibrated on benign sweeps, reported on others, attacked and corrupted.

What a study of a monitor found, from lines by sweep to one row of plain numbers for each case.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from viewshed.datasets.sample import Sample
from viewshed.fov.estimate import FovEstimate, FovEstimator
from viewshed.grid import BevGrid, polar_of_cells
from viewshed.integrity.monitor import RULE, DeviationMonitor, Rule
from viewshed.integrity.roc import auroc, auroc_interval, tpr_at_fpr
from viewshed.preprocess.leveling import level
from viewshed.sweep import Sweep
from viewshed.threats.attacks import ATTACKS, Knowledge, Tampered
from viewshed.threats.corruptions import CORRUPTIONS

REGIONS = ("touched", "wedge", "changed")
"""Where suspect cells should lie: cells with a return that was added or removed; cells whose azimuth the attacker
reaches; cells that the estimate calls visible on only one of the clean and the spoilt sweep."""

FALSE_ALARM_RATE = 0.01

_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class Located:
    """How well suspect cells fit a region, counted over all sweeps that have one.

    Attributes:
        cells: watched cells of the region.
        suspects: suspect cells.
        both: suspect cells of the region.
        watched: watched cells.
    """

    cells: int
    suspects: int
    both: int
    watched: int

    @property
    def precision(self) -> float:
        """Share of the suspect cells that lie in the region; NaN without suspects."""
        return self.both / self.suspects if self.suspects else float("nan")

    @property
    def recall(self) -> float:
        """Share of the region that is suspect; NaN without a region."""
        return self.both / self.cells if self.cells else float("nan")

    @property
    def chance(self) -> float:
        """Share of the watched cells that lie in the region: the precision of guessing; NaN without cells."""
        return self.cells / self.watched if self.watched else float("nan")


@dataclass(frozen=True, slots=True)
class Row:
    """One case over all sweeps; ``dataclasses.asdict`` makes it plain.

    Attributes:
        kind: benign, attack or corruption.
        name: of the attack or corruption.
        frames: sweeps that it was done to.
        refused: sweeps that it could not be done to.
        idle: frames on which the attack added and removed no return: nothing to see, yet counted as missed.
        alarms: share of the frames that alarm at the calibrated limit.
        auroc: P(score > that of a benign sweep), ties half; NaN for benign sweeps themselves.
        auroc_low: lower end of its 95 % interval over samples.
        auroc_high: upper end.
        caught: share of the frames above a limit that at most 1 % of these benign frames pass (with fewer than 100
            frames: that none of them passes); NaN for benign sweeps themselves.
        auroc_mean: AUROC of the plain mean deviation over the watched cells, for comparison; NaN likewise.
        located: by region of ``REGIONS``, where the case has one.
    """

    kind: str
    name: str
    frames: int
    refused: int
    idle: int
    alarms: float
    auroc: float
    auroc_low: float
    auroc_high: float
    caught: float
    auroc_mean: float
    located: dict[str, Located]


def rows_of(lines: Iterable[dict[str, Any]], seed: int = 0) -> list[Row]:
    """Return one row for each case of the lines, in their order; the order of the lines changes nothing.

    Args:
        lines: what ``watched`` returned of each sweep.
        seed: of the intervals.

    Raises:
        ValueError: there are no lines, or two are of one sweep.
    """
    ordered = sorted(lines, key=lambda line: int(line["number"]))
    if not ordered or len({line["number"] for line in ordered}) < len(ordered):
        raise ValueError(f"lines must be one for each sweep, got {[line['number'] for line in ordered]}")
    return [_row(ordered, place, seed) for place in range(len(ordered[0]["cases"]))]


def _row(lines: Sequence[dict[str, Any]], place: int, seed: int) -> Row:
    kind, name = (lines[0]["cases"][place][key] for key in ("kind", "name"))
    done = [(line["cases"][0], line["cases"][place], line["watched"]) for line in lines]
    done = [each for each in done if "refused" not in each[1]]
    alarms = float(np.mean([case["alarm"] for _, case, _ in done])) if done else _NAN
    told = _told([benign for benign, _, _ in done], [case for _, case, _ in done], seed, name)
    located = {region: found for region in REGIONS if (found := _located(done, region)) is not None}
    idle = sum(case.get("returns") == 0 for _, case, _ in done)
    return Row(kind, name, len(done), len(lines) - len(done), idle, alarms, *told, located)


def _told(benign: list[Any], spoilt: list[Any], seed: int, name: str) -> tuple[float, float, float, float, float]:
    """Return AUROC, its interval, the share caught, and the AUROC of the mean deviation; NaN for benign."""
    if not name or not spoilt:
        return (_NAN, _NAN, _NAN, _NAN, _NAN)
    rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, zlib.crc32(name.encode())])))
    calm, doubtful = ([case["score"] for case in cases] for cases in (benign, spoilt))
    low, high = auroc_interval(calm, doubtful, rng, paired=True)
    mean = auroc([case["mean_std"] for case in benign], [case["mean_std"] for case in spoilt])
    return auroc(calm, doubtful), low, high, tpr_at_fpr(calm, doubtful, FALSE_ALARM_RATE), mean


def _located(done: Sequence[tuple[Any, Any, int]], region: str) -> Located | None:
    having = [(case, watched) for _, case, watched in done if region in case["regions"]]
    if not having:
        return None
    cells, both = (sum(case["regions"][region][k] for case, _ in having) for k in (0, 1))
    return Located(cells, sum(case["suspects"] for case, _ in having), both, sum(watched for _, watched in having))


Line = dict[str, Any]
"""What was found on one sweep, as plain values."""

Mask = NDArray[np.bool_]


class Subject(Protocol):
    """A sweep, and what the same sensor measured before."""

    @property
    def sample(self) -> Sample:
        """The sweep; its truth is not used."""
        ...

    @property
    def earlier(self) -> tuple[Sweep, ...]:
        """Earlier sweeps, the oldest first; an attacker replays the oldest."""
        ...


@dataclass(frozen=True, slots=True)
class MonitorPlan:
    """What a monitor is tried on.

    Attributes:
        attacks: names of ``ATTACKS``, each with its own budget.
        corruptions: names of ``CORRUPTIONS``.
        severity: of the corruptions, 1 to 5.
        false_alarm_rate: that it is calibrated for.
        rule: how it is fitted.
        seed: of all that is random.

    Raises:
        ValueError: there is no such attack, corruption or severity.
    """

    attacks: tuple[str, ...] = tuple(ATTACKS)
    corruptions: tuple[str, ...] = tuple(CORRUPTIONS)
    severity: int = 3
    false_alarm_rate: float = 0.05
    rule: Rule = RULE
    seed: int = 0

    def __post_init__(self) -> None:
        for what, names, table in (("attacks", self.attacks, ATTACKS), ("corruptions", self.corruptions, CORRUPTIONS)):
            if wrong := [name for name in names if name not in table]:
                raise ValueError(f"{what} must be among {', '.join(table)}, got {', '.join(wrong)}")
        CORRUPTIONS["fog"](self.severity)

    def cases(self) -> list[tuple[str, str]]:
        """Return kind and name of all that is done to a sweep, nothing first."""
        attacks = [("attack", name) for name in self.attacks]
        return [("benign", ""), *attacks, *(("corruption", name) for name in self.corruptions)]


@dataclass(frozen=True, slots=True, eq=False)
class Sets:
    """Benign sweeps for each step, no sweep in two of them, best no scene either.

    Attributes:
        fit: thresholds of the cells come from these.
        calibrate: the limit of the alarm comes from these.
        report: these are attacked, corrupted and counted.
    """

    fit: Iterable[Subject]
    calibrate: Iterable[Subject]
    report: Iterable[Subject]


def monitor_study(estimator: FovEstimator, sets: Sets, plan: MonitorPlan) -> list[Row]:
    """Return one row for benign sweeps, each attack and each corruption.

    To go on where a study was stopped, save what :func:`fitted` returns and each line of :func:`watched`, and hand the
    lines to ``rows_of``.

    Raises:
        ValueError: the estimator has no standard deviation, or there are too few sweeps for the false-alarm rate.
    """
    monitor = fitted(estimator, sets.fit, sets.calibrate, plan)
    lines = [watched(monitor, estimator, subject, number, plan) for number, subject in enumerate(sets.report)]
    return rows_of(lines, plan.seed)


def fitted(
    estimator: FovEstimator, fit: Iterable[Subject], calibrate: Iterable[Subject], plan: MonitorPlan
) -> DeviationMonitor:
    """Return a monitor fitted on one set of benign sweeps and calibrated on another. Raises as the study does."""
    monitor = DeviationMonitor.fit((estimator.estimate(each.sample.sweep) for each in fit), plan.rule)
    scored = (estimator.estimate(each.sample.sweep) for each in calibrate)
    return monitor.calibrated(scored, plan.false_alarm_rate)


def watched(
    monitor: DeviationMonitor, estimator: FovEstimator, subject: Subject, number: int, plan: MonitorPlan
) -> Line:
    """Return what the monitor says of one sweep, clean, attacked and corrupted, as plain values.

    Args:
        monitor: calibrated, for this estimator.
        estimator: with standard deviations.
        subject: a benign sweep that the monitor was neither fitted nor calibrated on.
        number: of the sweep in the study, for seeds.
        plan: what is done.
    """
    bench = _Bench.of(monitor, estimator, subject)
    found = [{"kind": kind, "name": name, **bench.case(kind, name, number, plan)} for kind, name in plan.cases()]
    return {"number": number, "scene": subject.sample.scene, "watched": int(monitor.watched.sum()), "cases": found}


@dataclass(frozen=True, slots=True, eq=False)
class _Bench:
    """One sweep, with what is known of it before anything is done to it."""

    monitor: DeviationMonitor
    estimator: FovEstimator
    sweep: Sweep
    knowledge: Knowledge
    clean: FovEstimate

    @classmethod
    def of(cls, monitor: DeviationMonitor, estimator: FovEstimator, subject: Subject) -> _Bench:
        sweep = subject.sample.sweep
        knowledge = Knowledge(subject.earlier[:1], half_extent_m=monitor.grid.half_extent_m)
        return cls(monitor, estimator, sweep, knowledge, estimator.estimate(sweep))

    def case(self, kind: str, name: str, number: int, plan: MonitorPlan) -> Line:
        """Return score, alarm and suspect cells of a case, or why it was refused."""
        words = [zlib.crc32(word.encode()) for word in (kind, name)]
        rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence([plan.seed, number, *words])))
        try:
            if kind == "attack":
                return self._attacked(ATTACKS[name](None, self.knowledge).apply(self.sweep, rng))
            if kind == "corruption":
                return self._told(CORRUPTIONS[name](plan.severity).apply(self.sweep, rng), {})
        except ValueError as error:
            return {"refused": " ".join(str(error).split())}
        return self._told(self.sweep, {})

    def _attacked(self, tampered: Tampered) -> Line:
        returns = int(tampered.added.sum()) + int(tampered.removed.sum())
        regions = dict(_regions(tampered, self.sweep, self.monitor.grid))
        return {"returns": returns, **self._told(tampered.sweep, regions)}

    def _told(self, sweep: Sweep, regions: dict[str, Mask]) -> Line:
        estimate = self.clean if sweep is self.sweep else self.estimator.estimate(sweep)
        report, seen = self.monitor.check(estimate), self.monitor.watched
        if sweep is not self.sweep:
            regions["changed"] = estimate.visible() != self.clean.visible()
        areas = {name: mask & seen for name, mask in regions.items()}
        counted = {
            name: [int(area.sum()), int((area & report.suspect).sum())] for name, area in areas.items() if area.any()
        }
        told = {"score": report.score, "mean_std": float(np.nanmean(np.asarray(estimate.std)[seen]))}
        return {**told, "alarm": report.alarm, "suspects": int(report.suspect.sum()), "regions": counted}


def _regions(tampered: Tampered, clean: Sweep, grid: BevGrid) -> Iterator[tuple[str, Mask]]:
    """Yield the cells with a return that was added or removed, and those whose azimuth the attacker's wedge holds."""
    level_from_sensor = level(clean, grid).level_from_sensor
    rows = np.concatenate([tampered.sweep.points[tampered.added], clean.points[tampered.removed]])
    cells, inside = grid.index((level_from_sensor @ rows)[:, :2])
    touched = np.zeros(grid.shape, np.bool_)
    touched[tuple(cells[inside].T)] = True
    yield "touched", touched
    if tampered.wedge is not None:
        yield "wedge", tampered.wedge.holds(polar_of_cells(grid)[1])
