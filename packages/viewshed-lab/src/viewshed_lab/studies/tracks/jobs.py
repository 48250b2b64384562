"""The jobs of the study of tracks: one per drive, with every field of view and every attack."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from viewshed.objects.calibration import count_drive, highest_e_values, limits_of, model_of_counts
from viewshed.objects.evidence import EvidenceCounts, EvidenceModel
from viewshed.objects.tracker import ExistenceRules, Rules
from viewshed_lab._jobs import Engine
from viewshed_lab.studies.cases import generator
from viewshed_lab.studies.plan import check_names
from viewshed_lab.studies.runner import Job, Progress, lacking, run_jobs
from viewshed_lab.studies.store import JobResult, ResultStore
from viewshed_lab.studies.tracks.drives import Moment, simulate_drive
from viewshed_lab.studies.tracks.evaluate import evaluate, track_drive, tracking_gospa_m, tracks_of_objects
from viewshed_lab.studies.tracks.lidar_level import SweepForger
from viewshed_lab.studies.tracks.plan import BENIGN_CASE, STEPS, TracksPlan
from viewshed_lab.studies.tracks.published import PublishedRules
from viewshed_lab.studies.tracks.stone_soup import stone_soup_centers
from viewshed_lab.threats.object_attacks import OBJECT_ATTACKS

COASTING_S = (0.5, 1.0, 2.0, 3.0, 5.0)
"""Coasting times to try for the published rules and Stone Soup; each is tested with its best."""

LIDAR_FOVS = ("none", "published", "default")
"""Fields of view that are tested on forged sweeps."""

RULES = ExistenceRules()

PUBLISHED, STONE_SOUP = "published", "stone_soup"
"""The field of view whose tracker has the published rules; Stone Soup, which has no field of view."""


def run_study(
    store: ResultStore[TracksPlan],
    engine: Engine,
    steps: tuple[str, ...] = STEPS,
    on_progress: Progress = lambda *_: None,
) -> Iterator[str]:
    """Run the unfinished jobs of some of ``STEPS``; yield one line for each failed job."""
    check_names("only", steps, STEPS)
    plan = store.plan
    before = {"count": (), "limit": ("count",), "test": ("count", "limit"), "lidar": ("count", "limit")}
    for step, earlier in before.items():
        if step not in steps:
            continue
        needed = {key for other in earlier for key in plan.drive_keys(other)}
        missing = lacking(needed, "drives that it rests on are not done")
        yield from run_jobs(store, do_job, plan.drive_keys(step), engine, on_progress, step=step, missing=missing)


def do_job(job: Job[TracksPlan]) -> JobResult:
    """Simulate a drive; count its evidence, take its highest e-values, or attack it, by step."""
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
        facts["coasting"] = {STONE_SOUP: by_coasting}
    if step == "test":
        centers = stone_soup_centers(sweeps, best_coasting_s(job.folder, plan, STONE_SOUP))
        facts[STONE_SOUP] = tracking_gospa_m(moments, centers)
    for fov in fovs:
        if step == "count":
            if fov == PUBLISHED:
                facts["coasting"][fov] = _gospa_by_coasting(moments)
            counts, rules = EvidenceCounts(), PublishedRules() if fov == PUBLISHED else RULES
            observed = (one.observed for one in track_drive(moments, fov, rules=rules))
            count_drive(observed, counts, generator(plan.seed, "elsewhere", number, fov))
            facts[fov] = {name: array.tolist() for name, array in counts.arrays().items()}
        elif step == "limit":
            tracked = list(track_drive(moments, fov, rules=rules_of(job.folder, plan, fov)))
            model = _without_limits(job.folder, plan, fov)
            of_objects = tracks_of_objects(tracked)
            highest = highest_e_values((one.observed for one in tracked), model)
            facts[fov] = [list(values) for number, values in highest.items() if number in of_objects]
        elif step == "test":
            facts[fov] = {case: _try(job, moments, fov, case) for case in plan.cases()}
        else:
            facts[fov] = {job.key[4]: _try(job, moments, fov, BENIGN_CASE)}
    return JobResult(facts={"sweeps": len(moments), **facts})


def _try(job: Job[TracksPlan], moments: Sequence[Moment], fov: str, case: str) -> dict[str, Any]:
    """Return the outcome of a drive in a case with a field of view, as plain values."""
    plan, attack = job.plan, None
    if case != BENIGN_CASE:
        parameters = OBJECT_ATTACKS[case](counts="exact", mean_count=float(plan.objects))
        attack = parameters.begin(generator(plan.seed, *job.key, case))
    tracked = list(track_drive(moments, fov, attack, rules_of(job.folder, plan, fov)))
    return evaluate(tracked, model_of(job.folder, plan, fov)).to_json()


def _gospa_by_coasting(moments: Sequence[Moment]) -> list[float]:
    """Return the GOSPA of a drive in meters with the published rules, for each of ``COASTING_S``."""
    gospa_m = []
    for coast_s in COASTING_S:
        tracked = [one.observed[0] for one in track_drive(moments, PUBLISHED, rules=PublishedRules(coast_s=coast_s))]
        gospa_m.append(tracking_gospa_m(moments, [tracks.boxes[tracks.confirmed] for tracks in tracked]))
    return gospa_m


@lru_cache(maxsize=2)
def _facts_of(folder: Path, plan: TracksPlan, step: str) -> list[dict[str, Any]]:
    """Return the facts of each drive of a finished step."""
    return list(ResultStore(folder, plan).results(step).facts.values())


def best_coasting_s(folder: Path, plan: TracksPlan, tracker: str) -> float:
    """Return the coasting time with the best GOSPA of a reference tracker on the drives of step ``count``."""
    by_drive = [one["coasting"][tracker] for one in _facts_of(folder, plan, "count")]
    return COASTING_S[int(np.mean(by_drive, axis=0).argmin())]


def rules_of(folder: Path, plan: TracksPlan, fov: str) -> Rules:
    """Return the rules of a tracker; the published ones have the coasting time that was best on other drives."""
    return PublishedRules(coast_s=best_coasting_s(folder, plan, fov)) if fov == PUBLISHED else RULES


@lru_cache(maxsize=8)
def _without_limits(folder: Path, plan: TracksPlan, fov: str) -> EvidenceModel:
    """Return the model of a field of view from the counts of step ``count``, without limits."""
    counts = EvidenceCounts()
    for one in _facts_of(folder, plan, "count"):
        counts.add_arrays({name: np.array(values) for name, values in one[fov].items()})
    return model_of_counts(counts, plan.accused)


@lru_cache(maxsize=8)
def model_of(folder: Path, plan: TracksPlan, fov: str) -> EvidenceModel:
    """Return the calibrated model of a field of view.

    Raises:
        ValueError: there are too few honest tracks for the share that may be accused.
    """
    highest = np.array([values for one in _facts_of(folder, plan, "limit") for values in one[fov]]).reshape(-1, 3)
    model = _without_limits(folder, plan, fov)
    return replace(model, limits=limits_of(highest, plan.accused), tracks=len(highest))
