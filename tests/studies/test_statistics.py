"""Scores counted by hand; an estimate whose place in the map is spoofed; pooled figures and intervals."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from viewshed import BevGrid, Sweep
from viewshed.datasets import Sample
from viewshed.estimators.base import ClassicalEstimator
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.fov.truth import Truth
from viewshed.fov.visibility import CAR
from viewshed.geometry import Rigid
from viewshed.preprocess.history import History
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.studies.cases import BENIGN, Case
from viewshed.studies.robustness.plan import study_named
from viewshed.studies.robustness.results import Key, Results, f1, precision, recall
from viewshed.studies.robustness.store import ResultStore
from viewshed.studies.statistics import Reference, average_precision, counts, score
from viewshed.studies.suite import Contestants, paper, subject_of

GRID = BevGrid(4, 8.0)


def _by_sorting(prob: NDArray[np.float32], visible: NDArray[np.bool_]) -> float:
    """The definition itself: from the surest down, precision at each threshold times the recall it adds."""
    total, recall_before = 0.0, 0.0
    for threshold in sorted(set(prob.tolist()), reverse=True):
        claimed = prob >= threshold
        recall_now = (claimed & visible).sum() / visible.sum()
        total += (recall_now - recall_before) * (claimed & visible).sum() / claimed.sum()
        recall_before = recall_now
    return float(total)


@given(st.lists(st.tuples(st.integers(0, 20), st.booleans()), min_size=1, max_size=40))
def test_average_precision_is_that_of_the_definition(cells: list[tuple[int, bool]]) -> None:
    prob = np.array([p / 20 for p, _ in cells], np.float32)
    visible = np.array([v for _, v in cells])
    if visible.any():
        assert average_precision(prob, visible) == pytest.approx(_by_sorting(prob, visible))
    else:
        assert np.isnan(average_precision(prob, visible))


def test_average_precision_by_hand() -> None:
    """Ranks 1 to 4 are visible, hidden, visible, hidden: 1 · 1/2 + 2/3 · 1/2."""
    prob = np.array([0.9, 0.8, 0.7, 0.1], np.float32)
    assert average_precision(prob, np.array([True, False, True, False])) == pytest.approx(5 / 6)


def test_view_and_wedge_are_counted_apart() -> None:
    prob = np.zeros(GRID.shape, np.float32)
    prob[3, :2] = 0.5  # claimed: two cells far ahead
    prob[0, 0] = 0.49
    visible = np.zeros(GRID.shape, bool)
    visible[3, 1:] = True
    known = np.ones(GRID.shape, bool)
    known[1] = False
    azimuth = np.arctan2(GRID.centers[..., 1], GRID.centers[..., 0]).astype(np.float32)
    reference = Reference.of(visible, known, azimuth)
    left_ahead = (reference.azimuth > 0) & (reference.azimuth < np.pi / 2)
    found = score(prob, 0.5, reference, left_ahead)
    assert found[:4] == [1, 1, 2, 8]
    assert found[4:8] == [0, 0, 2, 2]  # rows 2 and 3, columns 2 and 3: two visible, none claimed
    assert score(prob, 0.5, reference, None)[4:8] == [0, 0, 0, 0]


def test_counts_add_up() -> None:
    rng = np.random.default_rng(0)
    claimed, visible = rng.random((2, 50)) < 0.4
    assert counts(claimed, visible) == (
        sum(c and v for c, v in zip(claimed, visible, strict=True)),
        sum(c and not v for c, v in zip(claimed, visible, strict=True)),
        sum(v and not c for c, v in zip(claimed, visible, strict=True)),
        sum(not c and not v for c, v in zip(claimed, visible, strict=True)),
    )


class _OneCell(ClassicalEstimator):
    """Claims the cell one step ahead and one to the left of the sensor."""

    grid, target, name = GRID, CAR, "one"

    def _estimate(self, leveled: LeveledSweep, history: History | None) -> FovEstimate:
        prob = np.zeros(GRID.shape, np.float32)
        prob[2, 2] = 1.0
        return FovEstimate(GRID, prob, np.zeros(GRID.shape, np.uint8), world_from_level=leveled.sweep.world_from_sensor)


def _field(pose: Rigid | None) -> Contestants:
    reference = Reference.of(np.ones(GRID.shape, bool), np.ones(GRID.shape, bool), np.zeros(GRID.shape, np.float32))
    return Contestants(GRID, 0.5, {"one": _OneCell()}, reference, pose)


@pytest.mark.parametrize(
    ("spoof", "cell"),
    [
        (Rigid.from_yaw(0.0), (2, 2)),
        (Rigid(np.eye(3), np.array([4.0, 0.0, 0.0])), (3, 2)),  # said to be 4 m farther ahead: one cell
        (Rigid(np.eye(3), np.array([0.0, -4.0, 0.0])), (2, 1)),
        (Rigid.from_yaw(np.pi / 2), (1, 2)),  # turned left: ahead-left becomes behind-left
    ],
)
def test_an_estimate_with_a_spoofed_pose_claims_cells_elsewhere(spoof: Rigid, cell: tuple[int, int]) -> None:
    """Claims are compared where they lie in the map; the sensor itself has not moved."""
    clean = Rigid(np.eye(3), np.array([100.0, 50.0, 0.0]))
    sweep = Sweep(np.ones((1, 3), np.float32), sensor_height_m=1.0)
    pose = Rigid(spoof.rotation, clean.translation + spoof.translation)
    claimed = _field(clean).probs(sweep.replace(world_from_sensor=pose))["one"]
    assert [tuple(map(int, found)) for found in np.argwhere(claimed > 0)] == [cell]


def test_the_label_is_right_about_itself_and_a_far_point_is_not() -> None:
    sample = subject_of("ugv", 0, 1, 7).sample
    field = paper(sample)
    probs = field.probs(sample.sweep)
    reference = field.reference
    assert score(probs["paper_label"], field.threshold, reference, None)[1:3] == [0, 0]
    far = np.concatenate([sample.sweep.points, [[17.0, 3.0, 0.0]]]).astype(np.float32)
    spoofed = field.probs(Sweep(far, sensor_height_m=sample.sweep.sensor_height_m, attitude=sample.sweep.attitude))
    before, after = (score(p["paper_quantized"], 0.7, reference, None) for p in (probs, spoofed))
    assert isinstance(after[1], int)
    assert isinstance(before[1], int)
    assert after[1] > before[1]


def _results(tmp_path: Path) -> Results:
    study = replace(study_named("tiny"), domains=("ugv",), samples=(3,))
    store = ResultStore.open(tmp_path, study)
    attacked = Case("attack", "ghost_wall", "full")
    for number, values in ((2, [3, 1, 1, 5, 1, 0, 1, 0, 0.5]), (0, [1, 1, 3, 5, 0, 0, 1, 1, None])):
        cases = [{"case": ["benign", "", "", ""], "scores": {"majority_vote": [8, 0, 0, 2, 0, 0, 0, 0, 1.0]}},
                 {"case": ["attack", "ghost_wall", "full", ""], "scores": {"majority_vote": values}},
                 {"case": ["attack", "replay", "full", ""], "refused": "no earlier sweep"},
                 {"case": ["attack", "ghost_wall", "full", "radius"], "defense": [None, 1, 2, 3, 4]}]  # fmt: skip
        store.append({"job": ["ugv", number, "attacks"], "about": {"cell_m2": 0.25}, "cases": cases})
    found = Results.read(store)
    assert found.refused == {("ugv", Case("attack", "replay", "full"), "no earlier sweep"): 2}
    assert np.nansum(found.judged["ugv", replace(attacked, defense="radius")], axis=0).tolist() == [0, 2, 4, 6, 8]
    return found


def test_samples_are_pooled_whatever_the_order_of_the_lines(tmp_path: Path) -> None:
    found, key = _results(tmp_path), Key("ugv", "strict", Case("attack", "ghost_wall", "full"), "majority_vote")
    tally = found.tally(key)
    assert (tally.both, tally.over, tally.under, tally.neither) == (4, 2, 4, 10)
    assert (tally.area_m2, tally.samples, tally.over_m2) == (5.0, 2, 0.25)
    assert found.tally(key, "wedge").recall == pytest.approx(1 / 3)
    assert found.each(key, precision).tolist() == pytest.approx([0.5, 0.75])
    assert found.each(key, recall).tolist() == pytest.approx([0.25, 0.75])
    assert found.areas(key).tolist() == [0.5]
    assert found.samples("ugv") == 2
    assert found.samples("ugv", "paper") == 0
    assert np.isnan(found.tally(replace(key, estimator="nobody")).f1)


def test_an_interval_spans_what_redrawn_samples_give(tmp_path: Path) -> None:
    """Two samples with F1 of 1/3 and 3/4: redrawn, one of them alone has a chance of 1/4 each."""
    found, key = _results(tmp_path), Key("ugv", "strict", Case("attack", "ghost_wall", "full"), "majority_vote")
    assert found.interval([key], f1) == pytest.approx((1 / 3, 3 / 4))
    benign = replace(key, case=BENIGN)
    assert found.interval([benign], f1) == (1.0, 1.0)
    assert found.interval([key, benign], f1) == pytest.approx((2 / 3, 7 / 8))
    assert np.isnan(found.interval([replace(key, estimator="nobody")], f1)).all()


def test_only_samples_with_truth_and_cells_that_are_known_count() -> None:
    truth = Truth(
        GRID, {"car": np.full(GRID.shape, 9, np.uint8)}, {"car": np.full(GRID.shape, CellState.FREE, np.uint8)}
    )
    known = np.zeros(GRID.shape, bool)
    known[3, 0] = True
    from viewshed.studies.suite import strict

    field = strict(Sample(Sweep(np.ones((1, 3), np.float32)), truth, known), ["quantized"])
    assert list(field.estimators) == ["quantized"]
    assert field.reference.visible.tolist() == [True]
    assert field.reference.azimuth.tolist() == pytest.approx([float(np.arctan2(-6.0, 6.0))])
