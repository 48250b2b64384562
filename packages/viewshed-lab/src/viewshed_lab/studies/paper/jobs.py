"""The jobs of the study, step by step: data, trainings, pairs, every attack, trade study, monitor."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

from viewshed.estimators import Estimator
from viewshed.estimators.unet import UnetEstimator
from viewshed.monitor.deviation import DeviationMonitor
from viewshed.networks.card import Runner
from viewshed.preprocess.leveling import level
from viewshed.sweep import Sweep
from viewshed_lab._jobs import Engine, LocalEngine
from viewshed_lab.data.simulated import recipe_of
from viewshed_lab.studies.cases import DEFAULT, apply, corruption_cases, generator, strength_cases
from viewshed_lab.studies.evaluate import Evaluation
from viewshed_lab.studies.paper.data import SPLITS, evaluation_of, held_out, make_archive, open_archive, preset_of
from viewshed_lab.studies.paper.models import (
    WEIGHTS,
    NetworkAlone,
    check_training,
    config_of,
    crossval_config,
    load_runner,
    network_of,
    passes_of,
    trade_config,
    train,
    weights_of,
)
from viewshed_lab.studies.paper.monitor import watch
from viewshed_lab.studies.paper.plan import CLASSICAL, MIXTURES, PROTOCOLS, STEPS, VARIANTS, Model, PaperPlan
from viewshed_lab.studies.paper.protocols import ProtocolSetting, setting_of
from viewshed_lab.studies.plan import JobKey, check_names
from viewshed_lab.studies.records import BENIGN, STRICT, Case, Row, pool
from viewshed_lab.studies.runner import Job, Progress, run_jobs
from viewshed_lab.studies.store import JobResult, ResultStore
from viewshed_lab.studies.suite import EstimatorSuite
from viewshed_lab.threats.attacks import ATTACKS
from viewshed_lab.threats.attacks.base import Tampered
from viewshed_lab.training.data import Fold

ATTACKED = Case("attack", "adversarial")
"""The attacked case of the pairs: in the paper's protocol its mixture, in the strict one all attacks in turn."""

TRADE = "trade"
"""Protocol of the rows of the trade study: the paper's, on grids of other resolutions."""

THREADS = (2, 1)
"""Numbers of threads for which the trade study measures latency."""


def strict_cases(plan: PaperPlan) -> list[Case]:
    """Return the cases: benign, every attack with its default budget, and its strengths if the plan has them."""
    strengths = [case for name in ATTACKS for case in strength_cases(name)] if plan.strengths else []
    return [BENIGN, *(Case("attack", name, DEFAULT) for name in ATTACKS), *strengths]


def do_job(job: Job[PaperPlan]) -> JobResult:
    """Run a job of any step."""
    works = {
        "crossval": _fold, "models": _train, "pairs": _pair, "strict": _strict, "trade": _trade, "monitor": _monitor,
    }  # fmt: skip
    return works[job.key[0]](job)


def _fold(job: Job[PaperPlan]) -> JobResult:
    config, fold = crossval_config(job.plan, job.folder, job.key), Fold(int(job.key[-1]), job.plan.crossval_folds)
    out = job.folder / "crossval" / config.name / f"fold-{fold.number}"
    return JobResult(facts=train(config, out, job.folder / "cache", job.device, fold))


def _train(job: Job[PaperPlan]) -> JobResult:
    model = job.plan.model(*job.key[1:])
    config = config_of(job.plan, job.folder, model)
    out = weights_of(job.folder, model).parent
    return JobResult(facts=train(config, out, job.folder / "cache", job.device))


def _pair(job: Job[PaperPlan]) -> JobResult:
    _, protocol, name, domain, part = job.key
    setting = setting_of(job.plan, protocol, domain)
    estimators: dict[str, Estimator] = {
        name: network_of(job.plan, job.folder, job.plan.model(protocol, name), setting, job.device)
    } if name != CLASSICAL else {name: make(setting.grid) for name, make in setting.classical().items()}  # fmt: skip
    numbers = job.plan.parts(domain, job.plan.is_mcd(name))[int(part)]
    begun_s = time.perf_counter()
    rows = pair_rows(job.plan, job.folder, setting, setting.suite(estimators), numbers)
    return JobResult(rows, {"seconds": time.perf_counter() - begun_s})


def pair_rows(
    plan: PaperPlan, folder: Path, setting: ProtocolSetting, suite: EstimatorSuite, numbers: Sequence[int]
) -> list[Row]:
    """Return rows with the counts of some held-out sweeps, benign and attacked, and rows with their pooled scores."""
    counts: list[Row] = []
    scores: list[Row] = []
    for number in numbers:
        evaluation = evaluation_of(plan, folder, setting, suite, number)
        for row in both_rows(evaluation, setting.attack(number), plan.test_seed):
            (scores if "scores" in row else counts).append(row)
    return counts + pool(scores)


def both_rows(evaluation: Evaluation, attack: Case, seed: int) -> Iterator[Row]:
    """Yield rows with counts and scores of a sweep, benign and attacked."""
    sweeps = {BENIGN: evaluation.sample.sweep, ATTACKED: tampered_of(evaluation, attack, seed).sweep}
    for case, sweep in sweeps.items():
        for name, estimate in evaluation.suite.estimates(level(sweep, evaluation.suite.grid)).items():
            yield from evaluation.compare(name, case, estimate, None)
            scores = evaluation.reference.scores(estimate, evaluation.reference.known)
            yield evaluation.row(name, case, scores=scores)


def tampered_of(evaluation: Evaluation, attack: Case, seed: int) -> Tampered:
    """Return a held-out sweep of the pairs after an attack."""
    rng = generator(seed, evaluation.protocol, evaluation.domain, str(evaluation.number))
    return apply(attack, evaluation.sample, rng)


def _strict(job: Job[PaperPlan]) -> JobResult:
    _, domain, number = job.key
    setting = setting_of(job.plan, STRICT, domain)
    runners = {model: load_runner(weights_of(job.folder, model), job.device) for model in in_domain(domain)}
    suite = setting.suite(strict_estimators(job.plan, setting, runners))
    evaluation = evaluation_of(job.plan, job.folder, setting, suite, int(number))
    return JobResult(list(evaluation.rows(strict_cases(job.plan), untouched=True)))


def strict_estimators(plan: PaperPlan, setting: ProtocolSetting, runners: dict[Model, Runner]) -> dict[str, Estimator]:
    """Return the estimators of the step ``strict`` by name: networks of the domain, then the classical ones."""
    networks: dict[str, Estimator] = {
        model.short_name: UnetEstimator(runner, passes_of(plan, model), plan.test_seed, model.short_name)
        for model, runner in runners.items()
    }
    return networks | {name: make(setting.grid) for name, make in setting.classical().items()}


def in_domain(domain: str) -> list[Model]:
    """Return the strict protocol's models of one domain."""
    return [Model(STRICT, variant, mixture, domain) for variant in VARIANTS for mixture in MIXTURES]


def _trade(job: Job[PaperPlan]) -> JobResult:
    """Train a network of another width, depth and resolution; return its scores, latency and size."""
    from viewshed.networks.runtime import OnnxRunner

    plan, (width, depth, cells) = job.plan, map(int, job.key[1:])
    config = trade_config(plan, job.folder, (width, depth, cells))
    out = job.folder / "trade" / config.name
    facts = train(config, out, job.folder / "cache", job.device)
    setting = replace(setting_of(plan, "paper", plan.trade_domain), grid=config.grid)
    networks = {}
    for threads in THREADS:
        runner = OnnxRunner(out / WEIGHTS, threads=threads, engine="onnxruntime")
        networks[threads] = NetworkAlone(runner, setting.card(runner.card), 1, 0)
    suite, rows = setting.suite({config.name: networks[2]}), list[Row]()
    for number in plan.parts(plan.trade_domain, mcd=False)[0]:
        evaluation = replace(evaluation_of(plan, job.folder, setting, suite, number), protocol=TRADE)
        estimate = networks[2].estimate(evaluation.sample.sweep)
        rows += evaluation.compare(config.name, BENIGN, estimate, None)
    sample = held_out(plan, job.folder, setting.domain, 0)
    latency = {str(n): _latency_ms(network, sample.sweep, plan.trade_repeats) for n, network in networks.items()}
    size = {"parameters": config.shape.parameters, "flops": config.shape.flops(config.cells), "name": config.name}
    return JobResult(rows, facts | size | {"latency_ms": latency})


def _latency_ms(network: NetworkAlone, sweep: Sweep, repeats: int) -> float:
    """Return the median time of one pass through the network in milliseconds, without preparing its input."""
    inputs = network.card.input_of(sweep)[None]
    times = []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        network.runner.run(inputs)
        times.append(1e3 * (time.perf_counter() - start))
    return median(times[1:])


def _monitor(job: Job[PaperPlan]) -> JobResult:
    """Fit, calibrate and evaluate the deviation monitor on different held-out scenes."""
    plan = job.plan
    model = Model(STRICT, "mcd", job.key[1], plan.monitor_domain)
    runner = load_runner(weights_of(job.folder, model), job.device)
    estimator = UnetEstimator(runner, plan.passes, plan.test_seed, "mcd")
    fit, calibrate, report = (
        [held_out(plan, job.folder, plan.monitor_domain, part * plan.monitor_frames + n)
         for n in range(plan.monitor_frames)]
        for part in range(3)
    )  # fmt: skip
    monitor = DeviationMonitor.fit(estimator.estimate(sample.sweep) for sample in fit)
    benign = (estimator.estimate(sample.sweep) for sample in calibrate)
    monitor = monitor.calibrated(benign, plan.monitor_false_alarms)
    cases = [BENIGN, *(Case("attack", name, DEFAULT) for name in ATTACKS),
             *corruption_cases(plan.monitor_corruptions, (plan.monitor_severity,))]  # fmt: skip
    of: dict[str, Any] = {"domain": plan.monitor_domain, "method": job.key[1], "seed": plan.test_seed}
    by_sample = [watch(monitor, estimator, sample, cases, number, **of) for number, sample in enumerate(report)]
    return JobResult([row for rows in by_sample for row in rows], {"limit": monitor.limit})


@dataclass(frozen=True, slots=True)
class Scope:
    """Steps and protocols to run, and the hardware."""

    steps: tuple[str, ...] = STEPS  # of ``STEPS``
    protocols: tuple[str, ...] = PROTOCOLS  # of ``PROTOCOLS``
    device: str = "cpu"  # ``cpu`` or ``cuda``, for trainings and networks
    workers: int | None = None  # number of parallel jobs; None is one per core

    def __post_init__(self) -> None:
        for name, given, known in (("only", self.steps, STEPS), ("protocol", self.protocols, PROTOCOLS),
                                   ("device", (self.device,), ("cpu", "cuda"))):  # fmt: skip
            check_names(name, given, known)
        LocalEngine(self.workers)

    def engine(self, step: str, plan: PaperPlan) -> Engine:
        """Return the engine of a step; jobs that need the GPU, own processes or all cores run in this process."""
        alone = (
            step == "trade"
            or (step in ("crossval", "models") and plan.workers > 0)
            or (self.device != "cpu" and step != "data")
        )
        return LocalEngine(1 if alone else self.workers)


def run_study(store: ResultStore[PaperPlan], scope: Scope, on_progress: Progress = lambda *_: None) -> Iterator[str]:
    """Run the unfinished jobs; yield one line for each job that failed or had to wait, as it happens."""
    if {"crossval", "models", "trade"} & set(scope.steps) or scope.device != "cpu":
        check_training(scope.device)
    if "data" in scope.steps:
        make_data(store, scope, on_progress)
    steps = [step for step in STEPS[1:-1] if step in scope.steps]
    if steps:
        _check_data(store)
    for step in steps:
        keys, engine = store.plan.job_keys_of(step, scope.protocols), scope.engine(step, store.plan)
        yield from run_jobs(
            store, do_job, keys, engine, on_progress, step=step, device=scope.device,
            missing=partial(missing_models, store.plan),
        )  # fmt: skip


def missing_models(plan: PaperPlan, key: JobKey, done: set[JobKey]) -> str:
    """Return which trainings a job waits for, as text; an empty string if all are done."""
    if set(needed(plan, key)) <= done:
        return ""
    return "not all folds are done" if key[0] in ("models", "trade") else "not all of its models are trained"


def needed(plan: PaperPlan, key: JobKey) -> list[JobKey]:
    """Return the keys of the trainings that must be finished before a job."""
    step, *names = key
    if step in ("models", "trade"):
        return plan.job_keys_of("crossval")
    if step == "pairs" and names[1] != CLASSICAL:
        return [("models", names[0], names[1])]
    if step == "strict":
        return [model.key for model in in_domain(names[0])]
    if step == "monitor":
        return [Model(STRICT, "mcd", names[0], plan.monitor_domain).key]
    return []


def _check_data(store: ResultStore[PaperPlan]) -> None:
    for domain in store.plan.domains:
        for split in SPLITS:
            try:
                archive = open_archive(store.folder, domain, split)
            except (ValueError, OSError) as error:
                raise ValueError(f"{error}; the other steps need the step data") from error
            if archive.manifest.recipe != recipe_of(preset_of(store.plan, domain, split)):
                raise ValueError(
                    f"{archive.store.place} must be made as the plan {store.plan.name} says, got sweeps of another"
                    " recipe; move it away and run the step data"
                )


def make_data(store: ResultStore[PaperPlan], scope: Scope, on_progress: Progress) -> None:
    """Simulate the missing sweeps of all domains."""
    parts = [(domain, split) for domain in store.plan.domains for split in SPLITS]
    total, done = sum(preset_of(store.plan, *part).sweeps for part in parts), 0

    def more(sweeps: int) -> None:
        nonlocal done
        done += sweeps
        on_progress("data", done, total)

    for part in parts:
        make_archive(store.plan, store.folder, part, scope.engine("data", store.plan), more)
