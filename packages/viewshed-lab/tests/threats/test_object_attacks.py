"""Attacks on objects: when they begin, what they forge, what they say they forged."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from viewshed.detections import Detections, ObjectKind
from viewshed_lab.threats.object_attacks import OBJECT_ATTACKS, ForgedDetections

GROUND = np.array([100.0, -50.0, 2.0])


def _detections(count: int, seed: int = 0, spread_m: float = 30.0) -> Detections:
    rng = np.random.default_rng(seed)
    boxes = np.tile([0.0, 0.0, 0.75, 4.2, 1.8, 1.5, 0.0], (count, 1))
    boxes[:, :3] += GROUND
    boxes[:, :2] += rng.uniform(-spread_m, spread_m, (count, 2))
    return Detections(boxes, np.full(count, ObjectKind.CAR), np.full(count, 80))


def _is_forged(one: ForgedDetections) -> bool:
    return bool(one.removed.any() or one.moved.any() or (one.ghost >= 0).any())


def _run(
    name: str, detections: Detections, seed: int = 0, seconds: float = 6.0, **changed: object
) -> list[ForgedDetections]:
    running = OBJECT_ATTACKS[name](**{"counts": "exact", "mean_count": 3.0} | changed).begin(
        np.random.default_rng(seed)
    )
    return [running.apply(detections, t_s, GROUND) for t_s in np.arange(0.0, seconds, 0.1)]


@pytest.mark.parametrize("name", OBJECT_ATTACKS)
def test_every_attack_keeps_its_times_and_its_record(name: str) -> None:
    """Honest before two seconds, forged after; the same seed gives the same bytes; honest rows are untouched."""
    detections = _detections(8)
    before = detections.boxes.copy()
    sweeps = _run(name, detections)
    assert np.array_equal(detections.boxes, before)
    for one in sweeps[:20]:
        assert not _is_forged(one)
    assert _is_forged(sweeps[21])
    for one in sweeps[21:]:
        kept = (one.source >= 0) & ~one.moved
        assert np.array_equal(one.detections.boxes[kept], detections.boxes[one.source[kept]])
        assert (one.source[one.ghost >= 0] == -1).all()
    again = _run(name, detections)
    assert all(np.array_equal(a.detections.boxes, b.detections.boxes) for a, b in zip(sweeps, again, strict=True))


@given(st.integers(0, 2**32 - 1), st.integers(0, 12))
def test_a_random_walk_is_never_too_fast(seed: int, count: int) -> None:
    """A fabricated object that walks at random keeps its number, its height, and a speed of 30 m/s at most."""
    sweeps = _run("fabricate_markov", Detections.none(), seed, 4.0, mean_count=float(count))
    for one, after in pairwise(sweeps[20:]):
        assert np.array_equal(one.ghost, after.ghost)
        way_m = np.linalg.norm((after.detections.boxes - one.detections.boxes)[:, :2], axis=1)
        assert (way_m <= 3.0 + 1e-6).all()
        assert np.allclose(after.detections.boxes[:, 2], GROUND[2] + 1.0)


def test_a_random_walk_has_the_published_speeds() -> None:
    """Each axis begins with a standard deviation of 10 m/s; from sweep to sweep it changes by .5 m/s."""
    sweeps = _run("fabricate_markov", Detections.none(), seconds=3.0, mean_count=1000.0)
    places = np.stack([one.detections.boxes[:, :2] for one in sweeps[20:23]])
    first, second = np.diff(places, axis=0) / 0.1
    assert np.median(np.abs(first)) == pytest.approx(6.745, rel=0.08)  # as of a normal distribution of 10
    slow = np.hypot(*first.T) < 25.0  # none of these is held at 30 m/s
    assert (second - first)[slow].std() == pytest.approx(0.5, rel=0.06)


def test_fabricated_objects_have_the_published_size_and_spread() -> None:
    """Boxes of 4 by 2 by 2 m, 15 m about the sensor; other objects after ten seconds, under new numbers."""
    sweeps = _run("fabricate_static", Detections.none(), seconds=13.0, mean_count=400.0)
    boxes = sweeps[30].detections.boxes
    assert np.allclose(boxes[:, 3:6], (4.0, 2.0, 2.0))
    assert np.allclose(boxes[:, :2].std(axis=0), 15.0, rtol=0.1)
    assert np.allclose(boxes[:, :2].mean(axis=0), GROUND[:2], atol=2.5)
    assert set(sweeps[119].ghost) == set(range(400))
    assert set(sweeps[120].ghost) == set(range(400, 800))


def test_poisson_counts_have_their_mean() -> None:
    """Over many resets the number of fabricated objects has the mean that was asked for."""
    sweeps = _run("fabricate_static", Detections.none(), seconds=60.0, mean_count=2.0, counts="poisson", reset_s=0.2)
    counts = [len(one.detections) for one in sweeps[20::2]]
    assert 1.7 < np.mean(counts) < 2.3
    assert np.var(counts) > 1.0


def test_removal_takes_the_nearest_within_six_meters_and_only_near_objects() -> None:
    """An object farther than 50 m is never chosen; a static place that its object has left removes nothing."""
    for away_m, is_chosen in ((49.9, True), (50.1, False)):
        box = np.array([[GROUND[0], GROUND[1] + away_m, 2.75, 4.2, 1.8, 1.5, 0.0]])
        sweeps = _run("remove_static", Detections(box, np.array([ObjectKind.CAR]), np.array([9])))
        assert any(one.removed.any() for one in sweeps) == is_chosen
    near = _detections(1, spread_m=5.0)
    running = OBJECT_ATTACKS["remove_static"](counts="exact", mean_count=1.0, start_s=0.0).begin(
        np.random.default_rng(0)
    )
    assert running.apply(near, 0.0, GROUND).removed.tolist() == [True]
    away = Detections(near.boxes + np.array([[5.9, 0, 0, 0, 0, 0, 0]]), near.kinds, near.returns)
    assert running.apply(away, 0.1, GROUND).removed.tolist() == [True]
    gone = Detections(near.boxes + np.array([[6.1, 0, 0, 0, 0, 0, 0]]), near.kinds, near.returns)
    assert running.apply(gone, 0.2, GROUND).removed.tolist() == [False]


@pytest.mark.parametrize(("name", "low", "high"), [("translate_static", 2.0, 6.0), ("shift_static", 0.3, 1.0)])
def test_translated_objects_are_moved_by_so_much(name: str, low: float, high: float) -> None:
    """The vector of each object stays the same, and has the length of its attack."""
    detections = _detections(5)
    sweeps = _run(name, detections, mean_count=5.0)
    ways = [one.detections.boxes - detections.boxes[one.source] for one in sweeps[20:]]
    length = np.linalg.norm(ways[0][:, :2], axis=1)
    assert ((length >= low) & (length <= high)).all()
    assert np.allclose(ways[0], ways[-1])
    assert sweeps[-1].moved.all()


def test_a_translation_on_a_trajectory_grows() -> None:
    """Nothing at first, the whole vector after three seconds, and never a jump."""
    detections = _detections(1, spread_m=5.0)
    sweeps = _run("translate_trajectory", detections, mean_count=1.0)
    ways = np.array([np.linalg.norm((one.detections.boxes - detections.boxes)[0, :2]) for one in sweeps[20:]])
    assert ways[0] == 0.0
    assert ways[-1] >= 2.0
    assert np.diff(ways).max() < 0.3


def test_time_that_goes_back_begins_anew() -> None:
    """A second drive has its two honest seconds as well."""
    running = OBJECT_ATTACKS["fabricate_static"](counts="exact", mean_count=1.0).begin(np.random.default_rng(0))
    assert len(running.apply(Detections.none(), 10.0, GROUND).detections) == 0
    assert len(running.apply(Detections.none(), 12.0, GROUND).detections) == 1
    assert len(running.apply(Detections.none(), 3.0, GROUND).detections) == 0


def test_removal_on_a_trajectory_follows_its_object() -> None:
    """An object that drives 2 m a sweep stays removed until the reset."""
    start = _detections(1, spread_m=5.0)
    running = OBJECT_ATTACKS["remove_trajectory"](counts="exact", mean_count=1.0, start_s=0.0).begin(
        np.random.default_rng(0)
    )
    for step in range(20):
        there = Detections(start.boxes + np.array([[2.0 * step, 0, 0, 0, 0, 0, 0]]), start.kinds, start.returns)
        assert running.apply(there, 0.1 * step, GROUND).removed.tolist() == [True]
