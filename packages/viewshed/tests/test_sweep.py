from typing import Any

import numpy as np
import pytest

from viewshed import Rigid, Sweep, lidar_model


def test_rows_that_are_not_finite_go_with_their_columns() -> None:
    points = np.array([[1, 2, 3], [np.nan, 0, 0], [4, 5, 6], [0, np.inf, 0]], np.float32)
    sweep = Sweep(points, intensity=np.arange(4, dtype=np.float32), ring=np.array([3, 2, 1, 0], np.int16))
    assert sweep.points.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert sweep.dropped_points == 2
    assert sweep.intensity.tolist() == [0, 2]
    assert sweep.ring.tolist() == [3, 1]


@pytest.mark.parametrize(
    ("covariance", "message"),
    [
        (np.eye(3), r"pose_covariance of car must be \(6, 6\) finite numbers, got shape \(3, 3\)"),
        (np.full((6, 6), np.nan), "must be .* finite numbers, got nan"),
        (np.diag([1.0, 1.0, -1.0, 0.0, 0.0, 0.0]), "pose_covariance of car must have no negative eigenvalue, got -1"),
        (np.triu(np.ones((6, 6))), "pose_covariance of car must be symmetric, got numbers 1 apart"),
    ],
)
def test_a_covariance_that_is_none_is_refused(covariance: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Sweep(np.ones((1, 3), np.float32), agent="car", pose_covariance=covariance)


def test_a_sweep_is_read_only_and_its_source_stays_writable() -> None:
    points = np.ones((2, 3), np.float32)
    sweep = Sweep(points)
    with pytest.raises(ValueError, match="read-only"):
        sweep.points[0, 0] = 5.0
    points[0, 0] = 7.0
    assert points[0, 0] == 7.0


def test_select_takes_the_rows_of_every_column_in_order() -> None:
    sweep = Sweep(
        np.arange(9, dtype=np.float32).reshape(3, 3),
        ring=np.array([0, 1, 2], np.int16),
        time_s=np.array([0.0, 0.1, 0.2], np.float32),
    )
    picked = sweep.select(np.array([2, 0]))
    assert picked.points[:, 0].tolist() == [6, 0]
    assert picked.ring.tolist() == [2, 0]
    assert picked.time_s is not None
    assert np.allclose(picked.time_s, [0.2, 0.0])


def test_the_pose_gives_the_attitude_where_none_is_given() -> None:
    pose = Rigid.from_yaw(0.7, (10.0, 0.0, 2.0))
    known = Sweep(np.zeros((1, 3), np.float32), world_from_sensor=pose).known_attitude
    assert known is not None
    assert np.allclose(known, [1, 0, 0, 0])
    assert Sweep(np.zeros((1, 3), np.float32)).known_attitude is None


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"points": np.zeros((3, 4))}, r"points must have shape \(N, 3\), got \(3, 4\)"),
        ({"points": np.zeros(3)}, r"points must have shape \(N, 3\)"),
        ({"points": np.zeros((2, 3), complex)}, "real numbers"),
        ({"points": np.zeros((2, 3)), "ring": np.array([0])}, r"ring must have shape \(2,\)"),
        ({"points": np.zeros((2, 3)), "ring": np.array([0, -1])}, r"ring must lie in \[0, 4096\), got -1…0"),
        ({"points": np.zeros((2, 3)), "ring": np.array([0, 70000])}, "ring must lie in"),
        ({"points": np.zeros((2, 3)), "ring": np.array([0.5, 1.0])}, "ring must be whole numbers"),
        ({"points": np.zeros((2, 3)), "ring": np.array([np.nan, 1.0])}, "ring must be whole numbers"),
        ({"points": np.zeros((2, 3)), "attitude": np.zeros(4)}, "norm 1"),
        ({"points": np.zeros((2, 3)), "sensor_height_m": -1.0}, "sensor_height_m must lie in"),
        ({"points": np.zeros((2, 3)), "sensor_height_m": float("nan")}, "sensor_height_m must lie in"),
        ({"points": np.zeros((2, 3)), "ring": np.array(["a", "b"])}, "ring must be real numbers, got dtype <U1"),
        ({"points": np.zeros((2, 3)), "time_s": [0.0, np.nan]}, "time_s must be finite seconds within one revolution"),
        ({"points": np.zeros((2, 3)), "time_s": [0.0, 2.01]}, r"time_s must be .* got 0…2\.01"),
        ({"points": np.zeros((2, 3)), "time_s": [0.0, 1e300]}, "time_s must be finite seconds"),
        ({"points": np.zeros((2, 3)), "azimuth": [np.nan, 0.0]}, "azimuth must be finite radians within ±2π"),
        ({"points": np.zeros((2, 3)), "azimuth": [0.0, -6.3]}, r"azimuth must be .* got -6\.3…0"),
        (
            {"points": np.zeros((2, 3)), "t_ns": 2**63},
            "t_ns must be nanoseconds that fit int64, got 9223372036854775808",
        ),
        ({"points": np.zeros((2, 3)), "t_ns": -(2**63) - 1}, "t_ns must be nanoseconds that fit int64"),
        ({"points": np.zeros((2, 3)), "t_ns": 1.7e9}, "t_ns, in nanoseconds, must be a whole number, got 1700000000.0"),
        ({"points": np.zeros((2, 3)), "world_from_sensor": np.eye(4)}, "must be a Rigid, got ndarray; viewshed.Rigid"),
        ({"points": np.zeros((2, 3)), "model": "vlp16"}, "model must be a LidarModel, got str; viewshed"),
        ({"points": np.zeros((2, 3)), "dropped_points": -5}, "dropped_points must not be negative, got -5"),
        ({"points": np.zeros((1, 3)), "vehicle_yaw": np.nan}, "vehicle_yaw must be finite radians, got nan"),
        (
            {"points": np.zeros((2, 3)), "ring": np.array([0, 16]), "model": lidar_model("vlp16")},
            "of VLP-16, got 0…16; name the right sensor",
        ),
    ],
)
def test_bad_columns_are_refused_in_one_line(columns: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        Sweep(**columns)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


def test_columns_at_their_limits_are_taken() -> None:
    sweep = Sweep(
        np.zeros((2, 3), np.float32), azimuth=np.array([-2 * np.pi, 2 * np.pi]), time_s=np.array([-2.0, 2.0]),
        t_ns=2**63 - 1,
    )  # fmt: skip
    assert sweep.time_s.tolist() == [-2.0, 2.0]
    # what a point that is not finite has in its columns goes with it
    dropped = Sweep(np.array([[1.0, 2, 3], [np.nan, 0, 0]]), time_s=np.array([0.5, np.nan]))
    assert dropped.time_s.tolist() == [0.5]


def test_an_origin_moves_points_and_pose_and_no_axes() -> None:
    pose = Rigid.from_quaternion((np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)), (10.0, 0.0, 0.0))  # x points to the map's y
    sweep = Sweep(np.array([[5.0, 1.0, 0.0]], np.float32), world_from_sensor=pose).seen_from((1.0, 0.0, 1.5))
    assert sweep.points.tolist() == [[4.0, 1.0, -1.5]]
    assert sweep.world_from_sensor.translation == pytest.approx([10.0, 1.0, 1.5])
    assert sweep.world_from_sensor @ sweep.points[0].astype(np.float64) == pytest.approx(
        pose @ np.array([5.0, 1.0, 0.0])
    )
    with pytest.raises(ValueError, match="origin_m must be three finite numbers in meters"):
        sweep.seen_from((1.0, np.nan, 0.0))
