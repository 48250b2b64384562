"""The jobs of the study: each simulates one drive once, and asks every field of view and every attack of it."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed._files import write_atomic
from viewshed._jobs import Engine
from viewshed.fusion.calibration import count_drive, highest_e_values, limits_of, model_of_counts
from viewshed.fusion.evidence import EvidenceCounts, EvidenceModel
from viewshed.studies.cases import generator
from viewshed.studies.plan import check_names
from viewshed.studies.runner import Job, Progress, ignore_progress, lacking, run_jobs
from viewshed.studies.store import JobResult, ResultStore
from viewshed.studies.tracks.drives import simulate_drive
from viewshed.studies.tracks.evaluate import evaluate, track_drive
from viewshed.studies.tracks.plan import BENIGN_CASE, STEPS, TracksPlan
from viewshed.threats.object_attacks import OBJECT_ATTACKS

MODELS = "models"
"""Folder of the calibrated models, one file for each field of view."""

COUNTS, HIGHEST = "counts", "highest"
"""Folders of counted evidence and of the highest e-values of honest tracks, a file for each drive and field of view."""


def run_study(
    store: ResultStore[TracksPlan],
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
    plan = store.plan
    for folder in (COUNTS, HIGHEST):
        (store.folder / folder).mkdir(exist_ok=True)
    for step, before in (("count", ()), ("limit", ("count",)), ("test", ("count", "limit"))):
        if step not in steps:
            continue
        needed = {key for earlier in before for key in plan.drive_keys(earlier)}
        missing = lacking(needed, "drives that it rests on are not done")
        yield from run_jobs(store, do_job, plan.drive_keys(step), engine, on_progress, step=step, missing=missing)


def do_job(job: Job[TracksPlan]) -> JobResult:
    """Simulate a drive, and count, take the highest e-values, or attack it."""
    step, _, _, number = job.key
    plan, facts = job.plan, dict[str, Any]()
    moments = list(simulate_drive(plan.scene(job.key), plan.fovs, plan.detector))
    for fov in plan.fovs:
        if step == "count":
            counts = EvidenceCounts()
            observed = (one.observed for one in track_drive(moments, fov))
            count_drive(observed, counts, generator(plan.seed, "elsewhere", number, fov))
            _save(job.folder / COUNTS / f"{fov}-{number}.npz", counts.arrays())
        elif step == "limit":
            observed = (one.observed for one in track_drive(moments, fov))
            highest = highest_e_values(observed, _without_limits(job.folder, plan, fov))
            _save(
                job.folder / HIGHEST / f"{fov}-{number}.npz", {"highest": np.array([*highest.values()]).reshape(-1, 3)}
            )
        else:
            facts[fov] = {case: _try(job, moments, fov, case) for case in plan.cases()}
    return JobResult(facts={"sweeps": len(moments), **facts})


def _try(job: Job[TracksPlan], moments: Any, fov: str, case: str) -> dict[str, Any]:
    """Return what became of a drive in a case with a field of view, as plain values."""
    plan, attack = job.plan, None
    if case != BENIGN_CASE:
        chosen = OBJECT_ATTACKS[case](counts="exact", mean_count=float(plan.objects))
        attack = chosen.begin(generator(plan.seed, *job.key, case))
    tracked = list(track_drive(moments, fov, attack))
    return evaluate(tracked, model_of(job.folder, plan, fov)).to_json()


@lru_cache(maxsize=8)
def _without_limits(folder: Path, plan: TracksPlan, fov: str) -> EvidenceModel:
    """Return the tables of a field of view from the drives that were counted."""
    counts = EvidenceCounts()
    for path in sorted((folder / COUNTS).glob(f"{fov}-*.npz")):
        with np.load(path, allow_pickle=False) as file:
            counts.add_arrays({name: file[name] for name in file.files})
    return model_of_counts(counts, plan.accused)


@lru_cache(maxsize=8)
def model_of(folder: Path, plan: TracksPlan, fov: str) -> EvidenceModel:
    """Return the calibrated model of a field of view.

    Raises:
        ValueError: too few honest tracks were seen for the share that may be accused.
    """
    highest: list[NDArray[np.float64]] = []
    for path in sorted((folder / HIGHEST).glob(f"{fov}-*.npz")):
        with np.load(path, allow_pickle=False) as file:
            highest.append(file["highest"])
    every = np.concatenate(highest) if highest else np.zeros((0, 3))
    model = _without_limits(folder, plan, fov)
    return replace(model, limits=limits_of(every, plan.accused), tracks=len(every))


def save_models(store: ResultStore[TracksPlan]) -> None:
    """Write the calibrated model of each field of view; that of the default one is what the package ships.

    Raises:
        ValueError: limits are not there yet.
        OSError: a file cannot be written.
    """
    (store.folder / MODELS).mkdir(exist_ok=True)
    for fov in store.plan.fovs:
        model_of(store.folder, store.plan, fov).save(store.folder / MODELS / f"{fov}.json")


def _save(path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    write_atomic(path, file.getvalue())
