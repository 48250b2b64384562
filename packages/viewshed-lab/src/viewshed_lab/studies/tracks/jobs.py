"""The jobs of the study: each simulates one drive once, and tries every field of view and every attack on it."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed._files import write_atomic
from viewshed.objects.calibration import count_drive, highest_e_values, limits_of, model_of_counts
from viewshed.objects.evidence import EvidenceCounts, EvidenceModel
from viewshed.objects.tracker import Rules
from viewshed_lab._jobs import Engine
from viewshed_lab.studies.cases import generator
from viewshed_lab.studies.plan import check_names
from viewshed_lab.studies.runner import Job, Progress, ignore_progress, lacking, run_jobs
from viewshed_lab.studies.store import JobResult, ResultStore
from viewshed_lab.studies.tracks.drives import RULES, Moment, simulate_drive
from viewshed_lab.studies.tracks.evaluate import evaluate, track_drive, tracking_gospa_m, tracks_of_objects
from viewshed_lab.studies.tracks.lidar_level import SweepForger
from viewshed_lab.studies.tracks.plan import BENIGN_CASE, STEPS, TracksPlan
from viewshed_lab.studies.tracks.published import PublishedRules
from viewshed_lab.threats.object_attacks import OBJECT_ATTACKS

MODELS = "models"
"""Folder of the calibrated models, one file for each field of view."""

COUNTS, HIGHEST = "counts", "highest"
"""Folders of counted evidence and of the highest e-values of honest tracks, a file for each drive and field of view."""

COASTING = "coasting"
"""Folder of the GOSPA of the published rules by coasting time."""

COASTING_S = (0.5, 1.0, 2.0, 3.0, 5.0)
"""Coasting times that the published rules are tried with."""

LIDAR_FOVS = ("none", "published", "default")
"""Fields of view that look at forged sweeps."""

PUBLISHED = "published"
"""The field of view whose tracks the published rules make."""


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
    for folder in (COUNTS, HIGHEST, COASTING):
        (store.folder / folder).mkdir(exist_ok=True)
    before = {"count": (), "limit": ("count",), "test": ("count", "limit"), "lidar": ("count", "limit")}
    for step, earlier in before.items():
        if step not in steps:
            continue
        needed = {key for each in earlier for key in plan.drive_keys(each)}
        missing = lacking(needed, "drives that it rests on are not done")
        yield from run_jobs(store, do_job, plan.drive_keys(step), engine, on_progress, step=step, missing=missing)


def do_job(job: Job[TracksPlan]) -> JobResult:
    """Simulate a drive, and count, take the highest e-values, or attack it."""
    step, detector, _, _, number = job.key[:5]
    plan, facts = job.plan, dict[str, Any]()
    forger, fovs = None, plan.fovs
    if step == "lidar":
        attack = job.key[5]
        forger = SweepForger(attack, generator(plan.seed, *job.key))
        fovs = tuple(fov for fov in fovs if fov in LIDAR_FOVS)
    moments = list(simulate_drive(plan.scene(job.key), fovs, detector, forger=forger))
    for fov in fovs:
        name = f"{detector}-{fov}-{number}.npz"
        if step == "count":
            if fov == PUBLISHED:
                _save(job.folder / COASTING / name, {"gospa_m": _gospa_by_coasting(moments)})
            counts, rules = EvidenceCounts(), PublishedRules() if fov == PUBLISHED else RULES[detector]
            observed = (one.observed for one in track_drive(moments, fov, rules=rules))
            count_drive(observed, counts, generator(plan.seed, "elsewhere", number, fov))
            _save(job.folder / COUNTS / name, counts.arrays())
        elif step == "limit":
            tracked = list(track_drive(moments, fov, rules=rules_of(job.folder, detector, fov)))
            model = _without_limits(job.folder, plan, detector, fov)
            of_objects = tracks_of_objects(tracked)
            highest = highest_e_values((one.observed for one in tracked), model)
            honest = [values for number, values in highest.items() if number in of_objects]
            _save(job.folder / HIGHEST / name, {"highest": np.array(honest).reshape(-1, 3)})
        elif step == "test":
            facts[fov] = {case: _try(job, moments, fov, case) for case in plan.cases()}
        else:
            facts[fov] = {attack: _try(job, moments, fov, BENIGN_CASE)}
    return JobResult(facts={"sweeps": len(moments), **facts})


def _try(job: Job[TracksPlan], moments: Sequence[Moment], fov: str, case: str) -> dict[str, Any]:
    """Return what became of a drive in a case with a field of view, as plain values."""
    plan, attack, detector = job.plan, None, job.key[1]
    if case != BENIGN_CASE:
        chosen = OBJECT_ATTACKS[case](counts="exact", mean_count=float(plan.objects))
        attack = chosen.begin(generator(plan.seed, *job.key, case))
    tracked = list(track_drive(moments, fov, attack, rules_of(job.folder, detector, fov)))
    return evaluate(tracked, model_of(job.folder, plan, detector, fov)).to_json()


def _gospa_by_coasting(moments: Sequence[Moment]) -> NDArray[np.float64]:
    """Return the GOSPA of a drive in meters with the published rules, for each of ``COASTING_S``."""
    every = [PublishedRules(coast_s=coast_s) for coast_s in COASTING_S]
    return np.array([tracking_gospa_m(track_drive(moments, PUBLISHED, rules=rules)) for rules in every])


@lru_cache(maxsize=8)
def rules_of(folder: Path, detector: str, fov: str) -> Rules:
    """Return the rules of a tracker: the published ones with the coasting time that was best on other drives.

    Raises:
        ValueError: no drive was counted yet.
    """
    if fov != PUBLISHED:
        return RULES[detector]
    by_drive = []
    for path in sorted((folder / COASTING).glob(f"{detector}-{fov}-*.npz")):
        with np.load(path, allow_pickle=False) as file:
            by_drive.append(file["gospa_m"])
    if not by_drive:
        raise ValueError(f"{folder / COASTING} must hold counted drives, got none; run the step count")
    return PublishedRules(coast_s=COASTING_S[int(np.mean(by_drive, axis=0).argmin())])


@lru_cache(maxsize=8)
def _without_limits(folder: Path, plan: TracksPlan, detector: str, fov: str) -> EvidenceModel:
    """Return the tables of a field of view from the drives that were counted."""
    counts = EvidenceCounts()
    for path in sorted((folder / COUNTS).glob(f"{detector}-{fov}-*.npz")):
        with np.load(path, allow_pickle=False) as file:
            counts.add_arrays({name: file[name] for name in file.files})
    return model_of_counts(counts, plan.accused)


@lru_cache(maxsize=8)
def model_of(folder: Path, plan: TracksPlan, detector: str, fov: str) -> EvidenceModel:
    """Return the calibrated model of a field of view.

    Raises:
        ValueError: too few honest tracks were seen for the share that may be accused.
    """
    highest: list[NDArray[np.float64]] = []
    for path in sorted((folder / HIGHEST).glob(f"{detector}-{fov}-*.npz")):
        with np.load(path, allow_pickle=False) as file:
            highest.append(file["highest"])
    every = np.concatenate(highest) if highest else np.zeros((0, 3))
    model = _without_limits(folder, plan, detector, fov)
    return replace(model, limits=limits_of(every, plan.accused), tracks=len(every))


def save_models(store: ResultStore[TracksPlan]) -> None:
    """Write the calibrated model of each field of view; that of the default one is what the package ships.

    Raises:
        ValueError: limits are not there yet.
        OSError: a file cannot be written.
    """
    (store.folder / MODELS).mkdir(exist_ok=True)
    for detector in store.plan.detectors:
        for fov in store.plan.fovs:
            model_of(store.folder, store.plan, detector, fov).save(store.folder / MODELS / f"{detector}-{fov}.json")


def _save(path: Path, arrays: dict[str, NDArray[Any]]) -> None:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    write_atomic(path, file.getvalue())
