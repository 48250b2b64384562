"""``viewshed monitor``: learn what doubt is usual on benign sweeps, and alarm where there is more."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from viewshed.cli import _options as options
from viewshed.cli._options import AUTO, BAD_INPUTS, Passes, Reading, Seed, Weights
from viewshed.cli._outputs import Failures, free_name, refuse_inputs, stem_of, with_bar

if TYPE_CHECKING:
    from viewshed.estimators.unet import UnetEstimator
    from viewshed.fov.estimate import FovEstimate
    from viewshed.integrity import DeviationMonitor, IntegrityReport
    from viewshed.sweep import Sweep


monitor_app = typer.Typer(help="Learn what doubt is usual, and alarm where there is more.")
Named = tuple[str, "Sweep"]


@monitor_app.callback()
def monitor() -> None:
    """Learn what doubt is usual, and alarm where there is more."""


@monitor_app.command()
def fit(
    sources: options.Sources,
    out: Annotated[Path, typer.Option(help="File of the monitor.")] = Path("monitor.npz"),
    false_alarm_rate: Annotated[float, typer.Option(help="Share of benign sweeps that may alarm.")] = 0.05,
    sigmas: Annotated[float, typer.Option(help="Standard deviations above its mean from which a cell is suspect.")] = 3,
    split: options.Split = None,
    grid: options.GridName = "road",
    target: options.TargetName = "car",
    weights: Weights = None,
    passes: Passes = None,
    seed: Seed = None,
    sensor: options.SensorName = AUTO,
) -> None:
    """Fit a monitor of Monte Carlo dropout on benign sweeps: thresholds on the first half, the limit on the second.

    Example: viewshed monitor fit benign --out monitor.npz
    """
    from viewshed.estimators.unet import PASSES, load_network
    from viewshed.integrity import DeviationMonitor, Rule, save_monitor
    from viewshed.integrity.calibration import alarms_allowed

    rule, sweeps = Rule(sigmas=sigmas), _Source(tuple(sources), split, sensor)
    refuse_inputs((out,), map(Path, sources))
    estimator = load_network(
        "mc_dropout", options.parse_grid(grid), options.parse_target(target), weights=weights, passes=passes,
        seed=seed or 0,
    )  # fmt: skip
    count = sum(1 for _ in sweeps)
    alarms_allowed(count - count // 2, false_alarm_rate, unit="sweeps")
    estimates = (estimator.estimate(sweep) for _, sweep in with_bar(sweeps, count))
    made = DeviationMonitor.fit(islice(estimates, count // 2), rule).calibrated(estimates, false_alarm_rate)
    facts = {"network": _identity(estimator), "target": target, "passes": str(passes or PASSES), "seed": str(seed or 0)}
    save_monitor(replace(made, facts=facts), out)
    typer.echo(
        f"{out}: fitted on {made.sweeps[0]} sweeps, calibrated on {made.sweeps[1]}; alarms above a score of "
        f"{made.limit:.4f}, for at most {false_alarm_rate:.1%} false alarms"
    )


@monitor_app.command()
def check(
    sources: options.Sources,
    monitor: Annotated[Path, typer.Option(help="File of viewshed monitor fit.")] = Path("monitor.npz"),
    split: options.Split = None,
    weights: Weights = None,
    sensor: options.SensorName = AUTO,
    out: Annotated[Path | None, typer.Option(help="Folder of pictures and suspect cells; none if not given.")] = None,
) -> None:
    """Check sweeps with a fitted monitor: score, alarm and suspect area of each, one line a sweep.

    A sweep that cannot be checked costs one line on standard error and does not stop the others; the exit code is then
    2. An alarm does not change the exit code.

    Example: viewshed monitor check drive --monitor monitor.npz
    """
    from viewshed.integrity import load_monitor

    fitted = load_monitor(monitor)
    run = _Run(fitted, estimator_of(fitted, weights), out)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    for source in sources:
        try:
            for name, sweep in _Source((source,), split, sensor):
                run.one(name, sweep)
        except BAD_INPUTS as error:
            run.failures.report(source, error)
    typer.echo(f"{run.checked} sweeps, {run.alarms} alarms")
    if run.failures.count:
        raise typer.Exit(2)


@dataclass(frozen=True, slots=True)
class _Source:
    """Sweeps that can be gone through more than once."""

    places: tuple[str, ...]
    split: str | None
    sensor: str

    def __iter__(self) -> Iterator[Named]:
        for place in self.places:
            if options.is_data_set(place):
                yield from self._archived(place)
            elif self.split is not None:
                raise ValueError(f"--split goes with a data set that has splits, got {place}")
            else:
                yield from self._read(Path(place))

    def _archived(self, place: str) -> Iterator[Named]:
        from viewshed.datasets import Archive

        archive = Archive.open(place)
        for number, sample in enumerate(archive if self.split is None else archive.split(self.split)):
            yield f"{sample.scene} {number:05}", sample.sweep

    def _read(self, path: Path) -> Iterator[Named]:
        several = path.is_dir()
        for number, sweep in enumerate(Reading(self.sensor).sweeps(path)):
            yield f"{path.name} {number:05}" if several or number else path.name, sweep


@dataclass(slots=True)
class _Run:
    """A monitor at work."""

    monitor: DeviationMonitor
    estimator: UnetEstimator
    out: Path | None
    checked: int = 0
    alarms: int = 0
    failures: Failures = field(default_factory=Failures)
    taken: set[str] = field(default_factory=set)

    def one(self, name: str, sweep: Sweep) -> None:
        """Say what the monitor finds in a sweep."""
        try:
            found = self.estimator.estimate(sweep)
            report = self.monitor.check(found)
            word = f"ALARM, {report.suspect_m2:.0f} m² suspect" if report.alarm else "no alarm"
            line = f"{name}: score {report.score:.4f}, limit {report.threshold:.4f}, {word}"
            typer.echo(line if self.out is None else f"{line} → {self._drawn(name, line, found, report, sweep)}")
        except BAD_INPUTS as error:
            self.failures.report(name, error)
        else:
            self.checked += 1
            self.alarms += report.alarm

    def _drawn(self, name: str, line: str, found: FovEstimate, report: IntegrityReport, sweep: Sweep) -> Path:
        """Write picture and suspect cells of a sweep and return where the picture is."""
        from viewshed._files import write_atomic
        from viewshed.integrity.report import suspects_geojson
        from viewshed.plot import Panel, maps_picture
        from viewshed.preprocess.leveling import level

        panel = Panel(found, line, level(sweep, self.estimator.grid), self.estimator.card.threshold)
        stem = free_name(stem_of(name).replace("/", "_"), self.taken)
        place = (self.out or Path()) / f"{stem}.png"
        write_atomic(place, maps_picture(panel))
        write_atomic(place.with_name(f"{stem}.geojson"), suspects_geojson(report))
        return place


def estimator_of(monitor: DeviationMonitor, weights: str | None) -> UnetEstimator:
    """Return the network that a monitor was fitted on.

    Raises:
        ValueError: the monitor does not name it, or the weights are others.
    """
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
    """Return name and fingerprint of an estimator's network: its card tells how it was trained."""
    digest = hashlib.sha256(estimator.card.to_json().encode()).hexdigest()
    return f"{estimator.card.name} {digest[:12]}"
