import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from viewshed.geometry import Rigid, attitude_of, polar, quaternion_from_rotation, rotation_from_quaternion

angles = st.floats(-3.1, 3.1)


@given(angles, angles, angles)
def test_quaternions_agree_with_scipy(roll: float, pitch: float, yaw: float) -> None:
    oracle = Rotation.from_euler("xyz", [roll, pitch, yaw])
    x, y, z, w = oracle.as_quat(canonical=True)
    assert np.allclose(rotation_from_quaternion([w, x, y, z]), oracle.as_matrix(), atol=1e-9)
    found = quaternion_from_rotation(oracle.as_matrix())
    assert abs(abs(found @ [w, x, y, z]) - 1.0) < 1e-9


@given(angles, angles, angles)
def test_a_transform_and_its_inverse_cancel(x: float, y: float, yaw: float) -> None:
    transform = Rigid.from_yaw(yaw, (x, y, 2.0))
    points = np.array([[1.0, 2.0, 3.0], [-4.0, 5.0, -6.0]])
    assert np.allclose(transform.inverse() @ (transform @ points), points, atol=1e-9)
    assert np.allclose((transform @ transform.inverse()).as_matrix(), np.eye(4), atol=1e-9)


def test_yaw_turns_forward_to_the_left() -> None:
    assert np.allclose(Rigid.from_yaw(np.pi / 2) @ np.array([1.0, 0.0, 0.0]), [0.0, 1.0, 0.0])


@given(angles, st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_attitude_keeps_the_tilt_and_drops_the_yaw(yaw: float, pitch: float, roll: float) -> None:
    pose = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    level_from_sensor = rotation_from_quaternion(attitude_of(pose.as_matrix()))
    assert np.allclose(level_from_sensor[2], pose.as_matrix()[2], atol=1e-9)
    assert abs(level_from_sensor[1, 0]) < 1e-9


def test_polar_is_counter_clockwise_from_forward() -> None:
    range_m, azimuth = polar(np.array([[3.0, 4.0], [0.0, -2.0], [-1.0, 0.0]]))
    assert np.allclose(range_m, [5.0, 2.0, 1.0])
    assert np.allclose(azimuth, [np.arctan(4 / 3), -np.pi / 2, -np.pi])


@pytest.mark.parametrize(
    ("quaternion", "message"),
    [
        ([0, 0, 0, 0], "norm 1, got norm 0; divide"),
        ([2, 0, 0, 0], "norm 1, got norm 2"),
        ([1, 0, 0], "four finite numbers"),
        ([np.nan, 0, 0, 1], "four finite numbers"),
    ],
)
def test_bad_quaternions_are_refused(quaternion: list[float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        rotation_from_quaternion(quaternion)


def test_bad_transforms_are_refused() -> None:
    with pytest.raises(ValueError, match="orthonormal and right-handed"):
        Rigid(np.diag([1.0, -1.0, 1.0]), np.zeros(3))
    with pytest.raises(ValueError, match="must be finite"):
        Rigid(np.eye(3), np.array([0.0, np.inf, 0.0]))
    with pytest.raises(ValueError, match=r"shape \(4, 4\)"):
        Rigid.from_matrix(np.eye(3))
    with pytest.raises(ValueError, match=r"row 0, 0, 0, 1, got \[1.0, 2.0, 3.0, 1.0\]; is it transposed"):
        Rigid.from_matrix(Rigid(np.eye(3), np.array([1.0, 2.0, 3.0])).as_matrix().T)
