"""``viewshed monitor``: calibrate monitors, and check sweeps: inconsistent or degraded, where and why."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from viewshed.cli import _options as options
from viewshed.cli._options import AUTO, MonitorFile, Passes, Reading, Seed, Weights
from viewshed.cli._outputs import Failures, Streams, free_name, make_folder, refuse_inputs, stem_of, with_bar
from viewshed.cli._places import chosen_files, place_of_result
from viewshed.cli._stream import placed_sweeps
from viewshed.cli._terminal import BAD_INPUTS, note, raise_if_interrupted
from viewshed.cli._verdicts import stream_monitor, stream_verdicts, verdicts

if TYPE_CHECKING:
    from viewshed.arrays import F32
    from viewshed.estimators import Estimator
    from viewshed.estimators.unet import UnetEstimator
    from viewshed.grid import BevGrid
    from viewshed.monitor import Calibration, DeviationMonitor, IntegrityReport, StreamMonitor
    from viewshed.monitor.stream_monitor import EvidenceStream, StreamReport
    from viewshed.preprocess.leveling import LeveledSweep
    from viewshed.preprocess.sensor_identification import SensorId
    from viewshed.sweep import Sweep


HZ = 10.0
"""Assumed rate of drives without times."""

monitor_app = typer.Typer(help="Check if a sweep is inconsistent or degraded, where and why.")


@monitor_app.callback()
def monitor() -> None:
    """Check if a sweep is inconsistent or degraded, where and why."""


@monitor_app.command()
def fit(
    sources: options.Sources,
    out: Annotated[Path, typer.Option(help="File of the monitor.")] = Path("monitor.npz"),
    false_alarm_rate: Annotated[float, typer.Option(help="Share of benign sweeps that may raise an alarm.")] = 0.05,
    sigmas: Annotated[
        float, typer.Option(help="A cell is suspect from this many standard deviations above its mean.")
    ] = 3,
    split: options.Split = None,
    grid: options.GridName = "road",
    target: options.TargetName = "car",
    weights: Weights = None,
    passes: Passes = None,
    seed: Seed = None,
    sensor: options.SensorName = AUTO,
) -> None:
    """Fit the published monitor of Monte Carlo dropout.

    Sets the thresholds of the cells on the first half of the benign sweeps, and the alarm limit on the second half.

    Example: viewshed monitor fit benign --out monitor.npz
    """
    from viewshed.estimators.unet import PASSES, load_network
    from viewshed.monitor import DeviationMonitor, Rule, save_monitor
    from viewshed.monitor.calibration import alarms_allowed

    rule, sweeps = Rule(sigmas=sigmas), _Source(tuple(sources), split, sensor)
    refuse_inputs((out,), map(Path, sources))
    estimator = load_network(
        "mc_dropout", options.parse_grid(grid), options.parse_target(target), weights=weights, passes=passes,
        seed=seed or 0,
    )  # fmt: skip
    count = sum(1 for _ in sweeps)
    alarms_allowed(count - count // 2, false_alarm_rate, unit="sweeps")
    estimates = (estimator.estimate(sweep) for _, _, sweep in with_bar(sweeps, count))
    fitted = DeviationMonitor.fit(islice(estimates, count // 2), rule).calibrated(estimates, false_alarm_rate)
    facts = {"network": _identity(estimator), "target": target, "passes": str(passes or PASSES), "seed": str(seed or 0)}
    save_monitor(replace(fitted, facts=facts), out)
    typer.echo(
        f"{out}: fitted on {fitted.sweeps[0]} sweeps, calibrated on {fitted.sweeps[1]}; alarms above a score of "
        f"{fitted.limit:.4f}, for at most {false_alarm_rate:.1%} false alarms"
    )


@monitor_app.command()
def calibrate(
    sources: options.Sources,
    out: Annotated[Path, typer.Option(help="File of the monitor.")] = Path("monitor.npz"),
    per_hour: Annotated[
        float | None,
        typer.Option(
            help="False alarms an hour; the lowest rate that these drives support if not given, but at least 1."
        ),
    ] = None,
    monitor_file: MonitorFile = None,
    split: options.Split = None,
    grid: options.GridName = "road",
    sensor: options.SensorName = AUTO,
    topic: options.Topic = None,
    poses: options.Poses = None,
) -> None:
    """Calibrate the monitor on a minute or more of your own drives.

    The drives must be free of attacks. Impossible sweeps are left out, and so are sweeps on which the base monitor (the
    shipped one, or --monitor-file) alarms, if the scores of the other sweeps do not explain them. Both are listed.

    The scores stay those of the base monitor; the alarm limit is set from these drives. N false alarms an hour need 60
    / N minutes of driving. Without times, ten sweeps a second are assumed.

    Example: viewshed monitor calibrate my_drives --per-hour 10 --out monitor.npz
    """
    from viewshed.monitor import Calibration, load_calibration, save_calibration, shipped_calibration

    refuse_inputs((out,), map(Path, sources))
    base = shipped_calibration() if monitor_file is None else load_calibration(monitor_file)
    failures = Failures()
    drives = _measured(
        _Source(tuple(sources), split, sensor, topic, poses, failures), options.parse_grid(grid), failures
    )
    fitted = Calibration.fit(drives.streams, drives.hz, base=base)
    rate = max(fitted.least_per_hour, 1.0) if per_hour is None else per_hour
    limit = fitted.limit(rate)
    save_calibration(replace(fitted, facts={**fitted.facts, "per_hour": repr(rate)}), out)
    sweeps = sum(map(len, drives.streams))
    typer.echo(f"{out}: calibrated on {sweeps} sweeps of {len(drives.streams)} drives")
    typer.echo(f"  {fitted.promise(rate)}")
    typer.echo(f"  {int((fitted.peaks > limit).sum())} alarms in these drives at this limit")
    for line in _suspicious_sweeps(drives, fitted, base, rate):
        typer.echo(f"  {line}")
    if failures.count:
        raise typer.Exit(2)


@monitor_app.command()
def check(
    sources: options.Sources,
    monitor_file: MonitorFile = None,
    split: options.Split = None,
    grid: options.GridName = "road",
    weights: Weights = None,
    sensor: options.SensorName = AUTO,
    topic: options.Topic = None,
    poses: options.Poses = None,
    per_hour: Annotated[
        float | None, typer.Option(help="False alarms an hour; those of the monitor's file, or 6, if not given.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of pictures and suspect cells; none if not given.")] = None,
) -> None:
    """Check sweeps with a monitor: verdict and reason, a line each.

    Each line also has the p-value and the suspect sectors. Without --monitor-file, the monitor shipped with viewshed is
    used. Each sweep of a recording is judged by the sweeps before it; a folder of files with one sweep each is one
    stream if the files have times, or --poses gives them. A sweep that cannot be checked gives one line on standard
    error and does not stop the others; the exit code is then 2. An alarm does not change the exit code.

    Example: viewshed monitor check drive --monitor-file monitor.npz
    """
    if out is not None:
        make_folder(out)
    run = _run_of(monitor_file, options.parse_grid(grid), weights, out, per_hour)
    for source in sources:
        try:
            for seen in _Source((source,), split, sensor, topic, poses, run.failures):
                run.one(seen)
        except BAD_INPUTS as error:
            run.failures.report(source, error)
    typer.echo(run.summary())
    if run.failures.count:
        raise typer.Exit(2)


@monitor_app.command()
def explain(
    source: Annotated[str, typer.Argument(metavar="SRC", help="A sweep, or a recording or data set.")],
    number: Annotated[int, typer.Option(min=0, help="Which sweep of the recording, counted from 0.")] = 0,
    monitor_file: MonitorFile = None,
    split: options.Split = None,
    grid: options.GridName = "road",
    sensor: options.SensorName = AUTO,
    topic: options.Topic = None,
    poses: options.Poses = None,
    out: Annotated[str, typer.Option(help="Picture to write, or a folder for it.")] = "explained.png",
) -> None:
    """Draw the suspect sectors of one sweep, and give the reasons.

    The picture shows the map, and all evidence by azimuth. Without --monitor-file, the monitor shipped with viewshed is
    used. A sweep of a recording is judged by the sweeps before it.

    Example: viewshed monitor explain drive.mcap --number 120 --out explained.png
    """
    from viewshed._files import write_atomic

    picture = place_of_result(out, "explained.png")
    refuse_inputs((picture,), [Path(source)])
    run = SweepRun(None, stream_monitor(monitor_file), options.parse_grid(grid))
    for place, seen in enumerate(_Source((source,), split, sensor, topic, poses)):
        leveled, report = run.check(seen)
        if place == number:
            line = f"{seen.name}: {stream_verdicts(report)}"
            write_atomic(picture, run.picture(leveled, report.now, line))
            typer.echo(f"{line} → {picture}")
            for reason in report.now.reasons[1:]:
                typer.echo(f"  {reason}")
            return
    raise ValueError(f"number must be below the number of sweeps in {source}, got {number}")


class SceneSweep(NamedTuple):
    """A sweep with its file or scene and its own name."""

    scene: str
    name: str
    sweep: Sweep


@dataclass(frozen=True, slots=True)
class _Source:
    """The sweeps of the arguments, which can be iterated more than once.

    A file that cannot be read is reported to ``failures``; without ``failures`` the error is raised.
    """

    places: tuple[str, ...]
    split: str | None
    sensor: str
    topic: str | None = None
    poses: Path | None = None
    failures: Failures | None = None

    def __iter__(self) -> Iterator[SceneSweep]:
        from viewshed.recordings.recording import is_data_set

        for place in self.places:
            if is_data_set(place):
                yield from self._archived(place)
            elif self.split is not None:
                raise ValueError(f"--split is for a data set that has splits, got {place}")
            else:
                yield from self._read(place)

    def _archived(self, place: str) -> Iterator[SceneSweep]:
        from viewshed.recordings.recording import data_sets

        for number, (scene, sweep) in enumerate(data_sets(place).sweeps(place, self.split)):
            raise_if_interrupted()
            yield SceneSweep(f"{place} {scene}", f"{scene} {number:05}", sweep)

    def _read(self, place: str) -> Iterator[SceneSweep]:
        reading = Reading(self.sensor, topic=self.topic, poses=self.poses)
        jobs = list(chosen_files([Path(place)], None))
        for path, sweeps in placed_sweeps(reading, jobs, self.failures):
            is_folder = path.is_dir()
            try:
                for number, (scene, sweep) in enumerate(sweeps):
                    name = f"{path.name} {number:05}" if is_folder or number else path.name
                    yield SceneSweep(f"{place} {scene}", name, sweep)
            except BAD_INPUTS as error:
                if self.failures is None:
                    raise
                self.failures.report(path, error)


LISTED = 6
"""Maximum number of suspicious sweeps listed by name."""

LIMIT_MARGIN = 1.0
"""A limit is clearly higher than the base's by this score: about ten times fewer benign sweeps exceed it."""


@dataclass(slots=True)
class _Drive:
    """Evidence of one drive of one sensor, while it is measured."""

    stream: EvidenceStream
    sensor: SensorId
    evidence: list[F32] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    last_ns: int | None = None


@dataclass(frozen=True, slots=True)
class _Drives:
    """The evidence of all drives."""

    streams: list[F32]  # (T, E, SECTORS) of each drive
    names: list[list[str]]  # names of their sweeps
    hz: float  # sweeps a second
    impossible: list[str]  # names of impossible sweeps, which are left out


def _measured(sources: _Source, grid: BevGrid, failures: Failures) -> _Drives:
    """Return the evidence of each drive; impossible sweeps are left out."""
    import numpy as np

    from viewshed.monitor.impossible import impossible_reasons
    from viewshed.monitor.stream_monitor import EvidenceStream
    from viewshed.preprocess.leveling import level
    from viewshed.preprocess.sensor_identification import UNIDENTIFIED

    drives: list[_Drive] = []
    impossible: list[str] = []
    gaps_ns: list[int] = []
    # Current drive of each agent and named sensor of the scene.
    current: dict[tuple[str, str], _Drive] = {}
    streams = Streams(is_judged=True)
    for seen in sources:
        try:
            if streams.begins(seen.scene, seen.sweep):
                current = {}
            key = seen.sweep.agent, "" if seen.sweep.model is None else seen.sweep.model.name
            drive = current.get(key)
            leveled = level(seen.sweep, grid, UNIDENTIFIED if drive is None else drive.sensor)
            if drive is None or drive.stream.why_anew(leveled):
                current[key] = drive = _Drive(EvidenceStream(), leveled.sensor_id)
                drives.append(drive)
            evidence, is_possible = drive.stream.measure(leveled), not impossible_reasons(leveled)
            if is_possible:
                drive.evidence.append(evidence)
                drive.names.append(seen.name)
            else:
                impossible.append(seen.name)
            drive.stream.add(leveled, compared=is_possible)
            now_ns, last_ns = leveled.sweep.t_ns, drive.last_ns
            gaps_ns += [now_ns - last_ns] if now_ns is not None and last_ns is not None else []
            drive.last_ns, drive.sensor = now_ns, leveled.sensor_id
        except BAD_INPUTS as error:
            failures.report(seen.name, error)
    hz = 1e9 / float(np.median(gaps_ns)) if gaps_ns else HZ
    drives = [drive for drive in drives if drive.names]
    return _Drives([np.stack(drive.evidence) for drive in drives], [drive.names for drive in drives], hz, impossible)


def _suspicious_sweeps(drives: _Drives, fitted: Calibration, base: Calibration, per_hour: float) -> Iterator[str]:
    """Yield lines about sweeps that may have been attacked: impossible sweeps, and alarms of the base."""
    if drives.impossible:
        yield f"left out as impossible: {_listed(drives.impossible)}"
    base_limit = base.limit(per_hour, extrapolate=True)
    is_raised = fitted.limit(per_hour) > base_limit + LIMIT_MARGIN
    if not is_raised and "left_out" not in fitted.facts:
        return
    from viewshed.monitor.calibration import scores_of

    limit = base.limit(1.0, extrapolate=True)
    alarms = [
        name
        for stream, names in zip(drives.streams, drives.names, strict=True)
        for name, score in zip(names, scores_of(stream, base, limit), strict=True)
        if score > limit
    ]
    what = f"at one alarm an hour, the base monitor flags {len(alarms)} sweeps{': ' * bool(alarms)}{_listed(alarms)}"
    if "left_out" in fitted.facts:
        yield f"left out as attacked, since the other sweeps do not explain their scores; {what}"
    else:
        limits = f"the limit is {fitted.limit(per_hour):.2f}, that of the base monitor {base_limit:.2f}"
        yield f"{limits}: the drives were attacked, or the sensor is another one; {what}"


def _listed(names: list[str]) -> str:
    """Return names as text, at most ``LISTED`` of them."""
    return ", ".join(names[:LISTED]) + (f" and {len(names) - LISTED} more" if len(names) > LISTED else "")


def _run_of(file: Path | None, grid: BevGrid, weights: str | None, out: Path | None, per_hour: float | None) -> _Run:
    """Return the run of the monitor in a file, of either kind; None is the shipped one."""
    from viewshed.monitor.calibration import kind_of_monitor
    from viewshed.monitor.deviation import NAME, load_monitor

    if file is not None and kind_of_monitor(file) == NAME:
        if per_hour is not None:
            raise ValueError("--per-hour is for a monitor of viewshed monitor calibrate, or for the shipped one")
        fitted = load_monitor(file)
        return _DeviationRun(out, fitted, estimator_of(fitted, weights))
    if weights is not None:
        raise ValueError("--weights is for a monitor of viewshed monitor fit: it gives the network of that monitor")
    run = SweepRun(out, stream_monitor(file, per_hour), grid)
    if per_hour is not None:
        note(run.monitor.calibration.promise(per_hour))
    return run


@dataclass(slots=True)
class _Run(ABC):
    """Checks sweeps with a monitor of either kind, and counts alarms."""

    out: Path | None
    checked: int = field(default=0, init=False)
    alarms: int = field(default=0, init=False)
    failures: Failures = field(default_factory=Failures, init=False)
    taken: set[str] = field(default_factory=set, init=False)

    def one(self, seen: SceneSweep) -> None:
        """Check a sweep, print its line, and write its picture if there is an output folder."""
        try:
            line, write, count = self._check_one(seen)
            if self.out is not None:
                place = self.out / f"{free_name(stem_of(seen.name).replace('/', '_'), self.taken)}.png"
                write(place)
                line = f"{line} → {place}"
            typer.echo(line)
        except BAD_INPUTS as error:
            self.failures.report(seen.name, error)
        else:
            self.checked += 1
            count()

    @abstractmethod
    def _check_one(self, seen: SceneSweep) -> tuple[str, Callable[[Path], None], Callable[[], None]]:
        """Check a sweep; return its line, a function that writes its picture, and one that counts it."""

    @abstractmethod
    def summary(self) -> str:
        """Return one line with the numbers of checked sweeps and findings."""


@dataclass(slots=True)
class SweepRun(_Run):
    """Checks sweeps with the stream monitor."""

    monitor: StreamMonitor
    grid: BevGrid
    inconsistent: int = 0
    degraded: int = 0
    sensor: SensorId | None = None
    estimator: Estimator | None = None
    streams: Streams = field(default_factory=lambda: Streams(is_judged=True), init=False)

    def check(self, seen: SceneSweep) -> tuple[LeveledSweep, StreamReport]:
        """Return the next sweep, leveled, and the report on it; each file or scene is a new stream."""
        from viewshed.preprocess.leveling import level
        from viewshed.preprocess.sensor_identification import UNIDENTIFIED

        if self.streams.begins(seen.scene, seen.sweep):
            self.monitor.reset()
            self.sensor = None
        leveled = level(seen.sweep, self.grid, self.sensor or UNIDENTIFIED)
        self.sensor = leveled.sensor_id
        return leveled, self.monitor.check(leveled)

    def _check_one(self, seen: SceneSweep) -> tuple[str, Callable[[Path], None], Callable[[], None]]:
        from viewshed._files import write_atomic

        leveled, report = self.check(seen)
        line = f"{seen.name}: {stream_verdicts(report)}"

        def count() -> None:
            self.inconsistent += report.now.inconsistent
            self.degraded += report.now.degraded
            self.alarms += report.doubtful_sweeps == 1

        return line, lambda place: write_atomic(place, self.picture(leveled, report.now, line)), count

    def summary(self) -> str:
        """Return one line with the numbers of checked sweeps and findings."""
        alarms = f", {_alarms(self.alarms)}" if self.alarms else ""
        return f"{self.checked} sweeps, {self.inconsistent} inconsistent, {self.degraded} degraded{alarms}"

    def picture(self, leveled: LeveledSweep, report: IntegrityReport, line: str) -> bytes:
        """Return a PNG of a report: suspect sectors on the map of the default estimate, and the surprises."""
        from viewshed.estimators import load_estimator
        from viewshed.grid import BevGrid
        from viewshed.show.plot import Panel, monitor_picture

        self.estimator = self.estimator or load_estimator(grid=BevGrid(256, leveled.ground.half_extent_m))
        estimate = self.estimator.estimate(leveled)
        panel = Panel(estimate, line, leveled, estimate.threshold)
        return monitor_picture(panel, report, self.monitor.calibration.names, report.evidence)


@dataclass(slots=True)
class _DeviationRun(_Run):
    """Checks sweeps with the published detector and the network that it was fitted on."""

    monitor: DeviationMonitor
    estimator: UnetEstimator

    def _check_one(self, seen: SceneSweep) -> tuple[str, Callable[[Path], None], Callable[[], None]]:
        from viewshed._files import write_atomic
        from viewshed.monitor.report import suspects_geojson
        from viewshed.preprocess.leveling import level
        from viewshed.show.plot import Panel, maps_picture

        estimate = self.estimator.estimate(seen.sweep)
        report = self.monitor.check(estimate)
        line = f"{seen.name}: {verdicts(report)}"

        def write(place: Path) -> None:
            panel = Panel(estimate, line, level(seen.sweep, self.estimator.grid), self.estimator.card.threshold)
            write_atomic(place, maps_picture(panel))
            write_atomic(place.with_suffix(".geojson"), suspects_geojson(report))

        def count() -> None:
            self.alarms += report.alarm

        return line, write, count

    def summary(self) -> str:
        """Return one line with the numbers of checked sweeps and alarms."""
        return f"{self.checked} sweeps, {_alarms(self.alarms)}"


def estimator_of(monitor: DeviationMonitor, weights: str | None) -> UnetEstimator:
    """Return the network that a monitor was fitted on."""
    from viewshed.estimators.unet import load_network

    if not {"network", "target", "passes", "seed"} <= set(monitor.facts):
        raise ValueError("monitor must name its network, passes and seed, got none; fit it with viewshed monitor fit")
    facts = monitor.facts
    estimator = load_network(
        "mc_dropout", monitor.grid, options.parse_target(facts["target"]), weights=weights,
        passes=int(facts["passes"]), seed=int(facts["seed"]),
    )  # fmt: skip
    if _identity(estimator) != facts["network"]:
        raise ValueError(
            f"weights must be those of the monitor, {facts['network']}, got {_identity(estimator)}; give --weights,"
            " or fit a monitor for these"
        )
    return estimator


def _identity(estimator: UnetEstimator) -> str:
    """Return name and fingerprint of an estimator's network, a hash of its card."""
    digest = hashlib.sha256(estimator.card.to_json().encode()).hexdigest()
    return f"{estimator.card.name} {digest[:12]}"


def _alarms(count: int) -> str:
    return f"{count} alarm{'s' * (count != 1)}"
