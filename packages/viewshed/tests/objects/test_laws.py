"""Laws that hold for any detections and any view."""

from dataclasses import dataclass

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from tests.objects.scripted import ScriptedView, everywhere

from viewshed.arrays import F64
from viewshed.detections import Detections
from viewshed.geometry import Rigid
from viewshed.objects.tracker import ExistenceRules, Rules, Tracker
from viewshed.objects.tracks import Tracks
from viewshed.objects.views import SeesAll
from viewshed_lab.studies.tracks.published import PublishedRules

RULES: dict[str, Rules] = {
    "existence": ExistenceRules(),
    "textbook": ExistenceRules(lasting_share=0.0, doubt_s=0.0, spreads=False),
    "published": PublishedRules(),
    "published, centers": PublishedRules(cost="center"),
}


@dataclass(frozen=True, slots=True)
class Moved:
    """A view asked in a frame that was moved."""

    view: ScriptedView
    back: Rigid
    in_world: bool = True

    @property
    def t_s(self) -> float:
        return self.view.t_s

    def _home(self, boxes: F64) -> F64:
        home = boxes.copy()
        home[:, :3] = self.back @ boxes[:, :3]
        return home

    def visible(self, boxes: F64) -> F64:
        return self.view.visible(self._home(boxes))

    def detectable(self, boxes: F64, kinds: NDArray[np.uint8]) -> F64:
        return self.view.detectable(boxes, kinds)

    def hides_near(self, boxes: F64, within_m: F64) -> F64:
        return self.view.hides_near(self._home(boxes), within_m)

    def false_odds(self, boxes: F64, kinds: NDArray[np.uint8]) -> F64 | None:
        return self.view.false_odds(self._home(boxes), kinds)


def _half_plane(angle: float) -> ScriptedView:
    """Return a view that sees less and less along a direction."""
    normal = np.array([np.cos(angle), np.sin(angle)])
    return ScriptedView(0.0, lambda xy: 1.0 / (1.0 + np.exp(np.clip(xy @ normal / 8.0, -30, 30))), found=0.9)


def _at(view: ScriptedView, t_s: float) -> ScriptedView:
    return ScriptedView(t_s, view.seen, view.found)


def _recording(seed: int, sweeps: int = 8) -> list[Detections]:
    """Return detections of six objects that cross, some missed, and false ones."""
    rng = np.random.default_rng(seed)
    place, velocity = rng.uniform(-20, 20, (6, 2)), rng.uniform(-12, 12, (6, 2))
    recording = []
    for k in range(sweeps):
        centers = place + 0.1 * k * velocity + rng.normal(0, 0.2, (6, 2))
        centers = np.concatenate([centers[rng.random(6) < 0.8], rng.uniform(-30, 30, (rng.poisson(1.0), 2))])
        count = len(centers)
        boxes = np.concatenate(
            [centers, rng.normal(0.8, 0.1, (count, 1)), rng.uniform([3, 1.5, 1.2], [6, 2.5, 2], (count, 3)),
             rng.uniform(-3, 3, (count, 1))], axis=1,
        )  # fmt: skip
        kinds, returns = rng.integers(0, 5, count, np.uint8), rng.integers(5, 500, count, np.int32)
        recording.append(Detections(boxes, kinds, returns))
    return recording


def _run(rules: Rules, recording: list[Detections], view: ScriptedView) -> list[Tracks]:
    tracker = Tracker(rules)
    return [tracker.step(0.1 * k, found, _at(view, 0.1 * k)) for k, found in enumerate(recording)]


SEEDS = st.integers(0, 10_000)

NAMES = st.sampled_from(sorted(RULES))

ANGLES = st.floats(-3, 3)


@settings(max_examples=20)
@given(seed=SEEDS, name=NAMES, angle=ANGLES)
def test_tracks_hold_what_tracks_may_and_never_an_id_or_a_detection_twice(seed: int, name: str, angle: float) -> None:
    ever, before = set[int](), set[int]()
    for tracks in _run(RULES[name], _recording(seed), _half_plane(angle)):
        now, used = set(tracks.ids.tolist()), tracks.detection[tracks.detection >= 0].tolist()
        assert len(now) == len(tracks)
        assert not (now - before) & ever
        assert len(set(used)) == len(used) or name.startswith("published")
        ever, before = ever | now, now
        for prob in (tracks.existence, tracks.visible, tracks.detectable, tracks.born_hidden):
            assert ((prob >= 0) & (prob <= 1)).all()
        assert (np.linalg.eigvalsh(tracks.covariances) > 0).all() or not len(tracks)
        assert (tracks.box_variances > 0).all()
        assert (tracks.boxes[:, 3:6] > 0).all()
        np.testing.assert_array_equal(tracks.boxes[:, :2], tracks.states[:, :2])


@settings(max_examples=20)
@given(seed=SEEDS, name=NAMES, angle=ANGLES)
def test_the_order_of_detections_does_not_matter(seed: int, name: str, angle: float) -> None:
    recording, rng = _recording(seed), np.random.default_rng(seed)
    mixed = [found.take(rng.permutation(len(found))) for found in recording]
    for one, other in zip(
        _run(RULES[name], recording, _half_plane(angle)), _run(RULES[name], mixed, _half_plane(angle)), strict=True
    ):
        assert one.ids.tolist() == other.ids.tolist()
        np.testing.assert_allclose(one.states, other.states, atol=1e-9)
        np.testing.assert_allclose(one.existence, other.existence, atol=1e-9)


@settings(max_examples=20)
@given(seed=SEEDS, name=NAMES, angle=ANGLES, yaw=st.floats(-3, 3), x=st.floats(-500, 500), y=st.floats(-500, 500))
def test_tracks_move_with_the_frame(seed: int, name: str, angle: float, yaw: float, x: float, y: float) -> None:
    # At the mean place: where a covariance is a circle, the five places lie along the axes of the frame.
    rules = ExistenceRules(spreads=False) if name == "existence" else RULES[name]
    recording, view = _recording(seed), _half_plane(angle)
    there_from_here = Rigid.from_yaw(yaw, (x, y, 0.0))
    tracker = Tracker(rules)
    turn = np.kron(np.eye(2), there_from_here.rotation[:2, :2])
    for k, here in enumerate(_run(rules, recording, view)):
        moved = Moved(_at(view, 0.1 * k), there_from_here.inverse())
        there = tracker.step(0.1 * k, recording[k].moved(there_from_here), moved)
        # New ids go by place, which is another in another frame.
        order = np.lexsort((here.states[:, 1], here.states[:, 0]))
        back = there_from_here.inverse() @ there.boxes[:, :3]
        other = np.lexsort((back[:, 1], back[:, 0]))
        assert len(here) == len(there)
        np.testing.assert_allclose(here.boxes[order, :2], back[other, :2], atol=1e-6)
        np.testing.assert_allclose((here.states @ turn.T)[order, 2:], there.states[other, 2:], atol=1e-6)
        np.testing.assert_allclose((turn @ here.covariances @ turn.T)[order], there.covariances[other], atol=1e-6)
        np.testing.assert_allclose(here.existence[order], there.existence[other], atol=1e-6)


@settings(max_examples=20)
@given(
    seed=SEEDS, sweeps=st.integers(1, 15), recurrence=st.sampled_from([0.0, 0.5]), doubt_s=st.sampled_from([0.0, 0.3])
)
def test_a_miss_where_nothing_can_be_seen_costs_only_survival(
    seed: int, sweeps: int, recurrence: float, doubt_s: float
) -> None:
    rules = ExistenceRules(recurrence=recurrence, doubt_s=doubt_s, lifetime_s=5.0, lost_m=np.inf, drop_below=0.0)
    tracker = Tracker(rules)
    recording = _recording(seed)
    for k, found in enumerate(recording):
        before = tracker.step(0.1 * k, found, SeesAll(0.1 * k))
    for k in range(len(recording), len(recording) + sweeps):
        after = tracker.step(0.1 * k, Detections.none(), ScriptedView(0.1 * k, everywhere(0.0), found=0.9))
    np.testing.assert_allclose(after.existence, before.existence * np.exp(-0.1 * sweeps / 5.0), rtol=1e-12)
    assert after.ids.tolist() == before.ids.tolist()


@settings(max_examples=20)
@given(prob=st.floats(0.05, 1.0), more=st.floats(0.0, 1.0), misses=st.integers(1, 8))
def test_the_better_something_could_be_seen_the_more_a_miss_costs(prob: float, more: float, misses: int) -> None:
    left = []
    for seen in (prob, prob + (1 - prob) * more):
        tracker = Tracker(ExistenceRules(drop_below=0.0))
        for k in range(4):
            tracker.step(0.1 * k, _recording(0)[0], SeesAll(0.1 * k))
        for k in range(4, 4 + misses):
            tracks = tracker.step(0.1 * k, Detections.none(), ScriptedView(0.1 * k, everywhere(seen), found=1.0))
        left.append(tracks.existence)
    assert (left[1] <= left[0] + 1e-12).all()
