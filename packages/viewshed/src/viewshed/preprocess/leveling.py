"""Leveling of a sweep: identify its sensor, find isolated returns, estimate attitude and ground, rotate the points."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import Mask
from viewshed.fov.height_map import HeightMap
from viewshed.fov.visibility import Beams
from viewshed.geometry import Rigid, rotation_from_quaternion
from viewshed.grid import BevGrid
from viewshed.preprocess.range_image import RangeImage, pixels_of
from viewshed.preprocess.sensor_identification import UNIDENTIFIED, SensorId, identify_sensor
from viewshed.sweep import Sweep

OBSTACLE_HEIGHTS_M = (0.3, 3.0)
"""(low, high) height range above local ground of obstacle returns."""

NULL_RANGE_M = 0.5
"""Minimum range of a return for all sensors; nearer ones are null returns or the sensor's housing."""

MAX_RANGE_M = 250.0
"""Maximum range of a return if the sensor is unknown."""

LEVEL_TILT = _core.LEVEL_TILT
"""Minimum slope (radians) of a ground plane that is taken for the sensor's tilt if the attitude is unknown."""

EGO_BOX_M = _core.EGO_LENGTH_M, _core.EGO_WIDTH_M
"""Half length and half width of the vehicle below a sensor 1.2 to 3 m high; returns within are dropped."""

MIN_SUPPORT = _core.MIN_HEIGHT_SUPPORT
"""Minimum share of the near ground on the ground plane for a reliable estimate of the sensor's height."""

PLANE_HEIGHT_M = 0.3
"""Default height of a planar scan above the ground, which is within the height of every target."""

_OBSTACLE_M = 0.5
"""Minimum height above the ground given to returns of a planar scan, so that all are obstacles."""


@dataclass(frozen=True, slots=True)
class Held:
    """Height and attitude of the sensor in earlier sweeps of the stream; holds no reference to the sweeps."""

    # ``level_from_sensor`` as estimated from the returns of the last sweeps, the current sweep last
    estimates: tuple[Rigid, ...]
    is_height_held: bool = False  # whether a height of the ``estimates`` replaced the sweep's own


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class LeveledSweep:
    """A sweep in its ``level`` frame, without ego returns, null returns and clutter; M of N rows, in order."""

    sweep: Sweep  # the original sweep, reduced to the farthest return of each beam
    points: NDArray[np.float32]  # (M, 3) float32 meters in ``level`` (the sensor is at (0, 0, sensor_height_m))
    range_m: NDArray[np.float32]  # (M,) float32 horizontal range from the sensor
    azimuth: NDArray[np.float32]  # (M,) float32 radians in [-π, π), counter-clockwise from forward
    height_m: NDArray[np.float32]  # (M,) float32 height above local ground
    rows: NDArray[np.int32]  # (M,) int32 row of each point in the sweep
    level_from_sensor: Rigid  # the transform of the points
    ground: HeightMap  # the local ground
    sensor_id: SensorId = UNIDENTIFIED  # rings and sensor, the sweep's own or identified from its points
    # range image of the sweep's N returns, or None if the rings are unknown
    range_image: RangeImage | None = None
    # height and attitude in earlier sweeps (:mod:`viewshed.preprocess.held_ground`); None without earlier sweeps
    held: Held | None = None
    every_return: Sweep | None = None  # the sweep with all returns, if a beam has several
    # cache of derived values; the first item of a key names the function that computes the value
    derived: dict[Hashable, Any] = field(default_factory=dict, init=False, repr=False)

    @property
    def delivered(self) -> Sweep:
        """The original sweep with all returns of each beam."""
        return self.sweep if self.every_return is None else self.every_return

    @property
    def sensor_height_m(self) -> float:
        """Height of the sensor above the ground below it, in meters."""
        return float(self.level_from_sensor.translation[2])

    @property
    def is_sure_of_height(self) -> bool:
        """Whether the sensor's height is given, or its estimate is supported by enough near ground."""
        return self.sweep.sensor_height_m is not None or self.ground.support >= MIN_SUPPORT

    @property
    def world_from_level(self) -> Rigid | None:
        """Pose of the ``level`` frame in the map, or None if the sweep has no pose."""
        pose = self.sweep.world_from_sensor
        return None if pose is None else pose @ self.level_from_sensor.inverse()

    def beams(self, left_out: Mask | None = None) -> Beams:
        """Return the M beams with a return: straight lines from the sensor to each point.

        Beams of the sweep's rows in the mask ``left_out`` (N,) point straight up and hit nothing; removing them would
        copy the arrays.
        """
        slope = _core.beam_slopes(self.points, self.range_m, self.sensor_height_m, left_out, self.rows)
        return Beams(self.azimuth, slope, self.range_m)

    def obstacle_cells(self, grid: BevGrid) -> NDArray[np.bool_]:
        """Return the mask (cells, cells) of cells with an obstacle return, 0.3 to 3 m above local ground."""
        return _core.obstacle_cells(
            self.points, self.height_m, *grid.origin_m, 1.0 / grid.cell_m, *OBSTACLE_HEIGHTS_M, grid.cells
        )


def level(sweep: Sweep, grid: BevGrid, before: SensorId = UNIDENTIFIED) -> LeveledSweep:
    """Return ``sweep`` leveled, its ground estimated over the extent of ``grid``.

    The attitude is the sweep's own, else that of its pose. Else the sensor's z axis is assumed vertical, unless the
    ground plane is steeper than 6°: then its slope is taken for the sensor's tilt. The height is the sweep's own, else
    that of the sensor above the estimated ground. Dropped are returns nearer than 0.5 m, beyond the sensor's maximum
    range, or inside the box of a vehicle below the sensor (heights of 1.2 to 3 m), and clutter
    (:mod:`viewshed.preprocess.range_image`) if the rings are known or can be identified. If a beam has several returns,
    the farthest is used: the light passed leaves, wires and rain. In a stream, ``before`` is the ``sensor_id`` of the
    previous sweep (see :func:`identify_sensor`).

    A planar scan sees no ground: the ground is assumed flat, 0.3 m below the sensor if the height is unknown, and every
    return is an obstacle.
    """
    if sweep.planar is not None:
        return _level_planar(sweep, grid)
    farthest = _core.farthest_returns(sweep.points, sweep.ring)
    every_return, sweep = (None, sweep) if farthest is None else (sweep, sweep.select(farthest.astype(np.intp)))
    sensor_id = identify_sensor(sweep, before)
    pixels = pixels_of(sensor_id)
    attitude = sweep.known_attitude
    arrays, rotation, height_m, (heights_m, std_m, seen, plane, support), columns = _core.level_sweep(
        sweep.points, None if pixels is None else pixels.ring, 0 if pixels is None else len(pixels.elevation),
        0 if pixels is None else pixels.columns, *range_limits(sweep),
        None if attitude is None else rotation_from_quaternion(attitude), sweep.sensor_height_m, sweep.vehicle_yaw,
        _half_extent_m(grid),
    )  # fmt: skip
    for column in columns:
        column.setflags(write=False)
    return LeveledSweep(
        sweep,
        *columns,
        Rigid(rotation, np.array([0.0, 0.0, height_m])),
        HeightMap(heights_m, _half_extent_m(grid), seen, plane, support, std_m),
        sensor_id,
        None if pixels is None or arrays is None else pixels.image(*arrays),
        every_return=every_return,
    )


def _level_planar(sweep: Sweep, grid: BevGrid) -> LeveledSweep:
    """Return a planar scan leveled over flat ground."""
    attitude = sweep.known_attitude
    rotation = np.eye(3) if attitude is None else rotation_from_quaternion(attitude)
    level_from_sensor = Rigid(rotation, np.array([0.0, 0.0, sweep.sensor_height_m or PLANE_HEIGHT_M]))
    ground, heading = HeightMap.flat(_half_extent_m(grid)), sweep.vehicle_yaw or 0.0
    points, range_m, azimuth, heights_m, rows = _core.level_points(
        sweep.points, None, level_from_sensor.as_matrix()[:3].astype(np.float32), *range_limits(sweep), heading,
        ground.heights_m, ground.half_extent_m,
    )  # fmt: skip
    # Every return is an obstacle, however low the plane is.
    columns = points, range_m, azimuth, np.maximum(heights_m, np.float32(_OBSTACLE_M)), rows
    for column in columns:
        column.setflags(write=False)
    return LeveledSweep(sweep, *columns, level_from_sensor, ground)


def leveled_on(sweep: Sweep | LeveledSweep, grid: BevGrid, before: SensorId = UNIDENTIFIED) -> LeveledSweep:
    """Return ``sweep`` leveled for ``grid`` by :func:`level`; a LeveledSweep is returned unchanged.

    Raises:
        TypeError: ``sweep`` is neither a Sweep nor a LeveledSweep.
        ValueError: ``sweep`` was leveled for a smaller grid.
    """
    if isinstance(sweep, Sweep):
        return level(sweep, grid, before)
    if not isinstance(sweep, LeveledSweep):
        raise TypeError(
            f"sweep must be a Sweep or a LeveledSweep, got {type(sweep).__name__}; make one with viewshed.Sweep(points)"
        )
    extent_m = _half_extent_m(grid)
    if sweep.ground.half_extent_m < extent_m:
        raise ValueError(
            f"a leveled sweep must have ground out to {extent_m:g} m for this grid, got"
            f" {sweep.ground.half_extent_m:g} m; level it on the estimator's grid"
        )
    return sweep


def range_limits(sweep: Sweep) -> tuple[float, float]:
    """Return the minimum and maximum range in meters of the returns to use."""
    if sweep.planar is not None:
        return 0.0, MAX_RANGE_M
    if sweep.model is None:
        return NULL_RANGE_M, MAX_RANGE_M
    return max(NULL_RANGE_M, sweep.model.min_range_m), sweep.model.max_range_m


def _half_extent_m(grid: BevGrid) -> float:
    """Return half the side in meters of the ground lattice that covers a grid."""
    return grid.half_extent_m + max(abs(offset) for offset in grid.offset_m)
