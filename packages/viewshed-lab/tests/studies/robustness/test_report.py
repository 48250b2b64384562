"""What the pages say: verdicts by hand, tables from known records, one HTML file that fetches nothing."""

import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread
from tests.studies.by_hand import refused, rows

from viewshed import BevGrid
from viewshed_lab.studies.figures import (
    OVER,
    PictureRow,
    scene_figure,
)
from viewshed_lab.studies.records import BENIGN, PAPER, WEDGE, Case, Row, Series, row_of
from viewshed_lab.studies.robustness import tables
from viewshed_lab.studies.robustness.plan import RobustnessPlan
from viewshed_lab.studies.robustness.verdicts import AttackedDomain
from viewshed_lab.studies.store import JobResult, ResultStore

CLEAN = [80, 20, 20, 80]
"""Both, over, under, neither: precision, recall and F1 of .8."""
CALM = [8, 2, 2, 8]
AREAS = {"majority_vote": 0.75, "quantized": 0.5}
Store = ResultStore[RobustnessPlan]


def _cells(view: Sequence[int], wedge: Sequence[int] = ()) -> dict[str, list[Sequence[int]]]:
    """Counts of a vote, beside a method that never changes."""
    return {"majority_vote": [view, wedge] if wedge else [view], "quantized": [CLEAN, CALM] if wedge else [CLEAN]}


def _judged(number: int, case: Case, **numbers: Any) -> Row:
    return row_of(Series("ugv", "", case), f"s{number}", number, **numbers)


def _store(folder: Path, worst: list[int], wedge: list[int]) -> Store:
    """Two samples: the vote is given counts under a full ghost wall, quantized never changes."""
    plan = replace(RobustnessPlan.load("tiny"), attacks=("uniform", "ghost_wall"), budgets=("0", "150", "full"))
    store = ResultStore.open(folder, plan)
    full, uniform = Case("attack", "ghost_wall", "full"), Case("paper", "uniform", "150")
    for number in (0, 1):
        attacks = [
            *rows("ugv", number, BENIGN, _cells(CLEAN), AREAS),
            *rows("ugv", number, Case("attack", "uniform", "0"), _cells(CLEAN)),
            *rows("ugv", number, Case("attack", "uniform", "150"), _cells([80, 60, 20, 40])),
            *rows("ugv", number, Case("attack", "ghost_wall", "0"), _cells(CLEAN, CALM)),
            *rows("ugv", number, Case("attack", "ghost_wall", "150"), _cells(CLEAN, CALM)),
            *rows("ugv", number, full, _cells(worst, wedge)),
            refused("ugv", number, Case("attack", "replay", "full"), "replay needs an earlier sweep"),
        ]
        paper = [
            *rows("ugv", number, BENIGN, {"paper_quantized": [CLEAN]}, {"paper_quantized": 0.8}, PAPER),
            *rows("ugv", number, uniform, {"paper_quantized": [[60, 40, 20, 80]]}, {}, PAPER),
        ]
        behind = replace(full, defense="radius")
        defenses = [
            _judged(number, replace(BENIGN, defense="radius"), caught=0, added=0, lost=3, others=100),
            *rows("ugv", number, replace(BENIGN, defense="radius"), _cells(CLEAN)),
            _judged(number, behind, caught=5, added=50, lost=1, others=100),
            *rows("ugv", number, behind, _cells(worst, wedge)),
            _judged(number, replace(full, defense="empty_sector"), caught=0, added=50, lost=0, others=100, alarm=1),
            *rows("ugv", number, replace(full, defense="empty_sector"), _cells(worst, wedge)),
        ]
        for part, found in (("attacks", attacks), ("paper", paper), ("defenses", defenses)):
            store.append((part, "ugv", str(number)), JobResult(found))
    return store


def _domain(folder: Path, worst: list[int], wedge: list[int]) -> AttackedDomain:
    return AttackedDomain(_store(folder, worst, wedge).results(), "ugv")


def test_a_wedge_called_visible_is_found_although_the_view_hardly_changes(tmp_path: Path) -> None:
    """Precision in the wedge falls from 8/10 to 10/20; F1 of the view from .8 to 164/(164+26+18) = .788."""
    verdict = _domain(tmp_path, [82, 26, 18, 74], [10, 10, 0, 0]).verdict("majority_vote", "ghost_wall")
    assert verdict.precision == pytest.approx(0.3)
    assert verdict.recall == 0.0  # it rises at the full budget; at 150 nothing changes
    assert verdict.f1 == pytest.approx(0.8 - 164 / 208)
    assert not verdict.withstands


def test_who_claims_nothing_any_more_loses_all_recall(tmp_path: Path) -> None:
    verdict = _domain(tmp_path, [72, 18, 28, 82], [0, 0, 10, 10]).verdict("majority_vote", "ghost_wall")
    assert (verdict.precision, verdict.recall) == pytest.approx((0.0, 0.8))
    assert not replace(verdict, f1=0.0).withstands
    assert replace(verdict, f1=0.0, recall=0.0).withstands


def test_tables_say_what_was_counted(tmp_path: Path) -> None:
    found = _domain(tmp_path, [82, 26, 18, 74], [10, 10, 0, 0])
    clean = tables.benign_table(found).rows
    assert clean[1] == ["majority_vote", ".800", ".800", ".800 [.800, .800]", ".667", "5", "5", ".750"]
    assert tables.bar_overview([found], WEDGE).rows == [["ghost_wall", ".800 [.800, .800] quantized"]]
    assert tables.bar_overview([found], "view").rows[1] == ["uniform", ".800 [.800, .800] quantized"]
    assert tables.paper_table(found).rows == [["paper_quantized", ".800", ".600 (-25 %)"]]
    assert tables.fall_of(found, "paper_quantized", Case("paper", "uniform", "150")) == pytest.approx(0.25)
    caught = {row[0]: row[1:] for row in tables.caught_table(found).rows}
    assert caught["ghost_wall"] == [".100 / .010", "alarm 1.00"]
    assert caught["*benign*"] == ["– / .030", "–"]
    assert tables.gain_table(found).rows[0] == ["radius", "+.000 / –", "+.000 / –"]
    # Without a wedge the view counts: 80 of 100 claimed cells are right before, 80 of 140 under uniform points.
    assert found.verdict("majority_vote", "uniform", 200).precision == pytest.approx(80 / 100 - 80 / 140)
    assert found.verdict("majority_vote", "ghost_wall", 200).withstands
    assert found.verdict("quantized", "uniform").withstands


def _adaptive(folder: Path) -> Store:
    """Three samples, the first of which meets attackers who query: they open half of the wedge of the vote."""
    plan = replace(
        RobustnessPlan.load("tiny"), samples=(3,), attacks=("far_wall",), budgets=("0", "150"), defenses=("radius",),
        adaptive=("adaptive_over_claim",), adaptive_defended=("majority_vote",),
    )  # fmt: skip
    store = ResultStore.open(folder, plan)
    opened, half = ([82, 26, 18, 74], [10, 10, 0, 0]), ([80, 24, 20, 76], [8, 6, 2, 4])
    little = [80, 22, 20, 78], [8, 4, 2, 6]
    for number in range(3):
        wall = little if number == 0 else opened  # samples that nobody who queries meets do not count beside him
        store.append(("attacks", "ugv", str(number)), JobResult([
            *rows("ugv", number, BENIGN, _cells(CLEAN)),
            *rows("ugv", number, Case("attack", "far_wall", "0"), _cells(CLEAN, CALM)),
            *rows("ugv", number, Case("attack", "far_wall", "150"), _cells(*wall)),
        ]))  # fmt: skip
    name = "adaptive_over_claim"
    store.append(("adaptive", "ugv", "0"), JobResult([
        *rows("ugv", 0, Case("adaptive", name, "0"), _cells(CLEAN, CALM)),
        *rows("ugv", 0, Case("adaptive", name, "150"), _cells(*opened)),
        *rows("ugv", 0, Case("adaptive", name, "0", "radius"), {"majority_vote": [CLEAN, CALM]}),
        *rows("ugv", 0, Case("unaware", name, "150", "radius"), {"majority_vote": little}),
        *rows("ugv", 0, Case("adaptive", name, "150", "radius"), {"majority_vote": half}),
    ]))  # fmt: skip
    return store


def test_who_queries_is_compared_on_the_samples_that_it_met(tmp_path: Path) -> None:
    """Precision in the wedge: .8 untouched, 8/12 under the far wall, 10/20 under the attacker who queried."""
    found = AttackedDomain(_adaptive(tmp_path).results(), "ugv")
    assert tables.adaptive_table(found).rows == [
        ["quantized", "far_wall +0 m² (.000)", "far_wall +0 m² (.000)", "+0 m² (.000)"],
        ["majority_vote", "far_wall +0 m² (.133)", "far_wall +0 m² (.000)", "+2 m² (.300)"],
    ]  # over: 22 - 20 and 26 - 20 cells of .25 m²
    verdict = found.losses("majority_vote", found.adaptive("adaptive_over_claim"))
    assert (verdict.precision, verdict.recall) == pytest.approx((0.3, -0.2))
    assert verdict.f1 == pytest.approx(0.8 - 164 / 208)
    assert tables.summary_table(found).rows[1][-1] == "0 of 1"
    assert tables.summary_table(found).rows[0][-1] == "**1 of 1**"


def test_pictures_open_and_show_forward_above_and_left_on_the_left() -> None:
    grid = BevGrid(8, 4.0)
    claimed = np.zeros(grid.shape, bool)
    claimed[6:, 5:] = True  # ahead on the left, and false
    scene = PictureRow("a", grid, ~np.ones(grid.shape, bool), np.ones(grid.shape, bool), np.ones((2, 2), np.float32),
                  np.array([True, False]), (0.5, 0.4), {"one": claimed})  # fmt: skip
    image = np.asarray(imread(io.BytesIO(scene_figure([scene]))), float)[..., :3]
    rows, columns = np.nonzero(np.abs(image - OVER).max(axis=-1) < 0.04)
    upper = rows < 0.7 * image.shape[0]  # not the legend
    panel = columns[upper] - image.shape[1] / 2
    assert 0 < panel.mean() < image.shape[1] / 4
    assert rows[upper].mean() < image.shape[0] / 2
