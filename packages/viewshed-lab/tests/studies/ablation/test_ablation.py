"""The ablation's parts: who says what of which sweep, and its tiny plan from start to end."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.studies.by_hand import stored

from viewshed.estimators.classical import ClassicalEstimator
from viewshed.estimators.first_blocker import FirstBlocker
from viewshed.fov.visibility import CAR, PEDESTRIAN
from viewshed.grid import BevGrid
from viewshed.metrics import Scores
from viewshed.networks.weights import manifest
from viewshed.preprocess.history import History
from viewshed.preprocess.leveling import LeveledSweep
from viewshed_lab._jobs import LocalEngine
from viewshed_lab.studies.ablation.evaluate import (
    ATTACKS,
    BANDS,
    CASES,
    MARGIN,
    Enveloped,
    evaluate,
    evaluation_of,
)
from viewshed_lab.studies.ablation.jobs import run_study
from viewshed_lab.studies.ablation.page import files_of
from viewshed_lab.studies.ablation.plan import STEPS, WHOLE, AblationPlan
from viewshed_lab.studies.ablation.results import OURS, SettingResults, sure_from
from viewshed_lab.studies.cases import BARE, DEFAULT
from viewshed_lab.studies.records import BENIGN, VIEW, WEDGE, Case, Results, Series
from viewshed_lab.studies.runner import ignore_progress
from viewshed_lab.studies.samples import CLEAR, StudySample, parts_of
from viewshed_lab.studies.store import ResultStore
from viewshed_lab.training.config import TrainConfig, read_config

GRID = BevGrid(32, 64.0)


class Fixed(ClassicalEstimator):
    """An estimator that says the same of every sweep."""

    grid, target, name = GRID, CAR, "fixed"

    def __init__(self, prob: NDArray[np.float32]) -> None:
        self.prob = prob

    def visible_prob(self, leveled: LeveledSweep, history: History | None) -> NDArray[np.float32]:
        return self.prob


WALL = Case("attack", "far_wall", DEFAULT)


def test_every_case_is_shown_and_only_bare_clouds_lose_their_rings(sample: StudySample) -> None:
    one, again = (evaluation_of(sample, {}, "roads", 0, 1, CAR) for _ in range(2))
    for case in CASES:
        sweep = one.tampered(case).sweep
        assert (sweep.model is None) == (case == BARE)
        if case in ATTACKS:
            assert not np.array_equal(sweep.points, sample.sweep.points)
        assert np.array_equal(sweep.points, again.tampered(case).sweep.points)
    wedge = one.tampered(WALL).wedge
    assert wedge is not None
    assert 0 < one.reference.inside(wedge).mean() < 0.5


def test_who_says_the_truth_has_all_of_it_and_wedges_are_parts_of_views(sample: StudySample) -> None:
    visible, known = sample.truth.visible(), sample.known
    methods = {"right": Fixed(visible.astype(np.float32)), "none": Fixed(np.zeros(GRID.shape, np.float32))}
    found = Results.of(None, evaluate({0: sample, 1: sample}, methods, "roads", 1))
    for case in CASES:
        right, none = (found.scores([Series("roads", name, case)]) for name in methods)
        assert right.f1() == 1.0
        assert none.recall() == 0.0
        assert right.cells == 2 * known.sum()
        counts = found.counts(Series("roads", "right", case))
        assert (counts.both, counts.neither, counts.samples) == (
            2 * (visible & known).sum(), 2 * (~visible & known).sum(), 2
        )  # fmt: skip
    wall = Series("roads", "right", WALL)
    assert 0 < found.scores([wall.of(WEDGE)]).cells < found.scores([wall.of(VIEW)]).cells
    assert Series("roads", "right", BENIGN, WEDGE) not in found


def test_parts_are_cells_clear_of_the_threshold_bands_of_range_and_whose_sensor_it_was(sample: StudySample) -> None:
    truth = sample.truth
    parts = parts_of(sample.sample, CAR, BANDS, MARGIN)
    assert np.array_equal(parts[CLEAR], ~np.isin(truth.expected_returns["car"], [3, 4, 5, 6, 7]))
    assert np.array_equal(
        parts_of(sample.sample, PEDESTRIAN, BANDS, MARGIN)[CLEAR],
        ~np.isin(truth.expected_returns["pedestrian"], [1, 2, 3, 4, 5]),
    )
    range_m = np.hypot(GRID.centers[..., 0], GRID.centers[..., 1])
    bands = [parts[name] for name in ("0 to 20 m", "20 to 40 m", "40 to 64 m", "from 64 m on")]
    assert (np.sum(bands, axis=0) == 1).all()
    assert range_m[bands[0]].max() < 20
    assert 40 < range_m[bands[2]].min() < range_m[bands[2]].max() < 64
    assert parts["sensor HDL-32E"].all()
    near = replace(truth, grid=BevGrid(32, 16.0))
    indoor = StudySample(replace(sample.sample, truth=near))
    assert list(parts_of(indoor.sample, CAR, BANDS, MARGIN))[1:4] == ["0 to 5 m", "5 to 10 m", "10 to 16 m"]


def test_parts_are_counted_untouched_and_add_up(sample: StudySample) -> None:
    truth, known = sample.truth.visible(), sample.known
    wrong_far = truth ^ (np.hypot(GRID.centers[..., 0], GRID.centers[..., 1]) >= 40)
    plan = AblationPlan.load("small")
    rows = evaluate({0: sample, 1: sample}, {OURS: Fixed(wrong_far.astype(np.float32))}, "roads", 1)
    results = Results.of(plan, [*rows, *rows])
    assert {s.case for s in results.series() if s.region not in (VIEW, WEDGE)} == {BENIGN}
    found = SettingResults(results, "roads")
    assert found.parts["sensor HDL-32E"] == 4
    assert list(found.parts)[-1] == "sensor HDL-32E"
    assert [found.counts(OURS, BENIGN, part).f1 for part in ("0 to 20 m", "20 to 40 m", "40 to 64 m")] == [
        1.0,
        1.0,
        0.0,
    ]
    near = results.counts(found.series(OURS, BENIGN, "0 to 20 m"))
    assert near.cells == 4 * (known & (np.hypot(*GRID.centers.T).T < 20)).sum()
    assert found.counts(OURS, BENIGN, "sensor HDL-32E").f1 == found.f1(OURS, [BENIGN])


def test_truth_is_that_of_the_target(sample: StudySample) -> None:
    known, truth = sample.known, sample.truth.visible(PEDESTRIAN)
    assert (truth != sample.truth.visible(CAR))[known].any()
    found = Results.of(None, evaluate({0: sample}, {"right": Fixed(truth.astype(np.float32))}, "roads", 1, PEDESTRIAN))
    assert found.scores([Series("roads", "right")]).f1() == 1.0


def test_nothing_behind_the_nearest_obstacle_is_claimed(sample: StudySample) -> None:
    bound = FirstBlocker(GRID, limit_farthest=False)
    found = Enveloped(Fixed(np.ones(GRID.shape, np.float32)), bound).estimate(sample.sweep)
    assert np.array_equal(found.visible(), bound.estimate(sample.sweep).visible())


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
    plan = AblationPlan.load("small")
    reported = {plan.title_of(setting) for setting in plan.settings}
    assert reported == {"roads, car", "rooms, pedestrian", "roads, pedestrian", "rooms, car"}
    configs = [plan.config_in(setting) for setting in plan.settings]
    ours = [line for line in manifest().values() if "viewnet" in line.methods]
    assert {(each.cells, each.half_extent_m, each.target) for each in configs} == {
        (line.cells, line.half_extent_m, line.target) for line in ours
    }


def test_variants_change_what_they_say_and_nothing_else() -> None:
    plan = AblationPlan.load("small")
    whole = plan.config_of(WHOLE)
    assert whole == TrainConfig.from_json(read_config("viewnet_road").to_json() | dict(plan.base) | {"name": WHOLE})
    assert set(plan.base) == {"data", "epochs", "frames_per_epoch"}
    for name, changes in plan.variants.items():
        table, other = whole.to_json(), plan.config_of(name).to_json()
        assert {key for key in table if table[key] != other[key]} - {"name"} == set(changes)
    none = SettingResults(Results.of(plan, ()), plan.config)
    assert not set(none.trained) & set(none.unseen)
    assert len(none.unseen) >= 5


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
        ({"queries": [20, 20]}, r"queries must be different numbers of at least 1, got \[20, 20\]"),
        ({"claim_precision": 1.0}, r"claim_precision must lie in \(0, 1\), got 1.0"),
        ({"more": 1}, "missing or unknown: more"),
    ],
)
def test_wrong_plans_are_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        AblationPlan.from_json(AblationPlan.load("tiny").to_json() | change)


@pytest.mark.slow
def test_the_tiny_plan_runs_to_its_page_and_goes_on_where_it_was_stopped(tmp_path: Path) -> None:
    pytest.importorskip("torch", reason="torch is not installed: the plan is not run")
    plan, seen = AblationPlan.load("tiny"), list[tuple[str, int, int]]()
    store = ResultStore.open(tmp_path, plan)
    assert list(run_study(store, LocalEngine(1), ("validation",), ignore_progress)) == [
        "validation: not all variants are trained"
    ]
    assert list(run_study(store, LocalEngine(1), STEPS, lambda *step: seen.append(step))) == []
    assert ("test", 2, 2) in seen
    assert seen[-1] == ("chosen", 1, 1)
    page = files_of(store)["ablation.md"].decode()
    for words in ("| whole |", "| counts alone |", "| majority_vote |", "far_wall \\*", "| relay |", "| sensor "):
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
    before = stored(store)
    store.path_of(plan.job_keys()[-1]).unlink()
    assert list(run_study(store, LocalEngine(1), STEPS, ignore_progress)) == []
    assert stored(store) == before
    with pytest.raises(ValueError, match="only must be among models, validation, test, chosen, page, got 'trade'"):
        list(run_study(store, LocalEngine(1), ("trade",), ignore_progress))
