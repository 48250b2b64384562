"""The jobs of the study: their names, what must be there before them, and the work of one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from viewshed.datasets.manifest import code_version
from viewshed.reproduce.contestants import classical, load_runner, network, passes_of, weights_of
from viewshed.reproduce.data import subject_of, test_sweeps
from viewshed.reproduce.models import config_of, trade_config, trained
from viewshed.reproduce.monitoring import monitor_line
from viewshed.reproduce.plan import StudyPlan
from viewshed.reproduce.protocols import MIXTURES, VARIANTS, Model, models_of, setting_of
from viewshed.reproduce.scoring import score_contestants
from viewshed.reproduce.store import Key
from viewshed.reproduce.strict import field_of, strict_estimators, strict_line
from viewshed.reproduce.trade import trade_line, trade_shapes

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
