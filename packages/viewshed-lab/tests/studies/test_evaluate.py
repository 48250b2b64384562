"""What is counted of one sample, by hand; an estimate whose position in the map is spoofed."""

from functools import partial

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from viewshed import BevGrid, Sweep
from viewshed.estimators.classical import ClassicalEstimator
from viewshed.fov.estimate import CellState
from viewshed.fov.truth import Truth
from viewshed.fov.visibility import CAR
from viewshed.geometry import Rigid
from viewshed.metrics import ConfusionCounts
from viewshed.preprocess.history import History
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed_lab.data import Sample
from viewshed_lab.studies.cases import case_generator
from viewshed_lab.studies.evaluate import Evaluation, Reference
from viewshed_lab.studies.records import BENIGN, VIEW, WEDGE, Case, counts_of
from viewshed_lab.studies.samples import StudySample, sample_of
from viewshed_lab.studies.suite import EstimatorSuite, paper_suite, strict_suite
from viewshed_lab.threats.attacks import Wedge

GRID = BevGrid(4, 8.0)


class _Fixed(ClassicalEstimator):
    """Claims the same cells of every sweep."""

    grid, target, name = GRID, CAR, "fixed"

    def __init__(self, prob: NDArray[np.float32]) -> None:
        self.prob = prob

    def visible_prob(self, leveled: LeveledSweep, history: History | None) -> NDArray[np.float32]:
        return self.prob


def _sample(visible: NDArray[np.bool_], known: NDArray[np.bool_], sweep: Sweep | None = None) -> StudySample:
    returns = np.where(visible, 9, 0).astype(np.uint8)
    truth = Truth(GRID, {"car": returns}, {"car": np.full(GRID.shape, CellState.FREE, np.uint8)})
    measured = Sweep(np.ones((1, 3), np.float32), sensor_height_m=1.0) if sweep is None else sweep
    return StudySample(Sample(measured, truth, known, "street"))


def _evaluation(sample: StudySample, prob: NDArray[np.float32], visible: NDArray[np.bool_]) -> Evaluation:
    suite = EstimatorSuite(GRID, 0.5, {"fixed": _Fixed(prob)})
    reference = Reference.of(sample, visible, sample.known, GRID)
    return Evaluation(sample, suite, reference, "ugv", 3, partial(case_generator, 0, "ugv", 3))


def test_view_and_wedge_are_counted_apart() -> None:
    prob, visible, known = np.zeros(GRID.shape, np.float32), np.zeros(GRID.shape, bool), np.ones(GRID.shape, bool)
    prob[3, :2] = 0.5  # claimed: two cells far ahead
    prob[0, 0] = 0.49
    visible[3, 1:] = True
    known[1] = False
    evaluation = _evaluation(_sample(visible, known), prob, visible)
    estimate = evaluation.suite.estimators["fixed"].estimate(evaluation.sample.sweep)
    found = list(evaluation.compare("fixed", BENIGN, estimate, Wedge(np.pi / 4, np.pi / 2)))
    assert [row["region"] for row in found] == [VIEW, WEDGE]
    assert counts_of(pd.DataFrame(found[:1])) == ConfusionCounts(1, 1, 2, 8, 12 * 16.0)
    assert counts_of(pd.DataFrame(found[1:])) == ConfusionCounts(
        0, 0, 2, 2, 4 * 16.0
    )  # rows 2 and 3, columns 2 and 3: none claimed
    assert {(row["scene"], row["sweep"], row["domain"]) for row in found} == {("street", 3, "ugv")}
    assert ["auprc" in row for row in found] == [True, False]
    assert len(list(evaluation.compare("fixed", BENIGN, estimate, None))) == 1


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
    prob, every = np.zeros(GRID.shape, np.float32), np.ones(GRID.shape, bool)
    prob[2, 2] = 1.0  # one step ahead and one to the left
    reference = Reference(GRID, every, every, clean)
    pose = Rigid(spoof.rotation, clean.translation + spoof.translation)
    claimed = reference.prob_of(_Fixed(prob).estimate(sweep.replace(world_from_sensor=pose)))
    assert [tuple(map(int, found)) for found in np.argwhere(claimed > 0)] == [cell]


def test_the_label_is_right_about_itself_and_a_far_point_is_not() -> None:
    sample = sample_of("ugv", 0, 1, 7)
    suite = paper_suite(sample.truth.grid.half_extent_m)
    reference = Reference.label(sample, suite.grid)

    def counted(method: str, sweep: Sweep) -> ConfusionCounts:
        estimate = suite.estimates(level(sweep, suite.grid))[method]
        return reference.counts(reference.prob_of(estimate), suite.threshold, reference.known)

    label = counted("paper_label", sample.sweep)
    assert (label.over, label.under) == (0, 0)
    far = np.concatenate([sample.sweep.points, [[17.0, 3.0, 0.0]]]).astype(np.float32)
    spoofed = Sweep(far, sensor_height_m=sample.sweep.sensor_height_m, attitude=sample.sweep.attitude)
    assert counted("paper_quantized", spoofed).over > counted("paper_quantized", sample.sweep).over


def test_a_case_that_cannot_be_made_is_named_and_the_rest_goes_on() -> None:
    sample = sample_of("ugv", 0, 1, 7)
    alone = StudySample(sample.sample)
    suite, reference = strict_suite(sample.truth.grid, ["quantized"]), Reference.exact(sample)
    evaluation = Evaluation(alone, suite, reference, "ugv", 0, partial(case_generator, 7, "ugv", 0))
    replay, uniform = evaluation.rows([Case("attack", "replay", "full"), Case("attack", "uniform", "150")])
    assert replay["refused"].startswith("replay needs an earlier sweep, got none")
    assert "both" not in replay
    assert uniform["both"] > 0
