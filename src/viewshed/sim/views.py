"""Several views of one scene with their exact beams: worlds in which cross-view truth can be checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from viewshed.geometry import Rigid
from viewshed.sensors import LidarModel
from viewshed.sim.scene import Scene, cast, depth_image
from viewshed.sim.shapes import Box, Cylinder
from viewshed.sweep import Sweep
from viewshed.visible import Beams


def view(
    scene: Scene, model: LidarModel, pose: tuple[float, float, float], height_m: float, rng: np.random.Generator
) -> tuple[Sweep, Beams]:
    """Return a noisy sweep of a flat ``scene`` and its exact beams (no return: depth +inf), both from ``pose``.

    Args:
        scene: what stands there; its ground must be level.
        model: the sensor.
        pose: x and y in metres and yaw in radians, in the scene.
        height_m: sensor height above the ground.
        rng: noise of the measured ranges.

    Raises:
        ValueError: the scene's ground slopes.
    """
    if any(scene.slope):
        raise ValueError(f"scene must have level ground to be seen from several places, got slope {scene.slope}")
    x, y, yaw = pose
    seen = _moved(scene, x, y, yaw)
    depth = depth_image(model, seen, height_m)
    flat = np.cos(model.elevation)[:, None]
    azimuth = -np.pi + np.arange(model.azimuth_columns) * model.azimuth_step + np.zeros((model.rings, 1))
    slope = np.tan(model.elevation)[:, None] + np.zeros_like(azimuth)
    beams = Beams(*(a.ravel().astype(np.float32) for a in (azimuth, slope, depth * flat)))
    sweep = cast(model, seen, height_m, rng=rng)
    return sweep.replace(world_from_sensor=Rigid.from_yaw(yaw, (x, y, height_m))), beams


def drive(
    scene: Scene, model: LidarModel, poses: Sequence[tuple[float, float, float]], rng: np.random.Generator
) -> list[tuple[Sweep, Beams]]:
    """Return the views from ``poses``, one a second, by a sensor 1.8 m above the ground."""
    views = [view(scene, model, pose, 1.8, rng) for pose in poses]
    return [(sweep.replace(t_ns=second * 10**9), beams) for second, (sweep, beams) in enumerate(views)]


def _moved(scene: Scene, x_m: float, y_m: float, yaw: float) -> Scene:
    c, s = np.cos(yaw), np.sin(yaw)

    def there(solid: Box | Cylinder) -> dict[str, Any]:
        dx, dy = solid.x_m - x_m, solid.y_m - y_m
        return {"x_m": float(c * dx + s * dy), "y_m": float(c * dy - s * dx)}

    return Scene(
        boxes=tuple(replace(box, **there(box), yaw=box.yaw - yaw) for box in scene.boxes),
        cylinders=tuple(replace(cylinder, **there(cylinder)) for cylinder in scene.cylinders),
    )
