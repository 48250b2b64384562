"""The simulator: worlds from a seed, what every beam meets in them, and what could have been seen."""

from viewshed.sim.caster import cast_world
from viewshed.sim.scene import Scene, cast, depth_image, junction
from viewshed.sim.shapes import Box, Cylinder, Ellipsoid

__all__ = ["Box", "Cylinder", "Ellipsoid", "Scene", "cast", "cast_world", "depth_image", "junction"]
