"""Tracks that agents share: matched, put together by covariance intersection, and only from agents that are heard."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from viewshed.fusion.shared_tracks import fuse_by_trust, heard, join_shared
from viewshed.messages.view_message import SharedTracks


def shared(xy: list[tuple[float, float]], variance: float = 0.25, existence: float = 0.9) -> SharedTracks:
    """Return tracks of cars at places."""
    count = len(xy)
    states = np.column_stack([np.array(xy).reshape(-1, 2), np.zeros((count, 2))])
    boxes = np.column_stack([states[:, :2], np.tile([0.8, 4.2, 1.8, 1.5, 0.0], (count, 1))])
    one = np.ones(count)
    return SharedTracks(
        np.arange(count), states, np.tile(variance * np.eye(4), (count, 1, 1)), boxes, np.full((count, 5), 0.1),
        np.full(count, 3, np.uint8), existence * one, one, one, 0.0 * one, one, 0.0 * one,
    )  # fmt: skip


def test_tracks_of_one_object_become_one_and_others_stay() -> None:
    first, second = shared([(0, 0), (20, 5)]), shared([(20.4, 5), (40, 0)], variance=1.0)
    joined = join_shared([first, second], np.array([0.75, 0.25]))
    assert joined.members.tolist() == [[0, -1], [1, 0], [-1, 1]]
    # Information 4 and 1, trust .75 and .25: 3 to .25.
    assert joined.states[1, 0] == pytest.approx(20 + 0.4 * 0.25 / 3.25)
    assert joined.covariances[1] == pytest.approx(np.eye(4) / 3.25)
    assert joined.existence == pytest.approx([0.675, 1 - (1 - 0.675) * (1 - 0.225), 0.225])
    assert joined.boxes[1, :2] == pytest.approx(joined.states[1, :2])


def test_what_is_far_apart_is_of_two_objects_however_unsure() -> None:
    unsure = shared([(0, 0)], variance=100.0)
    assert len(join_shared([unsure, shared([(9, 0)], variance=100.0)], np.ones(2)).states) == 2


def test_who_shares_nothing_adds_nothing() -> None:
    joined = join_shared([shared([]), shared([(3, 1)])], np.ones(2))
    assert joined.members.tolist() == [[-1, 0]]
    assert len(join_shared([], np.zeros(0)).states) == 0
    with pytest.raises(ValueError, match="2 positive numbers"):
        join_shared([shared([]), shared([])], np.array([1.0, 0.0]))


def test_what_two_have_in_common_is_not_counted_twice() -> None:
    """The same track from two agents is as sure as from one."""
    one = shared([(3, 1)])
    joined = join_shared([one, replace(one)], np.ones(2))
    assert joined.covariances[0] == pytest.approx(one.covariances[0])


def test_covariance_intersection_weighted_by_trust() -> None:
    """Two tracks along one axis: information 1/1 and 1/4, trust .75 and .25; positions 0 and 10."""
    states = np.array([[0.0, 0, 0, 0], [10.0, 0, 0, 0]])
    covariances = np.stack([np.eye(4), 4 * np.eye(4)])
    state, covariance = fuse_by_trust(states, covariances, np.array([0.75, 0.25]))
    information = 0.75 * 1 + 0.25 / 4
    assert covariance == pytest.approx(np.eye(4) / information)
    assert state[0] == pytest.approx(10 * (0.25 / 4) / information)
    with pytest.raises(ValueError, match="with trust in one of them"):
        fuse_by_trust(states, covariances, np.zeros(2))
    with pytest.raises(ValueError, match="with trust in one of them"):
        fuse_by_trust(states[:0], covariances[:0], np.zeros(0))


@given(st.integers(1, 5), st.integers(0, 2**32))
def test_the_fused_covariance_never_claims_more_than_the_best_track(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    half = rng.normal(size=(count, 4, 4))
    covariances = half @ half.swapaxes(1, 2) + 0.1 * np.eye(4)
    states = rng.normal(size=(count, 4))
    state, covariance = fuse_by_trust(states, covariances, rng.random(count) + 0.01)
    assert np.isfinite(state).all()
    # Convex in information: along each axis no surer than the surest track.
    least = np.linalg.eigvalsh(covariances)[:, 0].min()
    assert np.linalg.eigvalsh(covariance)[0] >= least * (1 - 1e-9)


def test_who_hears_whom() -> None:
    assert heard(np.array([[0.0, 0], [40, 0], [81, 0]]), 40.0).tolist() == [
        [False, True, False], [True, False, False], [False, False, False],
    ]  # fmt: skip
