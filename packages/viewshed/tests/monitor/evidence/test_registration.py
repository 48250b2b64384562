"""Poses that are off by known amounts."""

import numpy as np
import pytest
from tests.monitor.evidence.drives import HEIGHT_M, look, measure

from viewshed.geometry import Rigid
from viewshed.sweep import Sweep
from viewshed_lab.sim import Box

# Walls close by, in both directions.
ROOM = (
    Box(0.0, 8.5, 40.0, 1.0, 9.0),
    Box(0.0, -6.5, 40.0, 1.0, 9.0),
    Box(14.5, 0.0, 1.0, 30.0, 9.0),
    Box(-10.5, 0.0, 1.0, 30.0, 9.0),
)

TUNNEL = (Box(0.0, 6.5, 300.0, 1.0, 9.0), Box(0.0, -5.5, 300.0, 1.0, 9.0))


def _off(sweep: Sweep, yaw_deg: float = 0.0, x_m: float = 0.0, y_m: float = 0.0) -> Sweep:
    pose = sweep.world_from_sensor
    assert pose is not None
    turn = Rigid.from_yaw(np.deg2rad(yaw_deg)).rotation
    return sweep.replace(world_from_sensor=Rigid(turn @ pose.rotation, pose.translation + np.array([x_m, y_m, 0.0])))


def _drive(boxes: tuple[Box, ...] = ROOM, count: int = 6) -> list[Sweep]:
    rng = np.random.default_rng(2)
    return [look(boxes, number, 1.0 * number, rng, yaw=0.01 * number) for number in range(count)]


@pytest.mark.parametrize("off", [{"yaw_deg": 0.5}, {"x_m": 0.5}, {"y_m": -0.5}, {"yaw_deg": -2.0, "x_m": 0.7}])
def test_a_pose_that_jumps_is_told(off: dict[str, float]) -> None:
    *before, now = _drive()
    assert measure("registration", *before, now)[0] < 1.0
    assert measure("registration", *before, _off(now, **off))[0] > 4.0


def test_a_pose_that_is_as_noisy_as_it_states_is_no_cause_for_worry() -> None:
    # The map's y is straight ahead of the sensor; the covariance is along the map's axes.
    turned = Rigid.from_yaw(np.pi / 2)
    *before, now = (sweep.replace(world_from_sensor=turned @ sweep.world_from_sensor) for sweep in _drive())
    off, stated = _off(now, y_m=0.5), np.diag([0.0, 0.3, 0.0, 0.0, 0.0, 0.0]) ** 2
    assert measure("registration", *before, off)[0] > 4.0
    assert measure("registration", *before, off.replace(pose_covariance=stated))[0] < 2.5
    across = np.diag([0.3, 0.0, 0.0, 0.0, 0.0, 0.0]) ** 2
    assert measure("registration", *before, off.replace(pose_covariance=across))[0] > 3.5
    assert measure("frame_noise", *before, off).max() > 0.4
    assert measure("frame_noise", *before, off.replace(pose_covariance=stated)).max() < 0.1


def test_a_pose_that_stays_off_is_told_while_an_earlier_sweep_is_right() -> None:
    sweeps = _drive()
    off = [_off(sweep, yaw_deg=0.5) for sweep in sweeps]
    assert measure("registration", *sweeps[:1], *off[1:])[0] > 4.0
    # All poses off: only the way driven does not fit the heading, by 5 m x 0.5° = 4 cm.
    assert measure("registration", *off)[0] < 2.0


def test_along_a_tunnel_nothing_is_known() -> None:
    *before, now = _drive(TUNNEL)
    assert measure("registration", *before, _off(now, x_m=0.5))[0] < 1.0
    assert measure("registration", *before, _off(now, y_m=0.5))[0] > 4.0


def test_an_open_field_tells_nothing() -> None:
    field = [look((), number, 1.0 * number).replace(sensor_height_m=HEIGHT_M) for number in range(3)]
    assert np.isnan(measure("registration", *field)).all()


def test_a_column_of_cars_does_not_carry_the_pose_along() -> None:
    def cars(k: int) -> tuple[Box, ...]:
        # Two cars drive ahead of the sensor, 1.5 m in each tenth of a second, past walls that show no way along.
        return (*TUNNEL, Box(12.0 + 1.5 * k, 1.0, 4.5, 1.8, 1.5), Box(-10.0 + 1.5 * k, -2.0, 4.5, 1.8, 1.5))

    rng = np.random.default_rng(3)
    sweeps = [look(cars(number), number, 1.5 * number, rng) for number in range(4)]
    assert measure("registration", *sweeps)[0] < 2.5
