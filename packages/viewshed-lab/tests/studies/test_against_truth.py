"""Scores counted by hand on small masks, and on a simulated sample."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.cli.commands import run

from viewshed import CAR, BevGrid, Sweep
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.fov.truth import Truth
from viewshed.metrics import ConfusionCounts
from viewshed_lab.data.sample import Sample
from viewshed_lab.studies.against_truth import DEFINITION, FORMS, TruthEvaluation, form_case
from viewshed_lab.studies.records import VIEW, Results, Series
from viewshed_lab.studies.samples import CLEAR

GRID = BevGrid(4, 8.0)
COUNTS = np.array([[0, 2, 3, 4], [5, 6, 7, 8], [255, 5, 0, 0], [9, 9, 9, 9]], np.uint8)


def _sample(counts: NDArray[np.uint8] = COUNTS, scene: str = "a") -> Sample:
    state = np.where(counts >= 5, CellState.FREE, CellState.HIDDEN).astype(np.uint8)
    masks = {"farthest": np.ones(GRID.shape, bool), "first_blocker": np.eye(4, dtype=bool)}
    known = np.ones(GRID.shape, bool)
    known[3] = False
    return Sample(Sweep(np.ones((1, 3), np.float32)), Truth(GRID, {"car": counts}, {"car": state}, masks), known, scene)


Counted = Callable[[str, str, str], ConfusionCounts]


def _evaluate(samples: Sequence[Sample], evaluation: TruthEvaluation) -> Counted:
    """Return the counts by estimator, form (empty for another definition) and region."""
    results = Results.of(evaluation, [*evaluation.rows(samples), *evaluation.definitions(samples)])

    def counted(method: str, form: str, region: str) -> ConfusionCounts:
        series = Series("", method, form_case(form) if form else DEFINITION, region)
        assert series in results
        return results.counts(series)

    return counted


class _Fixed:
    """Claims the same cells whatever it is given; remembers what it was given."""

    def __init__(self, grid: BevGrid) -> None:
        self.grid = grid
        self.given: list[Sweep] = []

    def estimate(self, sweep: Sweep) -> FovEstimate:
        self.given.append(sweep)
        prob = np.zeros(self.grid.shape, np.float32)
        prob[:, 1] = 0.9
        prob[1, 0] = 0.4
        return FovEstimate(self.grid, prob, np.zeros(self.grid.shape, np.uint8))


def test_cells_are_counted_where_the_truth_is_known() -> None:
    """Column 1 is claimed; visible are (1, 0…3), (2, 0), (2, 1) of the three known rows."""
    scores = _evaluate([_sample()], TruthEvaluation({"fixed": _Fixed}, CAR, {"as it is": FORMS["rings known"]}))
    assert scores("fixed", "as it is", VIEW) == ConfusionCounts(2, 1, 4, 5, 12 * 16.0)
    counts = scores("fixed", "as it is", VIEW)
    assert (counts.precision, counts.recall, counts.iou) == pytest.approx((2 / 3, 2 / 6, 2 / 7))
    assert counts.f1 == pytest.approx(2 * (2 / 3) * (1 / 3) / (2 / 3 + 1 / 3))
    assert (counts.over_m2, counts.under_m2) == (16.0, 64.0)


def test_range_bands_part_the_known_cells() -> None:
    scores = _evaluate([_sample()], TruthEvaluation({"f": _Fixed}, CAR, {"x": FORMS["rings known"]}, bands=(0, 0.5, 2)))
    near, far = scores("f", "x", "0 to 4 m"), scores("f", "x", "4 to 16 m")
    assert near == ConfusionCounts(2, 0, 1, 1, 4 * 16.0)
    assert replace(near + far, samples=1) == scores("f", "x", VIEW)


def test_other_definitions_are_compared_with_ours() -> None:
    scores = _evaluate([_sample()], TruthEvaluation({}, CAR, {}))
    assert scores("farthest", "", VIEW) == ConfusionCounts(6, 6, 0, 0, 12 * 16.0)
    assert scores("first_blocker", "", VIEW) == ConfusionCounts(1, 2, 5, 4, 12 * 16.0)
    with pytest.raises(AssertionError):
        scores("line_of_sight", "", VIEW)


def test_command_writes_a_page(tmp_path: Path) -> None:
    data, page = tmp_path / "data", tmp_path / "truth.md"
    small = ("simulate", "nuscenes-small", "--sweeps", 8, "--workers", 1, "--grid", "64x32", "--out", data)
    assert run(*small)[0] == 0
    words = ("evaluate", "truth", data, "--methods", "shadow_map,first_blocker", "--limit", 3, "--out", page)
    assert run(*words)[0] == 0
    short, text = page.read_text(encoding="utf-8"), (tmp_path / "truth_full.md").read_text(encoding="utf-8")
    assert short.count("| shadow_map |") == 2  # rings known, and by range
    assert "3 of 8 samples" in text
    rows = [line for line in text.splitlines() if line.startswith("| shadow_map |")]
    assert len(rows) == len(FORMS) + 2
    assert "### F1 by sensor, rings known" in text
    assert all(0 <= float(cell) <= 1 for cell in rows[0].split("|")[2:6])
    assert "| line_of_sight |" in text


def test_clear_leaves_out_three_to_seven_returns_of_a_car() -> None:
    scores = _evaluate([_sample()], TruthEvaluation({"fixed": _Fixed}, CAR, {"x": FORMS["rings known"]}))
    assert scores("fixed", "x", CLEAR) == ConfusionCounts(0, 1, 2, 3, 6 * 16.0)
