"""The whole study on one domain of rooms: every step leaves what the next one needs, and nothing is done twice."""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from viewshed.networks.architecture import UNetShape
from viewshed.networks.card import NetworkCard
from viewshed.studies.paper import jobs
from viewshed.studies.paper.data import open_archive, subject_of
from viewshed.studies.paper.data import test_sweep as held_out
from viewshed.studies.paper.jobs import Scope, run_steps
from viewshed.studies.paper.models import network
from viewshed.studies.paper.page import files_of
from viewshed.studies.paper.plan import StudyPlan, plan_named
from viewshed.studies.paper.protocols import TOUCHING, setting_of
from viewshed.studies.paper.results import Results
from viewshed.studies.paper.store import JobStore

pytestmark = pytest.mark.slow

PLAN = replace(
    plan_named("tiny"), domains=("ugv",), train_scenes=(4,), train_times=(2,), test_scenes=(9,), test_times=(5,),
    interval_s=(0.5,), strict_frames=1, strengths=False, trade_widths=(4,), frames_per_epoch=4, epochs=1,
)  # fmt: skip
Told = list[tuple[str, int, int]]


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[JobStore[StudyPlan], Told]]:
    """A study that has been run from start to end."""
    before, told = os.environ.get("OMP_NUM_THREADS"), Told()
    os.environ["OMP_NUM_THREADS"] = "1"
    store = JobStore.open(tmp_path_factory.mktemp("study"), PLAN)
    assert list(run_steps(store, Scope(workers=1), lambda *what: told.append(what))) == []
    yield store, told
    if before is None:
        del os.environ["OMP_NUM_THREADS"]


def test_every_job_is_there_and_none_is_done_twice(study: tuple[JobStore[StudyPlan], Told]) -> None:
    store, told = study
    wanted = {key for step in jobs.STEPS for key in jobs.keys_of(PLAN, step, ("paper", "strict"))}
    assert store.keys() == wanted
    assert [what for what in told if what[0] == "models"][-1] == ("models", 8, 8)
    size = store.path.stat().st_size
    assert list(run_steps(store, Scope(workers=1), lambda *_: None)) == []
    assert store.path.stat().st_size == size


def test_scores_of_a_job_are_the_same_when_it_is_done_again(study: tuple[JobStore[StudyPlan], Told]) -> None:
    store, _ = study
    key = ("pairs", "strict", "mcd-adversarial-ugv", "ugv")
    line = next(store.jobs(*key))
    again = jobs.do_job(jobs.Job(PLAN, store.folder, key))
    assert {"job": list(key), **again} == line


def test_pages_hold_targets_facts_and_figures(study: tuple[JobStore[StudyPlan], Told]) -> None:
    store, _ = study
    results = Results.read(store)
    for protocol in ("paper", "strict"):
        files = files_of(results, protocol)
        page = files[f"reproduce_{protocol}.md"].decode()
        assert all(f"]({name})" in page for name in files if name.endswith(".png"))
        assert all(content.startswith(b"\x89PNG") for name, content in files.items() if name.endswith(".png"))
        assert "Not finished" not in page
        assert f"seeds: {PLAN.seed} trained, {PLAN.test_seed} tested" in page
    assert "reproduce_paper_trade.png" in files_of(results, "paper")


def test_pages_say_what_is_missing(study: tuple[JobStore[StudyPlan], Told], tmp_path: Path) -> None:
    store, _ = study
    part = JobStore.open(tmp_path, PLAN)
    for line in store.jobs("pairs", "paper"):
        part.append(tuple(line.pop("job")), line)
    page = files_of(Results.read(part), "paper")["reproduce_paper.md"].decode()
    assert "**Not finished:** models 0 of 4, trade 0 of 1." in page
    with pytest.raises(ValueError, match="must hold pairs of the strict protocol, got none; run step pairs"):
        files_of(Results.read(part), "strict")


def test_what_waits_for_a_model_is_told_and_left(tmp_path: Path) -> None:
    store = JobStore.open(tmp_path, PLAN)
    with pytest.raises(ValueError, match="the other steps need the step data"):
        list(run_steps(store, Scope(steps=("monitor",)), lambda *_: None))
    assert list(run_steps(store, Scope(steps=("data",), workers=1), lambda *_: None)) == []
    problems = list(run_steps(store, Scope(steps=("monitor",), workers=1), lambda *_: None))
    assert problems == [
        f"monitor {mixture}: not all of its models are trained" for mixture in ("benign", "adversarial")
    ]


def test_held_out_sweeps_are_of_other_scenes_and_have_a_past(study: tuple[JobStore[StudyPlan], Told]) -> None:
    store, _ = study
    train, test = (open_archive(store.folder, "ugv", split) for split in ("train", "test"))
    assert (len(train), len(test)) == (8, 45)
    subjects = [subject_of(PLAN, store.folder, "ugv", number) for number in range(12)]
    assert len({subject.sample.scene for subject in subjects[:9]}) == 9
    assert subjects[9].sample.scene == subjects[0].sample.scene
    assert not np.array_equal(subjects[9].sample.sweep.points[:50], subjects[0].sample.sweep.points[:50])
    now, before = subjects[0].sample.sweep.t_ns, [sweep.t_ns for sweep in subjects[0].earlier]
    assert now is not None
    assert [now - then for then in before if then is not None] == [2_000_000_000, 500_000_000]
    trained = {train[k].sweep.points.tobytes() for k in range(8)}
    assert not trained & {test[k].sweep.points.tobytes() for k in range(45)}


def test_attacks_of_the_strict_pairs_take_turns_and_the_truth_is_the_clean_one(
    study: tuple[JobStore[StudyPlan], Told],
) -> None:
    store, _ = study
    setting = setting_of(PLAN, "strict", "ugv")
    tests = [held_out(PLAN, store.folder, setting, number) for number in range(3)]
    assert [test.attack for test in tests] == list(TOUCHING[:3])
    for number, test in enumerate(tests):
        sample = subject_of(PLAN, store.folder, "ugv", number).sample
        assert np.array_equal(test.visible, sample.truth.visible())
        assert len(test.attacked) != len(test.benign) or not np.array_equal(test.attacked.points, test.benign.points)


class _Echo:
    """Answers with its input, and with the sum of its masks in one corner."""

    def __init__(self) -> None:
        self.card = NetworkCard("echo", UNetShape(4, 2))

    def run(self, inputs: np.ndarray, masks: np.ndarray) -> np.ndarray:
        found = np.repeat(inputs[:, 0], len(masks), axis=0).astype(np.float32)
        found[:, 0, 0] = masks.mean(axis=1) / 2
        return found

    def single_threaded(self) -> None:
        return

    def run_with_doubt(self, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        raise NotImplementedError


def test_a_network_is_tried_on_the_grid_of_where_it_is_tried(study: tuple[JobStore[StudyPlan], Told]) -> None:
    store, _ = study
    sweep = subject_of(PLAN, store.folder, "ugv", 0).sample.sweep
    setting = setting_of(PLAN, "paper", "ugv")
    once, no_std = network(_Echo(), setting, 1, 0)(sweep)
    assert no_std is None
    assert once[0, 0] == 0.5  # masks of ones
    counted = setting.grid.count(sweep.points, max_range_m=20.0)
    assert once.shape == counted.shape
    assert np.corrcoef(once[1:].ravel(), np.minimum(counted, 255)[1:].ravel())[0, 1] > 0.9
    mean, std = network(_Echo(), setting, 5, 0)(sweep)
    assert std is not None
    assert std[0, 0] > 0
    assert std[5, 5] == 0
    assert np.array_equal(mean, network(_Echo(), setting, 5, 0)(sweep)[0])


def test_plans_of_one_domain_are_plans_too() -> None:
    assert StudyPlan.from_json(PLAN.to_json()) == PLAN
