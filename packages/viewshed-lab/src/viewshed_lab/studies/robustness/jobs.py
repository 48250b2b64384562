"""The jobs of the robustness study: one per sample and part."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache, partial

from viewshed_lab._jobs import Engine
from viewshed_lab.studies.cases import case_generator
from viewshed_lab.studies.evaluate import AdaptiveEvaluation, Evaluation, Reference, defense_of
from viewshed_lab.studies.records import PAPER, STRICT
from viewshed_lab.studies.robustness.plan import RobustnessPlan
from viewshed_lab.studies.runner import Job, Progress, run_jobs
from viewshed_lab.studies.samples import StudySample, sample_of
from viewshed_lab.studies.store import JobResult, ResultStore
from viewshed_lab.studies.suite import paper_suite, strict_suite


def run_study(
    store: ResultStore[RobustnessPlan], engine: Engine, on_progress: Progress = lambda *_: None
) -> Iterator[str]:
    """Run the jobs that are not in the store; yield one line for each failed job."""
    return run_jobs(store, do_job, store.plan.job_keys(), engine, on_progress, step=store.plan.name)


def do_job(job: Job[RobustnessPlan]) -> JobResult:
    """Evaluate every estimator on one sample in the cases of one part."""
    part, cases = job.key[0], job.plan.cases(job.key[0])
    evaluation = evaluation_of(job)
    if part != "adaptive":
        return JobResult(list(evaluation.rows(cases)))
    adaptive = AdaptiveEvaluation(evaluation, job.plan.adaptive_queries, job.plan.adaptive_defended)
    return JobResult(list(adaptive.rows(cases)))


def evaluation_of(job: Job[RobustnessPlan]) -> Evaluation:
    """Return the evaluation of a job: its sample, with the estimators, truth and defenses of its part."""
    plan, (part, domain, number) = job.plan, job.key
    sample = _sample(domain, int(number), plan.count(domain), plan.seed)
    rng_of = partial(case_generator, plan.seed, domain, int(number))
    if part == "paper":
        suite = paper_suite(sample.truth.grid.half_extent_m)
        return Evaluation(sample, suite, Reference.label(sample, suite.grid), domain, int(number), rng_of, PAPER)
    suite = strict_suite(sample.truth.grid, plan.defended if part == "defenses" else ())
    defenses = {name: defense_of(name, sample) for name in plan.defenses} if part in ("defenses", "adaptive") else {}
    return Evaluation(sample, suite, Reference.exact(sample), domain, int(number), rng_of, STRICT, defenses)


@lru_cache(maxsize=2)
def _sample(domain: str, number: int, count: int, seed: int) -> StudySample:
    """Return a sample, cached as one worker often gets several parts of it."""
    return sample_of(domain, number, count, seed)
