"""What is counted of contestants whose answers are known."""

from dataclasses import dataclass, replace

import numpy as np

from viewshed import BevGrid, FovEstimate, Sweep
from viewshed.studies.paper.data import Said, score_contestants
from viewshed.studies.paper.data import TestSweep as Held
from viewshed.studies.paper.jobs import field_of, strict_line
from viewshed.studies.paper.plan import plan_named
from viewshed.studies.paper.protocols import setting_of
from viewshed.studies.suite import subject_of

PLAN = replace(plan_named("tiny"), strengths=False, cells=256)


def _by_returns(sweep: Sweep) -> Said:
    """All cells at .8 for a sweep of one return, at .6 for others."""
    return np.full((1, 4), 0.8 if len(sweep) == 1 else 0.6, np.float32), None


def test_benign_and_attacked_sweeps_are_counted_apart_and_only_where_the_truth_is_known() -> None:
    benign, attacked = Sweep(np.ones((1, 3), np.float32)), Sweep(np.ones((2, 3), np.float32))
    visible, known = np.array([[True, True, False, True]]), np.array([[True, True, True, False]])
    test = Held("here", "uniform", benign, attacked, visible, known)
    line = score_contestants([test, test], {"one": _by_returns}, 0.7)
    assert (line["scenes"], line["attacks"]) == (["here"] * 2, ["uniform"] * 2)
    frames = {tested: [row[:4] for row in told["frames"]] for tested, told in line["scores"]["one"].items()}
    assert frames == {"benign": [[2, 1, 0, 0]] * 2, "adversarial": [[0, 0, 2, 1]] * 2}


@dataclass(frozen=True)
class _Fooled:
    """Claims everything of one sweep and nothing of any other."""

    grid: BevGrid
    clean: Sweep

    def estimate(self, sweep: Sweep) -> FovEstimate:
        claimed = np.full(self.grid.shape, float(len(sweep) == len(self.clean)), np.float32)
        return FovEstimate(self.grid, claimed, np.zeros(self.grid.shape, np.uint8))


def test_the_untouched_wedge_is_that_of_the_clean_sweep() -> None:
    subject, setting = subject_of("ugv", 0, 2, 7), setting_of(PLAN, "strict", "ugv")
    field = field_of(setting, subject, {"fooled": _Fooled(setting.grid, subject.sample.sweep)})
    line = strict_line(PLAN, subject, field, ("ugv", 0))
    rows = {tuple(entry["case"][:2]): entry["scores"]["fooled"] for entry in line["cases"] if "scores" in entry}
    view = rows["benign", ""][:4]
    assert view[2:] == [0, 0]
    assert sum(view) == subject.sample.known.sum()
    assert view[0] == (subject.sample.truth.visible() & subject.sample.known).sum()
    removed = rows["attack", "removal"]
    assert removed[4:6] == [0, 0]
    assert removed[9:11] == removed[6:8]  # all that was claimed before, and nothing of it now
    assert removed[11:] == [0, 0]
    assert 0 < sum(removed[9:]) < sum(view)
