"""The ablation's parts: who says what of which sweep, and its tiny plan from start to end."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from viewshed.estimators.base import ClassicalEstimator
from viewshed.estimators.first_blocker import FirstBlocker
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.fov.visibility import CAR, PEDESTRIAN
from viewshed.grid import BevGrid
from viewshed.metrics import Scores
from viewshed.networks.weights import manifest
from viewshed.preprocess.history import History
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.studies.ablation.contest import BARE, BENIGN, CASES, CLEAR, Enveloped, Said, parts_of, score, shots_of
from viewshed.studies.ablation.jobs import STEPS, run_steps
from viewshed.studies.ablation.page import page_of
from viewshed.studies.ablation.plan import WHOLE, AblationPlan, ablation_named
from viewshed.studies.ablation.results import OURS, Results, sure_from
from viewshed.studies.paper.store import JobStore
from viewshed.studies.suite import Subject
from viewshed.training.config import TrainConfig, read_config

GRID = BevGrid(32, 64.0)


class Fixed(ClassicalEstimator):
    """An estimator that says the same of every sweep."""

    grid, target, name = GRID, CAR, "fixed"

    def __init__(self, prob: NDArray[np.float32]) -> None:
        self.prob = prob

    def _estimate(self, leveled: LeveledSweep, history: History | None) -> FovEstimate:
        return FovEstimate(GRID, self.prob, np.full(GRID.shape, CellState.FREE, np.uint8))


def test_every_case_is_shown_and_only_bare_clouds_lose_their_rings(subject: Subject) -> None:
    shots = {shot.case: shot for shot in shots_of(subject, 1, 0)}
    assert set(shots) == set(CASES)
    for case, shot in shots.items():
        assert (shot.sweep.model is None) == (case == BARE)
        if case not in (BENIGN, BARE):
            assert not np.array_equal(shot.sweep.points, subject.sample.sweep.points)
    assert shots["far_wall"].wedge is not None
    assert 0 < shots["far_wall"].wedge.mean() < 0.5
    again = {shot.case: shot for shot in shots_of(subject, 1, 0)}
    assert all(np.array_equal(shot.sweep.points, again[case].sweep.points) for case, shot in shots.items())


def test_who_says_the_truth_has_all_of_it_and_wedges_are_parts_of_views(subject: Subject) -> None:
    visible, known = subject.sample.truth.visible(), subject.sample.known
    right, none = Fixed(visible.astype(np.float32)), Fixed(np.zeros(GRID.shape, np.float32))
    found = score({0: subject, 1: subject}, {"right": right, "none": none}, 1)
    said = {name: {case: Said.from_json(told) for case, told in cases.items()} for name, cases in found.items()}
    for case in CASES:
        assert said["right"][case].view.f1() == 1.0
        assert said["none"][case].view.recall() == 0.0
        assert said["right"][case].view.cells == 2 * known.sum()
        assert said["right"][case].sweeps == [[int((visible & known).sum()), 0, 0, int((~visible & known).sum())]] * 2
    assert 0 < said["right"]["far_wall"].wedge.cells < said["right"]["far_wall"].view.cells
    assert said["right"][BENIGN].wedge.cells == 0


def test_parts_are_cells_clear_of_the_threshold_bands_of_range_and_whose_sensor_it_was(subject: Subject) -> None:
    truth = subject.sample.truth
    parts = dict(parts_of(subject, CAR))
    assert np.array_equal(parts[CLEAR], ~np.isin(truth.expected_returns["car"], [3, 4, 5, 6, 7]))
    assert np.array_equal(
        dict(parts_of(subject, PEDESTRIAN))[CLEAR], ~np.isin(truth.expected_returns["pedestrian"], [1, 2, 3, 4, 5])
    )
    range_m = np.hypot(GRID.centers[..., 0], GRID.centers[..., 1])
    bands = [parts[name] for name in ("0 to 20 m", "20 to 40 m", "40 to 64 m", "from 64 m on")]
    assert (np.sum(bands, axis=0) == 1).all()
    assert range_m[bands[0]].max() < 20
    assert 40 < range_m[bands[2]].min() < range_m[bands[2]].max() < 64
    assert parts["sensor HDL-32E"].all()
    near = replace(truth, grid=BevGrid(32, 16.0))
    indoor = Subject(replace(subject.sample, truth=near))
    assert [name for name, _ in parts_of(indoor, CAR)][1:4] == ["0 to 5 m", "5 to 10 m", "10 to 16 m"]


def test_parts_are_counted_untouched_and_add_up(subject: Subject) -> None:
    truth, known = subject.sample.truth.visible(), subject.sample.known
    wrong_far = truth ^ (np.hypot(GRID.centers[..., 0], GRID.centers[..., 1]) >= 40)
    told = score({0: subject, 1: subject}, {OURS: Fixed(wrong_far.astype(np.float32))}, 1)[OURS]
    said = {case: Said.from_json(each) for case, each in told.items()}
    assert not said["far_wall"].parts
    found = Results(ablation_named("small"), "roads", {OURS: {case: each + each for case, each in said.items()}})
    assert found.parts["sensor HDL-32E"] == 4
    assert list(found.parts)[-1] == "sensor HDL-32E"
    assert [found.f1_of_part(OURS, part) for part in ("0 to 20 m", "20 to 40 m", "40 to 64 m")] == [1.0, 1.0, 0.0]
    assert sum(said[BENIGN].parts["0 to 20 m"][1:]) == 2 * (known & (np.hypot(*GRID.centers.T).T < 20)).sum()
    assert found.f1_of_part(OURS, "sensor HDL-32E") == found.f1(OURS, [BENIGN])


def test_truth_is_that_of_the_target(subject: Subject) -> None:
    known = subject.sample.known
    truth = subject.sample.truth.visible(PEDESTRIAN)
    assert (truth != subject.sample.truth.visible(CAR))[known].any()
    told = score({0: subject}, {"right": Fixed(truth.astype(np.float32))}, 1, PEDESTRIAN)
    assert Said.from_json(told["right"][BENIGN]).view.f1() == 1.0


def test_nothing_behind_the_nearest_obstacle_is_claimed(subject: Subject) -> None:
    bound = FirstBlocker(GRID, limit_farthest=False)
    found = Enveloped(Fixed(np.ones(GRID.shape, np.float32)), bound).estimate(subject.sample.sweep)
    assert np.array_equal(found.visible(), bound.estimate(subject.sample.sweep).visible())


def test_the_threshold_of_sure_claims_reaches_its_precision() -> None:
    scores, rng = Scores(), np.random.default_rng(0)
    prob = rng.random(4000).astype(np.float32)
    scores.add(prob, rng.random(4000) < prob)
    sure = sure_from(scores, 0.9)
    assert scores.precision(sure) >= 0.9
    assert scores.precision(sure - 0.001) < 0.9
    scores.add(np.ones(10**5, np.float32), np.zeros(10**5, np.bool_))
    assert sure_from(scores, 0.9) == 1.0


def test_networks_are_reported_for_every_grid_and_target_that_they_are_shipped_for() -> None:
    plan = ablation_named("small")
    reported = {plan.title_of(setting) for setting in plan.settings}
    assert reported == {"roads, car", "rooms, pedestrian", "roads, pedestrian", "rooms, car"}
    configs = [plan.config_in(setting) for setting in plan.settings]
    ours = [line for line in manifest().values() if "viewnet" in line.methods]
    assert {(each.cells, each.half_extent_m, each.target) for each in configs} == {
        (line.cells, line.half_extent_m, line.target) for line in ours
    }


def test_variants_change_what_they_say_and_nothing_else() -> None:
    plan = ablation_named("small")
    whole = plan.config_of(WHOLE)
    assert whole == TrainConfig.from_json(read_config("viewnet_road").to_json() | dict(plan.base) | {"name": WHOLE})
    assert set(plan.base) == {"epochs", "frames_per_epoch", "doubt_frames"}
    for name, changes in plan.variants.items():
        table, other = whole.to_json(), plan.config_of(name).to_json()
        assert {key for key in table if table[key] != other[key]} - {"name"} == set(changes)
    assert not set(Results(plan, plan.config, {}).trained) & set(Results(plan, plan.config, {}).unseen)
    assert len(Results(plan, plan.config, {}).unseen) >= 5


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"variants": {}}, "variants must have one named whole that changes nothing"),
        ({"variants": {"whole": {}, "a": {"color": 1}}}, "missing or unknown: color"),
        ({"variants": 3}, "variants must be a table, got 3"),
        ({"test_seed": 7301}, "seed and test_seed must differ"),
        ({"chunk": 0}, "sweeps, test_sweeps, other_sweeps and chunk must be at least 1"),
        ({"others": {"viewnet_road": "rooms"}}, "others must not hold viewnet_road, the config of the ablation itself"),
        ({"others": {"viewnet_attic": "rooms"}}, "config must be a TOML file or one of"),
        ({"others": {"viewnet_indoor": "attic"}}, "preset must be one of"),
        ({"others": 3}, "others must be a table, got 3"),
        ({"chosen_sweeps": 3}, r"chosen_sweeps must lie in \[0, 2\], got 3"),
        ({"questions": [20, 20]}, r"questions must be different numbers of at least 1, got \[20, 20\]"),
        ({"claim_precision": 1.0}, r"claim_precision must lie in \(0, 1\), got 1.0"),
        ({"more": 1}, "missing or unknown: more"),
    ],
)
def test_wrong_plans_are_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        AblationPlan.from_json(ablation_named("tiny").to_json() | change)


@pytest.mark.slow
def test_the_tiny_plan_runs_to_its_page_and_goes_on_where_it_was_stopped(tmp_path: Path) -> None:
    pytest.importorskip("torch", reason="torch is not installed: the plan is not run")
    plan, told = ablation_named("tiny"), list[tuple[str, int, int]]()
    store = JobStore.open(tmp_path, plan)
    assert list(run_steps(store, ("validation",), 1, lambda *step: None)) == [
        "validation: not all variants are trained"
    ]
    assert list(run_steps(store, STEPS, 1, lambda *step: told.append(step))) == []
    assert ("test", 2, 2) in told
    assert told[-1] == ("chosen", 1, 1)
    page = page_of(store)
    for words in ("| whole |", "| counts alone |", "| vote |", "far_wall \\*", "| relay |", "| sensor "):
        assert words in page
    assert "| shadow_map | 20 | 1 |" in page
    road, indoor = page.split("## The shipped networks, nuscenes-small")[1].split("## The shipped networks, ugv-small")
    assert "the target is a car" in road
    assert "| viewnet |" not in road
    assert "Cells in doubt become UNKNOWN" not in page
    assert "the target is a pedestrian" in indoor
    assert "| viewnet |" in indoor
    assert [part.count("\n| 0.95 | ") for part in (road, indoor)] == [0, 2]
    assert "### Targets, nuscenes-small" not in page
    assert page.index("### Targets, ugv-small, pedestrian") < page.index("| F1, benign | ≥ 0.94 |")
    lines = store.path.read_text().splitlines()
    store.path.write_text("\n".join(lines[:-1]) + "\n")
    assert list(run_steps(store, STEPS, 1, lambda *step: None)) == []
    assert [json.loads(line).get("said") for line in store.path.read_text().splitlines()[1:]] == [
        json.loads(line).get("said") for line in lines[1:]
    ]
    with pytest.raises(ValueError, match="only must be among models, validation, test, chosen, page, got 'trade'"):
        list(run_steps(store, ("trade",), 1, lambda *step: None))
