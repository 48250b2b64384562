"""The jobs of the study: one a scene, whose file all runs share, then one a scene for all of its cases."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from functools import lru_cache

import numpy as np

from viewshed._files import write_atomic
from viewshed.agents.claims import SMALL_M, ClaimTable
from viewshed.agents.honest import HonestModel, fit_honest, is_expected
from viewshed.objects.detector import Detector
from viewshed_lab._jobs import Engine
from viewshed_lab.data.drive import SEEN_RETURNS, drive_sweeps
from viewshed_lab.studies.agents.plan import STEPS, AgentsPlan
from viewshed_lab.studies.agents.runs import SceneCases, claims_of, honest_examples
from viewshed_lab.studies.agents.scenes import FOLDER, Scene, scene_path, scene_world
from viewshed_lab.studies.cases import generator
from viewshed_lab.studies.plan import check_names
from viewshed_lab.studies.runner import Job, Progress, ignore_progress, lacking, run_jobs
from viewshed_lab.studies.store import JobResult, ResultStore

CLAIMS, HONEST_MODEL = "claims.json", "honest.json"
"""What claims are worth, and what honest agents report: fitted on the scenes of the first split."""

EXPECTED = "expected"
"""Of the claims counted, those at which an agent is expected to see an object."""


def run_study(
    store: ResultStore[AgentsPlan],
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
    (store.folder / FOLDER).mkdir(exist_ok=True)
    if "scenes" in steps:
        yield from run_jobs(store, do_job, store.plan.scene_keys(), engine, on_progress, step="scenes")
    if "runs" in steps:
        scenes = set(store.plan.scene_keys())
        missing = lacking(scenes, "scenes are not made")
        if scenes <= store.keys() and not (store.folder / CLAIMS).exists():
            claims = fitted_claims(store)
            write_atomic(store.folder / HONEST_MODEL, fitted_honest(store, claims).to_json().encode())
            write_atomic(store.folder / CLAIMS, claims.to_json().encode())
        keys = store.plan.run_keys()
        yield from run_jobs(store, do_job, keys, engine, on_progress, step="runs", missing=missing)


def fitted_claims(store: ResultStore[AgentsPlan]) -> ClaimTable:
    """Return what claims are worth in the scenes of their split."""
    parts = [claims_of(Scene.load(scene_path(store.folder, "claims", number))) for number in range(store.plan.claims)]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return ClaimTable.fit(*(columns[name] for name in ("prob", "boxes", "range_m", "height", "found")))


def fitted_honest(store: ResultStore[AgentsPlan], claims: ClaimTable) -> HonestModel:
    """Return what honest agents report in the scenes of their split."""
    rng, examples = generator(store.plan.seed, "honest"), []
    for number in range(store.plan.claims):
        examples += honest_examples(Scene.load(scene_path(store.folder, "claims", number)), claims, rng)
    return fit_honest(examples)


def do_job(job: Job[AgentsPlan]) -> JobResult:
    """Make a scene, or run one in all of its cases."""
    step, split, number = job.key
    path = scene_path(job.folder, split, int(number))
    if step == "scene":
        plan = job.plan.scene(split, int(number))
        sweeps = drive_sweeps(plan, scene_world(job.plan, split, int(number)))
        scene = Scene.simulate(plan, _detector(), sweeps)
        scene.save(path)
        return JobResult(facts={"file": path.name, "objects": scene.objects.shape[1], "detections": len(scene.found)})
    scene, claims = Scene.load(path), ClaimTable.from_json((job.folder / CLAIMS).read_text("utf-8"))
    honest = HonestModel.from_json((job.folder / HONEST_MODEL).read_text("utf-8"))
    seed = (job.plan.seed, split, int(number))
    cases = SceneCases(scene, seed, claims, honest, compared=split == "test")
    runs = [asdict(cases.run(case)) for case in job.plan.cases_of(split, int(number))]
    return JobResult(facts={"runs": runs, "coverage": coverage_of(scene) if split == "test" else {}})


def coverage_of(scene: Scene) -> dict[str, list[int]]:
    """Return how many objects agents claim, by the claimed probability: [claimed, of these without five returns].

    ``expected`` are those that an agent is expected to see, by probability and range.
    """
    columns = claims_of(scene)
    large = columns["boxes"][:, 3:5].max(axis=1, initial=0.0) > SMALL_M
    out = {}
    claims = {f"{least:g}": columns["prob"] >= least for least in (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98, 0.995)}
    claims[EXPECTED] = is_expected(columns["prob"], columns["range_m"])
    for name, claimed in claims.items():
        of_large = claimed & large
        out[name] = [int(of_large.sum()), int((of_large & (columns["returns"] < SEEN_RETURNS)).sum())]
    return out


@lru_cache(maxsize=1)
def _detector() -> Detector:
    return Detector()
