"""The study of tracks: drives with truth, what is counted of forged objects, and a run from plan to page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from viewshed.detections import Detections
from viewshed.objects.sensor_view import SensorView
from viewshed.objects.single import shipped_model
from viewshed.objects.views import SeesAll
from viewshed_lab._config import preset_names
from viewshed_lab._jobs import LocalEngine
from viewshed_lab.studies.store import ResultStore
from viewshed_lab.studies.tracks.drives import FOVS, Moment, ObjectsTruth, simulate_drive
from viewshed_lab.studies.tracks.evaluate import compare, evaluate, is_at_object, track_drive
from viewshed_lab.studies.tracks.jobs import COASTING_S, rules_of, run_study
from viewshed_lab.studies.tracks.lidar_level import LIDAR_ATTACKS, SweepForger
from viewshed_lab.studies.tracks.page import _ratio_of_drives, files_of
from viewshed_lab.studies.tracks.plan import TracksPlan
from viewshed_lab.studies.tracks.published import PublishedRules
from viewshed_lab.studies.tracks.stone_soup import stone_soup_centers

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
        tested = {plan.scene(key).preset.seed for key in plan.drive_keys("test") + plan.drive_keys("lidar")}
        assert not tested & (steps["count"] | steps["limit"])


def test_moments_hold_what_their_world_tells(moments: list[Moment]) -> None:
    """A tenth of a second apart; detections lie at the objects that they are of; exact views agree with returns."""
    assert np.diff([moment.t_s for moment in moments]) == pytest.approx(0.1)
    for moment in moments:
        numbers = moment.truth.numbers.tolist()
        rows = [numbers.index(number) for number in moment.of_object[moment.of_object >= 0]]
        found = moment.detections.boxes[moment.of_object >= 0]
        assert (np.hypot(*(found - moment.truth.boxes[rows])[:, :2].T) <= 2.0).all()
    last = moments[-1]
    near = np.hypot(*(last.truth.boxes[:, :2] - last.ground[:2]).T) < 40.0
    many = near & (last.truth.returns >= 30)
    assert many.any()
    assert (last.views["default"].view.visible(last.truth.boxes[many]) > 0.9).all()
    assert last.views["polygon"].cells is None
    assert last.views["none"].view.visible(last.truth.boxes).min() == 1.0


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


def test_an_object_is_there_within_two_meters_or_a_quarter_of_its_length() -> None:
    """By hand: a car and a bus of 12 m, each with a track 2.5 m off."""
    boxes = np.array([[0.0, 0.0, 0.75, 4.0, 2.0, 1.5, 0.0], [50.0, 0.0, 1.5, 12.0, 2.5, 3.0, 0.0]])
    truth = ObjectsTruth(np.arange(2, dtype=np.int32), boxes, np.array([3, 4], np.uint8), np.full(2, 50, np.int32))
    assert is_at_object(boxes + np.array([2.5, 0, 0, 0, 0, 0, 0]), truth).tolist() == [False, True]


def test_a_run_from_plan_to_page(tmp_path: Path) -> None:
    """Stopped after its first step and gone on, it ends with a page."""
    plan = replace(
        TINY, seconds=3.2, fovs=("published", "default"), attacks=("fabricate_static",), accused=0.3, count=1, limit=2,
        lidar_attacks=("ghost_car_clean",),
    )  # fmt: skip
    store, engine = ResultStore.open(tmp_path, plan), LocalEngine(1)
    waiting = list(run_study(store, engine, ("test",)))
    assert len(waiting) == 1
    assert "3 drives that it rests on are not done" in waiting[0]
    assert not list(run_study(store, engine, ("count",)))
    assert not list(run_study(store, engine))
    assert rules_of(tmp_path, plan, "published") in [PublishedRules(coast_s=each) for each in COASTING_S]
    page = files_of(store)["tracks.md"].decode()
    assert "\n| fabricate_static |" in page
    assert "\n| Stone Soup, none |" in page
    assert "| ghost_car_clean | default, probability |" in page
    assert "fabricated found within 1 s" in page


def test_an_object_behind_another_keeps_its_track_or_is_dropped(moments: list[Moment]) -> None:
    """By hand: hidden for half a second; with rules that forget after .2 s it comes back under another id."""
    first = moments[0]
    box = np.array([[10.0, 0.0, 0.75, 4.0, 2.0, 1.5, 0.0]]) + np.array([*first.ground, 0, 0, 0, 0])
    kept = []
    for coast_s in (3.0, 0.2):
        drive = []
        for k in range(40):
            is_hidden = 20 <= k < 25
            truth = ObjectsTruth(np.array([7]), box, np.array([3], np.uint8), np.array([0 if is_hidden else 50]))
            rows = np.zeros(0, np.intp) if is_hidden else np.zeros(1, np.intp)
            found = Detections(box, truth.kinds, truth.returns).take(rows)
            view = SensorView("top", SeesAll(0.1 * k), first.ground[:2])
            drive.append(
                Moment(
                    0.1 * k, first.ground, truth, found, np.array([7], np.int32)[rows], np.ones(1), {"none": view},
                    np.full(len(rows), 0.1), np.zeros(len(rows), bool),
                )
            )  # fmt: skip
        rules = PublishedRules(cost="center", coast_s=coast_s)
        kept.append(evaluate(list(track_drive(drive, "none", rules=rules)), shipped_model()).occluded)
    assert kept == [[False], [True]]


@pytest.mark.parametrize("name", LIDAR_ATTACKS)
def test_a_forged_sweep_has_a_ghost_or_lacks_an_object(name: str) -> None:
    """After two seconds; what is forged is told: detections of the ghost, objects that are gone."""
    scene = replace(TINY, seconds=2.6).scene(("lidar", "hdl32e", "clear", "0"))
    forger = SweepForger(name, np.random.default_rng(3))
    forged = list(simulate_drive(scene, ("default",), forger=forger))
    assert all(moment.report is not None for moment in forged)
    assert not any(moment.ghost.any() or moment.gone for moment in forged[:20])
    if name.startswith("ghost"):
        assert sum(moment.ghost.any() for moment in forged[20:]) >= (1 if name == "ghost_car_clean" else 0)
        assert not any(moment.gone for moment in forged)
    else:
        assert any(moment.gone for moment in forged[20:])
        # What is gone is not detected.
        for moment in forged[20:]:
            assert not moment.gone & set(moment.of_object.tolist())


def test_stone_soup_confirms_follows_and_drops() -> None:
    """By hand: a car at 5 m/s that is found for 2 s and then no more, and one false detection."""
    sweeps = []
    for k in range(35):
        xy = [[0.5 * k, 3.0]] if k < 20 else []
        xy += [[-20.0, -20.0]] if k == 7 else []
        boxes = np.zeros((len(xy), 7))
        boxes[:, :2], boxes[:, 3:6] = np.array(xy).reshape(-1, 2), 1.0
        sweeps.append((0.1 * k, Detections(boxes, np.full(len(xy), 3, np.uint8), np.full(len(xy), 50, np.int32))))
    centers = stone_soup_centers(sweeps, coast_s=1.0)
    assert [len(each) for each in centers[:2]] == [0, 0]
    assert all(len(each) == 1 for each in centers[4:20])
    assert centers[19][0] == pytest.approx([9.5, 3.0], abs=0.3)
    assert centers[27][0] == pytest.approx([13.5, 3.0], abs=1.0)  # it goes on where it was last seen
    assert not len(centers[34])


def test_ratios_are_of_the_same_drives() -> None:
    """By hand: ours is 20 % better on each drive, however the drives differ: no doubt is left about the ratio."""
    theirs = np.array([1.0, 9.0, 4.0, 2.0])
    assert _ratio_of_drives(0.8 * theirs, theirs, list("abcd")) == pytest.approx((0.8, 0.8, 0.8))
    ratio, low, high = _ratio_of_drives(theirs[::-1], theirs, list("abcd"))
    assert low < ratio == 1.0 < high


def test_intervals_of_ratios_draw_worlds_with_all_their_drives() -> None:
    """By hand: two worlds with ratios of 1/2 and 3/2; each alone has a chance of 1/4, and one world has no interval."""
    ours, theirs = np.array([1.0, 3.0] * 3), np.full(6, 2.0)
    assert _ratio_of_drives(ours, theirs, list("ababab")) == pytest.approx((1.0, 0.5, 1.5))
    assert _ratio_of_drives(ours, theirs, list("aaaaaa")) == pytest.approx((1.0, np.nan, np.nan), nan_ok=True)
    of_number = [TINY.scene(("test", sensor, "clear", "0")).preset.seed for sensor in ("hdl32e", "os1_64")]
    assert of_number[0] == of_number[1] != TINY.scene(("test", "hdl32e", "clear", "1")).preset.seed
