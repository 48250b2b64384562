"""Report of one agent at one time: its field of view, its detections, its pose and the pose's uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from viewshed.agents.registration import EXACT, PoseStd
from viewshed.arrays import F64, Mask
from viewshed.detections import Detections
from viewshed.fov.estimate import Basis, FovEstimate
from viewshed.fov.height_map import HeightMap
from viewshed.geometry import Rigid
from viewshed.objects.views import GridView

if TYPE_CHECKING:
    from viewshed.agents.view_message import ViewMessage

FAR_M = 50.0
"""Maximum range of a report; neither reports nor silence beyond it are used."""

OWN_SIZE_M = (4.8, 2.0, 1.6)
"""Assumed length, width and height of the own vehicle of an agent with a low sensor."""

ELEVATED_M, TALL_M = 4.0, 10.0
"""Minimum sensor heights in meters: to look over cars, and to count as a tall mast, with errors of its own."""

HEIGHTS = 3
"""Number of height classes of a sensor: among the traffic, above it, on a tall mast."""

STORY_M, STORY_PER_M = 1.5, 0.05
"""A box stands on another level (a deck, or the road below) if its foot is farther than this from the agent's ground:
the first where the agent sent its ground heights, plus the second per meter of range where it did not."""


@dataclass(frozen=True, eq=False)
class AgentReport:
    """What one agent reports about one time.

    Raises:
        ValueError: the view has no pose.
    """

    estimate: FovEstimate  # its field of view, with a pose and the agent's name
    detections: Detections  # its objects, in ``level``
    # (7,) box of its own vehicle in ``level``, which others see; None for a sensor on a mast
    own_box: F64 | None = None
    pose_std: PoseStd = EXACT  # stated standard deviations of its pose
    ground: HeightMap | None = None  # heights of the ground about it, in ``level``; None assumes flat ground

    def __post_init__(self) -> None:
        if self.estimate.world_from_level is None:
            raise ValueError(f"the view of {self.estimate.agent} must have a pose: without one it cannot be placed")

    @classmethod
    def of(
        cls,
        estimate: FovEstimate,
        detections: Detections,
        pose_std: PoseStd = EXACT,
        ground: HeightMap | None = None,
    ) -> AgentReport:
        """Return the report of an agent whose vehicle is unknown: one of ``OWN_SIZE_M`` below a low sensor, else none.

        Raises:
            ValueError: the view has no pose.
        """
        report = cls(estimate, detections, None, pose_std, ground)
        own = np.array([0.0, 0.0, OWN_SIZE_M[2] / 2, *OWN_SIZE_M, 0.0])
        return report if report.elevated else replace(report, own_box=own)

    @classmethod
    def of_message(cls, message: ViewMessage) -> AgentReport:
        """Return the report in a message with a view.

        Raises:
            ValueError: the message has no view.
        """
        if message.view is None:
            raise ValueError(f"the message of {message.agent} must have a view, got none")
        view, sensor = message.view, message.sensor
        if np.isfinite(sensor.height_m):
            reach_m = sensor.reach_m if np.isfinite(sensor.reach_m) else view.grid.half_extent_m
            view = replace(view, basis=Basis(sensor.height_m, "given", 1.0, 0.0, 0.0, reach_m))
        return cls.of(
            view, message.detections or Detections.none(), PoseStd.of(message.pose_covariance), message.ground
        )

    @property
    def agent(self) -> str:
        """Its name."""
        return self.estimate.agent

    @cached_property
    def world_from_level(self) -> Rigid:
        """Its pose."""
        assert self.estimate.world_from_level is not None
        return self.estimate.world_from_level

    @property
    def height(self) -> int:
        """Height class of its sensor: 0 among the traffic, 1 above it, 2 on a tall mast."""
        basis = self.estimate.basis
        return 0 if basis is None else int(np.searchsorted((ELEVATED_M, TALL_M), basis.sensor_height_m))

    @property
    def blind_m(self) -> float:
        """Range up to which an elevated sensor sees little of the objects there: its own height; 0 for a low one."""
        basis = self.estimate.basis
        return basis.sensor_height_m if basis is not None and self.elevated else 0.0

    @property
    def elevated(self) -> bool:
        """Whether its sensor looks over cars."""
        return self.height > 0

    @cached_property
    def in_world(self) -> Detections:
        """Its detections within ``FAR_M``, in the world."""
        near = np.hypot(self.detections.boxes[:, 0], self.detections.boxes[:, 1]) <= FAR_M
        return self.detections.take(near).moved(self.world_from_level)

    def placed_at(self, pose: Rigid) -> AgentReport:
        """Return the same report at another pose."""
        return replace(self, estimate=replace(self.estimate, world_from_level=pose))

    def range_m(self, boxes: F64) -> F64:
        """Return the horizontal range (K,) in meters of boxes (K, 7) of the world."""
        offsets = boxes[:, :2] - self.world_from_level.translation[:2]
        return np.hypot(offsets[:, 0], offsets[:, 1])

    def in_level(self, xy: F64) -> F64:
        """Return points (…, 2) of the world in ``level``."""
        pose = self.world_from_level
        level: F64 = (xy - pose.translation[:2]) @ pose.rotation[:2, :2]
        return level

    def ground_m(self, level: F64) -> F64:
        """Return the height (…,) in the world of the ground at points (…, 2) of ``level``."""
        base = np.full(level.shape[:-1], self.world_from_level.translation[2])
        return base if self.ground is None else base + self.ground.at(level)

    def on_its_level(self, boxes: F64) -> Mask:
        """Return which boxes (K, 7) of the world stand on the agent's own ground, not on a deck or a road below."""
        foot_m = boxes[:, 2] - boxes[:, 5] / 2
        max_offset_m = STORY_M + (STORY_PER_M * self.range_m(boxes) if self.ground is None else 0.0)
        return np.asarray(np.abs(foot_m - self.ground_m(self.in_level(boxes[:, :2]))) <= max_offset_m)

    @cached_property
    def view(self) -> GridView:
        """Its field of view, queried in the world."""
        return GridView(self.estimate, 0.0)

    def is_own(self, boxes: F64) -> Mask:
        """Return which boxes (K, 7) of the world are its own vehicle."""
        if self._own_circle is None:
            return np.zeros(len(boxes), np.bool_)
        (x_m, y_m), radius_m = self._own_circle
        return np.asarray(np.hypot(boxes[:, 0] - x_m, boxes[:, 1] - y_m) < radius_m)

    @cached_property
    def _own_circle(self) -> tuple[F64, float] | None:
        """Center (2,) of its own vehicle in the world and half its length; None for a sensor on a mast."""
        box = self.own_box
        return None if box is None else ((self.world_from_level @ box[:3])[:2], float(box[3]) / 2)
