"""The jobs of the study: their names, what must be there before them, and the work of one.

The study from start to end: what is there stays, the rest is done step after step and job after job.

The strict table: every in-domain model under every attack, beside every classical estimator, against exact truth.

The paper's anomaly detector tried on held-out sweeps, with one of the study's networks.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from viewshed._jobs import Engine, LocalEngine
from viewshed.datasets.archive.schema import code_version
from viewshed.estimators import Estimator
from viewshed.estimators.unet import UnetEstimator
from viewshed.grid import polar_of_cells
from viewshed.networks.card import Runner
from viewshed.preprocess.leveling import level
from viewshed.studies.cases import BENIGN, Case, Trial, apply, generator
from viewshed.studies.monitor.study import MonitorPlan, fitted, watched
from viewshed.studies.paper.data import (
    SPLITS,
    make_archive,
    open_archive,
    preset_of,
    score_contestants,
    subject_of,
    test_sweeps,
)
from viewshed.studies.paper.models import (
    check_training,
    classical,
    config_of,
    load_runner,
    network,
    passes_of,
    trade_config,
    trade_line,
    trade_shapes,
    trained,
    weights_of,
)
from viewshed.studies.paper.plan import StudyPlan
from viewshed.studies.paper.protocols import MIXTURES, PROTOCOLS, VARIANTS, Model, Setting, models_of, setting_of
from viewshed.studies.paper.store import JobStore, Key
from viewshed.studies.statistics import COUNTS, Reference, counts, score
from viewshed.studies.suite import Contestants, Probs, Subject
from viewshed.threats.attacks import ATTACKS, SEVERITIES, Knowledge


def monitor_line(plan: StudyPlan, folder: Path, runner: Runner) -> dict[str, Any]:
    """Return what the monitor says of benign, attacked and corrupted sweeps, as plain values.

    It is fitted on sweeps of some held-out scenes, calibrated on others, and reported on others again.

    Args:
        plan: of the study.
        folder: of the study.
        runner: of the network whose deviation is watched.
    """
    estimator = UnetEstimator(runner, plan.passes, plan.test_seed, "mcd")
    fit, calibrate, report = (_subjects(plan, folder, part) for part in range(3))
    how = MonitorPlan(
        corruptions=plan.monitor_corruptions, severity=plan.monitor_severity,
        false_alarm_rate=plan.monitor_false_alarms, seed=plan.test_seed,
    )  # fmt: skip
    monitor = fitted(estimator, fit, calibrate, how)
    lines = [watched(monitor, estimator, subject, number, how) for number, subject in enumerate(report)]
    return {"limit": monitor.limit, "lines": lines}


def _subjects(plan: StudyPlan, folder: Path, part: int) -> Iterator[Subject]:
    for number in range(part * plan.monitor_frames, (part + 1) * plan.monitor_frames):
        yield subject_of(plan, folder, plan.monitor_domain, number)


DEFAULT = "default"
"""Level of an attack with the budget that it has of itself."""

Row = list[float | int | None]


def strict_cases(plan: StudyPlan) -> list[Case]:
    """Return the cases: benign, every attack with its default budget, and where the plan says so its strengths."""
    strengths = [
        Case("strength", name, f"{attribute} {value:g}")
        for name, values in SEVERITIES.items()
        for attribute, value in values
    ]
    return [BENIGN, *(Case("attack", name, DEFAULT) for name in ATTACKS), *(strengths if plan.strengths else [])]


def strict_estimators(plan: StudyPlan, setting: Setting, runners: Mapping[Model, Runner]) -> dict[str, Estimator]:
    """Return the estimators of the strict table by name: networks of the domain, then the classical ones.

    Args:
        plan: of the study.
        setting: of the domain.
        runners: of its models.
    """
    from viewshed.estimators.unet import UnetEstimator

    found: dict[str, Estimator] = {
        short_name(model): UnetEstimator(runner, passes_of(plan, model), plan.test_seed, short_name(model))
        for model, runner in runners.items()
    }
    return found | {name: make(setting.grid) for name, make in setting.classical().items()}


def short_name(model: Model) -> str:
    """Return a model's name in tables of its own domain.

    >>> short_name(Model("strict", "mcd", "benign", "ugv"))
    'mcd-benign'
    """
    return f"{model.variant}-{model.mixture}"


def field_of(setting: Setting, subject: Subject, estimators: Mapping[str, Estimator]) -> Contestants:
    """Return the contestants on the truth's grid, against exact truth of ``probe``, car."""
    sample = subject.sample
    reference = Reference.of(sample.truth.visible(), sample.known, polar_of_cells(setting.grid)[1])
    pose = level(sample.sweep, setting.grid).world_from_level
    return Contestants(setting.grid, setting.threshold, estimators, reference, pose)


def trial_of(case: Case, subject: Subject, rng: np.random.Generator) -> Trial:
    """Return the subject's sweep as a case leaves it.

    Raises:
        ValueError: the attack cannot be made of this sweep.
    """
    if case.level != DEFAULT:
        return apply(case, subject, rng)
    knowledge = Knowledge(subject.earlier[:1], half_extent_m=subject.sample.truth.grid.half_extent_m)
    tampered = ATTACKS[case.name](None, knowledge).apply(subject.sample.sweep, rng)
    return Trial(tampered.sweep, tampered.added, tampered.wedge)


def strict_line(plan: StudyPlan, subject: Subject, field: Contestants, place: tuple[str, int]) -> dict[str, Any]:
    """Return what every contestant says of one sweep in every case, as plain values.

    Args:
        plan: of the study.
        subject: the sweep.
        field: the contestants.
        place: its domain and number.
    """
    clean = field.probs(subject.sample.sweep)
    cases = [dict(_entry(plan, subject, (field, clean), (case, place))) for case in strict_cases(plan)]
    return {"scene": subject.sample.scene, "cases": cases}


def _entry(
    plan: StudyPlan, subject: Subject, field: tuple[Contestants, Probs], what: tuple[Case, tuple[str, int]]
) -> Iterator[tuple[str, Any]]:
    case, (domain, number) = what
    yield "case", [case.kind, case.name, case.level]
    try:
        trial = trial_of(case, subject, generator(plan.test_seed, domain, number, case))
    except ValueError as error:
        yield "refused", " ".join(str(error).split())
        return
    yield "scores", _scores(field[0], field[1], trial, case)


def _scores(field: Contestants, clean: Probs, trial: Trial, case: Case) -> dict[str, Row]:
    """Return 13 numbers each: view, wedge, average precision, and the wedge with no return touched."""
    reference = field.reference
    probs = clean if case == BENIGN else field.probs(trial.sweep)
    wedge = None if trial.wedge is None else trial.wedge.holds(reference.azimuth)
    rows: dict[str, Row] = {}
    for name, prob in probs.items():
        before: tuple[int, ...] = (0,) * COUNTS
        if wedge is not None:
            claimed = clean[name][reference.among] >= np.float32(field.threshold)
            before = counts(claimed[wedge], reference.visible[wedge])
        rows[name] = [*score(prob, field.threshold, reference, wedge), *before]
    return rows


STEPS = ("data", "models", "pairs", "strict", "trade", "monitor", "pages")
"""What the command does, in order."""

CLASSICAL = "classical"
"""Names the classical estimators where a model's name stands otherwise."""


@dataclass(frozen=True, slots=True)
class Job:
    """One line of results that is to be found.

    Attributes:
        plan: of the study.
        folder: of the study.
        key: its step, and what tells it from the others of that step.
        device: ``cpu`` or ``cuda``.
    """

    plan: StudyPlan
    folder: Path
    key: Key
    device: str = "cpu"


def keys_of(plan: StudyPlan, step: str, protocols: Sequence[str]) -> list[Key]:
    """Return the names of all jobs of a step in some protocols, in the order in which they are done."""
    makers = {"models": _models, "pairs": _pairs, "strict": _strict, "trade": _trade, "monitor": _monitor}
    return list(makers[step](plan, protocols)) if step in makers else []


def _models(plan: StudyPlan, protocols: Sequence[str]) -> Iterable[Key]:
    return (("models", model.protocol, model.name) for model in models_of(plan, protocols))


def _pairs(plan: StudyPlan, protocols: Sequence[str]) -> Iterable[Key]:
    for protocol in protocols:
        names = [*(model.name for model in models_of(plan, [protocol])), CLASSICAL]
        yield from (("pairs", protocol, name, domain) for name in names for domain in plan.domains)


def _strict(plan: StudyPlan, protocols: Sequence[str]) -> Iterable[Key]:
    if "strict" in protocols:
        yield from (("strict", domain, str(n)) for n in range(plan.strict_frames) for domain in plan.domains)


def _trade(plan: StudyPlan, protocols: Sequence[str]) -> Iterable[Key]:
    if "paper" in protocols:
        yield from (("trade", *map(str, shape)) for shape in trade_shapes(plan))


def _monitor(plan: StudyPlan, protocols: Sequence[str]) -> Iterable[Key]:
    if "strict" in protocols:
        yield from (("monitor", mixture) for mixture in MIXTURES)


def needed(job: Job) -> list[Key]:
    """Return the names of the trainings that must be finished before a job."""
    step, *names = job.key
    if step == "pairs" and names[1] != CLASSICAL:
        return [("models", names[0], names[1])]
    if step == "strict":
        return [("models", model.protocol, model.name) for model in in_domain(job.plan, names[0])]
    if step == "monitor":
        return [("models", "strict", Model("strict", "mcd", names[0], job.plan.monitor_domain).name)]
    return []


def in_domain(plan: StudyPlan, domain: str) -> list[Model]:
    """Return the strict protocol's models of one domain."""
    return [Model("strict", variant, mixture, domain) for variant in VARIANTS for mixture in MIXTURES]


def do_job(job: Job) -> dict[str, Any]:
    """Return what a job found, as plain values."""
    work = {"models": _do_model, "pairs": _do_pair, "strict": _do_strict, "trade": _do_trade, "monitor": _do_monitor}
    return work[job.key[0]](job) | {"commits": list(code_version()["commits"])}


def model_of(plan: StudyPlan, protocol: str, name: str) -> Model:
    """Return the model of a name."""
    return next(model for model in models_of(plan, [protocol]) if model.name == name)


def _do_model(job: Job) -> dict[str, Any]:
    model = model_of(job.plan, *job.key[1:])
    config = config_of(job.plan, job.folder, model)
    return trained(config, weights_of(job.folder, model).parent, job.folder / "cache", job.device)


def _do_pair(job: Job) -> dict[str, Any]:
    _, protocol, name, domain = job.key
    setting = setting_of(job.plan, protocol, domain)
    if name == CLASSICAL:
        contestants = classical(setting)
    else:
        model = model_of(job.plan, protocol, name)
        runner = load_runner(weights_of(job.folder, model), job.device)
        contestants = {name: network(runner, setting, passes_of(job.plan, model), job.plan.test_seed)}
    sweeps = test_sweeps(job.plan, job.folder, setting, job.plan.pair_frames)
    return score_contestants(sweeps, contestants, setting.threshold)


def _do_strict(job: Job) -> dict[str, Any]:
    _, domain, number = job.key
    setting = setting_of(job.plan, "strict", domain)
    subject = subject_of(job.plan, job.folder, domain, int(number))
    runners = {model: load_runner(weights_of(job.folder, model), job.device) for model in in_domain(job.plan, domain)}
    field = field_of(setting, subject, strict_estimators(job.plan, setting, runners))
    return strict_line(job.plan, subject, field, (domain, int(number)))


def _do_trade(job: Job) -> dict[str, Any]:
    width, depth, cells = map(int, job.key[1:])
    config = trade_config(job.plan, job.folder, (width, depth, cells))
    done = trained(config, job.folder / "trade" / config.name, job.folder / "cache", job.device)
    return done | trade_line(job.plan, job.folder, config)


def _do_monitor(job: Job) -> dict[str, Any]:
    model = Model("strict", "mcd", job.key[1], job.plan.monitor_domain)
    runner = load_runner(weights_of(job.folder, model), job.device)
    return monitor_line(job.plan, job.folder, runner)


THREADS = "OMP_NUM_THREADS"
"""What tells a process how many threads a training has."""

Told = Callable[[str, int, int], None]
"""Is told the step, how many of its parts are there, and how many there are."""


@dataclass(frozen=True, slots=True)
class Scope:
    """What of a study is done, and with what.

    Attributes:
        steps: of ``STEPS``.
        protocols: of ``PROTOCOLS``.
        device: ``cpu`` or ``cuda``, for trainings and networks.
        workers: jobs under way at a time; None is one for each core.

    Raises:
        ValueError: a name is not known.
    """

    steps: tuple[str, ...] = STEPS
    protocols: tuple[str, ...] = PROTOCOLS
    device: str = "cpu"
    workers: int | None = None

    def __post_init__(self) -> None:
        for name, given, known in (("only", self.steps, STEPS), ("protocol", self.protocols, PROTOCOLS),
                                   ("device", (self.device,), ("cpu", "cuda"))):  # fmt: skip
            for word in given:
                if word not in known:
                    raise ValueError(f"{name} must be among {', '.join(known)}, got {word!r}")
        LocalEngine(self.workers)

    def engine(self, step: str, plan: StudyPlan) -> Engine:
        """Return what does the jobs of a step; what needs the GPU, processes of its own or all cores is done here."""
        alone = step == "trade" or (step == "models" and plan.workers > 0) or (self.device != "cpu" and step != "data")
        return LocalEngine(1 if alone else self.workers)


def run_steps(store: JobStore[StudyPlan], scope: Scope, told: Told) -> Iterator[str]:
    """Do what is not there yet, and yield one line for each job that failed or could not be done, as it happens.

    Args:
        store: of the study.
        scope: what of it is done.
        told: is told of what is there.

    Raises:
        ValueError: there is no such device, or data of another plan lie in the folder.
        ImportError: trainings are wanted and the extra for them is not installed.
        OSError: something cannot be written.
    """
    if {"models", "trade"} & set(scope.steps) or scope.device != "cpu":
        check_training(scope.device)
    if "data" in scope.steps:
        make_data(store, scope, told)
    working = [step for step in STEPS[1:-1] if step in scope.steps]
    if working:
        _check_data(store)
    for step in working:
        yield from run_step(store, scope, step, told)


def _check_data(store: JobStore[StudyPlan]) -> None:
    for domain in store.plan.domains:
        for split in SPLITS:
            try:
                open_archive(store.folder, domain, split)
            except (ValueError, OSError) as error:
                raise ValueError(f"{error}; the other steps need the step data") from error


def make_data(store: JobStore[StudyPlan], scope: Scope, told: Told) -> None:
    """Simulate the sweeps of all domains, as far as they are not there."""
    parts = [(domain, split) for domain in store.plan.domains for split in SPLITS]
    total, done = sum(preset_of(store.plan, *part).sweeps for part in parts), 0

    def more(sweeps: int) -> None:
        nonlocal done
        done += sweeps
        told("data", done, total)

    for part in parts:
        make_archive(store.plan, store.folder, part, scope.engine("data", store.plan), more)


def run_step(store: JobStore[StudyPlan], scope: Scope, step: str, told: Told) -> Iterator[str]:
    """Do the jobs of a step that are not there, and yield one line for each that failed or has nothing to start from.

    Args:
        store: of the study.
        scope: what of it is done.
        step: of ``STEPS``.
        told: is told of what is there.
    """
    done = store.keys()
    every = [Job(store.plan, store.folder, key, scope.device) for key in keys_of(store.plan, step, scope.protocols)]
    left = [job for job in every if job.key not in done]
    ready = [job for job in left if all(key in done for key in needed(job))]
    yield from (f"{' '.join(job.key)}: not all of its models are trained" for job in left if job not in ready)
    if every:
        told(step, len(every) - len(left), len(every))
        there = Counted(len(every) - len(left), len(every), lambda done, total: told(step, done, total))
        yield from run_jobs(store, do_job, ready, scope.engine(step, store.plan), there)


class Keyed(Protocol):
    """Work with a name."""

    @property
    def key(self) -> Key:
        """Its name."""
        ...


K = TypeVar("K", bound=Keyed)


@dataclass(slots=True)
class Counted:
    """How many jobs of a step are done, and who is told.

    Attributes:
        done: of them.
        total: how many there are.
        told: is given both after each job.
    """

    done: int
    total: int
    told: Callable[[int, int], None]

    def one_more(self) -> None:
        """Count a job."""
        self.done += 1
        self.told(self.done, self.total)


def run_jobs(
    store: JobStore[Any], work: Callable[[K], dict[str, Any]], jobs: Sequence[K], engine: Engine, there: Counted
) -> Iterator[str]:
    """Do jobs, keep what each finds, and yield one line for each that failed."""
    with _one_thread_each(engine), contextlib.closing(engine.run(work, jobs)) as run:
        for finished in run:
            key = jobs[finished.index].key
            if finished.result is None:
                yield f"{' '.join(key)}: {finished.error}"
            else:
                store.append(key, finished.result)
            there.one_more()


@contextlib.contextmanager
def _one_thread_each(engine: Engine) -> Iterator[None]:
    """Let processes that are started meanwhile use one thread each: several trainings share the cores."""
    before = os.environ.get(THREADS)
    if engine != LocalEngine(1):
        os.environ[THREADS] = "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(THREADS, None)
        else:
            os.environ[THREADS] = before


def named_steps(words: str | None) -> tuple[str, ...]:
    """Return the steps named with commas, all of them for none.

    >>> named_steps("data,models"), named_steps(None) == STEPS
    (('data', 'models'), True)
    """
    return STEPS if words is None else tuple(words.split(","))


def folder_of(out: Path) -> Path:
    """Return the folder of a study with its whole path: jobs may be done elsewhere."""
    return out.expanduser().resolve()
