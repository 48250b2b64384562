"""The convex solids that things are made of, in the frame of their thing (z from the local ground, metres)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viewshed.sim.materials import material_index


@dataclass(frozen=True, slots=True)
class Box:
    """An upright box.

    Attributes:
        x_m: centre, forward.
        y_m: centre, left.
        length_m: side along ``yaw``.
        width_m: side across ``yaw``.
        top_m: top above the ground.
        bottom_m: bottom above the ground; negative is sunk into it.
        yaw: radians from x, counter-clockwise from above.
        material: a name of ``MATERIALS``.
    """

    x_m: float
    y_m: float
    length_m: float
    width_m: float
    top_m: float
    bottom_m: float = -1.0
    yaw: float = 0.0
    material: str = "paint"

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
        """No matter for a cylinder: 0."""
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


def _check(*sizes_m: float) -> None:
    if not all(np.isfinite(size) and size > 0 for size in sizes_m):
        raise ValueError(f"sizes must be positive and finite, got {sizes_m}")
