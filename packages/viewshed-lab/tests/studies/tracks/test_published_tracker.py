"""The published rule, and that the existence filter is that rule where a view says yes or no."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely import Polygon
from tests.objects.scripted import ScriptedView, cars

from viewshed.arrays import F64
from viewshed.detections import Detections
from viewshed.geometry import Rigid
from viewshed.objects.metrics import ospa_m
from viewshed.objects.tracker import ExistenceRules, Rules, Tracker
from viewshed.objects.tracks import Tracks
from viewshed.objects.views import PolygonView, SeesAll
from viewshed_lab.studies.tracks.published import PUBLISHED_MOTION, PublishedRules, published_ospa

LEFT = Polygon([(-50, 0), (50, 0), (50, 50), (-50, 50)])
"""Covers what lies on the left of the x axis: y > 0."""


def _seen_from(tracker: Tracker, sweeps: int, *centers: tuple[float, float]) -> int:
    """Let objects be found in this many sweeps, ten a second, and return the number of the next one."""
    for k in range(sweeps):
        tracker.step(0.1 * k, cars(*centers), SeesAll(0.1 * k))
    return sweeps


def test_three_detections_confirm() -> None:
    tracker = Tracker(PublishedRules())
    confirmed = []
    for k in range(4):
        confirmed += tracker.step(0.1 * k, cars((5.0, 0.0)), SeesAll(0.1 * k)).confirmed.tolist()
    assert confirmed == [False, False, True, True]


def test_only_what_the_polygon_covers_counts_misses() -> None:
    tracker = Tracker(PublishedRules())
    start = _seen_from(tracker, 5, (10.0, 20.0), (10.0, -20.0))
    counts = []
    for k in range(start, start + 8):
        tracks = tracker.step(0.1 * k, Detections.none(), PolygonView(LEFT, Rigid.identity(), 0.1 * k))
        counts.append(len(tracks))
    assert counts == [2] * 6 + [1] * 2  # the seventh miss in a row ends the one in view
    assert tracks.states[:, 1].round().tolist() == [-20.0]


def test_a_polygon_that_covers_no_track_makes_all_of_them_observable() -> None:
    """The published bug: the only track is hidden, and yet it is missed; with a second one in view it is not."""
    for others, is_kept in (((), False), (((10.0, 20.0),), True)):
        tracker = Tracker(PublishedRules())
        start = _seen_from(tracker, 5, (10.0, -20.0), *others)
        for k in range(start, start + 8):
            view = PolygonView(LEFT, Rigid.identity(), 0.1 * k)
            tracks = tracker.step(0.1 * k, cars(*others), view)
        assert (-20.0 in tracks.states[:, 1].round().tolist()) == is_kept


@pytest.mark.parametrize(
    ("rules", "coast_s"),
    [(PublishedRules(repairs_empty_view=True), 3.0), (PublishedRules(coast_s=2.0, repairs_empty_view=True), 2.0)],
)
def test_hidden_or_not_a_track_coasts_for_three_seconds_or_as_in_its_node_two(rules: Rules, coast_s: float) -> None:
    tracker = Tracker(rules)
    k = _seen_from(tracker, 5, (10.0, -20.0))
    while len(tracker.step(0.1 * k, Detections.none(), PolygonView(LEFT, Rigid.identity(), 0.1 * k))):
        k += 1
    assert 0.1 * k - 0.4 == pytest.approx(coast_s, abs=0.11)


def test_overlap_or_distance_decides() -> None:
    """A car that moved by 3.9 m overlaps by less than a tenth with where it was, and is nearer than 4 m."""
    for rules, ids in ((PublishedRules(), [0, 1]), (PublishedRules(cost="center"), [0])):
        tracker = Tracker(rules)
        tracker.step(0.0, cars((10.0, 0.0)), SeesAll(0.0))
        assert tracker.step(0.1, cars((13.9, 0.0)), SeesAll(0.1)).ids.tolist() == ids


def test_a_detection_that_overlaps_by_less_than_a_tenth_is_of_no_track() -> None:
    """Cars of 4.2 m, s apart: the overlap is (4.2 - s) / (4.2 + s), a tenth for 3.436 m."""
    for apart_m, ids in ((3.40, [0]), (3.47, [0, 1])):
        tracker = Tracker(PublishedRules())
        tracker.step(0.0, cars((10.0, 0.0)), SeesAll(0.0))
        assert tracker.step(0.1, cars((10.0 + apart_m, 0.0)), SeesAll(0.1)).ids.tolist() == ids


def test_of_two_tracks_within_a_meter_the_one_with_more_detections_stays() -> None:
    for apart_m, ids in ((0.9, [0]), (1.1, [0, 1])):
        tracker = Tracker(PublishedRules())
        start = _seen_from(tracker, 3, (10.0, 0.0))
        assert tracker.step(0.1 * start, cars((10.0, 0.0), (10.0, apart_m)), SeesAll(0.1 * start)).ids.tolist() == ids


def test_too_fast_a_track_ends() -> None:
    tracker = Tracker(PublishedRules(cost="center", radius_m=20.0))
    for k in range(6):
        tracks = tracker.step(0.1 * k, cars((8.0 * k, 0.0)), SeesAll(0.1 * k))
    assert np.hypot(*tracks.states[:, 2:].T).max(initial=0.0) <= 60.0
    assert tracks.ids.max() > 0


def test_its_filter_is_the_published_one() -> None:
    """Two detections of x by hand: P = diag(25, 100), Q = diag((2 dt)², (3 dt)²), R = 1."""
    tracker = Tracker(PublishedRules(cost="center"))
    tracker.step(0.0, cars((10.0, 0.0)), SeesAll(0.0))
    tracks = tracker.step(0.5, cars((11.0, 0.0)), SeesAll(0.5))
    prior = np.array([[25.0 + 0.25 * 100.0 + 1.0, 50.0], [50.0, 100.0 + 2.25]])
    gain = prior[:, 0] / (prior[0, 0] + 1.0)
    np.testing.assert_allclose(tracks.states[0, [0, 2]], [10.0 + gain[0], gain[1]], rtol=1e-12)
    np.testing.assert_allclose(
        tracks.covariances[0][np.ix_([0, 2], [0, 2])], prior - np.outer(gain, prior[0]), rtol=1e-9
    )


def test_detections_have_the_published_noise() -> None:
    """[1, 1, 1, .25, .25, .25]²: of a standing car a first detection, far less sure, leaves nearly that of the second.

    Without time between both, 1/P = 1/P₀ + 1/R, with P₀ = 25 m² of a center and 4 m² of a length.
    """
    tracker = Tracker(PublishedRules())
    for t_s in (0.0, 1e-9):
        tracks = tracker.step(t_s, cars((10.0, 0.0)), SeesAll(t_s))
    found = [*np.diagonal(tracks.covariances[0])[:2], *tracks.box_variances[0, :4]]
    noise = 1 / (1 / np.array(found) - 1 / np.array([25.0] * 3 + [4.0] * 3))
    assert noise == pytest.approx(np.array([1.0, 1.0, 1.0, 0.25, 0.25, 0.25]) ** 2, rel=1e-5)


# Where the view says yes or no, and the detector finds what can be seen with one probability, existence is a count of
# misses in view: so it drops a track when the published rule does.

FOUND = 0.5

MAX_MISSES = 6

SUREST = 0.999

LAST = (1 - FOUND) ** MAX_MISSES * SUREST / ((1 - FOUND) ** MAX_MISSES * SUREST + 1 - SUREST)

NEXT = (1 - FOUND) * LAST / ((1 - FOUND) * LAST + 1 - LAST)

AS_PUBLISHED: dict[str, Rules] = {
    "existence": ExistenceRules(
        motion=PUBLISHED_MOTION, gate=1e9, false_odds=1e-9, lasting_share=0.0, most_found=FOUND, doubt_s=0.0,
        lifetime_s=np.inf, surest=SUREST, drop_below=(LAST + NEXT) / 2, lost_m=np.inf, spreads=False,
    ),
    "published": PublishedRules(
        cost="center", radius_m=8.0, coast_s=np.inf, most_misses=MAX_MISSES, repairs_empty_view=True
    ),
}  # fmt: skip


def _alive(rules: Rules, found: list[tuple[bool, bool]], in_view: list[tuple[bool, bool]]) -> list[list[float]]:
    """Return the y of the tracks after each sweep: two parked cars, found and in view as the script says."""
    tracker = Tracker(rules)
    places = [(10.0, 20.0), (10.0, -20.0)]
    alive = []
    for k, (is_found, is_seen) in enumerate(zip(found, in_view, strict=True)):

        def seen(xy: F64, is_seen: tuple[bool, bool] = is_seen) -> F64:
            return np.where(xy[:, 1] > 0, float(is_seen[0]), float(is_seen[1]))

        there = cars(*(place for place, is_here in zip(places, is_found, strict=True) if is_here))
        tracks: Tracks = tracker.step(0.1 * k, there, ScriptedView(0.1 * k, seen))
        alive.append(sorted(tracks.states[:, 1].round().tolist()))
    return alive


PAIR = st.tuples(st.booleans(), st.booleans())


@given(script=st.lists(st.tuples(PAIR, PAIR), min_size=1, max_size=60))
def test_where_a_view_says_yes_or_no_existence_counts_misses_as_the_published_rule(
    script: list[tuple[tuple[bool, bool], tuple[bool, bool]]],
) -> None:
    # What is found is in view; the first sweeps find both, so that both rules are sure of them.
    in_view = [(True, True)] * 3 + [seen for seen, _ in script]
    found = [(True, True)] * 3 + [(hit[0] and seen[0], hit[1] and seen[1]) for seen, hit in script]
    existence, published = (_alive(rules, found, in_view) for rules in AS_PUBLISHED.values())
    # After a track ended, both begin another at the next detection, of which the existence filter is not yet sure.
    ended = next((k for k, (a, b) in enumerate(pairwise(published)) if len(b) < len(a)), len(published))
    assert existence[: ended + 2] == published[: ended + 2]


@pytest.mark.parametrize(
    ("false", "published", "ospa"), [(0, 0.18, 0.18), (1, 1.26, 0.26), (2, 2.32, 0.32), (5, 5.45, 0.45)]
)
def test_what_the_published_evaluation_calls_ospa_is_not(false: int, published: float, ospa: float) -> None:
    truths = np.stack([10.0 * np.arange(10), np.zeros(10), np.zeros(10)], axis=1)
    ghosts = np.stack([10.0 * np.arange(false), np.full(false, 50.0), np.zeros(false)], axis=1)
    tracks = np.concatenate([truths + np.array([0.0, 0.18, 0.0]), ghosts])
    assert published_ospa(tracks, truths) == pytest.approx(published, abs=0.01)
    assert ospa_m(tracks, truths) == pytest.approx(ospa, abs=0.01)
