from dataclasses import replace

import numpy as np
import pytest
from tests.objects.scripted import ScriptedView, cars, everywhere

from viewshed.arrays import F64
from viewshed.detections import Detections
from viewshed.objects.existence import (
    after_detection,
    after_miss,
)
from viewshed.objects.kalman import Motion
from viewshed.objects.tracker import ExistenceRules, Tracker
from viewshed.objects.tracks import Tracks
from viewshed.objects.views import SeesAll
from viewshed_lab.studies.tracks.published import PublishedRules


def _drive(tracker: Tracker, sweeps: int, *, start: int = 0, y: float = 0.0, speed: float = 10.0) -> Tracks:
    """Return the tracks after a car was seen driving along x, ten times a second."""
    for k in range(start, start + sweeps):
        tracks = tracker.step(0.1 * k, cars((speed * 0.1 * k, y)), SeesAll(0.1 * k))
    return tracks


def test_existence_after_a_detection_is_bayes_over_all_that_may_have_happened() -> None:
    """An object, a lasting false source or nothing, found or not; what was matched is its detection, or a false one."""
    r, q, found, density, clutter, often = 0.4, 0.3, 0.7, 0.2, 0.01, 0.5
    true = r * (found * density + (1 - found) * clutter)
    false = q * (often * found * density + (1 - often * found) * clutter)
    total = true + false + (1 - r - q) * clutter
    one = np.ones(1)
    mine = after_detection(r * one, q * one, found * one, density * one, clutter, recurrence=often)
    np.testing.assert_allclose(np.concatenate(mine), [true / total, false / total])


def test_existence_after_a_miss_is_bayes() -> None:
    mine = after_miss(np.array([0.4]), np.array([0.2]), np.array([0.7]), recurrence=0.5)
    total = 0.4 * 0.3 + 0.2 * 0.65 + 0.4
    np.testing.assert_allclose(np.concatenate(mine), [0.4 * 0.3 / total, 0.2 * 0.65 / total])


def test_a_miss_in_plain_view_ends_a_track_and_a_hidden_one_does_not() -> None:
    for prob, is_kept in ((1.0, False), (0.0, True)):
        tracker = Tracker()
        _drive(tracker, 10)
        for k in range(10, 30):
            tracks = tracker.step(0.1 * k, Detections.none(), ScriptedView(0.1 * k, everywhere(prob), found=0.9))
        assert bool(len(tracks)) == is_kept
        if is_kept:
            assert tracks.existence[0] > 0.9
            assert tracks.seen_s[0] == pytest.approx(0.9)


def test_a_hidden_track_whose_place_is_vague_is_not_shown_until_it_is_detected_again() -> None:
    """It drives, so that its place grows vague within seconds; found again it is the same track, and shown."""
    tracker = Tracker()
    _drive(tracker, 20)
    shown = []
    for k in range(20, 50):
        tracks = tracker.step(0.1 * k, Detections.none(), ScriptedView(0.1 * k, everywhere(0.0)))
        std_m = np.sqrt(tracks.covariances[0, 0, 0])
        assert tracks.confirmed[0] == (std_m <= 2.5)
        shown.append(bool(tracks.confirmed[0]))
    assert shown[0]
    assert not shown[-1]
    tracks = _drive(tracker, 1, start=50)
    assert tracks.ids.tolist() == [0]
    assert tracks.confirmed.all()


def test_what_appears_where_all_was_seen_free_is_doubted() -> None:
    """From a place hidden a moment ago it is likely at once; in the middle of what was seen it takes longer."""

    def hidden_beyond(xy: F64) -> F64:
        return np.where(xy[:, 0] > 30.0, 0.0, 1.0)

    tracker = Tracker()
    tracker.step(0.0, Detections.none(), ScriptedView(0.0, hidden_beyond))
    tracks = tracker.step(0.1, cars((5.0, 0.0), (28.0, 3.0)), ScriptedView(0.1, everywhere(1.0)))
    near, far = np.argsort(tracks.states[:, 0])
    assert (tracks.born_hidden[near], tracks.born_hidden[far]) == (0.0, 1.0)
    assert tracks.existence[near] < 0.15
    assert tracks.existence[far] > 0.5


def test_a_parked_car_that_is_hidden_stays_and_one_that_drives_goes_on() -> None:
    """Centers err by a third of a meter; behind a truck for 3 s the parked one stands, the other is 30 m on."""
    rng, tracker = np.random.default_rng(1), Tracker()
    for k in range(50):
        xy = np.array([[0.0, 0.0], [k, 20.0]]) + rng.normal(0.0, 0.3, (2, 2))
        found = cars(*map(tuple, xy)) if k < 20 else Detections.none()
        tracks = tracker.step(0.1 * k, found, ScriptedView(0.1 * k, everywhere(1.0 if k < 20 else 0.0)))
    parked, driving = np.argsort(tracks.states[:, 1])
    assert np.hypot(*tracks.states[parked, :2]) < 0.6
    assert np.hypot(*(tracks.states[driving, :2] - [49.0, 20.0])) < 3.0
    # The longer it is hidden, the less is known of the one that drives; the other is where it was.
    assert tracks.covariances[parked, 0, 0] < 0.5 < tracks.covariances[driving, 0, 0]


def test_a_wrongly_completed_box_hardly_moves_a_track() -> None:
    """One center 1.6 m off among good ones; without outliers it would pull four times as far."""
    moved = []
    for share in (0.2, 0.0):
        tracker = Tracker(ExistenceRules(motion=Motion(outlier_share=share, center_std_m=0.3)))
        for k in range(15):
            tracker.step(0.1 * k, cars((10.0, 0.0)), SeesAll(0.1 * k))
        tracks = tracker.step(1.5, cars((11.2, 0.0)), SeesAll(1.5))
        assert len(tracks) == 1
        moved.append(tracks.states[0, 0] - 10.0)
    assert 0.0 < moved[0] < 0.5 * moved[1]


def test_detections_that_are_mostly_false_take_longer_to_believe() -> None:
    for odds, is_confirmed in ((0.01, True), (1.0, False)):
        tracker = Tracker()
        for k in range(3):
            tracks = tracker.step(0.1 * k, cars((10.0, 0.0)), SeesAll(0.1 * k), false_odds=np.array([odds]))
        assert bool(tracks.confirmed[0]) == is_confirmed
    with pytest.raises(ValueError, match="false_odds must be 1 positive numbers"):
        tracker.step(0.3, cars((10.0, 0.0)), SeesAll(0.3), false_odds=np.array([0.0]))


def test_a_part_of_a_track_begins_no_other() -> None:
    """A detector that cuts a car in two gives two boxes in one place."""
    tracker = Tracker()
    _drive(tracker, 5)
    tracks = tracker.step(0.5, cars((5.0, 0.0), (6.2, 0.4)), SeesAll(0.5))
    assert len(tracks) == 1
    assert len(Tracker().step(0.0, cars((5.0, 0.0), (5.0, 0.0)), SeesAll(0.0))) == 1  # doubled


def test_beyond_the_gate_a_detection_is_of_another_object() -> None:
    """The gate is of squared distances: 3.7 standard deviations, not 13.8."""
    for off, ids in ((3.4, [0]), (4.0, [0, 1])):
        tracker = Tracker(ExistenceRules(motion=Motion(), false_odds=1e-6))  # in the gate all is the track's
        before = _drive(tracker, 20, speed=0.0)
        std_m = float(np.sqrt(before.covariances[0, 1, 1] + 0.6**2))
        tracks = tracker.step(2.0, cars((0.0, off * std_m)), SeesAll(2.0))
        assert tracks.ids.tolist() == ids


def test_time_that_goes_back_begins_anew_and_says_so() -> None:
    tracker = Tracker()
    _drive(tracker, 20)
    tracks = tracker.step(0.2, cars((2.0, 0.0)), SeesAll(0.2))
    assert tracks.ids.tolist() == [1]
    assert tracks.notes == ("time went back by 1.700 s: all tracks dropped",)
    assert tracker.step(60_000.0, cars((2.0, 0.0)), SeesAll(60_000.0)).ids.tolist() == [2]  # off for a night


@pytest.mark.parametrize(("back_s", "words"), [(0.0, "a sweep with a repeated time"), (0.2, "a sweep 0.200 s late")])
def test_a_late_or_doubled_sweep_changes_nothing_and_is_named(back_s: float, words: str) -> None:
    tracker = Tracker()
    before = _drive(tracker, 20)
    t_s = before.t_s - back_s
    tracks = tracker.step(t_s, cars((90.0, 9.0)), SeesAll(t_s))
    assert tracks.notes == (f"{words}: its detections are left out",)
    assert tracks.detection.tolist() == [-1]
    np.testing.assert_array_equal(tracks.states, before.states)
    after = tracker.step(2.0, cars((20.0, 0.0)), SeesAll(2.0))
    assert after.ids.tolist() == [0]
    assert after.detection.tolist() == [0]


def test_poses_that_begin_or_end_drop_the_tracks_and_say_so() -> None:
    tracker = Tracker()
    _drive(tracker, 5)
    tracks = tracker.step(0.5, cars((5.0, 0.0)), SeesAll(0.5, in_world=False))
    assert tracks.notes == ("tracks are in the sensor's level frame (no poses) from now on: all tracks dropped",)
    assert not tracks.in_world
    assert tracks.ids.tolist() == [1]


def test_too_many_detections_are_refused_and_the_tracks_go_on() -> None:
    tracker = Tracker()
    _drive(tracker, 5)
    flood = cars(*((float(k % 100), float(k // 100)) for k in range(10_000)))
    with pytest.raises(ValueError, match="detections must be at most 1000, got 10000; this sweep is refused"):
        tracker.step(0.5, flood, SeesAll(0.5))
    assert _drive(tracker, 3, start=6).ids.tolist() == [0]


def test_odds_of_false_detections_that_nobody_gives_are_noted_once() -> None:
    tracker = Tracker()
    said = [tracker.step(0.1 * k, cars(*places), SeesAll(0.1 * k)).notes for k, places in enumerate(
        ((), ((5.0, 0.0),), ((5.0, 0.0),))
    )]  # fmt: skip
    late = Tracker()
    late.step(0.1, cars(), SeesAll(0.1))
    assert "the rate of false detections is not known" in late.step(0.0, cars((5.0, 0.0)), SeesAll(0.0)).notes[0]
    note = "the rate of false detections is not known for this view: 0.1 per true one assumed; give false_odds"
    assert said == [(), (note,), ()]
    assert not Tracker().step(0.0, cars((5.0, 0.0)), SeesAll(0.0), false_odds=np.array([0.1])).notes


def test_boxes_that_are_too_long_are_left_out_and_counted() -> None:
    found = cars((5.0, 0.0), (40.0, 0.0), (60.0, 0.0))
    boxes = found.boxes.copy()
    boxes[0, 3] = 100.0
    tracker = Tracker()
    tracks = tracker.step(0.0, replace(found, boxes=boxes), SeesAll(0.0))
    assert tracks.notes[-1] == "1 of 3 boxes left out: longer than 30 m"
    assert sorted(tracks.detection.tolist()) == [1, 2]  # their numbers in what was given


@pytest.mark.parametrize(
    "bad", [np.zeros((2, 2)), -np.eye(2), [[1.0, 2.0], [2.0, 1.0]], [[1.0, 0.5], [0.0, 1.0]], [[np.nan, 0], [0, 1.0]]]
)
def test_a_covariance_that_is_not_positive_definite_is_refused(bad: F64) -> None:
    noise = np.stack([np.eye(2), np.asarray(bad, np.float64)])
    with pytest.raises(ValueError, match=r"noise must be symmetric and positive definite, got .* for detection 1"):
        Tracker().step(0.0, cars((0.0, 0.0), (20.0, 0.0)), SeesAll(0.0), noise)


def test_covariances_of_another_shape_a_view_of_another_time_and_no_time_are_refused() -> None:
    with pytest.raises(ValueError, match=r"noise must have shape \(1, 2, 2\), got \(2, 2\)"):
        Tracker().step(0.0, cars((0.0, 0.0)), SeesAll(0.0), np.eye(2))
    with pytest.raises(ValueError, match=r"view must be of the time of the detections, 0.000 s, got 0.100 s"):
        Tracker().step(0.0, cars((0.0, 0.0)), SeesAll(0.1))
    with pytest.raises(ValueError, match="t_s must be finite, got nan"):
        Tracker().step(float("nan"), cars((0.0, 0.0)), SeesAll(0.0))


def test_a_view_that_fails_leaves_the_tracks_as_they_were() -> None:
    def broken(xy: F64) -> F64:
        raise RuntimeError("no beams")

    tracker, other = Tracker(), Tracker()
    _drive(tracker, 5)
    _drive(other, 5)
    with pytest.raises(RuntimeError, match="no beams"):
        tracker.step(0.5, cars((5.0, 0.0)), ScriptedView(0.5, broken))
    mine, expected = _drive(tracker, 1, start=5), _drive(other, 1, start=5)
    np.testing.assert_array_equal(mine.states, expected.states)
    np.testing.assert_array_equal(mine.existence, expected.existence)


def test_rules_out_of_range_are_refused() -> None:
    with pytest.raises(ValueError, match=r"recurrence must lie in \[0, 1\], got 2.0"):
        ExistenceRules(recurrence=2.0)
    with pytest.raises(ValueError, match=r"gate must be positive, got 0.0"):
        ExistenceRules(gate=0.0)
    with pytest.raises(ValueError, match=r"outlier_share must lie in \[0, 1\), got 2.0"):
        Motion(outlier_share=2.0)
    with pytest.raises(ValueError, match=r"coast_s must be positive, got 0.0"):
        PublishedRules(coast_s=0.0)


def test_a_flood_of_boxes_in_one_place_asks_the_view_of_few() -> None:
    """A thousand large boxes about one point: parts of each other are left out before the view is asked."""
    asked = []

    def seen(xy: F64) -> F64:
        asked.append(len(xy))
        return np.ones(len(xy))

    rng = np.random.default_rng(0)
    tracker = Tracker()
    for k in range(3):
        flood = cars(*rng.uniform(-3.0, 3.0, (1000, 2)))
        tracks = tracker.step(
            0.1 * k, replace(flood, boxes=flood.boxes * [1, 1, 1, 2, 4, 1, 1]), ScriptedView(0.1 * k, seen)
        )
        assert len(tracks) < 10
    assert max(asked) < 2000
