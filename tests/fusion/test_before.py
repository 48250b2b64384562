"""Where tracks were before their first detection: led back by hand through cells that were seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.fusion.by_hand import CAR, GHOST, cells, tracks

from viewshed.fusion.before import SeenBefore
from viewshed.geometry import Rigid
from viewshed.tracking.tracks import Tracks


def _at(t_s: float, boxes: list[np.ndarray], velocity: tuple[float, float] = (0.0, 0.0), born_s: float = 1.0) -> Tracks:
    shown, _ = tracks(t_s, boxes, [True] * len(boxes), born_s=born_s)
    states = shown.states.copy()
    states[:, 2:] = velocity
    return replace(shown, states=states)


@pytest.fixture
def seen() -> SeenBefore:
    past = SeenBefore()
    for t_s in np.arange(0.0, 1.0, 0.1):
        past.add(t_s, cells())
    return past


def test_a_place_in_the_open_was_free_and_one_at_a_surface_was_not(seen: SeenBefore) -> None:
    in_the_open, at_a_surface = seen.free_shares(_at(1.2, [GHOST, CAR]))
    assert in_the_open == 1.0
    assert at_a_surface < 0.6


def test_a_moving_track_is_led_back_to_where_it_was() -> None:
    """A surface drives by at 10 m/s: a track with its velocity was there all along, one that stands was not."""
    past = SeenBefore()
    for t_s in np.arange(0.0, 1.0, 0.1):
        moved = Rigid(np.eye(3), np.array([0.0, 10.0 * (t_s - 1.2), 0.0]))
        past.add(t_s, replace(cells(), frame_from_level=moved))
    assert past.free_shares(_at(1.2, [CAR], (0.0, 10.0)))[0] < 0.6
    assert past.free_shares(_at(1.2, [CAR]))[0] == 1.0


def test_nothing_is_said_of_old_tracks_of_vague_places_or_without_a_past(seen: SeenBefore) -> None:
    young = _at(1.2, [GHOST])
    assert np.isnan(seen.free_shares(_at(3.1, [GHOST])))
    assert np.isnan(seen.free_shares(replace(young, covariances=100.0 * young.covariances)))
    assert np.isnan(seen.free_shares(replace(young, in_world=False)))
    assert np.isnan(SeenBefore().free_shares(young))
    assert np.isnan(seen.free_shares(_at(9.2, [GHOST], born_s=9.0)))
    assert seen.free_shares(_at(1.2, [])).shape == (0,)


def test_what_is_kept_is_bounded(seen: SeenBefore) -> None:
    """A hundred sweeps a second for ten seconds: cells of three seconds, as far apart as ever."""
    for t_s in np.arange(1.0, 11.0, 0.01):
        seen.add(t_s, cells())
    assert len(seen._past) <= 13
