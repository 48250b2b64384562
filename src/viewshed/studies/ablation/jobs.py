"""The ablation from start to end: trainings, then every variant and every classical estimator on the same sweeps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from viewshed._jobs import LocalEngine
from viewshed.datasets.archive.schema import code_version
from viewshed.datasets.presets import preset_named
from viewshed.estimators import CLASSICAL, Estimator
from viewshed.estimators.first_blocker import FirstBlocker
from viewshed.estimators.unet import LEARNED, PASSES, UnetEstimator
from viewshed.fov.visibility import TARGETS
from viewshed.networks.card import INT8
from viewshed.networks.runtime import OnnxRunner, load_runner
from viewshed.networks.weights import default_name, float32_name
from viewshed.studies.ablation.contest import Enveloped, duels, score
from viewshed.studies.ablation.plan import WHOLE, AblationPlan
from viewshed.studies.ablation.results import FLOAT, OURS, RIVAL, SEVERAL, SHADOW_MAP
from viewshed.studies.paper.jobs import Counted, run_jobs
from viewshed.studies.paper.models import trained
from viewshed.studies.paper.store import JobStore, Key
from viewshed.studies.suite import Subject, subject_of_preset
from viewshed.training.config import TrainConfig
from viewshed.training.data import prepare
from viewshed.training.sources import on_grid

STEPS = ("models", "validation", "test", "chosen", "page")
"""What the command does, in order."""

VICTIMS = (OURS, "unet", SHADOW_MAP, RIVAL)
"""Against whom points are chosen, as far as they are there."""

REMEMBERING = (WHOLE, OURS, SHADOW_MAP)
"""Who is also told of the past."""

ENVELOPED = "whole, within first blocker"

Told = Callable[[str, int, int], None]
"""Is told the step, how many of its parts are there, and how many there are."""


@dataclass(frozen=True, slots=True)
class Job:
    """One line of results that is to be found.

    Attributes:
        plan: of the ablation.
        folder: of the ablation.
        key: its step, and what tells it from the others of that step.
    """

    plan: AblationPlan
    folder: Path
    key: Key


def keys_of(plan: AblationPlan, step: str) -> list[Key]:
    """Return the names of all jobs of a step, in the order in which they are done."""
    if step == "models":
        return [("models", name) for name in plan.variants]
    if step == "chosen":
        return [(step, plan.config, str(number)) for number in range(plan.chosen_sweeps)]
    settings = plan.settings if step == "test" else (plan.config,)
    chunks = {setting: -(-plan.count(step, setting) // plan.chunk) for setting in settings}
    return [(step, setting, str(number)) for setting in settings for number in range(chunks[setting])]


def run_steps(store: JobStore[AblationPlan], steps: tuple[str, ...], workers: int | None, told: Told) -> Iterator[str]:
    """Do what is not there yet, and yield one line for each job that failed.

    Args:
        store: of the ablation.
        steps: of ``STEPS``.
        workers: processes; None is one for each core.
        told: is told of what is there.

    Raises:
        ValueError: a step is not known.
        ImportError: trainings are wanted and the extra for them is not installed.
        OSError: something cannot be written.
    """
    for step in steps:
        if step not in STEPS:
            raise ValueError(f"only must be among {', '.join(STEPS)}, got {step!r}")
    for step in STEPS[:-1]:
        if step in steps:
            yield from _run_step(store, step, workers, told)


def _run_step(store: JobStore[AblationPlan], step: str, workers: int | None, told: Told) -> Iterator[str]:
    keys, done = keys_of(store.plan, step), store.keys()
    ready = [Job(store.plan, store.folder, key) for key in keys if key not in done]
    if step == "models" and ready:
        _keep_frames(store, told)
    if step == "validation" and not {("models", name) for name in store.plan.variants} <= done:
        yield "validation: not all variants are trained"
        return
    told(step, len(keys) - len(ready), len(keys))
    there = Counted(len(keys) - len(ready), len(keys), lambda done, total: told(step, done, total))
    yield from run_jobs(store, do_job, ready, LocalEngine(workers), there)


def _keep_frames(store: JobStore[AblationPlan], told: Told) -> None:
    """Make the frames of the whole network, which most variants share, with all cores."""
    prepare(store.plan.config_of(WHOLE), cache_of(store.folder), on_progress=told)


def cache_of(folder: Path) -> Path:
    """Return where simulated sweeps and kept frames are."""
    return folder / "cache"


def weights_of(folder: Path, variant: str) -> Path:
    """Return where the weights of a variant are."""
    return folder / "models" / variant / "network.onnx"


def do_job(job: Job) -> dict[str, Any]:
    """Return what a job found, as plain values."""
    works = {"models": _train, "chosen": _choose}
    return works.get(job.key[0], _score)(job) | {"commits": list(code_version()["commits"])}


def _train(job: Job) -> dict[str, Any]:
    variant = job.key[1]
    out = weights_of(job.folder, variant).parent
    return trained(job.plan.config_of(variant), out, cache_of(job.folder), "cpu")


def _score(job: Job) -> dict[str, Any]:
    plan, (split, setting, chunk) = job.plan, job.key
    config, first = plan.config_in(setting), int(chunk) * plan.chunk
    numbers = range(first, min(first + plan.chunk, plan.count(split, setting)))
    subjects = {number: subject_in(plan, split, setting, number) for number in numbers}
    estimators = _variants(plan, job.folder) if split == "validation" else _shipped(config)
    every, target = estimators | _classical(config), TARGETS[config.target]
    return {"said": score(subjects, every, plan.seed_of(split), target, REMEMBERING)}


def _choose(job: Job) -> dict[str, Any]:
    plan, (_, setting, number) = job.plan, job.key
    config = plan.config_in(setting)
    there = _shipped(config) | _classical(config)
    victims = {name: there[name] for name in VICTIMS if name in there}
    questions = {name: plan.questions if name == OURS else plan.questions[:1] for name in victims}
    subject = subject_in(plan, "test", setting, int(number))
    return {"said": duels(subject, victims, questions, (plan.test_seed, int(number)), TARGETS[config.target])}


def subject_in(plan: AblationPlan, split: str, setting: str, number: int) -> Subject:
    """Return one sweep of a split of a setting, with its truth on the grid that counts there."""
    preset = on_grid(preset_named(plan.preset_in(setting)), plan.config_in(setting))
    return subject_of_preset(preset, number, plan.count(split, setting), plan.seed_of(split))


def _variants(plan: AblationPlan, folder: Path) -> dict[str, Estimator]:
    found: dict[str, Estimator] = {
        name: UnetEstimator(OnnxRunner(weights_of(folder, name), threads=1), name=name) for name in plan.variants
    }
    bound = FirstBlocker(plan.config_of(WHOLE).grid, limit_farthest=False)
    return found | {ENVELOPED: Enveloped(found[WHOLE], bound)}


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
