"""What honest agents report: weights from counts, and what is asked of views."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from viewshed.agents.honest import (
    HonestExamples,
    HonestModel,
    ObjectReports,
    fit_honest,
    own_box_columns,
    place_columns,
    reported_columns,
    withholding,
)
from viewshed.agents.many import AgentReport, object_reports
from viewshed.agents.view_evidence import Surprises
from viewshed.detections import Detections
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.objects.cells import BoxCells
from viewshed.objects.log_ratios import Weights, counted
from viewshed_lab.threats.view_attacks import with_objects

GRID = BevGrid(128, 32.0)

CAR = np.array([12.0, 3.0, 0.8, 4.2, 1.8, 1.5, 0.0])


def reports(seen: np.ndarray, surface: np.ndarray, rng: np.random.Generator, before: int = 0) -> ObjectReports:
    """Return reports of agents whose views hold so much surface where each object is, all reported so often before."""
    count, agents = seen.shape
    cells = np.zeros((count, agents, len(BoxCells._fields)))
    cells[..., 0], cells[..., 1] = surface, 1.0 - surface
    return ObjectReports(
        seen, np.ones(seen.shape, bool), np.full(seen.shape, 0.9), rng.uniform(5, 45, seen.shape),
        np.zeros(agents, np.int64), np.full(count, 4.5), cells, np.where(seen[..., None], cells, 0.0),
        np.full(seen.shape, 9.0), np.full(seen.shape, before), np.zeros(seen.shape, np.int64),
        *(np.full(seen.shape, np.nan),) * 2,
    )  # fmt: skip


def test_weights_are_the_log_odds_of_the_bins() -> None:
    rng = np.random.default_rng(2)
    columns = np.column_stack([rng.integers(0, 3, 60000), 3 + rng.integers(0, 2, 60000)])
    odds = np.array([-2.0, 0.0, 1.5])[columns[:, 0]] + np.array([-0.5, 0.5])[columns[:, 1] - 3]
    fitted = Weights.fit(counted(columns, 5), rng.random(60000) < 1 / (1 + np.exp(-odds)))
    assert np.allclose(fitted(columns), odds, atol=0.1)
    with pytest.raises(ValueError, match="both classes"):
        Weights.fit(counted(columns, 5), np.ones(60000, bool))


def test_a_model_learns_who_reports_and_what_lies_elsewhere() -> None:
    rng = np.random.default_rng(3)
    examples = []
    for _ in range(30):
        # Objects hold surface; who has little of it reports seldom. Places elsewhere are free.
        surface = rng.choice([0.02, 0.45], (40, 4))
        seen = rng.random((40, 4)) < np.where(surface > 0.1, 0.95, 0.3)
        seen[:5] = np.eye(4, dtype=bool)[rng.integers(0, 4, 5)]
        one = np.eye(4, dtype=bool)[rng.integers(0, 4, 20)]
        elsewhere = reports(one, np.zeros((20, 4)), rng)
        said = reports(seen, surface, rng, before=3)
        chosen = seen & (rng.random(seen.shape) < 0.1)
        left_out = replace(said, seen=seen & ~chosen, able=chosen)
        examples.append(HonestExamples.of(said, seen.sum(axis=1) > 1, said, elsewhere, elsewhere, left_out))
    model = fit_honest(examples, Surprises.blank())
    surface = np.array([[0.45, 0.02, 0.45, 0.0]])
    said = reports(np.array([[True, False, True, True]]), surface, rng)
    odds = model.reported(reported_columns(said)[0])[0] + model.of_others[2, 0]
    assert odds[0] > 1.0
    assert odds[1] < 0.0
    displaced, invented = (question(own_box_columns(said)[0])[0] for question in (model.displaced, model.invented))
    assert invented[3] > invented[0]
    assert displaced[3] > 1.0
    assert displaced[0] < 0.0
    there = model.there(said, place_columns(said), own_box_columns(said)[0], model.withheld_ratio(said))[0]
    assert there[0] > there[1]  # a report speaks for an object, silence against it
    # Who alone reports a place that others see free is as one that puts an object there.
    alone = reports(np.eye(4, dtype=bool)[:1], np.array([[0.45, 0.0, 0.0, 0.0]]), rng)
    hedge = reports(np.eye(4, dtype=bool)[:1], np.array([[0.45, 0.45, 0.45, 0.45]]), rng)
    free, covered = (model.silent_views(place_columns(each)[0], each.silent_now)[0, 0] for each in (alone, hedge))
    assert free[0] == covered[0] == 0.0
    assert (free[1:] > covered[1:] + 0.5).all()
    # Who is silent about much of which it holds the surface withholds it; who holds little of it is honest.
    silent = np.zeros((3, 4), bool)
    silent[:, 3] = True
    withheld = reports(silent, np.array([[0.45, 0.02, 0.45, 0.45]] * 3), rng, before=3)
    ratio = model.withheld_ratio(withheld)
    evidence = withholding(withheld, ratio)
    assert (ratio[:, 0] > ratio[:, 1] + 0.5).all()
    assert (ratio[:, 3] == 0.0).all()
    assert evidence[0] > max(evidence[1], 0.0) + 0.5
    assert evidence[3] < -0.1
    # Its silence speaks less against the object than that of an agent that never reported it.
    place, own = place_columns(withheld), own_box_columns(withheld)[0]
    never = replace(withheld, before=silent * 0)
    known, unknown = (model.there(each, place, own, model.withheld_ratio(each))[:, 0] for each in (withheld, never))
    assert (unknown < known).all()
    assert (known < 0.0).all()
    assert (np.diff(model.found, axis=-1) >= 0).all()  # and never less where more is claimed
    again = HonestModel.from_json(model.to_json())
    assert np.allclose(again.reported.of_bins, model.reported.of_bins, atol=1e-3)
    with pytest.raises(ValueError, match="fit the model again"):
        HonestModel.from_json(model.to_json().replace("0.995", "0.99").replace("0.98", "0.97"))


def test_what_agents_say_and_could_have_seen() -> None:
    state, pose = np.full(GRID.shape, CellState.FREE, np.uint8), Rigid.from_yaw(0.7)
    view = FovEstimate(GRID, np.full(GRID.shape, 0.95, np.float32), state, world_from_level=pose, agent="a")
    found = Detections(CAR[None] + [[0.2, 0, 0, 0, 0, 0, 0]], np.array([3]), np.array([40]))
    seen = AgentReport(with_objects(view, found.boxes), found)
    far = Rigid(np.eye(3), np.array([200.0, 0.0, 0.0]))
    blind = AgentReport(FovEstimate(GRID, view.visible_prob, state, world_from_level=far, agent="b"), Detections.none())
    boxes = found.moved(pose).boxes
    said = object_reports([seen, blind], np.array([0, 2]), 3, boxes, np.array([[0, -1]], np.int32), np.zeros((1, 4, 3)))
    assert said.seen.tolist() == [[True, False, False]]
    assert said.able.tolist() == [[True, False, False]]  # b is too far, and the third says nothing
    assert said.cells[0, 0, 0] > 0.1  # its near side
    assert np.allclose(said.cells[0, 0], said.own_cells[0, 0])
    assert 0.7 < said.visible[0, 0] < 0.96
    assert (said.apart_m > 90).all()
    assert [counts.tolist() for counts in said.others()] == [[[0, 1, 1]], [[0, 0, 0]]]
