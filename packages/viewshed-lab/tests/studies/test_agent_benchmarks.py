"""What the benchmarks of many agents count, on cases computed by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba", reason="numba is not installed: worlds are not cast")

from benchmarks.agent_cases import Outcome, auroc, forged, only
from benchmarks.agent_scenes import as_view, share
from benchmarks.infrastructure import BOTH, CAR, MAST, Scene, _count_people
from tests.agents.test_many import CARS, GRID, report, view

from viewshed.fov.estimate import CellState
from viewshed.fov.truth import Truth
from viewshed.geometry import Rigid
from viewshed_lab.studies.agents.scenes import Scene as RecordedScene
from viewshed_lab.threats.object_attacks import OBJECT_ATTACKS


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
