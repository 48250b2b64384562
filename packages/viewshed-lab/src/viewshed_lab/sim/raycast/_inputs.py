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
    """

    # (B,) of the unit direction, in world axes; see :func:`viewshed_lab.sim.raycast._refine.beam_number`
    x: NDArray[np.float32]
    y: NDArray[np.float32]  # (B,) as ``x``
    z: NDArray[np.float32]  # (B,) as ``x``
    rise: NDArray[np.float32]  # (B,) start of the beam on the sensor's axis, meters
    time: NDArray[np.float32]  # (B,) seconds from the middle of the revolution


class Solids(NamedTuple):
    """S boxes, cylinders and ellipsoids, at the middle of the revolution."""

    # (S, 6, 3) center from the sensor, three rows of the rotation ``world_from_shape``, half sizes, velocity
    boxes: NDArray[np.float64]
    kinds: NDArray[np.uint8]  # (S,) ``BOX``, ``CYLINDER`` or ``ELLIPSOID``
    per_m: NDArray[np.float32]  # (S,) stops per meter of path; infinite for opaque solids
    salts: NDArray[np.uint32]  # (S,) uint32 that make the draws of two volumes differ
    things: NDArray[np.int32]  # (S,) int32 index of the thing that it belongs to
    materials: NDArray[np.uint8]  # (S,) uint8 rows of ``MATERIALS``


class Ground(NamedTuple):
    """A lattice of quads of two triangles each, seen from the sensor, in world axes."""

    x: NDArray[np.float64]  # (nx,) of the nodes
    y: NDArray[np.float64]  # (ny,) of the nodes
    z: NDArray[np.float64]  # (nx, ny) of the nodes
    material: NDArray[np.uint8]  # (nx - 1, ny - 1) uint8 of the quads


class View(NamedTuple):
    """The sensor: where it looks and how it moves."""

    rotation: NDArray[np.float64]  # (3, 3) ``world_from_sensor`` at the middle of the revolution
    step: float  # azimuth from column to column, radians
    low_offset: float  # least azimuth of a beam from that of its column, the turn within the revolution included
    high_offset: float  # largest one
    slopes: NDArray[np.float64]  # (R,) ascending tangents of the elevations
    columns: int  # C
    max_range_m: float  # farthest stop
    half_period_s: float  # half the duration of the revolution
    lift_m: float  # largest distance of a beam's start from the sensor's position
    slack: float  # how much slopes change by the turn of a tilted sensor
    velocity: NDArray[np.float64]  # (3,) of the sensor


class Nearest(NamedTuple):
    """The nearest stop of each beam so far."""

    depth: NDArray[np.float32]  # (B,) float32 meters, +inf for none
    winner: NDArray[np.int32]  # (B,) int32 solid, S + triangle of the ground, or -1
