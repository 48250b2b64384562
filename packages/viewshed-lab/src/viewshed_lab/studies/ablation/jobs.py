"""The ablation from start to end: trainings, then every variant and every classical estimator on the same sweeps."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from viewshed.estimators import CLASSICAL, Estimator
from viewshed.estimators.first_blocker import FirstBlocker
from viewshed.estimators.unet import LEARNED, PASSES, UnetEstimator
from viewshed.fov.visibility import TARGETS
from viewshed.networks.card import INT8
from viewshed.networks.runtime import OnnxRunner, load_runner
from viewshed.networks.weights import default_name, float32_name
from viewshed_lab._jobs import Engine
from viewshed_lab.data.presets import preset_named
from viewshed_lab.studies.ablation.evaluate import Enveloped, evaluate, evaluate_chosen, evaluation_of
from viewshed_lab.studies.ablation.plan import STEPS, WHOLE, AblationPlan
from viewshed_lab.studies.ablation.results import FLOAT, OURS, RIVAL, SEVERAL, SHADOW_MAP
from viewshed_lab.studies.paper.models import train
from viewshed_lab.studies.plan import check_names
from viewshed_lab.studies.runner import Job, Progress, ignore_progress, run_jobs
from viewshed_lab.studies.samples import StudySample, sample_of_preset
from viewshed_lab.studies.store import JobResult, ResultStore
from viewshed_lab.training.config import TrainConfig
from viewshed_lab.training.data import prepare
from viewshed_lab.training.sources import on_grid

VICTIMS = (OURS, "unet", SHADOW_MAP, RIVAL)
"""Against whom points are chosen, as far as they are there."""

WITH_HISTORY = (WHOLE, OURS, SHADOW_MAP)
"""Who is also given earlier sweeps."""

ENVELOPED = "whole, within first blocker"


def run_study(
    store: ResultStore[AblationPlan],
    engine: Engine,
    steps: tuple[str, ...] = STEPS,
    on_progress: Progress = ignore_progress,
) -> Iterator[str]:
    """Do what is not done yet of some of ``STEPS``, and yield one line for each job that failed."""
    check_names("only", steps, STEPS)
    models = set(store.plan.job_keys_of("models"))
    for step in STEPS[:-1]:
        if step in steps:
            keys, done = store.plan.job_keys_of(step), store.keys()
            if step == "models" and not models <= done:
                # Most variants share the frames of the whole network: these are made with all cores.
                prepare(store.plan.config_of(WHOLE), cache_of(store.folder), on_progress=on_progress)
            if step == "validation" and not models <= done:
                yield "validation: not all variants are trained"
                continue
            yield from run_jobs(store, do_job, keys, engine, on_progress, step=step)


def cache_of(folder: Path) -> Path:
    """Return the folder of simulated sweeps and kept frames."""
    return folder / "cache"


def weights_of(folder: Path, variant: str) -> Path:
    """Return the file of the weights of a variant."""
    return folder / "models" / variant / "network.onnx"


def do_job(job: Job[AblationPlan]) -> JobResult:
    """Return what a job found."""
    works = {"models": _train, "chosen": _choose}
    return works.get(job.key[0], _evaluate)(job)


def _train(job: Job[AblationPlan]) -> JobResult:
    variant = job.key[1]
    out = weights_of(job.folder, variant).parent
    return JobResult(facts=train(job.plan.config_of(variant), out, cache_of(job.folder), "cpu"))


def _evaluate(job: Job[AblationPlan]) -> JobResult:
    plan, (split, setting, chunk) = job.plan, job.key
    config, first = plan.config_in(setting), int(chunk) * plan.chunk
    numbers = range(first, min(first + plan.chunk, plan.count(split, setting)))
    samples = {number: sample_in(plan, split, setting, number) for number in numbers}
    networks = _variants(plan, job.folder) if split == "validation" else _shipped(config)
    every, target = networks | _classical(config), TARGETS[config.target]
    return JobResult(evaluate(samples, every, setting, plan.seed_of(split), target, WITH_HISTORY))


def _choose(job: Job[AblationPlan]) -> JobResult:
    plan, (_, setting, number) = job.plan, job.key
    config = plan.config_in(setting)
    every = _shipped(config) | _classical(config)
    victims = {name: every[name] for name in VICTIMS if name in every}
    queries = {name: plan.queries if name == OURS else plan.queries[:1] for name in victims}
    sample = sample_in(plan, "test", setting, int(number))
    evaluation = evaluation_of(sample, victims, setting, int(number), plan.test_seed, TARGETS[config.target])
    return JobResult(list(evaluate_chosen(evaluation, queries, plan.test_seed)))


def sample_in(plan: AblationPlan, split: str, setting: str, number: int) -> StudySample:
    """Return one sweep of a split of a setting, with its truth on the grid that counts there."""
    preset = on_grid(preset_named(plan.preset_in(setting)), plan.config_in(setting))
    return sample_of_preset(preset, number, plan.count(split, setting), plan.seed_of(split))


def _variants(plan: AblationPlan, folder: Path) -> dict[str, Estimator]:
    networks: dict[str, Estimator] = {
        name: UnetEstimator(OnnxRunner(weights_of(folder, name), threads=1), name=name) for name in plan.variants
    }
    bound = FirstBlocker(plan.config_of(WHOLE).grid, limit_farthest=False)
    return networks | {ENVELOPED: Enveloped(networks[WHOLE], bound)}


def _shipped(config: TrainConfig) -> dict[str, Estimator]:
    """Return the learned estimators with the weights that are shipped for the grid and the target of a config."""
    found: dict[str, Estimator] = {}
    for method in LEARNED:
        try:
            name = default_name(method, config.grid, config.target)
        except ValueError:  # none is shipped for this grid and target
            continue
        runner = load_runner(name, threads=1)
        found[method] = UnetEstimator(runner, PASSES if method == "mc_dropout" else 1, name=method)
        if method == OURS and runner.card.precision == INT8:
            found[FLOAT] = UnetEstimator(load_runner(float32_name(name), threads=1), name=FLOAT)
        if method == OURS and runner.card.shape.dropout:
            found[SEVERAL] = UnetEstimator(runner, PASSES, name=SEVERAL)
    return found


def _classical(config: TrainConfig) -> dict[str, Estimator]:
    target = TARGETS[config.target]
    return {name: make(config.grid, target) for name, make in CLASSICAL.items()}
