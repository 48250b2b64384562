"""Where tracks were before their first detection: led back by hand through cells that were seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.agents.by_hand import CAR, cells, tracks

from viewshed.geometry import Rigid
from viewshed.objects.before import SeenBefore
from viewshed.objects.tracks import Tracks


def _at(t_s: float, boxes: list[np.ndarray], velocity: tuple[float, float] = (0.0, 0.0)) -> Tracks:
    shown, _ = tracks(t_s, boxes, [True] * len(boxes))
    states = shown.states.copy()
    states[:, 2:] = velocity
    return replace(shown, states=states)


def _free(seen: SeenBefore, shown: Tracks) -> np.ndarray:
    """Ask of all tracks, each with a surface."""
    every = np.ones(len(shown), bool)
    return seen.free_shares(shown, 0.1 * every, every)


@pytest.fixture
def seen() -> SeenBefore:
    """A car stands there from .6 s on."""
    past = SeenBefore()
    for t_s in np.arange(0.0, 1.0, 0.1):
        past.add(float(t_s), cells(with_car=bool(t_s > 0.55)))
    return past


def test_a_moving_surface_is_followed() -> None:
    """It drives by at 10 m/s: a track with its velocity was there all along, one that stands was not."""
    past = SeenBefore()
    for t_s in np.arange(0.0, 1.0, 0.1):
        moved = Rigid(np.eye(3), np.array([0.0, 10.0 * (t_s - 1.2), 0.0]))
        past.add(t_s, replace(cells(), frame_from_level=moved))
    assert _free(past, _at(1.2, [CAR], (0.0, 10.0))) < 0.5
    assert _free(past, _at(1.2, [CAR])) > 0.8


def test_nothing_is_said_without_a_surface_a_velocity_poses_or_a_past(seen: SeenBefore) -> None:
    young = _at(1.2, [CAR])
    every = np.ones(1, bool)
    assert np.isnan(seen.free_shares(young, 0.0 * every, every))
    assert np.isnan(seen.free_shares(young, 0.1 * every, ~every))
    assert np.isnan(_free(seen, replace(young, covariances=400.0 * young.covariances)))
    assert np.isnan(_free(seen, replace(young, in_world=False)))
    assert np.isnan(_free(SeenBefore(), young))
    assert _free(seen, _at(1.2, [])).shape == (0,)


def test_what_is_kept_is_bounded(seen: SeenBefore) -> None:
    """A hundred sweeps a second for ten seconds: cells of four seconds, as far apart as ever."""
    for t_s in np.arange(1.0, 11.0, 0.01):
        seen.add(t_s, cells())
    assert len(seen._past) <= 17
