"""Scenes of upright boxes and cylinders on a plane, in the ``level`` frame (meters, sensor above the origin)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from viewshed.geometry import Rigid
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep
from viewshed_lab.sim.assets.shapes import Box, Cylinder
from viewshed_lab.sim.raycast.caster import cast_world
from viewshed_lab.sim.raycast.scan import ExactScan
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import Thing, World

NOISE_M = 0.015
"""Standard deviation of a measured range, typical of a mechanical sensor."""

_HALF_EXTENT_M = 1000.0


@dataclass(frozen=True, slots=True)
class Scene:
    """Solids on a plane."""

    boxes: tuple[Box, ...] = ()  # upright boxes
    cylinders: tuple[Cylinder, ...] = ()  # upright cylinders
    # (a, b): rise of the ground per meter of x and y; its height is 0 below the sensor
    slope: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if not np.isfinite(self.slope).all():
            raise ValueError(f"slope must be two finite numbers, got {self.slope}")

    def ground_m(self, x_m: float, y_m: float) -> float:
        """Return the ground's z in meters at (x, y).

        >>> Scene(slope=(0.1, 0.0)).ground_m(20.0, 3.0)
        2.0
        """
        return self.slope[0] * x_m + self.slope[1] * y_m

    def world(self) -> World:
        """Return the scene as a world; each solid is a thing on the ground below its center."""
        solids: tuple[Box | Cylinder, ...] = (*self.boxes, *self.cylinders)
        things = tuple(Thing("solid", (replace(s, x_m=0.0, y_m=0.0),), s.x_m, s.y_m) for s in solids)
        return World("scene", Terrain.plane(_HALF_EXTENT_M, self.slope), things)


def scan_of(
    model: LidarModel, scene: Scene, sensor_height_m: float, attitude: ArrayLike = (1.0, 0.0, 0.0, 0.0)
) -> ExactScan:
    """Cast the beams into a scene; column c fires at azimuth -π + c · ``model.azimuth_step``.

    ``attitude`` is ``level_from_sensor`` (w, x, y, z).
    """
    on_steps = replace(model, azimuth_offset=model.azimuth_offset - model.azimuth_step / 2)
    pose = Rigid.from_quaternion(attitude, (0.0, 0.0, sensor_height_m))
    return cast_world(scene.world().snapshot(0.0), on_steps, pose)


def depth_image(
    model: LidarModel, scene: Scene, sensor_height_m: float, attitude: ArrayLike = (1.0, 0.0, 0.0, 0.0)
) -> NDArray[np.float64]:
    """Return (rings, azimuth_columns) meters from each beam's start to its first hit; inf without a hit.

    >>> model = LidarModel("one", np.deg2rad([-30.0]), azimuth_columns=4)
    >>> depth_image(model, Scene(), sensor_height_m=2.0).round(5).tolist()
    [[4.0, 4.0, 4.0, 4.0]]
    """
    return np.asarray(scan_of(model, scene, sensor_height_m, attitude).depth_m.T, np.float64)


def cast(
    model: LidarModel,
    scene: Scene,
    sensor_height_m: float,
    attitude: ArrayLike = (1.0, 0.0, 0.0, 0.0),
    rng: np.random.Generator | None = None,
) -> Sweep:
    """Return the sweep that ``model`` measures in a scene, with ring and firing azimuth of every return.

    With ``rng`` the ranges have normal noise of :data:`NOISE_M`; without it they are exact.
    """
    scan = scan_of(model, scene, sensor_height_m, attitude)
    depth = scan.depth_m.T
    ring, column = np.nonzero((depth >= model.min_range_m) & np.isfinite(depth))
    measured = depth[ring, column] + (0.0 if rng is None else rng.normal(0.0, NOISE_M, len(ring)))
    level = scan.origin_m[column, ring] + scan.direction[column, ring] * measured[:, None]
    return Sweep(
        points=(level @ scan.world_from_sensor.rotation).astype(np.float32),
        ring=ring.astype(np.int16),
        azimuth=(-np.pi + column * model.azimuth_step).astype(np.float32),
        attitude=np.asarray(attitude, dtype=np.float64),
        sensor_height_m=sensor_height_m,
        model=model,
    )


def junction() -> Scene:
    """Return an asymmetric road junction: the sensor waits at the stop line, a bus crosses from the left.

    >>> len(junction().boxes) > 30
    True
    """
    trunks = [Cylinder(x, y, 0.22, 3.0) for x, y, _ in _TREES]
    crowns = [Cylinder(x, y, crown, 3.0 + 1.6 * crown, bottom_m=2.6) for x, y, crown in _TREES]
    people, poles = [Cylinder(x, y, 0.27, 1.72) for x, y in _PEOPLE], [Cylinder(x, y, 0.11, 7.0) for x, y in _POLES]
    cars = [part for pose in _CARS for part in _car(*pose)]
    return Scene((*_BLOCKS, *cars), (*people, *poles, *trunks, *crowns))


_BLOCKS = (
    Box(-24, 22, 58, 20, 11), Box(-8, -19, 26, 17, 8), Box(-45, -24, 30, 24, 14), Box(50, 29, 30, 30, 12, yaw=0.12),
    Box(44, -21, 16, 22, 6.5), Box(47, -50, 20, 26, 9, yaw=-0.2), Box(14, 58, 26, 16, 7),
    Box(12, -55, 14, 20, 5, yaw=0.3),
    Box(56, -8.5, 12, 0.3, 2.2), Box(9, -30, 0.3, 24, 1.9), Box(-26, -9, 9, 0.3, 1.1), Box(12, 34, 0.3, 20, 2.4),
    Box(10.5, 10.5, 2.6, 1.6, 2.6), Box(22.5, 13.0, 12.0, 2.55, 3.1, 0.35, np.pi / 2),
    Box(43.5, 3.6, 6.5, 2.5, 3.6, 0.7),
    Box(39.2, 3.6, 1.9, 2.4, 2.7, 0.4),
)  # fmt: skip
"""Houses, walls, a bus and a truck."""

_CARS = (
    (8.0, 0.1, 0.0), (-8.5, 3.6, np.pi), (-19.0, 0.0, 0.02), (27.5, -17.0, -np.pi / 2), (22.3, 31.0, np.pi / 2),
    (60.0, 0.2, 0.0), (9.2, -3.4, 0.0), (3.0, -3.5, 0.03), (-9.6, -3.4, 0.0), (-15.8, -3.5, 0.0),
    (-33.0, -3.4, 0.02), (-3.5, 7.1, np.pi), (-21.0, 7.0, 3.1), (-38.5, 7.1, np.pi), (31.5, -33.0, 1.55),
    (31.5, -39.2, 1.57), (18.4, 44.0, 1.6),
)  # fmt: skip
_PEOPLE = ((15.2, -1.6), (15.6, -2.5), (14.9, 4.4), (11.0, -6.3), (1.5, 9.3), (34.5, -7.0), (-12.0, -6.8))
_POLES = ((12.6, -5.6), (12.4, 8.6), (33.8, 8.8), (34.2, -6.2), (-14.5, 9.6), (-22.0, -6.4), (56.0, 8.0))
_TREES = ((-4.5, -7.6, 1.9), (-29.5, -6.9, 2.3), (36.5, -9.5, 2.6), (17.0, -38.0, 2.8), (4.5, 10.0, 1.6))
"""Poses of cars (x, y, yaw); positions of people, poles and trees, the last with the radius of their crowns."""


def _car(x_m: float, y_m: float, yaw: float) -> list[Box]:
    back = 0.25
    cabin_x, cabin_y = x_m - back * np.cos(yaw), y_m - back * np.sin(yaw)
    return [
        Box(x_m, y_m, 4.3, 1.8, 0.85, bottom_m=0.2, yaw=yaw),
        Box(cabin_x, cabin_y, 2.3, 1.6, 1.48, bottom_m=0.85, yaw=yaw),
    ]
