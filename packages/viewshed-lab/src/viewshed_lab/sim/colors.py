"""Colors for pictures of a world, and removal of ceilings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F32
from viewshed_lab.sim.assets.shapes import MATERIALS, material_index
from viewshed_lab.sim.world import Snapshot, World

Image = NDArray[np.uint8]

CEILING_M = 2.0
"""Indoors, pictures omit things that begin higher than this above the ground."""

_MATERIAL_COLORS = {
    "asphalt": (0.40, 0.41, 0.43), "concrete": (0.70, 0.69, 0.66), "plaster": (0.87, 0.82, 0.72),
    "brick": (0.68, 0.40, 0.31), "paint": (0.75, 0.77, 0.80), "dark_paint": (0.17, 0.18, 0.22),
    "metal": (0.58, 0.61, 0.66), "sign": (0.96, 0.80, 0.12), "clothes": (0.88, 0.28, 0.12),
    "bark": (0.42, 0.29, 0.18), "grass": (0.52, 0.66, 0.34), "wood": (0.70, 0.52, 0.31),
    "rubber": (0.10, 0.10, 0.10), "leaves": (0.30, 0.54, 0.20), "hedge": (0.22, 0.46, 0.20),
    "mesh": (0.62, 0.70, 0.70), "glass": (0.55, 0.80, 0.92), "absorber": (0.05, 0.05, 0.09),
    "cabin": (0.20, 0.24, 0.28), "window": (0.50, 0.77, 0.95), "tinted": (0.30, 0.45, 0.52),
}  # fmt: skip

_CAR_COLORS = ((0.80, 0.16, 0.16), (0.16, 0.34, 0.72), (0.92, 0.92, 0.90), (0.20, 0.50, 0.46), (0.88, 0.66, 0.16),
               (0.55, 0.57, 0.60))  # fmt: skip


def without_ceiling(world: World, snapshot: Snapshot) -> Snapshot:
    """Return the solids without a building's ceilings and the things in it that begin above ``CEILING_M``."""
    bottoms = np.array([min(part.bottom_m for part in thing.parts) for thing in world.things])
    ceilings = np.array([thing.kind == "ceiling" for thing in world.things], np.bool_)
    above = ((bottoms >= CEILING_M) | ceilings) & world.indoor
    kept = ~above[snapshot.thing]
    arrays = ("kind", "center_m", "rotation", "half_m", "velocity_mps", "material", "thing")
    return replace(snapshot, **{name: getattr(snapshot, name)[kept] for name in arrays})


def surface_colors(world: World, thing: NDArray[np.int32], material: NDArray[np.uint8]) -> F32:
    """Return colors (…, 3) in [0, 1] of hit surfaces: by material; painted vehicles have one of six colors.

    >>> from viewshed_lab.sim.terrain import Terrain
    >>> empty = World("empty", Terrain.plane(9.0))
    >>> colors = surface_colors(empty, np.array([-1], np.int32), np.array([material_index("grass")], np.uint8))
    >>> int(colors[0].argmax())  # red, green, blue
    1
    """
    colors = np.array([_MATERIAL_COLORS[one.name] for one in MATERIALS], np.float32)[material]
    vehicle = np.array([one.tilts for one in world.things] + [False])[thing]
    painted = vehicle & (material == material_index("paint"))
    colors[painted] = np.array(_CAR_COLORS, np.float32)[thing[painted] * 7 % len(_CAR_COLORS)]
    return colors


def to_bytes(colors: F32 | NDArray[np.float64]) -> Image:
    """Return colors in [0, 1] as uint8 in steps of two, which gives smaller files without a visible difference."""
    return np.asarray((colors * 127).round() * 2, np.uint8)
