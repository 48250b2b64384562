"""Hand-made scenes for the detector: cars of two boxes, people and walls, seen by one sensor."""

import numpy as np

from viewshed import BevGrid
from viewshed.detections import Detections, ObjectKind
from viewshed.objects.detector import Detector
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sensors import lidar_model
from viewshed_lab.sim import Box, Cylinder, Scene, cast

GRID = BevGrid(256, 64.0)
HEIGHT_M = 1.84


def car(x_m: float, y_m: float, yaw: float = 0.0) -> tuple[Box, Box]:
    """Return the body and the cabin of a car of 4.4 m by 1.8 m."""
    cabin_x, cabin_y = x_m - 0.3 * np.cos(yaw), y_m - 0.3 * np.sin(yaw)
    return (
        Box(x_m, y_m, 4.4, 1.8, 0.85, bottom_m=0.2, yaw=yaw),
        Box(cabin_x, cabin_y, 2.4, 1.5, 1.48, bottom_m=0.85, yaw=yaw),
    )


def person(x_m: float, y_m: float) -> Cylinder:
    return Cylinder(x_m, y_m, 0.27, 1.72)


def seen(*things: Box | Cylinder, sensor: str = "hdl64e", slope: tuple[float, float] = (0.0, 0.0)) -> LeveledSweep:
    boxes = tuple(thing for thing in things if isinstance(thing, Box))
    cylinders = tuple(thing for thing in things if isinstance(thing, Cylinder))
    scene = Scene(boxes, cylinders, slope)
    return level(cast(lidar_model(sensor), scene, HEIGHT_M, rng=np.random.default_rng(3)), GRID)


def found(*things: Box | Cylinder, sensor: str = "hdl64e", slope: tuple[float, float] = (0.0, 0.0)) -> Detections:
    return Detector().detect(seen(*things, sensor=sensor, slope=slope))


def of_kind(detections: Detections, kind: ObjectKind) -> Detections:
    return detections.take(detections.kinds == kind)
