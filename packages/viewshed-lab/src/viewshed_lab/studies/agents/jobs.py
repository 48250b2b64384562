"""The jobs of the study of many agents: first simulate each scene to a file, then run all its cases."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from functools import lru_cache

import numpy as np

from viewshed._files import write_atomic
from viewshed.agents.honest import HonestExamples, HonestModel, fit_honest
from viewshed.agents.view_evidence import Comparisons, Surprises
from viewshed.arrays import Mask
from viewshed.objects.detector import Detector
from viewshed_lab._jobs import Engine
from viewshed_lab.data.drive import drive_sweeps
from viewshed_lab.studies.agents.plan import HONEST_MODEL, STEPS, AgentsPlan
from viewshed_lab.studies.agents.runs import SceneCases, honest_examples
from viewshed_lab.studies.agents.scenes import FOLDER, Scene, scene_path, scene_world
from viewshed_lab.studies.cases import generator
from viewshed_lab.studies.plan import check_names
from viewshed_lab.studies.runner import Job, Progress, lacking, run_jobs
from viewshed_lab.studies.store import JobResult, ResultStore


def run_study(
    store: ResultStore[AgentsPlan],
    engine: Engine,
    steps: tuple[str, ...] = STEPS,
    on_progress: Progress = lambda *_: None,
) -> Iterator[str]:
    """Run the jobs that are not in the store; yield one line for each failed job.

    Args:
        store: store of the study.
        engine: runs the jobs.
        steps: steps to run, of ``STEPS``.
        on_progress: is called after each job.

    Raises:
        ValueError: a step is unknown.
        OSError: a file cannot be written.
    """
    check_names("only", steps, STEPS)
    (store.folder / FOLDER).mkdir(exist_ok=True)
    if "scenes" in steps:
        yield from run_jobs(store, do_job, store.plan.scene_keys(), engine, on_progress, step="scenes")
    if "runs" in steps:
        scenes = set(store.plan.scene_keys())
        missing = lacking(scenes, "scenes are not made")
        if scenes <= store.keys() and not (store.folder / HONEST_MODEL).exists():
            write_atomic(store.folder / HONEST_MODEL, fitted_honest(store).to_json().encode())
        keys = store.plan.run_keys()
        yield from run_jobs(store, do_job, keys, engine, on_progress, step="runs", missing=missing)


def fitted_honest(store: ResultStore[AgentsPlan]) -> HonestModel:
    """Return the model of honest agents, fitted on the scenes of the split ``learning``."""
    examples, compared, elevated = list[HonestExamples](), list[Comparisons](), list[Mask]()
    for number in range(store.plan.learning):
        scene = Scene.load(scene_path(store.folder, "learning", number))
        of_scene, views = honest_examples(scene, generator(store.plan.seed, "honest", number))
        examples, compared = examples + of_scene, compared + views
        elevated += [np.array([report.elevated for report in scene.reports(0)])] * len(views)
    return fit_honest(examples, Surprises.fit(compared, elevated))


def do_job(job: Job[AgentsPlan]) -> JobResult:
    """Simulate a scene, or run one in all of its cases."""
    step, split, number = job.key
    path = scene_path(job.folder, split, int(number))
    if step == "scene":
        plan = job.plan.scene(split, int(number))
        sweeps = drive_sweeps(plan, scene_world(job.plan, split, int(number)))
        scene = Scene.simulate(plan, _detector(), sweeps)
        scene.save(path)
        return JobResult(facts={"file": path.name, "objects": scene.objects.shape[1], "detections": len(scene.found)})
    honest = HonestModel.from_json((job.folder / HONEST_MODEL).read_text("utf-8"))
    seed = (job.plan.seed, split, int(number))
    cases = SceneCases(Scene.load(path), seed, honest, compared=split == "test")
    return JobResult(facts={"runs": [asdict(cases.run(case)) for case in job.plan.cases_of(split, int(number))]})


@lru_cache(maxsize=1)
def _detector() -> Detector:
    return Detector()
