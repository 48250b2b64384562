"""Simulated views of one scene with their exact beams; measures the cross-view metric's error on an exact mask."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from viewshed.fov.estimate import FovEstimate, FovEstimator
from viewshed.fov.height_map import HeightMap
from viewshed.fov.visibility import CAR, Beams, expected_returns, probability_of_visible
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.sensors import LidarModel, lidar_model
from viewshed.sweep import Sweep
from viewshed_lab.sim.assets.shapes import Box, Cylinder
from viewshed_lab.sim.scene import Scene, cast, depth_image, junction
from viewshed_lab.studies.crossview.faults import with_known_faults
from viewshed_lab.studies.crossview.rates import CrossViewRow, evaluate_crossview


def view(
    scene: Scene, model: LidarModel, pose: tuple[float, float, float], height_m: float, rng: np.random.Generator
) -> tuple[Sweep, Beams]:
    """Return a noisy sweep of a flat ``scene`` and its exact beams (no return: depth +inf), both from ``pose``.

    Args:
        scene: the scene, with level ground.
        model: the sensor.
        pose: x and y in meters and yaw in radians, in the scene.
        height_m: sensor height above the ground.
        rng: source of the range noise.
    """
    if any(scene.slope):
        raise ValueError(f"scene must have level ground to be seen from several places, got slope {scene.slope}")
    x, y, yaw = pose
    moved = _moved(scene, x, y, yaw)
    depth = depth_image(model, moved, height_m)
    flat = np.cos(model.elevation)[:, None]
    azimuth = -np.pi + np.arange(model.azimuth_columns) * model.azimuth_step + np.zeros((model.rings, 1))
    slope = np.tan(model.elevation)[:, None] + np.zeros_like(azimuth)
    beams = Beams(*(a.ravel().astype(np.float32) for a in (azimuth, slope, depth * flat)))
    sweep = cast(model, moved, height_m, rng=rng)
    return sweep.replace(world_from_sensor=Rigid.from_yaw(yaw, (x, y, height_m))), beams


def drive(
    scene: Scene, model: LidarModel, poses: Sequence[tuple[float, float, float]], rng: np.random.Generator
) -> list[tuple[Sweep, Beams]]:
    """Return the views from ``poses``, one per second, of a sensor 1.8 m above the ground."""
    views = [view(scene, model, pose, 1.8, rng) for pose in poses]
    return [(sweep.replace(t_ns=second * 10**9), beams) for second, (sweep, beams) in enumerate(views)]


def _moved(scene: Scene, x_m: float, y_m: float, yaw: float) -> Scene:
    c, s = np.cos(yaw), np.sin(yaw)

    def place(solid: Box | Cylinder) -> dict[str, Any]:
        dx, dy = solid.x_m - x_m, solid.y_m - y_m
        return {"x_m": float(c * dx + s * dy), "y_m": float(c * dy - s * dx)}

    return Scene(
        boxes=tuple(replace(box, **place(box), yaw=box.yaw - yaw) for box in scene.boxes),
        cylinders=tuple(replace(cylinder, **place(cylinder)) for cylinder in scene.cylinders),
    )


POSES = (
    (-30.0, 3.4, 3.14), (-20.0, 3.4, 3.14), (-6.0, 0.3, 0.0), (2.0, 0.2, 0.0), (14.0, 0.3, 0.1),
    (24.0, -8.0, -1.5), (24.5, 6.0, 1.57), (30.0, 20.0, -1.57), (34.0, 0.2, 0.0), (50.0, 0.2, 0.0),
)  # fmt: skip
"""Poses of the sensor in the simulated junction: x, y in meters and yaw in radians."""


@dataclass(frozen=True, slots=True, eq=False)
class ExactMask:
    """Estimator that applies the definition of visible to each simulated sweep's noise-free beams and level ground."""

    grid: BevGrid
    beams: Mapping[int, Beams]
    height_m: float = 1.8

    def estimate(self, sweep: Sweep) -> FovEstimate:
        """Return the exact mask; the sweep's time identifies its view."""
        beams = self.beams[sweep.t_ns or 0]
        returns, _ = expected_returns(beams, self.height_m, HeightMap.flat(64.0), self.grid, CAR)
        prob = probability_of_visible(returns, CAR.min_returns)
        return FovEstimate(self.grid, prob, (prob >= 0.5).astype(np.uint8), method="exact mask")


def evaluate_floor(estimators: Mapping[str, FovEstimator], *, rng: np.random.Generator) -> list[CrossViewRow]:
    """Return rates in a simulated junction seen from ten places.

    Rows: the exact mask, the exact mask with each known fault, then ``estimators``.
    """
    views = drive(junction(), lidar_model("hdl64e"), POSES, rng)
    exact = ExactMask(BevGrid(256, 64.0), {sweep.t_ns or 0: beams for sweep, beams in views})
    tried = with_known_faults("exact mask", exact) | dict(estimators)
    return evaluate_crossview([[sweep for sweep, _ in views]], tried, rng=rng)
