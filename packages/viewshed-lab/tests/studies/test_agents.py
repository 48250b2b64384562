"""The study of many agents: its machinery, from scenes to a page, and what its lies do."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.studies.by_hand import stored

from viewshed.agents.honest import HonestModel
from viewshed.agents.many import CommandCenter
from viewshed.agents.report import AgentReport
from viewshed.objects.detector import Detector
from viewshed_lab._jobs import LocalEngine
from viewshed_lab.studies.agents.jobs import run_study
from viewshed_lab.studies.agents.lies import APART_M, FORGED, LIES, Liars
from viewshed_lab.studies.agents.page import AgentsResults, files_of
from viewshed_lab.studies.agents.plan import HONEST, HONEST_MODEL, POSE_NOISE, SPLITS, STATED, UNSTATED, AgentsPlan
from viewshed_lab.studies.agents.runs import POSE_STD, SceneCases
from viewshed_lab.studies.agents.scenes import Scene, scene_path
from viewshed_lab.studies.store import ResultStore

PLAN = replace(AgentsPlan.load("tiny"), seconds=3.0, learning=1, calibration=4, test=1, each=2)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene.simulate(PLAN.scene("test", 0), Detector())


def test_presets_can_be_loaded_and_scenes_differ_between_splits() -> None:
    for name in ("tiny", "short", "small", "full"):
        plan = AgentsPlan.load(name)
        assert set(plan.lies) == set(LIES)
        assert {plan.cases_of("calibration", number)[0] for number in range(30)} == {HONEST, STATED}
        tried = {case for number in range(plan.test) for case in plan.cases_of("test", number)}
        assert tried == {HONEST, *POSE_NOISE, *LIES} or name == "tiny"
        assert not set(plan.worlds) & set(plan.test_worlds)
        assert {plan.scene("test", number).world_kind for number in range(8)} == set(plan.test_worlds)
    seeds = {str(PLAN.scene(split, 0).seed(0).entropy) for split in SPLITS}
    assert len(seeds) == len(SPLITS)
    with pytest.raises(ValueError, match="lies must be"):
        replace(PLAN, lies=("flattery",))


def test_a_scene_is_kept_in_a_file_as_it_was(scene: Scene, tmp_path: Path) -> None:
    scene.save(tmp_path / "scene.npz")
    again = Scene.load(tmp_path / "scene.npz")
    for name in Scene.__slots__:
        assert np.array_equal(getattr(scene, name), getattr(again, name)), name
    for one, other in zip(scene.reports(2), again.reports(2), strict=True):
        assert np.array_equal(one.estimate.state, other.estimate.state)
        assert np.array_equal(one.detections.boxes, other.detections.boxes)
        assert one.estimate.basis == other.estimate.basis


@pytest.mark.parametrize("name", [name for name, lie in LIES.items() if lie.about.startswith("objects")])
def test_liars_change_their_own_reports_and_no_others(scene: Scene, name: str) -> None:
    lie = LIES[name]
    numbers = (0, 1)[: lie.liars]
    liars = Liars(lie, numbers, -1, np.random.default_rng(4))
    for time in range(3):
        honest = scene.reports(time)
        said = liars.forge(list(honest))
        for number, (before, after) in enumerate(zip(honest, said, strict=True)):
            if number not in numbers:
                assert after is before
            assert (after.estimate is before.estimate) == (number not in numbers or "view" not in lie.about)
        first, now = honest[0].in_world, said[0].in_world
        if name.startswith("fabricate"):
            away = np.linalg.norm(now.boxes[:, None, :2] - first.boxes[None, :, :2], axis=2).min(axis=1)
            assert (away > APART_M / 2).sum() == FORGED
        elif name.startswith("remove"):
            assert len(now) < len(first) or liars.touched[-1] == 0
        else:
            assert len(now) == len(first)
    assert len(liars.touched) == 3


def test_the_study_runs_resumes_and_writes_its_page(tmp_path: Path) -> None:
    store = ResultStore.open(tmp_path, PLAN)
    assert not list(run_study(store, LocalEngine(1), ("scenes",)))
    assert not list(run_study(store, LocalEngine(1), ("runs",)))
    before = stored(store)
    assert not list(run_study(store, LocalEngine(1)))
    assert stored(store) == before
    _center_judges_as_the_study(store)
    page = files_of(store)["agents.md"].decode()
    for heading in ("Against the targets", "Where nobody lies", "Found", "Reliability of trust"):
        assert f"## {heading}" in page
    assert f"| scenes reported on | ≥ 1000 | {PLAN.test} | missed |" in page
    agents = PLAN.moving + PLAN.roadside
    assert re.search(rf"\| a round of {agents} agents \| ≤ 8 \| \d+, (met|missed) \| \d+ \|", page)
    found = AgentsResults(PLAN, store.results("run"))
    [lied] = found.of("fabricate", counting=False)
    over = replace(lied, case="over_claim", touched=[1.0] * len(lied.touched), trust=[[0.2] * agents] * len(lied.trust))
    found.__dict__["test"] = [*found.test, over]
    assert ["over-claimers trusted less than .5", "–", "1.000", ""] in found.target_table().rows


def _center_judges_as_the_study(store: ResultStore[AgentsPlan]) -> None:
    """A live center with the study's model accuses whom the study accuses, by the same messages."""
    found = AgentsResults(PLAN, store.results("run"))
    scene = Scene.load(scene_path(store.folder, "test", 0))
    honest = HonestModel.from_json((store.folder / HONEST_MODEL).read_text("utf-8"))
    center = CommandCenter(scene.agents, honest=honest)
    [benign] = found.of(HONEST)
    live = np.array([
        center.add(t_s, scene.reports(time)).verdicts.answers for time, t_s in enumerate(scene.times_s.tolist())
    ])  # fmt: skip
    assert live == pytest.approx(np.array(benign.answers), abs=0.02)
    assert (live[-1] >= live.max(axis=0)).all()
    assert found.limits.accused(live[-1], found.elevated, found.rate).tolist() == found.accused(benign).tolist()


def test_poses_that_are_off_are_off_by_what_is_stated(scene: Scene) -> None:
    """Errors differ between agents, last for the scene, and only the one case states them."""
    cases = SceneCases(scene, (1, "test", 0), HonestModel.blank(), compared=False)
    seen, add = list[list[AgentReport]](), CommandCenter.add

    def remembered(self: CommandCenter, t_s: float, said: list[AgentReport]) -> object:
        seen.append(said)
        return add(self, t_s, said)

    for case in (STATED, UNSTATED):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(CommandCenter, "add", remembered)
            cases.run(case)
    stated, unstated = seen[: len(scene.times_s)], seen[len(scene.times_s) :]
    assert {report.pose_std for reports in stated for report in reports} == {POSE_STD}
    off = np.array([
        [said.world_from_level.translation - true.world_from_level.translation
         for said, true in zip(reports, scene.reports(time), strict=True)]
        for time, reports in enumerate(unstated)
    ])  # fmt: skip
    assert np.ptp(off, axis=0).max() < 1e-9
    assert 0.02 < np.std(off[0, :, :2]) < 0.6
    assert np.abs(off[..., 2]).max() < 1e-9
