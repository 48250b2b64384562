"""The monitor of a sweep: all evidence, one score, two verdicts whose false alarms keep a chosen rate; as a file."""

from __future__ import annotations

import hashlib
import io
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, Self, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from viewshed._files import DAMAGED, read_arrays, write_atomic
from viewshed.arrays import F32, F64, Mask
from viewshed.grid import BevGrid
from viewshed.monitor.calibration import (
    Calibration,
    Earlier,
    Group,
    HighestScores,
    Per,
    Promise,
    RealScores,
    drift_warning,
    one_per_scene,
    tail_p_values_among_others,
)
from viewshed.monitor.evidence import EVIDENCE, SECTORS, Evidence, MonitoredSweep
from viewshed.monitor.over_time import BenignRuns, EDetector
from viewshed.monitor.report import IntegrityReport, cells_of_sectors
from viewshed.monitor.score import HELD_SWEEPS, EvidenceScore, held, measure_all
from viewshed.monitor.sectors import discoveries

NAME = "sweep"

EARLIER_SWEEPS = 5
"""Earlier sweeps that evidence over time is given; a sweep with fewer is judged by itself."""

UNUSUAL = 0.01
"""A reason is given if at most this share of benign scenes of the group shows its evidence as strongly."""


def evidence_id(kinds: Mapping[str, Evidence]) -> str:
    """Return what identifies evidence: a hash of names and versions in their order, of sectors and sweeps."""
    rows = [[name, kind.version, kind.over_time] for name, kind in kinds.items()]
    return hashlib.sha256(json.dumps([SECTORS, EARLIER_SWEEPS, HELD_SWEEPS, rows]).encode()).hexdigest()[:16]


EVIDENCE_ID = evidence_id(EVIDENCE)
"""Of the evidence of this version; other numbers void a calibration, a release does not."""


class Rates(NamedTuple):
    """False alarms that a monitor may raise.

    Attributes:
        inconsistent: share of the benign sweeps (or drives) that may be called inconsistent.
        degraded: share that may be called degraded.
        discoveries: share of the suspect sectors that may be false ones.
    """

    inconsistent: float = 0.01
    degraded: float = 0.01
    discoveries: float = 0.1


RATES = Rates()


@dataclass(frozen=True, slots=True, eq=False)
class BenignSweep:
    """What all evidence measured of a sweep that nobody attacked.

    Attributes:
        scene: that it is of; sweeps of one drive share it.
        group: with which it is calibrated, see :func:`group_of`.
        evidence: (E, SECTORS) of :func:`viewshed.monitor.score.measure_all`.
        clear: whether the scene is as it should be; one in bad weather is no false alarm of *degraded*.
    """

    scene: str
    group: Group
    evidence: NDArray[np.floating[Any]]
    clear: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class BenignTable:
    """Benign scenes of one group, beside their scores: what makes sectors suspect and evidence a reason.

    Attributes:
        sectors: scores of all sectors together, one column.
        strongest: each evidence's strongest sector, E columns.
    """

    sectors: HighestScores
    strongest: HighestScores


@dataclass(frozen=True, slots=True, eq=False)
class SweepMonitor:
    """Says of a sweep whether it is inconsistent or degraded, where and why.

    Attributes:
        score: of all evidence.
        inconsistent: calibration of that verdict.
        degraded: calibration of that verdict.
        benign: scenes of each group, for sectors and reasons.
        runs: of these scenes in a row, from which limits of alarms over time are.
        discovery_rate: expected share of false ones among the suspect sectors.
        per: what the rates count, sweeps or drives.
        estimates: methods of the estimates that the evidence was given; the same must be given to :meth:`check`.
        facts: what else must be known to make the same evidence, as fingerprints of weights; see :meth:`require`.
        warnings: what its benign scenes themselves speak against.
        per_hour: false alarms over time; None for as few as its runs support, but not below one.
        evidence: :data:`EVIDENCE_ID` of the evidence that it is calibrated on.

    Raises:
        ValueError: the parts are of different groups or evidence.
    """

    score: EvidenceScore
    inconsistent: Calibration
    degraded: Calibration
    benign: Mapping[Group, BenignTable]
    runs: BenignRuns
    discovery_rate: float = RATES.discoveries
    per: Per = "sweep"
    estimates: tuple[str, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    per_hour: float | None = None
    evidence: str = EVIDENCE_ID

    def __post_init__(self) -> None:
        groups = set(self.benign), set(self.inconsistent.scores), set(self.degraded.scores)
        if not groups[0] == groups[1] == groups[2]:
            raise ValueError(f"benign scenes and both verdicts must be of the same groups, got {groups}")
        for group, table in self.benign.items():
            columns = table.sectors.highest.shape[1], table.strongest.highest.shape[1]
            if columns != (1, len(self.score.names)):
                raise ValueError(f"{group}: tables must have 1 and {len(self.score.names)} columns, got {columns}")
        if not 0.0 < self.discovery_rate < 1.0:
            raise ValueError(f"discovery_rate must lie in (0, 1), got {self.discovery_rate}")

    @classmethod
    def calibrate(
        cls,
        score: EvidenceScore,
        benign: Iterable[BenignSweep],
        rng: np.random.Generator,
        *,
        rates: Rates = RATES,
        promise: Promise = "expected",
        per: Per = "sweep",
        estimates: Iterable[str] = (),
        facts: Mapping[str, str] | None = None,
        in_a_row: Iterable[BenignSweep] | None = None,
    ) -> Self:
        """Return the monitor that keeps its rates on further scenes like these.

        What is inconsistent is calibrated on all scenes; what is degraded on those that are clear. Runs for alarms over
        time are of the sweeps with most history, each judged by all other scenes.

        Args:
            score: of all evidence; it may have been trained on anything but these scenes.
            benign: sweeps of scenes that nobody attacked, several of each if there are, in the order of recording.
            rng: draws one sweep of each scene, and ties.
            rates: of false alarms.
            promise: whether the expected rate is kept, or the rate with probability .9.
            per: sweeps, or drives: then a scene counts by its largest score.
            estimates: methods of the estimates that the evidence was given.
            facts: what else must be known to make the same evidence.
            in_a_row: sweeps of these scenes one after the other, for runs; ``benign`` if not given.

        Raises:
            ValueError: a group has too few scenes for a rate; evidence is not that of the score, or gives no score.
        """
        rows: dict[Group, list[tuple[str, F64]]] = {}
        unclear: set[tuple[Group, str]] = set()
        for sweep in benign:
            rows.setdefault(sweep.group, []).append((sweep.scene, _row(score, sweep.evidence)))
            if not sweep.clear:
                unclear.add((sweep.group, sweep.scene))
        sequences = rows if in_a_row is None else _rows_of(score, in_a_row)
        longest = max((group.earlier for group in sequences), key=get_args(Earlier).index, default="none")
        inconsistent, degraded, tables, streams = {}, {}, {}, list[F64]()
        for group, of_group in rows.items():
            scenes, chosen = one_per_scene(
                [scene for scene, _ in of_group], np.array([row for _, row in of_group]), per, rng
            )
            clear = np.array([(group, scene) not in unclear for scene in scenes])
            inconsistent[group], degraded[group] = chosen[:, 0], chosen[clear, 1]
            if group.earlier == longest:
                own = {scene: list[float]() for scene in scenes}
                for scene, row in sequences.get(group, ()):
                    own[scene].append(float(row[0]))
                streams += tail_p_values_among_others(chosen[:, 0], [np.array(each) for each in own.values()])
            sectors, strongest = chosen[:, 2 : 2 + SECTORS], chosen[:, 2 + SECTORS :]
            share = max(rates.discoveries, 0.1)
            every = sectors.reshape(-1, 1)
            tables[group] = BenignTable(HighestScores.of(every, share), HighestScores.of(strongest, share))
        found = (drift_warning(scores, rng) for scores in (inconsistent, degraded))
        return cls(
            score, Calibration(inconsistent, rates.inconsistent, promise),
            Calibration(degraded, rates.degraded, promise), tables, BenignRuns.of(streams), rates.discoveries, per,
            tuple(estimates), dict(facts or {}), tuple(dict.fromkeys(line for line in found if line)),
        )  # fmt: skip

    def corrected(
        self, real: Iterable[BenignSweep], rng: np.random.Generator, *, rates: Rates = RATES,
        promise: Promise = "expected",
    ) -> Self:  # fmt: skip
        """Return the monitor, calibrated in simulation, corrected by real scenes: see ``calibration.RealScores``.

        Both verdicts are corrected. Sectors, reasons and runs stay those of the simulated scenes.

        Args:
            real: sweeps of real scenes that nobody attacked.
            rng: draws one sweep of each scene.
            rates: of false alarms.
            promise: whether the expected rate is kept, or the rate with probability .9.

        Raises:
            ValueError: there are none, one is of another evidence or history, or they leave no limit for a rate.
        """
        scores: list[tuple[Group, F64]] = []
        for group, of_group in _rows_of(self.score, real).items():
            chosen = one_per_scene(
                [scene for scene, _ in of_group], np.array([row for _, row in of_group]), self.per, rng
            )
            scores += [(group, row) for row in chosen[1]]
        verdicts = (self.inconsistent, rates.inconsistent), (self.degraded, rates.degraded)
        inconsistent, degraded = (
            replace(one, rate=rate, promise=promise, real=one.real_scores((group, row[place]) for group, row in scores))
            for place, (one, rate) in enumerate(verdicts)
        )
        return replace(self, inconsistent=inconsistent, degraded=degraded, discovery_rate=rates.discoveries)

    def detector(self, per_hour: float | None = None, hz: float = 10.0) -> EDetector:
        """Return what adds up doubt over a stream: its expected false alarms an hour are at most the chosen ones.

        Args:
            per_hour: false alarms; those that the monitor was calibrated for if not given.
            hz: sweeps a second.

        Raises:
            ValueError: a rate is not positive, or there are too few hours of benign runs for it.
        """
        return self.runs.detector(self._alarms_per_hour(hz) if per_hour is None else per_hour, hz)

    def _alarms_per_hour(self, hz: float) -> float:
        return max(1.0, self.runs.least_per_hour(hz)) if self.per_hour is None else self.per_hour

    def check(
        self,
        monitored: MonitoredSweep,
        evidence: Mapping[str, Evidence] = EVIDENCE,
        before: list[F32] | None = None,
    ) -> IntegrityReport:
        """Return what the monitor says of a sweep.

        It uses as much of the earlier sweeps as it was calibrated with: all of ``EARLIER_SWEEPS``, with poses or
        without, or none; so what evidence abstains from is the same as on benign scenes, and the rates hold. A sweep of
        fewer returns than sectors is degraded, without a p-value.

        Args:
            monitored: the sweep, with those before it.
            evidence: what is measured.
            before: (E, SECTORS) each, what was measured of up to ``HELD_SWEEPS`` sweeps before it in its stream, to
                which this one is added; None for a sweep by itself. Evidence over time is carried over if all have
                poses.

        Raises:
            ValueError: the sweep has no returns, lacks an estimate that the evidence needs, is of no calibrated group,
                or has no score; the monitor is of other evidence.
        """
        self._require_evidence(evidence)
        missing = [method for method in self.estimates if method not in monitored.estimates]
        if missing:
            raise ValueError(
                f"monitored must have the estimates of {', '.join(missing)}, got none; estimate them first"
            )
        returns = len(monitored.leveled.points)
        if not returns:
            raise ValueError("sweep must have usable returns, got none; nothing can be said of it")
        grid = next((estimate.grid for estimate in monitored.estimates.values()), None)
        monitored, group, notes = self._as_calibrated(monitored)
        recent = [measure_all(monitored, evidence)]
        if before and group.earlier == "posed":
            recent = [*before, *recent][-HELD_SWEEPS:]
        report = self.report(held(recent, [kind.over_time for kind in evidence.values()]), group, grid, notes, evidence)
        # Only what was judged is kept.
        if before is not None:
            before[:] = recent if group.earlier == "posed" else ()
        if returns >= SECTORS:
            return report
        # Hardly anything is measured, so nothing is found: that is no sign of health.
        few = f"too few returns to judge a sweep by: {returns}, less than one in each 5° of azimuth"
        return replace(report, degraded=True, degraded_p_value=math.nan, reasons=(few, *report.reasons))

    def report(
        self,
        evidence: NDArray[np.floating[Any]],
        group: Group,
        grid: BevGrid | None = None,
        notes: tuple[str, ...] = (),
        kinds: Mapping[str, Evidence] = EVIDENCE,
    ) -> IntegrityReport:
        """Return what the monitor says of a sweep by its evidence (E, SECTORS), measured already.

        Raises:
            ValueError: the evidence is not that of the score or gives no score, or the group is unknown without a like.
        """
        row = _row(self.score, evidence)
        if group not in self.benign:
            like = len(self.inconsistent.alike(group))
            note = f"{group} was not calibrated, no rate is promised: judged by the most cautious of {like} sensors"
            notes = (*notes, note)
        inconsistent, threshold = float(row[0]), self.inconsistent.limit(group)
        degraded = float(row[1]) > self.degraded.limit(group)
        reasons = self._reasons(evidence, row[2 + SECTORS :], group, kinds)
        if not reasons and (inconsistent > threshold or degraded):
            # What is usual one by one can be rare together: there is no verdict without a reason.
            reasons = self._reasons(evidence, row[2 + SECTORS :], group, kinds, most=1.0)[:1]
            reasons = tuple(f"rare all together, each alone is not; the rarest: {reason}" for reason in reasons)
        suspect = np.zeros(SECTORS, np.bool_)
        if inconsistent > threshold:
            suspect = self.suspect_sectors(row[2 : 2 + SECTORS], group)
        return IntegrityReport(
            NAME, inconsistent, threshold, self.inconsistent.p_value(inconsistent, group),
            degraded, self.degraded.p_value(float(row[1]), group), suspect, grid,
            np.zeros((0, 0), np.bool_) if grid is None else cells_of_sectors(suspect, grid),
            reasons, notes, np.asarray(evidence, np.float32),
            self.inconsistent.tail_p_value(inconsistent, group),
        )  # fmt: skip

    def suspect_sectors(self, sectors: ArrayLike, group: Group) -> Mask:
        """Return the mask (SECTORS,) of suspect sectors at the monitor's false-discovery rate.

        Each is compared with all sectors of the benign scenes together: with some hundred scenes the smallest p-value
        of a single sector could not tell one among 72.

        Args:
            sectors: (SECTORS,) scores of the sectors.
            group: of the sweep.

        Raises:
            ValueError: the group is unknown without a like.
        """
        p = [self.benign[each].sectors.p_values(sectors) for each in self.inconsistent.alike(group)]
        return discoveries(np.max(p, axis=0), self.discovery_rate)

    def require(self, facts: Mapping[str, str]) -> None:
        """Check that evidence is made with what the monitor was calibrated with, as the fingerprint of weights.

        Raises:
            ValueError: it is not.
        """
        for name, value in self.facts.items():
            if facts.get(name) != value:
                raise ValueError(
                    f"{name} must be that of the monitor, {value}, got {facts.get(name, 'none')}; calibrate a monitor"
                    " for it"
                )

    def promises(self) -> list[str]:
        """Return a line for each group and verdict, the limit and both promises; the last is of alarms over time."""
        hz, simulated = 10.0, ", simulated ones" if len(self.inconsistent.real) else ""
        over_time = (
            f"over time, at {hz:g} Hz: expected false alarms at most {self._alarms_per_hour(hz):.3g} an hour, by"
            f" {self.runs.hours(hz):.2g} h of benign runs of {self.runs.sweeps / hz:g} s{simulated}"
        )
        return [
            f"{group}: {name} above {calibration.limit(group):.4g}; per {self.per}: {calibration.promise_of(group)}"
            for group in sorted(self.benign)
            for name, calibration in (("inconsistent", self.inconsistent), ("degraded", self.degraded))
        ] + [over_time]

    def _require_evidence(self, evidence: Mapping[str, Evidence]) -> None:
        if self.evidence != EVIDENCE_ID:
            raise ValueError(
                f"monitor must be calibrated on the evidence of this version, {EVIDENCE_ID}, got {self.evidence};"
                " calibrate it again"
            )
        if tuple(evidence) != self.score.names:
            raise ValueError(
                f"evidence must be that of the monitor ({', '.join(self.score.names)}), got {', '.join(evidence)};"
                " calibrate a monitor for it"
            )

    def _as_calibrated(self, monitored: MonitoredSweep) -> tuple[MonitoredSweep, Group, tuple[str, ...]]:
        """Return the sweep with as much history as the monitor knows, its group, and what was left out."""
        known = {method: monitored.estimates[method] for method in self.estimates}
        sweep = _with_history(replace(monitored, estimates=known))
        group = group_of(sweep)
        histories = {each.earlier for each in self.benign}
        if group.earlier in histories:
            found = sweep
        elif "none" in histories:
            found = replace(sweep, earlier=())
        else:
            raise ValueError(
                f"sweep must have {EARLIER_SWEEPS} earlier sweeps with {'poses' if 'posed' in histories else 'times'},"
                f" as those that the monitor was calibrated on, got {len(monitored.earlier)}, {group.earlier}"
            )
        notes = []
        if len(found.earlier) < EARLIER_SWEEPS:
            why = "they have no poses" if group.earlier == "unposed" else f"there are {len(monitored.earlier)}"
            notes.append(f"judged without earlier sweeps: {why} of {EARLIER_SWEEPS}; evidence over time abstains")
        elif group.earlier == "unposed":
            notes.append("the sweeps have no poses: evidence that needs them abstains")
        return found, group_of(found), tuple(notes)

    def _reasons(
        self,
        evidence: NDArray[np.floating[Any]],
        strongest: F64,
        group: Group,
        kinds: Mapping[str, Evidence],
        most: float = UNUSUAL,
    ) -> tuple[str, ...]:
        """Return the sentences of the evidence with p-values up to ``most`` for the group, the rarest first."""
        p, beyond = np.zeros(len(strongest)), np.full(len(strongest), np.inf)
        least = 0.0
        for each in self.inconsistent.alike(group):
            benign = self.benign[each].strongest
            p = np.maximum(p, benign.p_values(strongest))
            # Where p-values tie: how far beyond the highest benign number, in units of the spread of those kept.
            highest, lowest = benign.highest[0].astype(np.float64), benign.highest[-1].astype(np.float64)
            with np.errstate(invalid="ignore"):
                ratio = (strongest - highest) / np.maximum(highest - lowest, 1e-9)
            beyond = np.minimum(beyond, np.nan_to_num(ratio, nan=np.inf))
            least = max(least, 1.0 / (benign.scenes + 1))
        unusual = np.flatnonzero((p <= max(most, least) + 1e-12) & np.isfinite(strongest))
        order = sorted(unusual.tolist(), key=lambda number: (p[number], -beyond[number]))
        return tuple(kinds[self.score.names[number]].reason(np.asarray(evidence[number])) for number in order)


def group_of(monitored: MonitoredSweep) -> Group:
    """Return the group with which a sweep is calibrated: its sensor, and whether all earlier sweeps have poses.

    Sensors without a name are distinguished by whether their rings are known, which much of the evidence needs.
    """
    sensor = monitored.leveled.sensor_id
    name = sensor.model.name if sensor.model is not None else "unknown sensor"
    if monitored.leveled.range_image is None:
        name += " without rings"
    earlier: Earlier = "none"
    if monitored.earlier:
        every = (*monitored.earlier, monitored.leveled)
        earlier = "posed" if all(each.sweep.world_from_sensor is not None for each in every) else "unposed"
    return Group(name, earlier)


def _with_history(monitored: MonitoredSweep) -> MonitoredSweep:
    """Return the sweep with exactly ``EARLIER_SWEEPS`` earlier ones, the last, or with none."""
    count = len(monitored.earlier)
    if count == EARLIER_SWEEPS:
        return monitored
    return replace(monitored, earlier=monitored.earlier[-EARLIER_SWEEPS:] if count > EARLIER_SWEEPS else ())


def _rows_of(score: EvidenceScore, sweeps: Iterable[BenignSweep]) -> dict[Group, list[tuple[str, F64]]]:
    """Return by group the scene and the :func:`_row` of each sweep."""
    rows: dict[Group, list[tuple[str, F64]]] = {}
    for sweep in sweeps:
        rows.setdefault(sweep.group, []).append((sweep.scene, _row(score, sweep.evidence)))
    return rows


def _row(score: EvidenceScore, evidence: NDArray[np.floating[Any]]) -> F64:
    """Return both scores, those of the sectors and each evidence's strongest sector, (2 + SECTORS + E,).

    Raises:
        ValueError: the evidence is not that of the score, or a score is not a number.
    """
    scores = score(evidence)
    verdicts = np.array([scores.inconsistent, scores.degraded], np.float64)
    if not np.isfinite(verdicts).all():
        raise ValueError(f"scores must be finite, got {verdicts[0]} and {verdicts[1]}; the evidence gives no score")
    known = np.where(np.isnan(evidence), -np.inf, np.asarray(evidence, np.float64))
    return np.concatenate([verdicts, np.asarray(scores.sectors, np.float64), known.max(axis=1)])


FORMAT_VERSION = 3

_EVIDENCE_OF_VERSIONS = {"0.3.0": "aa7179de52c61bce"}
"""``EVIDENCE_ID`` of releases whose files, of format 2, name the release instead."""

SHIPPED = Path(__file__).parent / "monitors" / "simulated.npz"
"""The shipped monitor."""

_MAX_BYTES = 1 << 26
"""Largest part of a file, unpacked: a hundred thousand scenes by 72 sectors."""


def save_sweep_monitor(monitor: SweepMonitor, path: str | Path) -> None:
    """Write a monitor to ``path`` (compressed NPZ) at once or not at all; the same monitor, the same bytes.

    Raises:
        OSError: the file cannot be written.
    """
    groups = sorted(monitor.benign)
    about = {
        "version": FORMAT_VERSION, "monitor": NAME, "evidence": monitor.evidence, "per": monitor.per,
        "promise": monitor.inconsistent.promise, "facts": dict(monitor.facts), "warnings": list(monitor.warnings),
        "rates": [monitor.inconsistent.rate, monitor.degraded.rate, monitor.discovery_rate],
        "run_sweeps": monitor.runs.sweeps, "per_hour": monitor.per_hour,
        "estimates": list(monitor.estimates), "groups": [list(group) for group in groups],
    }  # fmt: skip
    arrays: dict[str, Any] = {f"score.{name}": part for name, part in monitor.score.arrays().items()}
    for number, group in enumerate(groups):
        table = monitor.benign[group]
        arrays |= {
            f"{number}.inconsistent": monitor.inconsistent.scores[group],
            f"{number}.degraded": monitor.degraded.scores[group],
            f"{number}.sectors": table.sectors.highest,
            f"{number}.strongest": table.strongest.highest,
        }
    for name in ("inconsistent", "degraded"):
        real = getattr(monitor, name).real
        arrays[f"real.{name}"] = np.stack([real.place, real.strict, real.weak])
    arrays["runs"] = monitor.runs.wealth
    arrays["about"] = np.frombuffer(json.dumps(about).encode(), np.uint8)
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    write_atomic(path, file.getvalue())


def load_sweep_monitor(path: str | Path) -> SweepMonitor:
    """Return the monitor in a file of :func:`save_sweep_monitor`; nothing is unpickled.

    Raises:
        ValueError: the file is no such monitor, of other evidence, or damaged.
        OSError: it cannot be read.
    """
    raw = Path(path).read_bytes()
    try:
        arrays = read_arrays(raw, _MAX_BYTES)
        return _monitor(json.loads(arrays["about"].tobytes()), arrays)
    except DAMAGED as error:
        why = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(
            f"{path} must be a whole monitor file of this version, got: {why}; calibrate it again"
        ) from error


def shipped_monitor() -> SweepMonitor:
    """Return the shipped monitor, calibrated on simulated scenes; see docs/monitor.md for its measured rates."""
    return load_sweep_monitor(SHIPPED)


def kind_of_monitor(path: str | Path) -> str:
    """Return the name of the monitor that wrote a file; empty where none did.

    Raises:
        OSError: it cannot be read.
    """
    raw = Path(path).read_bytes()
    try:
        return str(json.loads(read_arrays(raw, _MAX_BYTES, ("about",))["about"].tobytes())["monitor"])
    except DAMAGED:
        return ""


def _monitor(about: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> SweepMonitor:
    version = about["version"]
    evidence = _EVIDENCE_OF_VERSIONS.get(about["viewshed"], about["viewshed"]) if version == 2 else about["evidence"]
    if about["monitor"] != NAME or version not in (2, FORMAT_VERSION) or evidence != EVIDENCE_ID:
        raise ValueError(f"version {version} of monitor {about['monitor']} of evidence {evidence}, not {EVIDENCE_ID}")
    groups = [Group(str(sensor), earlier) for sensor, earlier in about["groups"]]
    rates = Rates(*map(float, about["rates"]))

    def verdict(name: str, rate: float) -> Calibration:
        scores = {group: arrays[f"{number}.{name}"] for number, group in enumerate(groups)}
        return Calibration(scores, rate, about["promise"], RealScores(*np.asarray(arrays[f"real.{name}"], np.float64)))

    inconsistent, degraded = verdict("inconsistent", rates.inconsistent), verdict("degraded", rates.degraded)
    benign = {}
    for number, group in enumerate(groups):
        sectors, strongest = (np.asarray(arrays[f"{number}.{name}"], np.float32) for name in ("sectors", "strongest"))
        scenes = len(inconsistent.scores[group])
        benign[group] = BenignTable(HighestScores(scenes * SECTORS, sectors), HighestScores(scenes, strongest))
    score = {name.removeprefix("score."): part for name, part in arrays.items() if name.startswith("score.")}
    return SweepMonitor(
        EvidenceScore.from_arrays(score), inconsistent, degraded, benign,
        BenignRuns(np.asarray(arrays["runs"], np.float64), int(about["run_sweeps"])), rates.discoveries, about["per"],
        tuple(str(name) for name in about["estimates"]), {str(key): str(text) for key, text in about["facts"].items()},
        tuple(str(line) for line in about["warnings"]),
        None if about["per_hour"] is None else float(about["per_hour"]), evidence,
    )  # fmt: skip
