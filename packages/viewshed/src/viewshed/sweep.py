"""Sweep: the returns of one sensor in one revolution."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from viewshed import _core
from viewshed.arrays import as_int, frozen
from viewshed.geometry import Rigid, attitude_of, pose_covariance_of, rotation_from_quaternion
from viewshed.sensors import LidarModel, lidar_model


def unorganized(sweep: Sweep) -> Sweep:
    """Return the sweep without ring, firing azimuth and time; the sensor model stays."""
    return sweep.replace(ring=None, azimuth=None, time_s=None)


def unorganized_no_sensor(sweep: Sweep) -> Sweep:
    """Return the sweep without ring, firing azimuth, time and sensor model."""
    return unorganized(sweep).replace(model=None)


def bare_points(sweep: Sweep) -> Sweep:
    """Return a sweep of the points only, without sensor model, mounting height, attitude and pose."""
    return Sweep(sweep.points)


MAX_POINTS = 20_000_000
"""Maximum number of points in a sweep; the densest sensors have about 300,000 returns per revolution."""


REVOLUTION_S = 2.0
"""Maximum duration of a revolution in seconds; sensors turn at 5 to 20 Hz."""

_INT64 = 1 << 63

_MAX_HEIGHT_M = 100.0

_MAX_AZIMUTH = 2 * np.pi + 1e-3

LATEST_S = 9e9
"""Times below this fit int64 when converted from seconds to nanoseconds."""

_COLUMNS = ("points", "intensity", "ring", "azimuth", "time_s")

_MAX_COLUMNS = 16
"""An array with more columns does not have one point per row."""


@dataclass(frozen=True, slots=True, eq=False)
class PlanarScan:
    """No-return beams and maximum range of a planar scan (2-D laser), whose beams lie in z = 0 of the sensor frame.

    Raises:
        ValueError: a shape or a value is invalid.

    >>> PlanarScan(np.array([0.5, 1.0]), 30.0).open_azimuth.dtype.name
    'float32'
    """

    # (K,) float32 azimuths of the beams without a return up to ``max_range_m``, radians within ±2π
    open_azimuth: NDArray[np.float32]
    max_range_m: float  # maximum measurable range, positive; +inf if the sensor does not state it

    def __post_init__(self) -> None:
        azimuth = np.asarray(self.open_azimuth)
        if azimuth.ndim != 1 or azimuth.dtype.kind not in "fiu":
            raise ValueError(f"open_azimuth must be (K,) real numbers, got {azimuth.dtype} of shape {azimuth.shape}")
        if not (np.abs(azimuth) <= _MAX_AZIMUTH).all():
            raise ValueError(f"open_azimuth must be finite radians within ±2π, got {azimuth.min():g}…{azimuth.max():g}")
        if not self.max_range_m > 0:
            raise ValueError(f"max_range_m must be positive, got {self.max_range_m:g}")
        object.__setattr__(self, "open_azimuth", frozen(azimuth.astype(np.float32)))


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """One revolution of one LiDAR, in the sensor's own frame (x forward, y left, z up, sensor at the origin).

    Attributes:
        points: (N, 3) float32, meters. Rows that are not finite are dropped from all columns.
        intensity: (N,) float32 in the sensor's own scale, or None.
        ring: (N,) int16 beam index, 0 the lowest beam, or None if the format has none.
        azimuth: (N,) float32 firing azimuth in radians within ±2π as the sensor reported it, or None.
        time_s: (N,) float32 seconds since the start of the sweep, within ±2 s, or None.
        t_ns: time of the sweep in nanoseconds, within int64, or None.
        attitude: quaternion (w, x, y, z) of ``level_from_sensor``, or None to estimate it.
        sensor_height_m: mounting height above the ground below the sensor, or None to estimate it.
        world_from_sensor: pose in the map, or None.
        model: beam table of the sensor, or None if unknown.
        infer_sensor: whether to infer the sensor from the points if ``model`` is None; False: use no sensor model.
        agent: name of the vehicle or unit that carries the sensor.
        dropped_points: number of rows that were dropped because they were not finite.
        vehicle_yaw: heading of the vehicle that carries the sensor, radians counter-clockwise from the sensor's x, or
            None to estimate it from the returns near the sensor.
        planar: no-return beams and maximum range of a planar scan (2-D laser); None for any other sweep.
        pose_covariance: (6, 6) float64 covariance of the pose: x, y, z in meters, then rotations about these axes in
            radians, in map axes (ROS convention); or None if unknown.

    Raises:
        ValueError: a shape, a value or a type is invalid; the message names the fix.

    >>> sweep = Sweep(np.array([[5.0, 0.0, -1.0], [np.nan, 0.0, 0.0]]))
    >>> len(sweep), sweep.points.dtype.name, sweep.dropped_points
    (1, 'float32', 1)
    """

    points: NDArray[np.float32]
    intensity: NDArray[np.float32] | None = None
    ring: NDArray[np.int16] | None = None
    azimuth: NDArray[np.float32] | None = None
    time_s: NDArray[np.float32] | None = None
    t_ns: int | None = None
    attitude: NDArray[np.float64] | None = None
    sensor_height_m: float | None = None
    world_from_sensor: Rigid | None = None
    model: LidarModel | None = None
    infer_sensor: bool = True
    agent: str = "ego"
    dropped_points: int = field(default=0)
    vehicle_yaw: float | None = None
    planar: PlanarScan | None = None
    pose_covariance: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        for value, name, kind, maker in (
            (self.world_from_sensor, "world_from_sensor", Rigid, "viewshed.Rigid.from_matrix"),
            (self.model, "model", LidarModel, "viewshed.lidar_model"),
        ):
            if value is not None and not isinstance(value, kind):
                raise ValueError(f"{name} must be a {kind.__name__}, got {type(value).__name__}; {maker} makes one")
        points = _points(self.points)
        keep = None if _core.all_finite(points) else np.isfinite(points).all(axis=1)
        if keep is not None:
            _set(self, "dropped_points", self.dropped_points + int((~keep).sum()))
        _set(self, "points", frozen(points if keep is None else points[keep]))
        for name, dtype in (
            ("intensity", np.float32), ("ring", np.int16), ("azimuth", np.float32), ("time_s", np.float32),
        ):  # fmt: skip
            value = getattr(self, name)
            if value is not None:
                column = _column(name, value, len(points), dtype)
                _set(self, name, frozen(column if keep is None else column[keep]))
        self._check_ring()
        self._check_span("azimuth", _MAX_AZIMUTH, "finite radians within ±2π")
        self._check_span("time_s", REVOLUTION_S, f"finite seconds within one revolution (±{REVOLUTION_S:g} s)")
        self._check_attitude()
        self._check_covariance()
        if self.t_ns is not None:
            _set(self, "t_ns", as_int("t_ns, in nanoseconds,", self.t_ns))
            if not -_INT64 <= self.t_ns < _INT64:
                raise ValueError(f"t_ns must be nanoseconds that fit int64, got {self.t_ns}")
        if self.vehicle_yaw is not None and not np.isfinite(self.vehicle_yaw):
            raise ValueError(f"vehicle_yaw must be finite radians, got {self.vehicle_yaw}")
        if self.dropped_points < 0:
            raise ValueError(f"dropped_points must not be negative, got {self.dropped_points}")
        height = self.sensor_height_m
        if height is not None and not (np.isfinite(height) and 0.0 < height < _MAX_HEIGHT_M):
            raise ValueError(f"sensor_height_m must lie in (0, {_MAX_HEIGHT_M:g}), got {height:g}; give it in meters")

    def _check_ring(self) -> None:
        if self.ring is None or self.ring.size == 0:
            return
        low, high = int(self.ring.min()), int(self.ring.max())
        limit = 4096 if self.model is None else self.model.rings
        if low < 0 or high >= limit:
            of = "" if self.model is None else f" of {self.model.name}"
            raise ValueError(f"ring must lie in [0, {limit}){of}, got {low}…{high}; name the right sensor")

    def _check_span(self, name: str, limit: float, rule: str) -> None:
        column = getattr(self, name)
        if column is None or column.size == 0:
            return
        low, high = float(column.min()), float(column.max())
        if not (low >= -limit and high <= limit):  # NaN fails both
            raise ValueError(f"{name} must be {rule}, got {low:g}…{high:g}")

    def _check_attitude(self) -> None:
        if self.attitude is None:
            return
        attitude = np.array(self.attitude, dtype=np.float64)
        rotation_from_quaternion(attitude)
        _set(self, "attitude", frozen(attitude))

    def _check_covariance(self) -> None:
        if self.pose_covariance is None:
            return
        covariance = pose_covariance_of(self.pose_covariance, f"pose_covariance of {self.agent}")
        _set(self, "pose_covariance", frozen(covariance))

    def __len__(self) -> int:
        return len(self.points)

    @property
    def known_attitude(self) -> NDArray[np.float64] | None:
        """Quaternion (w, x, y, z) of ``level_from_sensor``: ``attitude``, else that of the pose, else None."""
        if self.attitude is not None or self.world_from_sensor is None:
            return self.attitude
        return attitude_of(self.world_from_sensor.rotation)

    def select(self, keep: NDArray[np.bool_] | NDArray[np.intp]) -> Sweep:
        """Return the sweep with the rows selected by ``keep``, an (N,) mask or indices, in that order."""
        columns = {
            name: None if value is None else value[keep] for name in _COLUMNS for value in (getattr(self, name),)
        }
        return self.replace(**columns)

    def seen_from(self, origin_m: ArrayLike) -> Sweep:
        """Return the sweep with its origin moved to the sensor, which is at ``origin_m`` (3,) in the current frame.

        Use it for files whose origin is the axle or the road. The pose is moved too; the axes stay.

        >>> Sweep(np.array([[5.0, 0.0, 0.5]])).seen_from((1.0, 0.0, 1.8)).points.round(3).tolist()
        [[4.0, 0.0, -1.2999999523162842]]
        """
        origin = np.asarray(origin_m, np.float64)
        if origin.shape != (3,) or not np.isfinite(origin).all():
            raise ValueError(f"origin_m must be three finite numbers in meters, got {origin_m!r}")
        if self.planar is not None:
            raise ValueError("a scan in one plane must be seen from its own sensor; leave origin_m out")
        pose = self.world_from_sensor
        return self.replace(
            points=self.points - origin.astype(np.float32),
            world_from_sensor=None if pose is None else pose @ Rigid(np.eye(3), origin),
        )

    def copy(self) -> Sweep:
        """Return the sweep with copies of its arrays.

        Use it if a driver reuses its buffer: a sweep made from the buffer is a view, and changes with it.

        >>> buffer = np.ones((1, 3), np.float32)
        >>> kept, view = Sweep(buffer).copy(), Sweep(buffer)
        >>> buffer[:] = 2.0
        >>> kept.points[0, 0].item(), view.points[0, 0].item()
        (1.0, 2.0)
        """
        columns = {name: getattr(self, name) for name in _COLUMNS}
        return self.replace(**{name: value.copy() for name, value in columns.items() if value is not None})

    def replace(self, **changes: Any) -> Sweep:
        """Return a copy with the given attributes replaced; an unknown name raises TypeError."""
        return Sweep(**({f.name: getattr(self, f.name) for f in fields(self)} | changes))


def _set(sweep: Sweep, name: str, value: object) -> None:
    object.__setattr__(sweep, name, value)


def shape_remedy(shape: tuple[int, ...]) -> str:
    """Return the fix for an array of points of a wrong shape, to append to an error message; empty if unclear.

    >>> shape_remedy((3, 50_000)), shape_remedy((64, 1024))[:21], shape_remedy((64, 1024, 3))
    ('; transpose it (points.T)', '; is it a range image', '; reshape it (points.reshape(-1, 3))')
    """
    if len(shape) == 2 and shape[0] in (3, 4) and shape[1] > _MAX_COLUMNS:
        return "; transpose it (points.T)" if shape[0] == 3 else "; transpose it and take its first three columns"
    if len(shape) == 2 and shape[1] > _MAX_COLUMNS:
        return "; is it a range image? turn its ranges into points x, y, z by the angles of its rows and columns"
    if len(shape) == 2 and shape[1] > 3:
        return "; take its first three columns (points[:, :3])"
    if len(shape) == 3 and 3 <= shape[2] <= _MAX_COLUMNS:
        return f"; reshape it (points.reshape(-1, {shape[2]}))"
    return ""


def has_points_in_rows(shape: tuple[int, ...]) -> bool:
    """Return whether an array of this shape has one point per row: (N, 3) to (N, 16).

    >>> [has_points_in_rows(shape) for shape in ((9, 3), (9, 5), (3, 900), (64, 1024), (64, 1024, 3), ())]
    [True, True, False, False, False, False]
    """
    return len(shape) == 2 and 3 <= shape[1] <= _MAX_COLUMNS


def sweep_of_points(
    points: ArrayLike,
    *,
    sensor: str | LidarModel | None = None,
    sensor_height_m: float | None = None,
    world_from_sensor: Rigid | None = None,
) -> Sweep:
    """Return the sweep of an array of points.

    Args:
        points: (N, 3+) in meters, x forward, y left, z up, the sensor at the origin; a fourth column is intensity,
            further columns are ignored. Or (N,) with fields x, y, z and optionally intensity and ring.
        sensor: beam table or its name (see :func:`viewshed.lidar_model`); None infers it.
        sensor_height_m: mounting height above the ground, if known.
        world_from_sensor: pose in the map, if known.

    Raises:
        ValueError: the array has another shape, or lacks a field.

    >>> sweep_of_points(np.ones((2, 5)), sensor="vlp16").intensity.tolist()
    [1.0, 1.0]
    """
    array = np.asarray(points)
    columns: dict[str, NDArray[Any]] = {}
    if array.dtype.names is not None:
        missing = [name for name in "xyz" if name not in array.dtype.names]
        if missing:
            raise ValueError(f"points must have fields x, y and z, got {', '.join(array.dtype.names)}")
        flat = array.ravel()
        columns = {name: flat[name] for name in ("intensity", "ring") if name in array.dtype.names}
        array = np.column_stack([flat[name] for name in "xyz"])
    elif not has_points_in_rows(array.shape):
        raise ValueError(f"points must have shape (N, 3+), got {array.shape}{shape_remedy(array.shape)}")
    elif array.shape[1] > 3:
        columns = {"intensity": array[:, 3]}
    return Sweep(
        array[:, :3], columns.get("intensity"), columns.get("ring"),
        model=lidar_model(sensor) if isinstance(sensor, str) else sensor,
        sensor_height_m=sensor_height_m, world_from_sensor=world_from_sensor,
    )  # fmt: skip


def _points(value: ArrayLike) -> NDArray[np.float32]:
    array = np.asarray(value)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"points must have shape (N, 3), got {array.shape}{shape_remedy(array.shape)}")
    if array.dtype.kind not in "fiu":
        raise ValueError(f"points must be real numbers, got dtype {array.dtype}")
    if len(array) > MAX_POINTS:
        raise ValueError(f"a sweep must have at most {MAX_POINTS} points, got {len(array)}; split it into revolutions")
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(array, np.float32)


def _column(name: str, value: ArrayLike, count: int, dtype: type[np.generic]) -> NDArray[Any]:
    array = np.asarray(value)
    if array.shape != (count,):
        raise ValueError(f"{name} must have shape ({count},) like points, got {array.shape}")
    if array.dtype.kind not in "fiub":
        raise ValueError(f"{name} must be real numbers, got dtype {array.dtype}")
    if dtype is np.int16 and array.size and array.dtype != np.int16:
        if array.dtype.kind not in "iub" and not (np.isfinite(array) & (array == np.floor(array))).all():
            raise ValueError(f"{name} must be whole numbers")
        if array.min() < -32768 or array.max() > 32767:
            raise ValueError(f"{name} must lie in [0, 4096), got {array.min()}…{array.max()}")
    with np.errstate(over="ignore"):
        return array.astype(dtype, copy=False)
