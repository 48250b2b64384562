"""The closed loop: the speed follows from what is seen, and whoever looks at nothing hits the one who walks out."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from viewshed import BevGrid
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed_lab.studies.guarantees import driving
from viewshed_lab.studies.guarantees.driving import CRUISE_MPS, ONLY, drive_through, speed_in_view

GRID = BevGrid(200, 50.0)
X, Y = np.moveaxis(GRID.centers, -1, 0)


def view(hidden: np.ndarray) -> FovEstimate:
    state = np.where(hidden, np.uint8(CellState.HIDDEN), np.uint8(CellState.FREE))
    return FovEstimate(GRID, (~hidden).astype(np.float32), state)


def test_speed_by_hand() -> None:
    assert speed_in_view(view(np.zeros(GRID.shape, bool))) == CRUISE_MPS
    # A wall across the lane whose cells begin 10 m before the front (2.7 m): v · .4 + v²/12 + .5 ≤ 10.05 m, so 8.5.
    assert speed_in_view(view((X > 12.6) & (np.abs(Y) < 3.0))) == 8.5
    # A hidden place beside the lane, 1.25 m from the car's side all along: .4 + v/6 ≤ .833 s, so 2.5.
    assert speed_in_view(view((Y < -2.0) & (X < 40.0))) == 2.5
    # Behind and far to the side nobody matters.
    assert speed_in_view(view((X < 2.0) | (np.abs(Y) > 6.0))) == CRUISE_MPS


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.05))
def test_less_seen_is_never_faster(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    some = rng.random(GRID.shape) < share
    more = some | (rng.random(GRID.shape) < share)
    assert speed_in_view(view(more)) <= speed_in_view(view(some))


@pytest.mark.slow
def test_who_does_not_look_hits_and_who_looks_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    drive = drive_through(0, "none", "ours + certificate")
    assert not drive.collided
    assert drive.time_s < driving.LAST_S
    # Who counts on certified cells alone is slower, and does not hit whom 150 beams erase.
    only = drive_through(0, "none", ONLY)
    assert drive.time_s < only.time_s < driving.LAST_S
    assert not drive_through(0, "vanished, 150 beams", ONLY).collided
    # At the speed for which they set out, whoever does not look meets them.
    monkeypatch.setattr(driving, "speed_in_view", lambda estimate: driving.PAST_MPS)
    assert any(drive_through(number, "none", "no monitor").collided for number in range(3))
