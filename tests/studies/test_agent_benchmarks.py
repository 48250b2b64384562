"""What the benchmarks of many agents count, on cases computed by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba", reason="numba is not installed: worlds are not cast")

from benchmarks.agent_cases import Outcome, auroc, forged, only
from benchmarks.agent_links import Link, changed, with_car
from benchmarks.agent_scenes import as_view, share
from benchmarks.agents_real import contradictions, objects_of
from benchmarks.infrastructure import BOTH, CAR, MAST, Scene, _count_people
from benchmarks.second_view import opened
from tests.fusion.test_many import CARS, GRID, report, view

from viewshed.fov.estimate import CellState
from viewshed.fov.truth import Truth
from viewshed.geometry import Rigid
from viewshed.io import read_sweep
from viewshed.io.samples import junction_path
from viewshed.studies.agents.scenes import Scene as RecordedScene
from viewshed.threats.attacks.base import Wedge
from viewshed.threats.object_attacks import OBJECT_ATTACKS


def test_a_share_has_an_interval_over_scenes() -> None:
    assert share([1.0, 1.0], [2.0, 2.0]) == "0.500 [0.500, 0.500]"
    assert share([0.0, 2.0], [2.0, 2.0], 1) == "0.5 [0.0, 1.0]"
    assert share([0.0], [0.0]) == "–"


def test_exact_truth_as_a_view_claims_what_is_seen_and_known() -> None:
    returns = np.zeros(GRID.shape, np.uint8)
    returns[:, :32] = 200
    truth = Truth(GRID, {"car": returns}, {"car": np.zeros(GRID.shape, np.uint8)})
    known = np.ones(GRID.shape, bool)
    known[:4] = False
    tilted = Rigid(Rigid.from_yaw(0.4).rotation, np.array([3.0, 4.0, 20.0]))
    made = as_view(truth, known, tilted, "mast")
    assert (made.state[4:, :32] == CellState.FREE).all()
    assert (made.state[4:, 32:] == CellState.HIDDEN).all()
    assert (made.state[:4] == CellState.UNKNOWN).all()
    assert made.world_from_level is not None
    assert made.world_from_level.yaw == pytest.approx(0.4)


def test_people_count_as_seen_in_time_only_before_the_car_is_near() -> None:
    """Four times a second apart of .5 s: one walks in seen by the mast, one was near from the beginning."""
    away_m = np.full((8, 3), 60.0)
    away_m[5:, 0] = 20.0
    away_m[:, 1] = 20.0
    away_m[4:, 2] = 24.0
    seen = np.zeros((2, 8, 3), bool)
    seen[0, 5:, 0] = True  # the car: too late
    seen[1, 4, 0] = True
    scene = Scene()
    _count_people(scene, away_m, seen)
    assert scene.in_time == {"all": 2, CAR: 0, MAST: 1, BOTH: 1}
    assert scene.sightings == {"all": 15, CAR: 3, MAST: 0, BOTH: 3}


def test_a_liar_claims_the_wedge_of_its_victim() -> None:
    victim, other = view("a", yaw=0.5), view("b", x_m=5.0, visible=0.0)
    claims = opened(other, victim, Wedge(0.0, 0.6))
    assert victim.world_from_level is not None
    assert other.world_from_level is not None
    inside = other.world_from_level.inverse() @ (victim.world_from_level @ np.array([12.0, 1.0, 0.0]))
    outside = other.world_from_level.inverse() @ (victim.world_from_level @ np.array([2.0, 9.0, 0.0]))
    assert claims.at(inside[None, :2])[0] == pytest.approx(0.98)
    assert claims.at(outside[None, :2])[0] == 0.0
    assert (other.state == CellState.HIDDEN).all()


def test_forged_reports_change_in_the_world_and_come_back_to_level() -> None:
    agent = view("a", 20.0, -9.0, 0.7)
    honest = report(agent, CARS)
    attack = OBJECT_ATTACKS["fabricate_static"](counts="exact", mean_count=2.0, start_s=1.0)
    running = attack.begin(np.random.default_rng(3))
    assert len(forged(honest, [running], 0.0).detections) == 2
    first, later = (forged(honest, [running], t_s) for t_s in (1.0, 1.5))
    assert len(later.detections) == 4
    assert later.in_world.boxes[:2] == pytest.approx(honest.in_world.boxes)
    assert first.detections.boxes[2:] == pytest.approx(later.detections.boxes[2:])  # they stand


def test_who_is_trusted_less_is_ranked_first() -> None:
    trust = np.tile([0.9, 0.2, 0.8], (8, 1))
    outcome = Outcome(0, (1,), {"ours": trust}, np.zeros(3, bool), np.zeros(3, bool), {}, {})
    assert auroc([outcome], "ours") == 1.0
    assert auroc([replace(outcome, attacked=(0,))], "ours") == 0.0


def test_late_reports_are_where_things_were_and_noise_moves_the_pose_alone() -> None:
    agent = view("agent0", 1.0, 0.0)
    moving, resting = CARS
    objects = np.stack([CARS, CARS])
    objects[1, 0, 0] += 5.0  # 10 m/s: from 12 m to 17 m in half a second
    poses = np.tile(np.eye(4), (2, 1, 1, 1))
    poses[:, 0, 0, 3] = [0.0, 1.0]  # the agent itself drives at 2 m/s
    cells = np.zeros((2, 1, 1, 1), np.uint8)
    scene = RecordedScene(
        np.array([0.25, 0.75]), cells, cells, poses, [], np.zeros((0, 9)),
        np.zeros((0, 2), np.int16), objects, np.zeros((2, 1, 2), np.int32), np.array([-1]),
    )  # fmt: skip
    now = report(agent, objects[1])
    late = changed(now, scene, 1, Link(late_s=0.2), np.random.default_rng(0), is_near=False)
    assert late.in_world.boxes[:, 0] == pytest.approx([moving[0] + 3.0, resting[0]])
    assert late.world_from_level.translation[0] == pytest.approx(0.6)
    assert changed(now, scene, 1, Link(late_s=0.2), np.random.default_rng(0), is_near=True) is not now
    noisy = changed(now, scene, 1, Link(pose_m=0.2, pose_deg=0.5), np.random.default_rng(0), is_near=False)
    assert noisy.detections is now.detections
    step = noisy.world_from_level.translation - now.world_from_level.translation
    assert 0.0 < np.hypot(*step[:2]) < 1.0
    assert step[2] == 0.0


def test_a_spoofed_car_stands_where_it_is_said_in_the_world() -> None:
    sweep = read_sweep(junction_path())
    pose = Rigid.from_yaw(1.1, (100.0, 50.0, 1.8))
    sweep = sweep.replace(world_from_sensor=pose)
    place = pose @ np.array([9.0, -2.0, 0.0])
    spoofed = with_car(sweep, np.array([place[0], place[1], 0.4]), np.random.default_rng(1))
    at = pose @ spoofed.points.astype(np.float64)
    was = pose @ sweep.points.astype(np.float64)

    def near(points: np.ndarray) -> int:
        """Returns above the ground within a car's length of the place."""
        return int(((np.hypot(*(points[:, :2] - place[:2]).T) < 2.6) & (points[:, 2] > 0.4)).sum())

    assert near(at) > near(was) + 20


def test_contradictions_are_surfaces_where_another_claims_free_ground_all_about() -> None:
    one, other = view("a"), view("b")
    state = one.state.copy()
    state[40, 40] = state[20, 20] = CellState.SURFACE
    one = replace(one, state=state)
    theirs = other.state.copy()
    theirs[21, 20] = CellState.SURFACE  # nearly the same surface
    other = replace(other, state=theirs)
    assert contradictions(one, other) == (1.0, 2.0, GRID.cells**2)
    hidden = replace(other, state=np.full(GRID.shape, CellState.HIDDEN, np.uint8))
    assert contradictions(one, hidden) == (0.0, 0.0, 0.0)


def test_objects_are_counted_where_both_claim_to_see() -> None:
    both = report(view("a"), CARS), report(view("b"), CARS[:1])
    assert objects_of(*both) == (1.0, 2.0)
    blind = report(view("b", visible=0.0), CARS[:1])
    assert objects_of(both[0], blind) == (1.0, 1.0)


def test_some_agents_of_a_scene_keep_what_is_theirs() -> None:
    cells = np.arange(6, dtype=np.uint8).reshape(2, 3, 1, 1)
    found = np.arange(36.0).reshape(4, 9)
    poses = np.tile(np.eye(4), (2, 3, 1, 1))
    poses[:, :, 0, 3] = [[0.0, 1.0, 2.0]] * 2
    scene = RecordedScene(
        np.array([0.25, 0.75]), cells, cells, poses, [[{"number": k} for k in range(3)]] * 2, found,
        np.array([[0, 0], [0, 1], [0, 2], [1, 2]], np.int16), np.zeros((2, 5, 7)),
        np.arange(30, dtype=np.int32).reshape(2, 3, 5), np.array([4, 2, -1]),
    )  # fmt: skip
    some = only(scene, [2, 0])
    assert some.agents == ("agent0", "agent1")
    assert some.poses[1, :, 0, 3].tolist() == [2.0, 0.0]
    assert some.found_at.tolist() == [[0, 1], [0, 0], [1, 0]]
    assert some.found[:, 0].tolist() == [0.0, 18.0, 27.0]
    assert some.bases[0] == [{"number": 2}, {"number": 0}]
    assert some.carriers.tolist() == [-1, 4]
    assert some.returns[0, 1].tolist() == [0, 1, 2, 3, 4]
