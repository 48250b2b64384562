"""The jobs of the study: one a drive, whose evidence goes into a file, then one a score, trained on these files."""

from __future__ import annotations

import io
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from viewshed._files import write_atomic
from viewshed.monitor.score import EvidenceScore
from viewshed_lab._jobs import Engine
from viewshed_lab.studies.monitor.archive import FOLDER, SweepTable
from viewshed_lab.studies.monitor.drives import Drive, measure_drive
from viewshed_lab.studies.monitor.plan import ALL_FAMILIES, PUBLISHED, STEPS, MonitorPlan
from viewshed_lab.studies.plan import check_names
from viewshed_lab.studies.runner import Job, Progress, ignore_progress, lacking, run_jobs
from viewshed_lab.studies.store import JobResult, ResultStore

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from viewshed_lab.training.evidence_score import ScoreTrainer

SCORES = "scores"


def run_study(
    store: ResultStore[MonitorPlan],
    engine: Engine,
    steps: tuple[str, ...] = STEPS,
    on_progress: Progress = ignore_progress,
) -> Iterator[str]:
    """Do what is not there yet; yield one line for each job that failed.

    Args:
        store: of the study.
        engine: does the jobs.
        steps: of ``STEPS``.
        on_progress: is called after each job.

    Raises:
        ValueError: a step is not known.
        OSError: something cannot be written.
    """
    check_names("only", steps, STEPS)
    for folder in (FOLDER, SCORES):
        (store.folder / folder).mkdir(exist_ok=True)
    if "drives" in steps:
        yield from run_jobs(store, do_job, store.plan.drive_keys(), engine, on_progress, step="drives")
    if PUBLISHED in steps and (keys := store.plan.published_keys()):
        yield from run_jobs(store, do_job, keys[:1], engine, on_progress, step="published detector, fit")
        missing = lacking(set(keys[:1]), "fits of the published detector are not done")
        yield from run_jobs(store, do_job, keys[1:], engine, on_progress, step="published detector", missing=missing)
    if "score" in steps:
        needed = {key for key in store.plan.drive_keys() if key[2] == "train"}
        missing = lacking(needed, "drives to train on are not measured")
        keys = store.plan.score_keys()
        yield from run_jobs(store, do_job, keys, engine, on_progress, step="scores", missing=missing)


def do_job(job: Job[MonitorPlan]) -> JobResult:
    """Measure a drive in its cases, train a score, or ask the published detector, and write what was found."""
    if job.key[0] == "score":
        return _train(job)
    if job.key[0] == PUBLISHED:
        from viewshed_lab.studies.monitor.published import run_published

        return run_published(job)
    _, domain, split, number = job.key
    drive = Drive.simulate(job.plan, domain, split, int(number))
    found = measure_drive(drive, job.plan.cases_of(domain, split, int(number)))
    found.save(job.folder / FOLDER)
    return JobResult(facts={"file": found.file, "cases": len(found.cases), "refused": len(found.refused)})


def _train(job: Job[MonitorPlan]) -> JobResult:
    from viewshed_lab.studies.monitor.examples import is_trained_on

    table, trainer = _training(job.folder)
    left_out = job.key[1]
    chosen = is_trained_on(table, left_out)
    # Only the score of all families also learns where doubt comes from.
    sector_epochs = job.plan.epochs if left_out == ALL_FAMILIES else 1
    score = trainer.train(chosen, job.plan.epochs, job.plan.seed, sector_epochs=sector_epochs)
    save_score(score, score_path(job.folder, left_out))
    return JobResult(facts={"sweeps": int(chosen.sum())})


@lru_cache(maxsize=1)
def _training(folder: Path) -> tuple[SweepTable, ScoreTrainer]:
    """Return the drives to train on, and the trainer that knows their features."""
    from viewshed_lab.studies.monitor.examples import examples_of
    from viewshed_lab.training.evidence_score import ScoreTrainer

    table = SweepTable.read(folder, "train")
    return table, ScoreTrainer.of(examples_of(table))


def score_path(folder: Path, left_out: str) -> Path:
    """Return the file of the score that is trained without a family."""
    return folder / SCORES / f"{left_out}.npz"


def save_score(score: EvidenceScore, path: Path) -> None:
    """Write a score at once or not at all."""
    arrays: dict[str, NDArray[np.generic]] = score.arrays()
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    write_atomic(path, file.getvalue())


def load_score(path: Path) -> EvidenceScore:
    """Return a score that was written."""
    with np.load(path, allow_pickle=False) as file:
        return EvidenceScore.from_arrays({name: file[name] for name in file.files})
