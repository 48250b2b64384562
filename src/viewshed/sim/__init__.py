"""Analytic scenes whose exact depths are known: for the embedded sample and as truth in tests."""

from viewshed.sim.caster import cast, depth_image
from viewshed.sim.scene import Box, Cylinder, Scene, junction

__all__ = ["Box", "Cylinder", "Scene", "cast", "depth_image", "junction"]
