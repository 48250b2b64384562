"""Simulator: random worlds, exact ray casting, LiDAR measurement, and exact visibility truth."""

from __future__ import annotations

from viewshed_lab.sim.assets.shapes import Box, Cylinder, Ellipsoid
from viewshed_lab.sim.raycast.caster import cast_world
from viewshed_lab.sim.scene import Scene, cast, depth_image, junction

__all__ = ["Box", "Cylinder", "Ellipsoid", "Scene", "cast", "cast_world", "depth_image", "junction"]
