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
from viewshed.objects.tracker import ExistenceRules, Rules
from viewshed_lab._jobs import Engine
from viewshed_lab.studies.cases import generator
from viewshed_lab.studies.plan import check_names
from viewshed_lab.studies.runner import Job, Progress, ignore_progress, lacking, run_jobs
from viewshed_lab.studies.store import JobResult, ResultStore
from viewshed_lab.studies.tracks.drives import Moment, simulate_drive
from viewshed_lab.studies.tracks.evaluate import evaluate, track_drive, tracking_gospa_m, tracks_of_objects
from viewshed_lab.studies.tracks.lidar_level import SweepForger
from viewshed_lab.studies.tracks.plan import BENIGN_CASE, STEPS, TracksPlan
from viewshed_lab.studies.tracks.published import PublishedRules
from viewshed_lab.studies.tracks.stone_soup import stone_soup_centers
from viewshed_lab.threats.object_attacks import OBJECT_ATTACKS

MODELS = "models"
"""Folder of the calibrated models, one file for each field of view."""

COUNTS, HIGHEST = "counts", "highest"
"""Folders of counted evidence and of the highest e-values of honest tracks, a file for each drive and field of view."""

COASTING = "coasting"
"""Folder of the GOSPA of the published rules and of Stone Soup by coasting time."""

COASTING_S = (0.5, 1.0, 2.0, 3.0, 5.0)
"""Coasting times that the published rules and Stone Soup are tried with; each is tested with its best."""

LIDAR_FOVS = ("none", "published", "default")
"""Fields of view that look at forged sweeps."""

RULES = ExistenceRules()

PUBLISHED, STONE_SOUP = "published", "stone_soup"
"""The field of view whose tracks the published rules make; Stone Soup, which has none."""


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
    step, number = job.key[0], job.key[3]
    plan, facts = job.plan, dict[str, Any]()
    forger, fovs = None, plan.fovs
    if step == "lidar":
        forger = SweepForger(job.key[4], generator(plan.seed, *job.key))
        fovs = tuple(fov for fov in fovs if fov in LIDAR_FOVS)
    moments = list(simulate_drive(plan.scene(job.key), fovs, forger=forger))
    sweeps = [(moment.t_s, moment.detections) for moment in moments]
    if step == "count":
        by_coasting = [tracking_gospa_m(moments, stone_soup_centers(sweeps, coast_s)) for coast_s in COASTING_S]
        _save(job.folder / COASTING / f"{STONE_SOUP}-{number}.npz", {"gospa_m": np.array(by_coasting)})
    if step == "test":
        centers = stone_soup_centers(sweeps, best_coasting_s(job.folder, STONE_SOUP))
        facts[STONE_SOUP] = tracking_gospa_m(moments, centers)
    for fov in fovs:
        name = f"{fov}-{number}.npz"
        if step == "count":
            if fov == PUBLISHED:
                _save(job.folder / COASTING / name, {"gospa_m": _gospa_by_coasting(moments)})
            counts, rules = EvidenceCounts(), PublishedRules() if fov == PUBLISHED else RULES
            observed = (one.observed for one in track_drive(moments, fov, rules=rules))
            count_drive(observed, counts, generator(plan.seed, "elsewhere", number, fov))
            _save(job.folder / COUNTS / name, counts.arrays())
        elif step == "limit":
            tracked = list(track_drive(moments, fov, rules=rules_of(job.folder, fov)))
            model = _without_limits(job.folder, plan, fov)
            of_objects = tracks_of_objects(tracked)
            highest = highest_e_values((one.observed for one in tracked), model)
            honest = [values for number, values in highest.items() if number in of_objects]
            _save(job.folder / HIGHEST / name, {"highest": np.array(honest).reshape(-1, 3)})
        elif step == "test":
            facts[fov] = {case: _try(job, moments, fov, case) for case in plan.cases()}
        else:
            facts[fov] = {job.key[4]: _try(job, moments, fov, BENIGN_CASE)}
    return JobResult(facts={"sweeps": len(moments), **facts})


def _try(job: Job[TracksPlan], moments: Sequence[Moment], fov: str, case: str) -> dict[str, Any]:
    """Return what became of a drive in a case with a field of view, as plain values."""
    plan, attack = job.plan, None
    if case != BENIGN_CASE:
        chosen = OBJECT_ATTACKS[case](counts="exact", mean_count=float(plan.objects))
        attack = chosen.begin(generator(plan.seed, *job.key, case))
    tracked = list(track_drive(moments, fov, attack, rules_of(job.folder, fov)))
    return evaluate(tracked, model_of(job.folder, plan, fov)).to_json()


def _gospa_by_coasting(moments: Sequence[Moment]) -> NDArray[np.float64]:
    """Return the GOSPA of a drive in meters with the published rules, for each of ``COASTING_S``."""
    gospa_m = []
    for coast_s in COASTING_S:
        tracked = [one.observed[0] for one in track_drive(moments, PUBLISHED, rules=PublishedRules(coast_s=coast_s))]
        gospa_m.append(tracking_gospa_m(moments, [tracks.boxes[tracks.confirmed] for tracks in tracked]))
    return np.array(gospa_m)


@lru_cache(maxsize=8)
def best_coasting_s(folder: Path, tracker: str) -> float:
    """Return the coasting time with which a reference tracker was best on the drives that were counted.

    Raises:
        ValueError: no drive was counted yet.
    """
    by_drive = [np.load(path)["gospa_m"] for path in sorted((folder / COASTING).glob(f"{tracker}-*.npz"))]
    if not by_drive:
        raise ValueError(f"{folder / COASTING} must hold counted drives, got none; run the step count")
    return COASTING_S[int(np.mean(by_drive, axis=0).argmin())]


def rules_of(folder: Path, fov: str) -> Rules:
    """Return the rules of a tracker: the published ones with the coasting time that was best on other drives."""
    return PublishedRules(coast_s=best_coasting_s(folder, fov)) if fov == PUBLISHED else RULES


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
