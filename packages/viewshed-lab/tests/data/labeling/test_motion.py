"""Motion from poses: by hand."""

import numpy as np
import pytest

from viewshed.geometry import Rigid
from viewshed_lab.data.labeling.beam_image import AT_REST, StampedPose, drift_of, well_spaced


def _at(x: float, y: float, yaw: float, t_s: float | None) -> StampedPose:
    return StampedPose(Rigid.from_yaw(yaw, (x, y, 1.0)), None if t_s is None else round(t_s * 1e9))


def test_velocity_is_in_the_axes_of_the_sensor_and_turns_are_counter_clockwise() -> None:
    drift = drift_of(_at(0, -1, 1.4, 0.0), _at(0.5, 0, np.pi / 2, 0.1), _at(1, 1, 1.8, 0.2))
    assert drift.velocity_mps == pytest.approx([10.0, -5.0, 0.0])  # forward is world y, left is world -x
    assert drift.yaw_rate == pytest.approx(2.0)


@pytest.mark.parametrize(
    "other",
    [None, StampedPose(None, 100), _at(1, 0, 0, None), _at(50, 0, 0, 0.1), _at(1, 0, 0, 9.0), _at(0, 0, 0, 0.0)],
    ids=["alone", "no pose", "no time", "too fast", "too late", "same time"],
)
def test_what_does_not_tell_is_rest(other: StampedPose | None) -> None:
    assert drift_of(None, _at(0, 0, 0, 0.0), other).velocity_mps.tolist() == [0, 0, 0]
    assert drift_of(None, StampedPose(None, 0), other) is AT_REST


def test_posts_are_apart_in_space_or_time_and_jumps_are_none() -> None:
    moments = [_at(0, 0, 0, 0.0), _at(1, 0, 0, 1.0), None, _at(1, 0, 0, 2.5), _at(900, 0, 0, 3.0), _at(5, 0, 0, 4.0)]
    assert well_spaced(moments, 3.0) == [0, 3, 5]
    assert well_spaced([StampedPose(None, 0), StampedPose(None, 1)], 3.0) == []
