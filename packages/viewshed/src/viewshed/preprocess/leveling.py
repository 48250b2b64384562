"""Level a sweep: identify its sensor, find isolated returns, estimate attitude and ground, turn its points level."""

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
"""Returns between these heights above local ground are obstacles."""

NULL_RANGE_M = 0.5
"""Returns nearer than this are null returns or the sensor's own housing, whatever the sensor."""

MAX_RANGE_M = 250.0
"""Returns farther than this are not used where the sensor is not known."""

LEVEL_TILT = _core.LEVEL_TILT
"""A ground plane steeper than this is taken as the sensor's tilt where the attitude is not known."""

EGO_BOX_M = _core.EGO_LENGTH_M, _core.EGO_WIDTH_M
"""Half of the length and of the width of the vehicle below a sensor 1.2 to 3 m high, whose returns are left out."""

LEAST_SUPPORT = _core.LEAST_SUPPORT
"""A height that was estimated from a plane with a smaller share of the near ground on it is doubtful."""

PLANE_HEIGHT_M = 0.3
"""Height of a scan in one plane where it is not known: within every target."""

_OBSTACLE_M = 0.5
"""Least height above the ground that counts for returns of a scan in one plane: clearly obstacles."""


@dataclass(frozen=True, slots=True)
class Held:
    """What a sweep takes from earlier ones of its stream beside their ground; numbers alone, no sweep."""

    # the sensor's heights above the ground that the last sweeps estimated, this one's last
    heights_m: tuple[float, ...]
    is_height_held: bool = False  # whether this sweep's own height was set aside for that of ``heights_m``


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class LeveledSweep:
    """A sweep in its ``level`` frame, without ego returns, null returns and clutter; M ≤ N rows in their order."""

    sweep: Sweep  # the sweep that it came from, with the farthest return of each beam
    points: NDArray[np.float32]  # (M, 3) float32 meters in ``level`` (the sensor is at (0, 0, sensor_height_m))
    range_m: NDArray[np.float32]  # (M,) float32 horizontal range from the sensor
    azimuth: NDArray[np.float32]  # (M,) float32 radians in [-π, π), counter-clockwise from forward
    height_m: NDArray[np.float32]  # (M,) float32 height above local ground
    rows: NDArray[np.int32]  # (M,) int32 row of each point in the sweep
    level_from_sensor: Rigid  # the transform used
    ground: HeightMap  # the local ground
    sensor_id: SensorId = UNIDENTIFIED  # the rings and the sensor, the sweep's own or identified by its points
    # the sweep's N returns on its range image, or None where the rings are not known
    range_image: RangeImage | None = None
    # what it takes from earlier sweeps beside their ground (:mod:`viewshed.preprocess.held_ground`); None for a sweep
    # by itself
    held: Held | None = None
    every_return: Sweep | None = None  # the sweep with all returns, where a beam has several
    # what was computed of it once and is needed again; the first item of a key names who computes it
    derived: dict[Hashable, Any] = field(default_factory=dict, init=False, repr=False)

    @property
    def delivered(self) -> Sweep:
        """The sweep as the sensor delivered it, with all returns of each beam."""
        return self.sweep if self.every_return is None else self.every_return

    @property
    def sensor_height_m(self) -> float:
        """Height of the sensor above the ground below it, in meters."""
        return float(self.level_from_sensor.translation[2])

    @property
    def is_sure_of_height(self) -> bool:
        """Whether the sensor's height is given, or enough of the near ground supports it."""
        return self.sweep.sensor_height_m is not None or self.ground.support >= LEAST_SUPPORT

    @property
    def world_from_level(self) -> Rigid | None:
        """Pose of the ``level`` frame in the map, or None where the sweep has none."""
        pose = self.sweep.world_from_sensor
        return None if pose is None else pose @ self.level_from_sensor.inverse()

    def beams(self, left_out: Mask | None = None) -> Beams:
        """Return the beams that returned: straight lines from the sensor to each point.

        Those of rows of the sweep in ``left_out`` (N,) point straight up and meet nothing: removing them costs copies.
        """
        slope = _core.beam_slopes(self.points, self.range_m, self.sensor_height_m, left_out, self.rows)
        return Beams(self.azimuth, slope, self.range_m)

    def obstacle_cells(self, grid: BevGrid) -> NDArray[np.bool_]:
        """Return the mask (cells, cells) of cells that hold an obstacle return, 0.3 to 3 m above local ground."""
        return _core.obstacle_cells(
            self.points, self.height_m, *grid.origin_m, 1.0 / grid.cell_m, *OBSTACLE_HEIGHTS_M, grid.cells
        )


def level(sweep: Sweep, grid: BevGrid, before: SensorId = UNIDENTIFIED) -> LeveledSweep:
    """Return ``sweep`` leveled, its ground estimated over the extent of ``grid``.

    The attitude is the sweep's own, else its pose's, else the sensor's z axis is taken as vertical unless the
    ground plane is steeper than 6°, which then is taken as the sensor's tilt. The height is the sweep's own, else
    the ground's below the sensor. Returns nearer than 0.5 m, farther than the sensor can see, or inside the box of
    a vehicle below the sensor (heights of 1.2 to 3 m) are left out, and so is clutter
    (:mod:`viewshed.preprocess.range_image`) where the rings are known or can be identified. Of a sensor that reports
    several returns of a beam the farthest counts: the light went on past leaves, wires and rain. In a stream
    ``before`` is what was identified of the sweep before: see :func:`identify_sensor`.

    A scan in one plane sees no ground: that is taken to be flat, 0.3 m below the sensor where the height is not known,
    and each of its returns is an obstacle.
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
    """Return a scan in one plane leveled over flat ground."""
    attitude = sweep.known_attitude
    rotation = np.eye(3) if attitude is None else rotation_from_quaternion(attitude)
    level_from_sensor = Rigid(rotation, np.array([0.0, 0.0, sweep.sensor_height_m or PLANE_HEIGHT_M]))
    ground, heading = HeightMap.flat(_half_extent_m(grid)), sweep.vehicle_yaw or 0.0
    points, range_m, azimuth, heights_m, rows = _core.level_points(
        sweep.points, None, level_from_sensor.as_matrix()[:3].astype(np.float32), *range_limits(sweep), heading,
        ground.heights_m, ground.half_extent_m,
    )  # fmt: skip
    # Whatever a beam of the plane meets is an obstacle, however low the plane is.
    columns = points, range_m, azimuth, np.maximum(heights_m, np.float32(_OBSTACLE_M)), rows
    for column in columns:
        column.setflags(write=False)
    return LeveledSweep(sweep, *columns, level_from_sensor, ground)


def leveled_on(sweep: Sweep | LeveledSweep, grid: BevGrid, before: SensorId = UNIDENTIFIED) -> LeveledSweep:
    """Return ``sweep`` leveled for ``grid``, see :func:`level`; one that is leveled already is taken as it is.

    Raises:
        TypeError: ``sweep`` is neither.
        ValueError: it was leveled for a smaller grid.
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
    """Return the nearest and the farthest range in meters at which returns of the sweep are used."""
    if sweep.planar is not None:
        return 0.0, MAX_RANGE_M
    if sweep.model is None:
        return NULL_RANGE_M, MAX_RANGE_M
    return max(NULL_RANGE_M, sweep.model.min_range_m), sweep.model.max_range_m


def _half_extent_m(grid: BevGrid) -> float:
    """Return half the side in meters of the ground that a grid needs."""
    return grid.half_extent_m + max(abs(offset) for offset in grid.offset_m)
