"""Convex solids that things consist of, in the frame of their thing (z from the local ground, meters).

Materials of surfaces: reflectivity, and whether beams pass through.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed_lab._config import one_of


@dataclass(frozen=True, slots=True)
class Material:
    """A surface or a volume."""

    name: str
    # share of the light that returns at normal incidence, 0 for absorbers and mirrors, above 1 for retroreflectors
    reflectivity: float
    # hits per meter of path: infinite for opaque things; finite for volumes that a beam may pass (leaves, wire mesh,
    # panes), where the free path is exponential (Beer's law)
    per_m: float = float("inf")
    gloss: float = 0.0  # specular reflectivity, at normal incidence and within :data:`GLINT` of it

    def __post_init__(self) -> None:
        if not 0 <= self.reflectivity <= 10 or not self.per_m > 0 or not 0 <= self.gloss <= 10:
            raise ValueError(f"{self.name}: reflectivity and gloss must lie in [0, 10] and per_m be positive")


MATERIALS: tuple[Material, ...] = (
    Material("asphalt", 0.12),
    Material("concrete", 0.35),
    Material("plaster", 0.55),
    Material("brick", 0.30),
    Material("paint", 0.45),
    Material("dark_paint", 0.06),
    Material("metal", 0.40),
    Material("sign", 3.0),
    Material("clothes", 0.30),
    Material("bark", 0.25),
    Material("grass", 0.25),
    Material("wood", 0.40),
    Material("rubber", 0.04),
    Material("leaves", 0.35, per_m=0.9),
    Material("hedge", 0.35, per_m=3.0),
    Material("mesh", 0.30, per_m=6.0),
    Material("glass", 0.0, per_m=18.0),
    Material("absorber", 0.0),
    Material("cabin", 0.2, per_m=2.0),
    Material("window", 0.012, per_m=18.0, gloss=0.8),
    Material("tinted", 0.02, per_m=60.0, gloss=1.2),
)
"""A beam that ends in glass is reflected away and gives no return; panes are about 2 cm thick, so two in three beams
pass. A cabin is the inside of a car behind its windows: beams end some way in, or leave at the other side. Windows and
tinted panes are glass with some dust, which returns a little at short range, and with a specular return where they face
the sensor; three in ten beams pass a tinted pane."""

_INDEX = {material.name: index for index, material in enumerate(MATERIALS)}

REFLECTIVITY: NDArray[np.float32] = np.array([material.reflectivity for material in MATERIALS], np.float32)

GLOSS: NDArray[np.float32] = np.array([material.gloss for material in MATERIALS], np.float32)

GLINT = 0.05
"""Angle of incidence, radians, at which the specular return has fallen to 1 / e."""

PER_M: NDArray[np.float32] = np.array([material.per_m for material in MATERIALS], np.float32)


def material_index(name: str) -> int:
    """Return the row of ``name`` in :data:`MATERIALS`.

    Raises:
        ValueError: there is no such material.

    >>> MATERIALS[material_index("glass")].reflectivity
    0.0
    """
    one_of("material", name, _INDEX)
    return _INDEX[name]


@dataclass(frozen=True, slots=True)
class Box:
    """An upright box."""

    x_m: float  # center, forward
    y_m: float  # center, left
    length_m: float  # side along ``yaw``
    width_m: float  # side across ``yaw``
    top_m: float  # top above the ground
    bottom_m: float = -1.0  # bottom above the ground; negative is sunk into it
    yaw: float = 0.0  # radians from x, counter-clockwise from above
    material: str = "paint"  # a name of ``MATERIALS``

    def __post_init__(self) -> None:
        _check(self.length_m, self.width_m, self.top_m - self.bottom_m)
        material_index(self.material)

    @property
    def half_sizes_m(self) -> tuple[float, float, float]:
        """Half the sides along the shape's own axes."""
        return self.length_m / 2, self.width_m / 2, (self.top_m - self.bottom_m) / 2


@dataclass(frozen=True, slots=True)
class Cylinder:
    """An upright cylinder; attributes as in :class:`Box`."""

    x_m: float
    y_m: float
    radius_m: float
    top_m: float
    bottom_m: float = -1.0
    material: str = "concrete"

    def __post_init__(self) -> None:
        _check(self.radius_m, self.top_m - self.bottom_m)
        material_index(self.material)

    @property
    def yaw(self) -> float:
        """Always 0: a cylinder has no heading."""
        return 0.0

    @property
    def half_sizes_m(self) -> tuple[float, float, float]:
        """Radius, radius, half the height."""
        return self.radius_m, self.radius_m, (self.top_m - self.bottom_m) / 2


@dataclass(frozen=True, slots=True)
class Ellipsoid:
    """An upright ellipsoid that fills the box of the same measures; attributes as in :class:`Box`."""

    x_m: float
    y_m: float
    length_m: float
    width_m: float
    top_m: float
    bottom_m: float
    yaw: float = 0.0
    material: str = "leaves"

    def __post_init__(self) -> None:
        _check(self.length_m, self.width_m, self.top_m - self.bottom_m)
        material_index(self.material)

    @property
    def half_sizes_m(self) -> tuple[float, float, float]:
        """Semi-axes."""
        return self.length_m / 2, self.width_m / 2, (self.top_m - self.bottom_m) / 2


Shape = Box | Cylinder | Ellipsoid

BOX, CYLINDER, ELLIPSOID = 0, 1, 2

KINDS: dict[type, int] = {Box: BOX, Cylinder: CYLINDER, Ellipsoid: ELLIPSOID}
"""The number of each kind in a snapshot."""


def ends_of(part: Shape, x_m: float = 0.0, y_m: float = 0.0, yaw: float = 0.0) -> tuple[float, float, float, float]:
    """Return (x min, y min, x max, y max) in meters of a solid whose thing is at (x, y), rotated by ``yaw``."""
    c, s = math.cos(yaw), math.sin(yaw)
    x, y = x_m + c * part.x_m - s * part.y_m, y_m + s * part.x_m + c * part.y_m
    a, b, _ = part.half_sizes_m
    c, s = abs(math.cos(yaw + part.yaw)), abs(math.sin(yaw + part.yaw))
    box = isinstance(part, Box)
    wide, deep = (c * a + s * b, s * a + c * b) if box else (math.hypot(c * a, s * b), math.hypot(s * a, c * b))
    return x - wide, y - deep, x + wide, y + deep


def _check(*sizes_m: float) -> None:
    if not all(0 < size < math.inf for size in sizes_m):
        raise ValueError(f"sizes must be positive and finite, got {sizes_m}")
