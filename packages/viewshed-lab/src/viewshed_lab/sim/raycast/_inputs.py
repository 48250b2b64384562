"""What the loops of the ray caster are given, as named tuples of arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

BLOCK = 16
"""Rings are padded to a multiple of this."""

DRAWS = 4096
"""Free paths in the table of volumes; a power of two."""


class Beams(NamedTuple):
    """B = blocks · C · BLOCK beams, in blocks of 16 rings, a block column after column, float32.

    So the beams that may meet a solid are runs without gaps, and a test without branches fills vector registers.

    Attributes:
        x: (B,) of the unit direction, in world axes; see :func:`viewshed_lab.sim.raycast._refine.beam_number`.
        y: (B,) as ``x``.
        z: (B,) as ``x``.
        rise: (B,) start of the beam on the sensor's axis, meters.
        time: (B,) seconds from the middle of the revolution.
    """

    x: NDArray[np.float32]
    y: NDArray[np.float32]
    z: NDArray[np.float32]
    rise: NDArray[np.float32]
    time: NDArray[np.float32]


class Solids(NamedTuple):
    """S boxes, cylinders and ellipsoids, at the middle of the revolution.

    Attributes:
        boxes: (S, 6, 3) center from the sensor, three rows of the rotation ``world_from_shape``, half sizes, velocity.
        kinds: (S,) ``BOX``, ``CYLINDER`` or ``ELLIPSOID``.
        per_m: (S,) stops per meter of path; infinite for opaque solids.
        salts: (S,) uint32 that make the draws of two volumes differ.
        things: (S,) int32 index of the thing that it belongs to.
        materials: (S,) uint8 rows of ``MATERIALS``.
    """

    boxes: NDArray[np.float64]
    kinds: NDArray[np.uint8]
    per_m: NDArray[np.float32]
    salts: NDArray[np.uint32]
    things: NDArray[np.int32]
    materials: NDArray[np.uint8]


class Ground(NamedTuple):
    """A lattice of quads of two triangles each, seen from the sensor, in world axes.

    Attributes:
        x: (nx,) of the nodes.
        y: (ny,) of the nodes.
        z: (nx, ny) of the nodes.
        material: (nx - 1, ny - 1) uint8 of the quads.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    material: NDArray[np.uint8]


class View(NamedTuple):
    """The sensor: where it looks and how it moves.

    Attributes:
        rotation: (3, 3) ``world_from_sensor`` at the middle of the revolution.
        step: azimuth from column to column, radians.
        low_offset: least azimuth of a beam from that of its column, the turn within the revolution included.
        high_offset: largest one.
        slopes: (R,) ascending tangents of the elevations.
        columns: C.
        max_range_m: farthest stop.
        half_period_s: half the duration of the revolution.
        lift_m: largest distance of a beam's start from the sensor's position.
        slack: how much slopes change by the turn of a tilted sensor.
        velocity: (3,) of the sensor.
    """

    rotation: NDArray[np.float64]
    step: float
    low_offset: float
    high_offset: float
    slopes: NDArray[np.float64]
    columns: int
    max_range_m: float
    half_period_s: float
    lift_m: float
    slack: float
    velocity: NDArray[np.float64]


class Nearest(NamedTuple):
    """The nearest stop of each beam so far.

    Attributes:
        depth: (B,) float32 meters, +inf for none.
        winner: (B,) int32 solid, S + triangle of the ground, or -1.
    """

    depth: NDArray[np.float32]
    winner: NDArray[np.int32]
