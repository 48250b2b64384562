"""What is counted of estimators whose answers are known."""

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from viewshed.estimators.classical import ClassicalEstimator
from viewshed.fov.visibility import CAR
from viewshed.grid import BevGrid
from viewshed.preprocess.history import History
from viewshed.preprocess.leveling import LeveledSweep
from viewshed_lab.studies.cases import DEFAULT, case_generator
from viewshed_lab.studies.evaluate import Evaluation, Reference
from viewshed_lab.studies.paper.jobs import ATTACKED, both_rows, strict_cases
from viewshed_lab.studies.paper.plan import PaperPlan
from viewshed_lab.studies.paper.protocols import setting_of
from viewshed_lab.studies.records import BENIGN, UNTOUCHED, VIEW, WEDGE, Case, Results, Series
from viewshed_lab.studies.samples import sample_of

PLAN = replace(PaperPlan.load("tiny"), strengths=False, cells=256)
SETTING = setting_of(PLAN, "strict", "ugv")


class _Fooled(ClassicalEstimator):
    """Claims everything of sweeps of one size and nothing of any other."""

    target, name = CAR, "fooled"

    def __init__(self, grid: BevGrid, returns: int) -> None:
        self.grid, self.returns = grid, returns

    def visible_prob(self, leveled: LeveledSweep, history: History | None) -> NDArray[np.float32]:
        return np.full(self.grid.shape, 0.8 if len(leveled.sweep) == self.returns else 0.3, np.float32)


def _evaluation() -> Evaluation:
    sample = sample_of("ugv", 0, 2, 7)
    suite = SETTING.suite({"fooled": _Fooled(SETTING.grid, len(sample.sweep))})
    rng_of = partial(case_generator, PLAN.test_seed, "ugv", 0)
    return Evaluation(sample, suite, Reference.exact(sample), "ugv", 0, rng_of)


def test_benign_and_attacked_sweeps_are_counted_apart_and_only_where_the_truth_is_known() -> None:
    evaluation = _evaluation()
    rows = list(both_rows(evaluation, Case("attack", "removal", DEFAULT), PLAN.test_seed))
    assert [(row["name"], "scores" in row) for row in rows] == [
        ("", False), ("", True), (ATTACKED.name, False), (ATTACKED.name, True)
    ]  # fmt: skip
    results = Results.of(PLAN, rows)
    sample = evaluation.sample
    visible, cells = int((sample.truth.visible() & sample.known).sum()), int(sample.known.sum())
    benign, attacked = (results.counts(Series("ugv", "fooled", case)) for case in (BENIGN, ATTACKED))
    assert (benign.both, benign.over, benign.under) == (visible, cells - visible, 0)
    assert (attacked.both, attacked.under, attacked.neither) == (0, visible, cells - visible)
    assert results.scores([Series("ugv", "fooled")]).counts(0.5)[:2] == (benign.both, benign.over)


def test_the_untouched_wedge_is_that_of_the_clean_sweep() -> None:
    evaluation = _evaluation()
    results = Results.of(PLAN, evaluation.rows(strict_cases(PLAN), untouched=True))
    removal = Series("ugv", "fooled", Case("attack", "removal", DEFAULT))
    view, wedge, untouched = (results.counts(removal.of(region)) for region in (VIEW, WEDGE, UNTOUCHED))
    assert (wedge.both, wedge.over) == (0, 0)
    assert (untouched.both, untouched.over) == (wedge.under, wedge.neither)  # all was claimed, and nothing is now
    assert (untouched.under, untouched.neither) == (0, 0)
    assert 0 < untouched.cells < view.cells == evaluation.sample.known.sum()
    assert removal.under(BENIGN).of(UNTOUCHED) not in results
