"""Fittings and people: doors, what hangs on walls, pillars, and those who stand, sit or walk in a building."""

from __future__ import annotations

import numpy as np

from viewshed.sim.furniture import Group, chair
from viewshed.sim.shapes import Box, Cylinder, Ellipsoid
from viewshed.sim.things import group, person
from viewshed.sim.world import Thing

DOOR_TOP_M = 2.05
"""Height of a door's opening; above it is the lintel."""


def door(width_m: float, angle: float, material: str = "wood") -> Group:
    """Return a door leaf hinged at the origin: closed along x, turned open by ``angle`` radians counter-clockwise."""
    leaf = Box(width_m / 2, 0.0, width_m, 0.04, DOOR_TOP_M - 0.02, 0.01, 0.0, material)
    return (Thing("door", (leaf,), yaw=angle),)


def whiteboard(rng: np.random.Generator) -> Group:
    """Return a board on a wall."""
    return (Thing("board", (Box(0.0, 0.0, 0.03, rng.uniform(1.0, 2.2), 1.95, 0.95, 0.0, "paint"),)),)


def mirror(rng: np.random.Generator) -> Group:
    """Return a mirror or a dark screen on a wall: it gives no return."""
    bottom = 0.15 if rng.random() < 0.5 else 0.9
    return (Thing("mirror", (Box(0.0, 0.0, 0.04, rng.uniform(0.6, 1.4), 1.8, bottom, 0.0, "absorber"),)),)


def radiator(rng: np.random.Generator) -> Group:
    """Return a radiator, as it hangs below a window."""
    return (Thing("radiator", (Box(0.0, 0.0, 0.1, rng.uniform(0.8, 1.6), 0.7, 0.12, 0.0, "metal"),)),)


def extinguisher(rng: np.random.Generator) -> Group:
    """Return a fire extinguisher on its hook with the sign above it."""
    bottle = Cylinder(0.02, 0.0, 0.08, 1.0, 0.45, "paint")
    return (Thing("extinguisher", (bottle, Box(-0.07, 0.0, 0.02, 0.2, 1.9, 1.7, 0.0, "sign"))),)


def locker(rng: np.random.Generator) -> Group:
    """Return a row of lockers, or one machine that sells drinks."""
    if rng.random() < 0.4:
        front = Box(0.36, 0.05, 0.02, 0.6, 1.65, 0.6, 0.0, "absorber")
        return (Thing("machine", (Box(0.0, 0.0, 0.7, 0.9, 1.83, 0.04, 0.0, "paint"), front)),)
    return (Thing("locker", (Box(0.0, 0.0, 0.5, rng.uniform(1.2, 3.0), 1.8, 0.1, 0.0, "metal"),)),)


def bench(rng: np.random.Generator) -> Group:
    """Return a bench without a back."""
    width = rng.uniform(1.2, 1.8)
    feet = tuple(Box(0.0, s * (width / 2 - 0.2), 0.3, 0.06, 0.42, 0.0, 0.0, "metal") for s in (-1, 1))
    return (Thing("bench", (Box(0.0, 0.0, 0.42, width, 0.46, 0.42, 0.0, "wood"), *feet)),)


def pillar(rng: np.random.Generator, top_m: float, side_m: float) -> Group:
    """Return a pillar up to ``top_m``: round or square, ``side_m`` across."""
    if rng.random() < 0.5:
        return (Thing("pillar", (Cylinder(0.0, 0.0, side_m / 2, top_m),)),)
    return (Thing("pillar", (Box(0.0, 0.0, side_m, side_m, top_m, -1.0, 0.0, "concrete"),)),)


def standing(rng: np.random.Generator) -> Group:
    """Return somebody who stands."""
    return (person(rng),)


def sitting(rng: np.random.Generator) -> Group:
    """Return somebody on a chair."""
    tall = rng.uniform(0.8, 0.92)
    shins = tuple(Cylinder(0.3, side * 0.12, 0.06, 0.47, 0.0, "clothes") for side in (-1, 1))
    thighs = Box(0.12, 0.0, 0.44, 0.36, 0.61, 0.47, 0.0, "clothes")
    trunk = Box(-0.06, 0.0, 0.22, 0.44, 0.46 + tall - 0.27, 0.61, 0.0, "clothes")
    head = Ellipsoid(-0.03, 0.0, 0.2, 0.16, 0.46 + tall, 0.46 + tall - 0.26, 0.0, "clothes")
    return (*chair(rng), Thing("pedestrian", (*shins, thighs, trunk, head)))


def talking(rng: np.random.Generator) -> Group:
    """Return two to four people in a ring, facing each other."""
    return tuple(group(rng, 0.0, 0.0))
