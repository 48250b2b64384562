"""The study of tracks: drives with truth, what is counted of forged objects, and a run from plan to page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from viewshed._config import preset_names
from viewshed._jobs import LocalEngine
from viewshed.studies.store import ResultStore
from viewshed.studies.tracks.drives import FOVS, Moment, ObjectsTruth, SimulatedDetector, simulate_drive
from viewshed.studies.tracks.evaluate import compare
from viewshed.studies.tracks.jobs import MODELS, run_study, save_models
from viewshed.studies.tracks.page import page_of
from viewshed.studies.tracks.plan import TracksPlan

TINY = TracksPlan.load("tiny")


@pytest.fixture(scope="module")
def moments() -> list[Moment]:
    scene = replace(TINY, seconds=1.0, fovs=FOVS).scene(("count", "hdl32e", "clear", "0"))
    return list(simulate_drive(scene))


def test_every_plan_is_sound_and_no_drive_is_in_two_steps() -> None:
    """Scenes are told apart by their seeds."""
    for name in preset_names(TracksPlan.FOLDER):
        plan = TracksPlan.load(name)
        keys = plan.job_keys()
        assert len(set(keys)) == len(keys)
        steps = {step: {plan.scene(key).preset.seed for key in plan.drive_keys(step)} for step in ("count", "limit")}
        assert not steps["count"] & steps["limit"]
        tested = {plan.scene(key).preset.seed for key in plan.drive_keys("test")}
        assert not tested & (steps["count"] | steps["limit"])


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"fovs": ("best",)}, "fovs must be among"), ({"accused": 0.0}, r"accused must lie in \(0, 1\)"),
        ({"seconds": 0.5}, "seconds must lie in"), ({"test": 0}, "test must be at least 1"),
    ],
)  # fmt: skip
def test_bad_plans_are_refused(changed: dict[str, object], message: str) -> None:
    """A value out of range is named."""
    with pytest.raises(ValueError, match=message):
        replace(TINY, **changed)  # type: ignore[arg-type]


def test_moments_hold_what_their_world_tells(moments: list[Moment]) -> None:
    """A tenth of a second apart; detections lie at the objects that they are of; exact views agree with returns."""
    assert np.diff([moment.t_s for moment in moments]) == pytest.approx(0.1)
    for moment in moments:
        numbers = moment.truth.numbers.tolist()
        rows = [numbers.index(number) for number in moment.of_object[moment.of_object >= 0]]
        found = moment.detections.boxes[moment.of_object >= 0]
        assert (np.hypot(*(found - moment.truth.boxes[rows])[:, :2].T) < 1.0).all()
    last = moments[-1]
    near = np.hypot(*(last.truth.boxes[:, :2] - last.ground[:2]).T) < 40.0
    many = near & (last.truth.returns >= 30)
    assert many.any()
    for fov in ("exact", "default"):
        assert (last.views[fov].view.visible(last.truth.boxes[many]) > 0.9).all()
    assert last.views["polygon"].cells is None
    assert last.views["none"].view.visible(last.truth.boxes).min() == 1.0


def test_the_detector_of_the_package_can_be_asked() -> None:
    """On returns of one sweep it finds objects with many of them, and each detection lies at its object."""
    scene = replace(TINY, seconds=1.0).scene(("count", "hdl32e", "clear", "0"))
    moment = next(simulate_drive(scene, ("default",), "perception"))
    numbers = moment.truth.numbers.tolist()
    is_object = moment.of_object >= 0
    rows = [numbers.index(number) for number in moment.of_object[is_object]]
    away = moment.detections.boxes[is_object, :2] - moment.truth.boxes[rows, :2]
    assert len(rows) >= 3
    assert (np.hypot(*away.T) <= 2.0).all()


def test_the_simulated_detector_finds_by_returns() -> None:
    """Many returns are found nearly always, few rarely, none never."""
    counts = np.repeat([0, 3, 100], 200)
    boxes = np.tile([0.0, 0.0, 0.75, 4.0, 2.0, 1.5, 0.0], (600, 1))
    boxes[:, 0] = 10.0 * np.arange(600)
    truth = ObjectsTruth(np.arange(600, dtype=np.int32), boxes, np.full(600, 3, np.uint8), counts.astype(np.int32))
    _, of_object = SimulatedDetector(np.random.default_rng(0)).detect(truth, np.zeros((0, 3)), 0.0)
    shares = np.bincount(counts[of_object], minlength=101)[[0, 3, 100]] / 200
    assert shares[0] == 0.0
    assert 0.1 < shares[1] < 0.5
    assert shares[2] > 0.95


def test_tracks_at_objects_that_do_not_count_are_neither_right_nor_false(moments: list[Moment]) -> None:
    """By hand: an exact track, one at an object that does not count, and one at nothing, which costs 8."""
    moment = moments[0]
    near = np.flatnonzero(np.hypot(*(moment.truth.boxes[:, :2] - moment.ground[:2]).T) < 30.0)
    counted = np.zeros(len(moment.truth.boxes), bool)
    counted[near[0]] = True
    exact, other = moment.truth.boxes[near[[0]]], moment.truth.boxes[near[[1]]]
    assert compare(exact, moment, counted) == 0.0
    assert compare(np.concatenate([exact, other]), moment, counted) == 0.0
    assert compare(other, moment, counted) == pytest.approx(np.sqrt(8.0))


def test_a_run_from_plan_to_page(tmp_path: Path) -> None:
    """Stopped after its first step and gone on, it ends with a page and a model for each field of view."""
    plan = replace(TINY, seconds=3.2, fovs=("default",), attacks=("fabricate_static",), accused=0.2, count=1, limit=2)
    store, engine = ResultStore.open(tmp_path, plan), LocalEngine(1)
    waiting = list(run_study(store, engine, ("test",)))
    assert len(waiting) == 1
    assert "3 drives that it rests on are not done" in waiting[0]
    assert not list(run_study(store, engine, ("count",)))
    assert not list(run_study(store, engine))
    save_models(store)
    assert (tmp_path / MODELS / "default.json").exists()
    page = page_of(store)
    assert "| fabricate_static |" in page
    assert "fabricated found within 1 s" in page
