"""The page of the study: tables of what is found, at which rates, where, and what is mistaken for an attack."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from viewshed.arrays import Mask
from viewshed.monitor.calibration import alarm_limit, p_values
from viewshed.monitor.over_time import EDetector, FalseAlarms, measure_false_alarms
from viewshed.monitor.score import EvidenceScore
from viewshed.monitor.sectors import discoveries
from viewshed_lab._page import facts
from viewshed_lab.studies.cases import DEFAULT, generator
from viewshed_lab.studies.formatting import commits, format_interval, format_rate
from viewshed_lab.studies.monitor.archive import FOLDER, RECORDED, SweepTable, over_time_of
from viewshed_lab.studies.monitor.examples import LOSSES
from viewshed_lab.studies.monitor.jobs import load_score, score_path
from viewshed_lab.studies.monitor.plan import (
    ALL_FAMILIES,
    BUDGETS,
    CLEAN,
    FRAMES,
    INTERVAL_S,
    ONSET,
    PUBLISHED,
    MonitorPlan,
    family_of,
)
from viewshed_lab.studies.monitor.published import LAST, UNATTACKED
from viewshed_lab.studies.monitor.results import (
    DEGRADED,
    INCONSISTENT,
    LOW_RATE,
    NOTHING,
    PER_HOUR,
    RATE,
    AttackedSweeps,
    Detection,
    Evaluation,
    Rate,
    RecordedScores,
    detect,
    mean_rate,
    placements,
)
from viewshed_lab.studies.pages import Table, fill_template
from viewshed_lab.studies.plan import JobKey
from viewshed_lab.studies.records import BENIGN, Case
from viewshed_lab.studies.store import ResultStore
from viewshed_lab.threats.attacks import INFORMED

FALSE_DISCOVERIES = 0.1

HZ = 1.0 / INTERVAL_S
"""Sweeps a second."""

APART = ("relay", "replay", "pose_spoof", *LOSSES, "jamming")
"""Attacks that are no part of the mean: they are seen over time, or are no more than a degraded view."""

_CHUNK = 512

NOMINAL = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
"""Rates at which p-values are compared with what they promise."""

MEASURED = "measured spoofer"


@dataclass(frozen=True, eq=False)
class MonitorResults:
    """Drives and scores of a study, and what follows from them."""

    plan: MonitorPlan  # of the study
    folder: Path  # of the study
    published: Mapping[JobKey, Mapping[str, float]]  # scores of the published detector by its jobs

    @cached_property
    def calibration(self) -> SweepTable:
        """Sweeps that limits are from."""
        return SweepTable.read(self.folder, "calibration").with_statistics()

    @cached_property
    def test(self) -> SweepTable:
        """Sweeps that are reported on."""
        table = self.every_test
        is_test = np.array([drive.split == "test" for drive in table.drives])
        return table.rows(is_test[table.drive])

    @cached_property
    def every_test(self) -> SweepTable:
        """Sweeps that are reported on, and those of the drives that nobody attacks."""
        return SweepTable.read(self.folder, "test", "benign").with_statistics()

    @cached_property
    def over_time(self) -> Mask:
        """Which evidence (E,) needs earlier sweeps."""
        return over_time_of(self.calibration.names)

    @cached_property
    def whole(self) -> Evaluation:
        """The score that was trained on all families."""
        return self._evaluation(ALL_FAMILIES, self.every_test)

    def _evaluation(self, left_out: str, test: SweepTable, silent: Mask | None = None) -> Evaluation:
        score = load_score(score_path(self.folder, left_out))
        return Evaluation(score, self.calibration, test, silent, self.plan.seed)

    @cached_property
    def detections(self) -> dict[Case, Detection]:
        """By case what is found of an attack by a score that was trained without its family."""
        return self._unseen[0]

    @cached_property
    def attacked(self) -> AttackedSweeps:
        """Sweeps of all attacks with their own budgets, each by a score that was trained without its family."""
        return self._unseen[1]

    @cached_property
    def _unseen(self) -> tuple[dict[Case, Detection], AttackedSweeps]:
        found, rows = dict[Case, Detection](), list[AttackedSweeps]()
        attacks = [case for case in self.test.cases if case.kind in ("attack", "strength")]
        for family in sorted({family_of(case.name) for case in attacks}):
            cases = [case for case in attacks if family_of(case.name) == family]
            test = self.test.rows(self.test.is_case([BENIGN, *cases]))
            chosen = self._evaluation(str(family), test)
            alone = self._evaluation(str(family), test, self.over_time)
            found |= {case: detect(chosen, alone, test.is_case([case])) for case in cases}
            own = [case for case in cases if case.kind == "attack" and case.level == DEFAULT]
            rows.append(AttackedSweeps.of(chosen, test.is_case(own), HZ))
        order = {case: place for place, case in enumerate(self.plan.all_cases())}
        return dict(sorted(found.items(), key=lambda item: order[item[0]])), AttackedSweeps.joined(rows)

    @cached_property
    def targets(self) -> list[tuple[str, str, float]]:
        """What was aimed at, the target, and what was reached."""
        own = {case: one for case, one in self.detections.items() if case.kind == "attack" and case.level == DEFAULT}

        def mean(kind: str, part: Callable[[Detection], Rate]) -> float:
            chosen = [one for case, one in own.items() if case.name not in APART and _kind_of(case.name) == kind]
            return mean_rate([part(one) for one in chosen])

        def of_attack(name: str, part: Callable[[Detection], Rate]) -> float:
            found = own.get(Case("attack", name, DEFAULT))
            return float("nan") if found is None else part(found).value

        tested, test = self.whole.tested, self.every_test
        inconsistent = self.whole.limits(INCONSISTENT, RATE).alarms(tested, INCONSISTENT)
        rarely = self.whole.limits(INCONSISTENT, LOW_RATE).alarms(tested, INCONSISTENT)
        degraded = self.whole.limits(DEGRADED, RATE).alarms(tested, DEGRADED)
        benign = (test.case == 0) & (test.frame >= ONSET)
        conditions = [drive.conditions for drive in test.drives]
        corrupted = benign & np.array([one.kind == "corruption" for one in conditions])[test.drive]
        worst = benign & np.array([one.kind == "corruption" and one.level == "5" for one in conditions])[test.drive]
        null = test.is_case([case for case in test.cases if case.kind == "null"])
        measured = MEASURED
        return [
            ("AUROC of a sweep, family unseen, mean", "≥ .98", mean(measured, lambda one: one.area)),
            ("the same of a spoofer without extra noise, mean", "≥ .93", mean("clean spoofer", lambda one: one.area)),
            ("the same of attackers who know the evidence, mean", "≥ .80", mean("informed", lambda one: one.area)),
            ("relay, AUROC of a sweep", "≥ .95", of_attack("relay", lambda one: one.area)),
            ("replay, AUROC of five sweeps", "≥ .95", of_attack("replay", lambda one: one.area_five)),
            ("false pose, AUROC of five sweeps", "≥ .95", of_attack("pose_spoof", lambda one: one.area_five)),
            ("caught at 1 %, mean", "≥ .80", mean(measured, lambda one: one.caught)),
            ("of five sweeps", "≥ .95", mean(measured, lambda one: one.caught_five)),
            ("caught at .1 %, mean", "≥ .65", mean(measured, lambda one: one.caught_low)),
            ("of five sweeps", "≥ .90", mean(measured, lambda one: one.caught_low_five)),
            ("benign sweeps called inconsistent at 1 %", ".005 to .015", _mean(inconsistent[benign])),
            ("at .1 %", "≤ .002", _mean(rarely[benign])),
            ("null attacks called inconsistent at 1 %", "≤ .015", _mean(inconsistent[null])),
            ("corrupted sweeps called inconsistent at 1 %", "≤ .03", _mean(inconsistent[corrupted])),
            ("the most at a single sensor", "≤ .02", self._most_at_a_sensor(inconsistent, benign)),
            ("sweeps corrupted at severity 5 called degraded", "≥ .90", _mean(degraded[worst])),
            self._false_alarms_target(),
            ("median delay over time, in sweeps (6: more than five)", "≤ 3", self._median_delay()),
            ("suspect sectors: overlap, mean of the attacks", "≥ .60", self._located_means()[0][0]),
            ("false discoveries, mean of their sweeps", "≤ .10", self._located_means()[1][1]),
            *self._recorded_targets(),
        ]  # fmt: skip

    def target_table(self) -> Table:
        """Return what was aimed at beside what was reached."""
        rows = [
            [what, target, f"{value:.3g}" if value >= 1 or value == 0 else format_rate(value), _is_met(target, value)]
            for what, target, value in self.targets
        ]
        return Table(["what", "target", "reached", ""], rows)

    def _most_at_a_sensor(self, alarms: NDArray[np.float64], benign: Mask) -> float:
        """Return the largest share of the benign sweeps of one sensor that alarm."""
        sensors = self.whole.tested.sensors
        return max(_mean(alarms[benign & (sensors == sensor)]) for sensor in np.unique(sensors))

    def _median_delay(self) -> float:
        """Return the median number of sweeps until a detector over time finds a measured spoofer's attacks."""
        attacked = self.attacked
        counted = np.array([name not in APART and _kind_of(name) == MEASURED for name in attacked.attack], np.bool_)
        delays = attacked.delays(counted, self._supported[0][0])
        return float(np.median(np.where(delays > 0, delays, FRAMES - ONSET + 1))) if len(delays) else float("nan")

    def _false_alarms_target(self) -> tuple[str, str, float]:
        _, asked_for, found, _ = next(row for row in self.false_alarms[2:] if row[2] is not None)
        assert found is not None
        return f"false alarms an hour, over time, {asked_for} asked for", "≤ 1", found.per_hour

    def _recorded_targets(self) -> list[tuple[str, str, float]]:
        found = self.recorded
        if found is None:
            return []
        benign, corrected = found.table.case == 0, found.corrected_p_values()
        what = f"of {benign.sum()} measured sweeps called inconsistent"
        return [
            (f"{what}, calibrated in simulation", "≤ 4", float((found.p[benign] <= RATE).sum())),
            (f"{what}, corrected", "≤ 2", float((corrected[benign] <= RATE).sum())),
        ]

    def found_table(self) -> Table:
        """Return what is found of each attack with its own budget, and the mean."""
        header = ["attack", "AUROC", "alone", "five", "caught at 1 %", "five", "at .1 %", "five", "degraded", "delay",
                  "idle", "scenes"]  # fmt: skip
        rows, inside = [], dict[str, list[Detection]]()
        for case, found in self.detections.items():
            if case.kind == "attack" and not case.level.isdecimal():
                level = "" if case.level == DEFAULT else f", {case.level}"
                rows.append([f"{case.name}{level} ({family_of(case.name)})", *_words(found)])
                if case.name not in APART:
                    inside.setdefault(_kind_of(case.name), []).append(found)
        for kind, several in inside.items():
            areas: list[Callable[[Detection], Rate]] = [
                lambda one: one.area, lambda one: one.area_alone, lambda one: one.area_five, lambda one: one.caught,
                lambda one: one.caught_five, lambda one: one.caught_low, lambda one: one.caught_low_five,
                lambda one: one.degraded,
            ]  # fmt: skip
            means = [format_rate(mean_rate([area(one) for one in several])) for area in areas]
            rows.append([f"**mean, {kind}**", *means, "", "", ""])
        return Table(header, rows)

    def severity_table(self) -> Table:
        """Return what is caught of attacks with other sectors, shares and offsets."""
        rows = [
            [case.name, case.level, format_rate(found.area.value), _pair(found), str(found.area.scenes)]
            for case, found in self.detections.items()
            if case.kind == "strength"
        ]
        return Table(["attack", "with", "AUROC", "caught at 1 %", "scenes"], rows)

    def budget_table(self) -> Table:
        """Return what is caught by the number of returns that an attacker touches, and the least that half need."""
        rows = []
        for name in self.plan.budgeted:
            found = {n: self.detections.get(Case("attack", name, str(n))) for n in BUDGETS}
            cells = ["–" if one is None else _pair(one) for one in found.values()]
            half = [str(n) for n, one in found.items() if one is not None and one.caught.value >= 0.5]
            rows.append([name, *cells, half[0] if half else f"> {BUDGETS[-1]}"])
        return Table(["attack", *map(str, BUDGETS), "half the sweeps alarm from"], rows)

    def rate_table(self) -> Table:
        """Return the achieved rates of false alarms by sensor, and of all."""
        benign, rows = self.whole.benign, []
        limits = {rate: self.whole.limits(INCONSISTENT, rate) for rate in (RATE, LOW_RATE)}
        degraded = self.whole.limits(DEGRADED, RATE).alarms(benign, DEGRADED)
        alarms = {rate: limit.alarms(benign, INCONSISTENT) for rate, limit in limits.items()}
        for sensor in (*sorted(set(benign.sensors)), ""):
            mine = (benign.sensors == sensor) | (sensor == "")
            drive = benign.table.drive
            rates = [Rate.of(alarms[rate][mine], drive[mine]) for rate in (RATE, LOW_RATE)]
            clear = mine & benign.is_clear
            known = limits[RATE].scenes
            scenes = sum(known.values()) if sensor == "" else known.get(sensor, 0)
            rows.append([
                sensor or "**all**", str(scenes), str(rates[0].scenes), str(rates[0].sweeps), *map(_interval, rates),
                _interval(Rate.of(degraded[clear], drive[clear])),
            ])  # fmt: skip
        header = ["sensor", "calibration scenes", "scenes", "sweeps", "inconsistent at 1 %", "at .1 %",
                  "degraded at 1 %, clear"]  # fmt: skip
        return Table(header, rows)

    def group_table(self) -> Table:
        """Return what is found of a measured spoofer's attacks by domain and by sensor: means over the attacks."""
        attacked = self.attacked
        counted = np.array([name not in APART and _kind_of(name) == MEASURED for name in attacked.attack], np.bool_)
        groups = [(f"*{name}*", attacked.domain == name) for name in self.plan.domains]
        groups += [(str(name), attacked.sensor == name) for name in sorted(set(attacked.sensor))]
        rows = []
        for name, mask in groups:
            mine = counted & mask
            each = [mine & (attacked.attack == attack) for attack in np.unique(attacked.attack[mine])]
            means = [
                format_rate(float(np.mean([_mean(values[of_one]) for of_one in each])) if each else float("nan"))
                for values in (attacked.area, attacked.caught, attacked.caught_low)
            ]
            rows.append([name, *means, str(int(mine.sum()))])
        return Table(["domain or sensor", "AUROC", "caught at 1 %", "at .1 %", "sweeps"], rows)

    def reliability_table(self) -> Table:
        """Return how often benign p-values are as small as they say, for both verdicts."""
        benign = self.whole.benign
        clear, drive = benign.is_clear, benign.table.drive
        p = [self.whole.p_values(benign, verdict) for verdict in (INCONSISTENT, DEGRADED)]
        rows = [
            [
                f"{format_rate(rate, 2)}", _interval(Rate.of((p[INCONSISTENT] <= rate) * 1.0, drive)),
                _interval(Rate.of((p[DEGRADED][clear] <= rate) * 1.0, drive[clear])),
            ]
            for rate in NOMINAL
        ]  # fmt: skip
        return Table(["p-value at most", "inconsistent, share of the sweeps", "degraded, of the clear ones"], rows)

    @cached_property
    def false_alarms(self) -> list[tuple[str, str, FalseAlarms | None, float]]:
        """Detectors over time on the benign test drives: name, what was asked for, false alarms, limit."""
        whole, benign, rng = self.whole, self.whole.benign, generator(self.plan.seed, "false alarms")
        p, tail_p = whole.p_values(benign, INCONSISTENT), whole.tail_p_values(benign)
        rows = [np.flatnonzero(benign.table.drive == drive) for drive in np.unique(benign.table.drive)]
        stated = EDetector.for_rate(PER_HOUR[0], HZ)
        shuffled = measure_false_alarms(stated, [rng.permutation(p)], HZ, rng)
        found: list[tuple[str, str, FalseAlarms | None, float]] = [
            ("bets as if sweeps were independent", f"{PER_HOUR[0]:g}",
             measure_false_alarms(stated, [p[each] for each in rows], HZ, rng), stated.limit),
            ("the same, of sweeps drawn one by one", f"{PER_HOUR[0]:g}", shuffled, stated.limit),
        ]  # fmt: skip
        for per_hour, detector in whole.detectors(HZ).items():
            drives, limit = [tail_p[each] for each in rows], float("nan") if detector is None else detector.limit
            alarms = None if detector is None else measure_false_alarms(detector, drives, HZ, rng)
            found.append(("limit of benign runs", f"{per_hour:.3g}", alarms, limit))
        return found

    @property
    def _supported(self) -> list[tuple[int, float]]:
        """Place and number of the false alarms an hour that there are runs enough for, ascending; one at least."""
        found = enumerate(self.whole.detectors(HZ).items())
        return [(place, per_hour) for place, (per_hour, detector) in found if detector is not None]

    def over_time_table(self) -> Table:
        """Return the false alarms of detectors over time on the benign test drives, beside what was asked for."""
        hours = self.whole.runs.hours(HZ)
        rows = []
        for name, per_hour, found, limit in self.false_alarms:
            if found is None:
                refused = f"refused: needs {1.0 / float(per_hour):.3g} h of benign runs, there are {hours:.2g}"
                rows.append([name, per_hour, refused, "", ""])
            else:
                low, high = found.interval_per_hour
                measured = f"{found.per_hour:.3g} [{low:.3g}, {high:.3g}]"
                rows.append([name, per_hour, measured, str(found.alarms), f"{limit:.3g}"])
        return Table(["detector", "asked for, an hour", "false alarms an hour", "alarms", "limit"], rows)

    def delay_table(self) -> Table:
        """Return how many sweeps it takes until an attack is found, by single sweeps and by detectors over time."""
        attacked = self.attacked
        kinds = np.array([name if name in APART else _kind_of(name) for name in attacked.attack])
        rows = []
        for kind in sorted(set(kinds), key=lambda name: (name not in APART, name)):
            streams = [attacked.p[each] for each in attacked.streams(kinds == kind)]
            single = np.array([np.argmax(p <= RATE) + 1 if (p <= RATE).any() else 0 for p in streams])
            over_time = [attacked.delays(kinds == kind, place) for place, _ in self._supported]
            cells = [cell for delays in (single, *over_time) for cell in _delay_cells(delays)]
            rows.append([kind, *cells, str(len(streams))])
        rates = [f"{per_hour:.3g} an hour" for _, per_hour in self._supported]
        header = [cell for rate in ("1 % of sweeps", *rates) for cell in (f"{rate}: found in five", "median")]
        return Table(["attack", *header, "drives"], rows)

    def published_table(self) -> Table | None:
        """Return the published detector beside this monitor on the same sweeps; None where it was not tried."""
        facts_of = {key[1:]: found for key, found in self.published.items() if key[1:] != ("fit",)}
        calibration = np.array([found[UNATTACKED] for key, found in facts_of.items() if key[0] == "calibration"])
        tested = {int(key[1]): found for key, found in facts_of.items() if key[0] == "test"}
        if not tested or len(calibration) < 1.0 / RATE - 1.0:
            return None
        limit = alarm_limit(calibration, RATE)
        benign = np.concatenate([calibration, [found[UNATTACKED] for found in tested.values()]])
        attacked = self.attacked
        same = (attacked.domain == self.plan.domains[0]) & (attacked.frame == LAST)
        theirs = np.array([
            tested.get(int(number), {}).get(str(name), np.nan)
            for number, name in zip(attacked.number, attacked.attack, strict=True)
        ])  # fmt: skip
        same &= np.isfinite(theirs)
        area = ((benign < theirs[:, None]).mean(axis=1) + (benign <= theirs[:, None]).mean(axis=1)) / 2
        kinds = np.array([name if name in APART else _kind_of(name) for name in attacked.attack])
        rows = []
        for kind in (*sorted(set(kinds[same]), key=lambda name: (name not in APART, name)), ""):
            mine = same & ((kinds == kind) | (kind == ""))
            rates = [
                Rate.of(values[mine], attacked.number[mine])
                for values in (area, (theirs > limit) * 1.0, attacked.area, attacked.caught)
            ]
            rows.append([kind or "**all**", *map(_interval, rates), str(int(mine.sum()))])
        header = ["attack", "published, AUROC", "caught at 1 %", "this monitor, AUROC", "caught at 1 %", "sweeps"]
        return Table(header, rows)

    def corruption_table(self) -> Table:
        """Return how often corrupted sweeps are called inconsistent and degraded, by severity."""
        tested, table = self.whole.tested, self.every_test
        alarms = [
            self.whole.limits(verdict, RATE).alarms(tested, verdict) for verdict in (INCONSISTENT, DEGRADED)
        ]  # fmt: skip
        conditions = [drive.conditions for drive in table.drives]

        def words(mask: Mask) -> str:
            if not mask.any():
                return "–"
            return " / ".join(format_rate(float(found[mask].mean())) for found in alarms)

        severities = sorted({*self.plan.severities, 1, 2, 3, 4, 5})
        rows, every = [], [np.zeros(len(table.drive), np.bool_) for _ in range(2 * len(severities))]
        for name in self.plan.corruptions:
            from_start, half_way = [], []
            for severity in severities:
                case = Case("corruption", name, str(severity))
                of_drive = np.array([one == case for one in conditions])[table.drive]
                from_start.append((table.case == 0) & (table.frame >= ONSET) & of_drive)
                half_way.append(table.is_case([case]))
            rows.append([name, *(words(mask) for mask in (*from_start, *half_way))])
            every = [total | mask for total, mask in zip(every, (*from_start, *half_way), strict=True)]
        rows.append(["**all**", *map(words, every)])
        header = [f"{word} {n}" for word in ("from the start", "attacked drives") for n in severities]
        return Table(["corruption", *header], rows)

    def null_table(self) -> Table:
        """Return how often attacks at zero strength are called inconsistent, and their area under the curve."""
        cases = [case for case in self.every_test.cases if case.kind == "null"]
        order = {case: place for place, case in enumerate(self.plan.all_cases())}
        limits, rows = self.whole.limits(INCONSISTENT, RATE), []
        clear = self.whole.benign.rows(self.whole.benign.is_clear)
        for case in (*sorted(cases, key=order.__getitem__), None):
            scored = self.whole.tested.rows(self.every_test.is_case(cases if case is None else [case]))
            if not len(scored.scores):
                continue
            alarms = Rate.of(limits.alarms(scored, INCONSISTENT), scored.table.drive)
            area = Rate.of(placements(clear, scored, INCONSISTENT), scored.table.drive)
            name = "**all**" if case is None else case.name
            rows.append([name, _interval(alarms), _interval(area), str(area.scenes)])
        return Table(["null attack", "inconsistent at 1 %", "AUROC against clear drives", "scenes"], rows)

    @cached_property
    def located(self) -> dict[str, tuple[float, float, int]]:
        """By attack mean overlap and share of false discoveries of suspect sectors, and the sweeps that alarm."""
        tested, table, found = self.whole.tested, self.every_test, dict[str, tuple[float, float, int]]()
        alarms = self.whole.limits(INCONSISTENT, RATE).alarms(tested, INCONSISTENT) == 1
        model, benign = self.whole.model, _sectors(self.whole.model, self.whole.one_of_each_scene.table).ravel()
        for name in self.plan.attacks:
            mask = table.is_case([Case("attack", name, DEFAULT)]) & alarms & table.touched.any(axis=1)
            if mask.any():
                rows = table.rows(mask)
                found[name] = (*_located(_sectors(model, rows), rows.touched, benign), int(mask.sum()))
        return found

    def _located_means(self) -> tuple[tuple[float, float], tuple[float, float], int]:
        """Return overlap and false discoveries, mean over attacks and over their sweeps, and how many these are."""
        counted = np.array([one for name, one in self.located.items() if name not in APART]).reshape(-1, 3)
        if not len(counted):
            return NOTHING, NOTHING, 0
        overlap, wrong, sweeps = counted.T
        means = [np.average([overlap, wrong], axis=1, weights=weights) for weights in (None, sweeps)]
        return (means[0][0], means[0][1]), (means[1][0], means[1][1]), int(sweeps.sum())

    def where_table(self) -> Table:
        """Return how well suspect sectors fit those that were touched, by attack."""
        rows = [
            [name, format_rate(overlap), format_rate(wrong), str(sweeps)]
            for name, (overlap, wrong, sweeps) in self.located.items()
        ]
        of_attacks, of_sweeps, sweeps = self._located_means()
        rows += [["**mean of the attacks**", *map(format_rate, of_attacks), ""],
                 ["**mean of their sweeps**", *map(format_rate, of_sweeps), str(sweeps)]]  # fmt: skip
        return Table(["attack", "overlap", "false discoveries", "sweeps that alarm"], rows)

    def recorded_table(self) -> Table | None:
        """Return how many measured sweeps are called inconsistent by sensor; None without any."""
        found = self.recorded
        if found is None:
            return None
        benign = found.table.case == 0
        corrected = found.corrected_p_values()
        rows = []
        for sensor in (*sorted(set(found.sensors[benign])), ""):
            mine = benign & ((found.sensors == sensor) | (sensor == ""))
            drives = np.unique(found.table.drive[mine])
            alarms = [int((p[mine] <= RATE).sum()) for p in (found.p, corrected)]
            low, high = binomtest(alarms[0], int(mine.sum())).proportion_ci(0.95)
            rows.append([
                sensor or "**all**", str(len(drives)), str(int(mine.sum())), str(alarms[0]),
                f"[{format_rate(low, 2)}, {format_rate(high, 2)}]", str(alarms[1]),
                format_rate(float(np.median(found.p[mine])), 2),
            ])  # fmt: skip
        header = ["sensor", "drives", "sweeps", "inconsistent", "rate, 95 %", "corrected", "median p"]
        return Table(header, rows)

    def recorded_attacks_table(self) -> Table | None:
        """Return what is found of attacks on measured sweeps; None without any."""
        found = self.recorded
        if found is None:
            return None
        benign, rows = -np.log(found.p[found.table.case == 0]), []
        for name in self.plan.attacks:
            mask = found.table.is_case([Case("attack", name, DEFAULT)]) & found.table.touched.any(axis=1)
            if mask.any():
                drive = found.table.drive[mask]
                below = [((benign < one).mean() + (benign <= one).mean()) / 2 for one in -np.log(found.p[mask])]
                area, caught = Rate.of(np.array(below), drive), Rate.of((found.p[mask] <= RATE) * 1.0, drive)
                rows.append([f"{name} ({family_of(name)})", _interval(area), _interval(caught), str(int(mask.sum()))])
        return Table(["attack", "AUROC", "caught at 1 %", "sweeps"], rows)

    @cached_property
    def recorded(self) -> RecordedScores | None:
        """Measured sweeps; None where the study has none."""
        if not any((self.folder / FOLDER).glob(f"{RECORDED}-*.npz")):
            return None
        table = SweepTable.read(self.folder, RECORDED)
        return RecordedScores.of(table, self._evaluation(ALL_FAMILIES, self.test, self.over_time))

    def evidence_table(self) -> Table:
        """Return how much of the area under the curve is lost without each kind of evidence."""
        cases = [
            case for case in self.test.cases
            if case.kind == "attack" and not case.level.isdecimal() and case.name not in LOSSES
        ]  # fmt: skip
        test = self.test.rows(self.test.is_case([BENIGN, *cases]))

        def areas(silent: Mask | None) -> dict[Case, float]:
            one = self._evaluation(ALL_FAMILIES, test, silent)
            touched = test.touched.any(axis=1)
            return {
                case: Rate.of(placements(one.benign, rows, INCONSISTENT), rows.table.drive).value
                for case in cases
                if len((rows := one.tested.rows(test.is_case([case]) & touched)).scores)
            }

        whole = areas(None)
        rows = [["all", format_rate(float(np.mean(list(whole.values())))), "", ""]]
        for number, name in enumerate(test.names):
            without = areas(np.arange(len(test.names)) == number)
            worst = max(whole, key=lambda case: whole[case] - without[case])
            rows.append([
                f"without {name}", format_rate(float(np.mean(list(without.values())))), f"{worst.name} {worst.level}",
                f"{format_rate(whole[worst])} → {format_rate(without[worst])}",
            ])  # fmt: skip
        return Table(["evidence", "AUROC", "most is lost for", "its AUROC"], rows)


def _mean(values: NDArray[np.floating[Any]]) -> float:
    """Return the mean of the values that are known; NaN of none."""
    return float(np.nanmean(values)) if np.isfinite(values).any() else float("nan")


def _hours(table: SweepTable) -> str:
    """Return how long the sweeps of a table are together before which enough was measured."""
    return f"{len(table.drives) * (FRAMES - ONSET) * INTERVAL_S / 3600.0:.2g}"


def _is_met(target: str, value: float) -> str:
    """Return whether a value meets a target, in a word.

    >>> _is_met("≥ .95", 0.96), _is_met("≤ .03", 0.05), _is_met(".005 to .015", 0.01)
    ('met', 'missed', 'met')
    """
    if np.isnan(value):
        return "not measured"
    low, _, high = target.partition(" to ")
    if high:
        return "met" if float(low) <= value <= float(high) else "missed"
    sign, limit = target.split()
    return "met" if (value >= float(limit) if sign == "≥" else value <= float(limit)) else "missed"


def _kind_of(name: str) -> str:
    """Return whose attacks a mean is over."""
    return "informed" if name in INFORMED else "clean spoofer" if name.endswith(CLEAN) else MEASURED


def _delay_cells(delays: NDArray[np.int64]) -> list[str]:
    """Return the share of the drives that are found, and the median of the sweeps that it takes, of all drives.

    >>> _delay_cells(np.array([1, 2, 2, 0]))
    ['.750', '2']
    """
    if not len(delays):
        return ["–"] * 2
    late = np.where(delays > 0, delays, FRAMES - ONSET + 1)
    median = float(np.quantile(late, 0.5, method="higher"))
    word = f"> {FRAMES - ONSET}" if median > FRAMES - ONSET else f"{median:g}"
    return [format_rate(float((delays > 0).mean())), word]


def _sectors(model: EvidenceScore, table: SweepTable) -> NDArray[np.float32]:
    """Return what each sector (N, SECTORS) of the sweeps of a table says for what is inconsistent."""
    starts = range(0, len(table.evidence), _CHUNK)
    chunks = (table.evidence[start : start + _CHUNK].astype(np.float32) for start in starts)
    return np.concatenate([model.logits(chunk)[..., INCONSISTENT] for chunk in chunks])


def _located(sectors: NDArray[np.float32], touched: Mask, benign: NDArray[np.float32]) -> tuple[float, float]:
    """Return mean overlap and mean share of false discoveries of the suspect sectors of sweeps.

    Args:
        sectors: (N, SECTORS) what each says.
        touched: (N, SECTORS) by the attacker.
        benign: scores of sectors of benign sweeps.
    """
    overlaps, false = [], []
    p = p_values(benign, sectors.ravel()).reshape(sectors.shape)
    for suspect, mine in zip((discoveries(each, FALSE_DISCOVERIES) for each in p), touched, strict=True):
        overlaps.append((suspect & mine).sum() / (suspect | mine).sum())
        false.append((suspect & ~mine).sum() / max(suspect.sum(), 1))
    return float(np.mean(overlaps)), float(np.mean(false))


def _words(found: Detection) -> list[str]:
    rates: Sequence[Rate] = (
        found.area_alone, found.area_five, found.caught, found.caught_five, found.caught_low, found.caught_low_five,
        found.degraded,
    )  # fmt: skip
    delay = "–" if np.isnan(found.delay) else f"{found.delay:g}"
    words = [format_rate(rate.value) for rate in rates]
    return [_interval(found.area), *words, delay, format_rate(found.idle, 2), str(found.area.scenes)]


def _pair(found: Detection) -> str:
    return f"{format_rate(found.caught.value)} / {format_rate(found.caught_five.value)}"


def _interval(rate: Rate) -> str:
    return format_interval(rate.value, rate.interval)


def files_of(store: ResultStore[MonitorPlan]) -> dict[str, bytes]:
    """Return the page as a file by its name.

    Raises:
        ValueError: there are no drives or scores.
    """
    plan, results = store.plan, MonitorResults(store.plan, store.folder, store.results(PUBLISHED).facts)
    names = results.test.names
    over_time = [name for name, needs in zip(names, results.over_time, strict=True) if needs]
    values = {
        "corruptions": len(plan.corruptions), "evidence": len(names), "names": ", ".join(names),
        "over_time": ", ".join(over_time) or "none", "apart": ", ".join(APART), "rate": f"{RATE:g}",
        "low_rate": f"{LOW_RATE:g}", "published": plan.published[0],
        "run": f"{(FRAMES - ONSET) * INTERVAL_S:g}",
        "hours": _hours(results.every_test), "calibration_hours": _hours(results.calibration),
    }  # fmt: skip
    page = fill_template("monitor/page.md", results=results, **values)
    tables = {"calibration": results.calibration, "test": results.test, "test and benign": results.every_test}
    drives = [f"{len(np.unique(table.drive))} {word}" for word, table in tables.items()]
    about = facts(
        plan=f"{plan.name}: {plan.about}", seed=str(plan.seed), domains=", ".join(plan.domains),
        drives=f"{sum(plan.train)} + {sum(plan.unattacked)} train, {', '.join(drives)}",
        commits=commits(store.results("score")),
    )  # fmt: skip
    return page.files("monitor.md", about)
