"""Makers of buildings: the front lies on the x axis and faces -y, the body behind it reaches to +y."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viewshed_lab.sim.assets.shapes import Box, Cylinder, Shape
from viewshed_lab.sim.assets.street import pick
from viewshed_lab.sim.world import Thing

_SUNK_M = -4.0
_PANE_M = 0.02


@dataclass(frozen=True, slots=True)
class Front:
    """Measures of a facade."""

    length_m: float  # along the street
    depth_m: float  # of the building
    height_m: float  # to the roof
    material: str  # of the walls
    storey_m: float = 3.1  # height of one storey
    ground_m: float = 3.6  # height of the first floor above the street


def town_house(rng: np.random.Generator, length_m: float, depth_m: float, plain: bool = False) -> Thing:
    """Return a building of 2 to 6 storeys: windows, a shop front, a wall with a recessed door, or ``plain`` walls.

    Bays, balconies and steps project from the front by at most 1.2 m; all but steps are above 2.6 m.
    """
    storeys = int(rng.integers(2, 7))
    ground = rng.uniform(3.3, 4.4)
    material = pick(rng, ("plaster", "plaster", "brick", "concrete"))
    front = Front(length_m, depth_m, ground + (storeys - 1) * 3.1, material, 3.1, ground)
    if plain:
        return Thing("building", tuple(_plain(rng, front)))
    kind = rng.random()
    parts = _windows(rng, front) if kind < 0.4 else _shop(rng, front) if kind < 0.65 else _door(rng, front)
    return Thing("building", (*parts, *_jutting(rng, front)))


def glass_hall(rng: np.random.Generator, length_m: float, depth_m: float) -> Thing:
    """Return a market or showroom: an unbroken glass front of 3.5 to 6 m, walls elsewhere, a projecting roof."""
    high, room = rng.uniform(3.5, 6.0), 0.6 * depth_m
    parts: list[Shape] = [
        Box(0.0, 0.05, length_m - 0.4, _PANE_M, high, 0.1, 0.0, "glass"),
        Box(0.0, (room + depth_m) / 2, length_m, depth_m - room, high, _SUNK_M, 0.0, "concrete"),
        *(_side(side, length_m, room, high, "concrete") for side in (-1, 1)),
        Box(0.0, depth_m / 2 - 0.75, length_m + 0.4, depth_m + 1.5, high + 0.7, high, 0.0, "metal"),
        Box(0.0, 0.2, length_m, 0.4, 0.1, _SUNK_M, 0.0, "concrete"),
        Box(rng.uniform(-0.2, 0.2) * length_m, 0.5 * room, 0.5 * length_m, 0.6, 1.5, 0.0, 0.0, "wood"),
    ]
    parts += [Cylinder(x * length_m, -1.1, 0.14, high, material="metal") for x in (-0.45, 0.45)]
    return Thing("building", tuple(parts))


def glass_front(rng: np.random.Generator, length_m: float, depth_m: float) -> Thing:
    """Return an office, a shop or a showroom whose front is glass from the floor up, one to four storeys of it.

    Behind the panes are rooms of 4 to 9 m with columns, counters, shelves, partitions and at times a vehicle.
    """
    storeys, rise = int(rng.integers(1, 5)), rng.uniform(3.2, 4.6)
    room = min(rng.uniform(4.0, 9.0), depth_m - 1.5)
    material, frame = pick(rng, ("plaster", "concrete", "metal")), pick(rng, ("metal", "dark_paint"))
    top, back = storeys * rise, rng.uniform(0.0, 0.6)
    pane = pick(rng, ("glass", "window", "window", "tinted"))
    parts: list[Shape] = [
        Box(0.0, (room + depth_m) / 2, length_m, depth_m - room, top, _SUNK_M, 0.0, "plaster"),
        *(_side(side, length_m, room, top, material) for side in (-1, 1)),
        Box(0.0, depth_m / 2, length_m + 0.3, depth_m + 0.3, top + 0.5, top, 0.0, material),
        Box(0.0, room / 2, length_m - 0.6, room, 0.06, _SUNK_M, 0.0, "concrete"),
    ]
    panes = max(2, round((length_m - 0.6) / rng.uniform(1.3, 3.2)))
    edges = np.linspace(-0.5, 0.5, panes + 1) * (length_m - 0.6)
    sill = rng.uniform(0.4, 0.9) if rng.random() < 0.3 else 0.06
    for k in range(storeys):
        low, set_back = k * rise, back if k == 0 else 0.0
        head = low + rise - 0.45
        if k:
            parts.append(Box(0.0, room / 2, length_m - 0.6, room, low, low - 0.35, 0.0, "concrete"))
        parts.append(Box(0.0, set_back, length_m - 0.6, _PANE_M, head, low + (sill if k == 0 else 0.0), 0.0, pane))
        if k == 0 and sill > 0.1:
            parts.append(Box(0.0, set_back, length_m - 0.6, 0.2, sill, 0.06, 0.0, material))
        parts += [Box(float(x), set_back, 0.06, 0.12, head, low, 0.0, frame) for x in edges]
    parts += _inside(rng, length_m, room, rise)
    return Thing("building", tuple(parts))


def _inside(rng: np.random.Generator, length_m: float, room_m: float, rise_m: float) -> list[Shape]:
    """Return the furnishing of the ground floor behind a glass front, within its room and clear of the panes."""
    parts: list[Shape] = [
        Cylinder(float(x), 0.55 * room_m, 0.2, rise_m - 0.45, 0.0, "concrete")
        for x in np.arange(-length_m / 2 + 3.0, length_m / 2 - 2.0, rng.uniform(4.5, 7.0))
    ]
    for x in np.arange(-length_m / 2 + 1.5, length_m / 2 - 2.5, rng.uniform(2.0, 4.0)).tolist():
        draw, y = rng.random(), rng.uniform(0.3, 0.85) * room_m
        if draw < 0.3:
            parts.append(Box(x, y, rng.uniform(0.8, 1.8), 0.5, rng.uniform(0.7, 1.1), 0.06, 0.0, "wood"))
        elif draw < 0.5:
            parts.append(Box(x, y, 0.4, min(1.6, 0.25 * room_m), rng.uniform(1.4, 2.2), 0.06, 0.0, "paint"))
        elif draw < 0.62:
            parts.append(Box(x, 0.5 * room_m, 0.12, 0.7 * room_m, rise_m - 0.45, 0.06, 0.0, "plaster"))
        elif draw < 0.75:
            parts += [Box(x, 0.45 * room_m, 1.8, min(4.3, 0.6 * room_m), 0.85, 0.25, 0.0, "paint"),
                      Box(x, 0.45 * room_m, 1.5, min(2.2, 0.3 * room_m), 1.45, 0.85, 0.0, "cabin")]  # fmt: skip
        elif draw < 0.88:
            parts.append(Box(x, y, 0.3, 0.45, rng.uniform(1.5, 1.9), 0.06, 0.0, "clothes"))
    return parts


def family_house(rng: np.random.Generator, length_m: float, depth_m: float, plain: bool = False) -> Thing:
    """Return a house of one or two storeys with windows, a recessed door or ``plain`` walls; a stepped roof."""
    eaves, material = (
        rng.uniform(2.7, 3.2) if rng.random() < 0.4 else rng.uniform(5.2, 6.2),
        pick(rng, ("plaster", "brick")),
    )
    front = Front(length_m, depth_m, eaves, material, 2.8, 2.9)
    parts = _plain(rng, front) if plain else _windows(rng, front) if rng.random() < 0.4 else _door(rng, front)
    rise = rng.uniform(0.3, 0.55) * depth_m
    for k, share in enumerate((1.06, 0.7, 0.34)):
        low, top = eaves + k * rise / 3, eaves + (k + 1) * rise / 3
        parts.append(Box(0.0, depth_m / 2, length_m * (1.03 - 0.02 * k), depth_m * share, top, low, 0.0, "brick"))
    if rng.random() < 0.6:
        chimney = rng.uniform(-0.4, 0.4) * length_m
        parts.append(Box(chimney, depth_m / 2, 0.6, 0.6, eaves + rise + 0.7, eaves, 0.0, "brick"))
    return Thing("house", tuple(parts))


def garage(rng: np.random.Generator) -> Thing:
    """Return a garage of 3.2 by 6 m whose door is set back, sometimes open with a bare inside."""
    walls = [Box(x, 3.0, 0.2, 6.0, 2.6, -1.5, 0.0, "plaster") for x in (-1.5, 1.5)]
    roof, back = Box(0.0, 2.95, 3.4, 6.1, 2.8, 2.5, 0.0, "concrete"), Box(0.0, 5.9, 3.0, 0.2, 2.6, -1.5, 0.0, "plaster")
    door = () if rng.random() < 0.3 else (Box(0.0, 0.35, 2.8, 0.08, 2.5, -0.3, 0.0, "metal"),)
    return Thing("garage", (*walls, roof, back, *door))


def kiosk(rng: np.random.Generator) -> Thing:
    """Return a booth of about 2.5 by 3 m with a window and a projecting roof."""
    long, wide = rng.uniform(2.2, 3.0), rng.uniform(2.0, 2.6)
    parts = (
        Box(0.0, wide / 2, long, wide, 1.0, material="paint"),
        Box(0.0, 0.02, long - 0.3, _PANE_M, 2.2, 1.0, 0.0, "glass"),
        Box(0.0, 0.75 * wide, long, 0.5 * wide, 2.3, 1.0, 0.0, "paint"),
        Box(0.0, wide / 2 - 0.2, long + 0.3, wide + 0.6, 2.55, 2.3, 0.0, "metal"),
    )
    return Thing("kiosk", parts)


def _plain(rng: np.random.Generator, front: Front) -> list[Shape]:
    """Return a body with pilasters, for distant buildings."""
    count = int(rng.integers(0, 3))
    body = Box(0.0, front.depth_m / 2, front.length_m, front.depth_m, front.height_m, _SUNK_M, 0.0, front.material)
    at = rng.uniform(-0.45, 0.45, count) * front.length_m
    return [body, *(Box(float(x), -0.1, 0.6, 0.3, front.height_m - 0.5, _SUNK_M, 0.0, front.material) for x in at)]


def _windows(rng: np.random.Generator, front: Front) -> list[Shape]:
    """Return two storeys of rooms behind one sheet of glass, with piers and bands before it that leave windows free.

    The storeys above are solid.
    """
    room, thick, sill = rng.uniform(2.5, 5.0), rng.uniform(0.25, 0.4), rng.uniform(0.7, 1.1)
    top = min(front.height_m, front.ground_m + front.storey_m)
    parts = _shell(front, room, top)
    parts.append(Box(0.0, thick, front.length_m - 0.3, _PANE_M, top, 0.3, 0.0, "glass"))
    bands = [(_SUNK_M, sill)] + ([(front.ground_m - 0.7, front.ground_m + 0.8)] if top > front.ground_m else [])
    parts += [Box(0.0, thick / 2, front.length_m, thick, high, low, 0.0, front.material) for low, high in bands]
    count = max(2, round(front.length_m / rng.uniform(2.4, 3.6)))
    wide = rng.uniform(0.9, 1.5)
    for x in np.linspace(-0.5, 0.5, count + 1).tolist():
        shift = -0.5 * wide * np.sign(x) * (abs(x) == 0.5)
        parts.append(Box(float(x * front.length_m + shift), thick / 2, wide, thick, top, 0.0, 0.0, front.material))
    parts.append(Box(0.0, thick / 2 + 0.1, wide, thick, 2.3, 0.0, 0.0, "wood"))
    return parts


def _shop(rng: np.random.Generator, front: Front) -> list[Shape]:
    """Return an unbroken glass front in the ground floor, set back a little, under solid upper storeys."""
    room, back, high = rng.uniform(3.0, 6.0), rng.uniform(0.1, 0.8), front.ground_m - 0.5
    parts = _shell(front, room, high)
    parts.append(Box(0.0, back, front.length_m - 0.6, _PANE_M, high, 0.05, 0.0, "glass"))
    ends = (-0.5, 0.5) if front.length_m < 11 else (-0.5, rng.uniform(-0.2, 0.2), 0.5)
    for x in ends:
        shift = -0.35 * np.sign(x) * (abs(x) == 0.5)
        parts.append(Box(float(x * front.length_m + shift), 0.25, 0.7, 0.5, high, _SUNK_M, 0.0, front.material))
    parts.append(Box(0.0, back + 0.5, front.length_m - 0.4, 0.9, 0.05, _SUNK_M, 0.0, "concrete"))
    if rng.random() < 0.4:
        parts.append(Box(0.0, -0.5, 0.8 * front.length_m, 1.0, 2.95, 2.75, 0.0, "clothes"))
    return parts


def _door(rng: np.random.Generator, front: Front) -> list[Shape]:
    """Return a solid front with a door set back by 0.4 to 1.2 m, and a step before it."""
    deep, wide = rng.uniform(0.4, 1.2), rng.uniform(1.1, 2.4)
    at = rng.uniform(-0.3, 0.3) * front.length_m
    left, right = front.length_m / 2 + at - wide / 2, front.length_m / 2 - at - wide / 2
    high, of = front.height_m, front.material
    parts: list[Shape] = [
        Box(0.0, (front.depth_m + deep) / 2, front.length_m, front.depth_m - deep, high, _SUNK_M, 0.0, of),
        Box(-front.length_m / 2 + left / 2, deep / 2, left, deep, front.height_m, _SUNK_M, 0.0, front.material),
        Box(front.length_m / 2 - right / 2, deep / 2, right, deep, front.height_m, _SUNK_M, 0.0, front.material),
        Box(at, deep / 2, wide, deep, front.height_m, 2.5, 0.0, front.material),
        Box(at, deep - 0.05, wide - 0.2, 0.1, 2.3, 0.0, 0.0, "wood"),
    ]
    if rng.random() < 0.5:
        parts.append(Box(at, -0.2, wide, 0.5, 0.16, _SUNK_M, 0.0, "concrete"))
    return parts + _panes(rng, front)


def _panes(rng: np.random.Generator, front: Front) -> list[Shape]:
    """Return panes before the wall, lit or with blinds behind, in the first floor, and a cornice below them."""
    count = max(2, round(front.length_m / 4.5))
    wide, low = rng.uniform(0.9, 1.8), front.ground_m + 0.7
    parts: list[Shape] = [Box(0.0, -0.03, front.length_m, 0.14, low - 0.6, low - 0.85, 0.0, front.material)]
    if front.height_m > low + 2.0:
        at = ((np.arange(count) + 0.5) / count - 0.5) * front.length_m
        parts += [Box(float(x), -0.02, wide, _PANE_M, low + 1.5, low, 0.0, "glass") for x in at]
    return parts


def _shell(front: Front, room_m: float, high_m: float) -> list[Shape]:
    """Return back and side walls of rooms ``room_m`` deep up to ``high_m``, and the body above and behind them."""
    rear = front.depth_m - room_m
    parts: list[Shape] = [
        Box(0.0, room_m + rear / 2, front.length_m, rear, front.height_m, _SUNK_M, 0.0, "plaster"),
        *(_side(side, front.length_m, room_m, high_m, front.material) for side in (-1, 1)),
    ]
    if front.height_m > high_m + 0.1:
        parts.append(Box(0.0, room_m / 2, front.length_m, room_m, front.height_m, high_m, 0.0, front.material))
    return parts


def _side(side: int, length_m: float, room_m: float, high_m: float, material: str) -> Box:
    return Box(side * (length_m / 2 - 0.15), room_m / 2, 0.3, room_m, high_m, _SUNK_M, 0.0, material)


def _jutting(rng: np.random.Generator, front: Front) -> list[Shape]:
    """Return bays or balconies from the first floor up, or nothing."""
    kind, parts = rng.random(), list[Shape]()
    count = max(1, int(front.length_m / 6.0))
    at = ((np.arange(count) + 0.5) / count - 0.5) * front.length_m
    if kind < 0.2:
        top = front.height_m - rng.uniform(0.0, 3.0)
        parts = [Box(float(x), -0.4, 2.2, 0.8, max(top, 4.2), 2.9, 0.0, front.material) for x in at]
    elif kind < 0.5 and front.height_m > 5.5:
        slabs = [Box(float(x), -0.55, 2.6, 1.1, front.ground_m, front.ground_m - 0.18, 0.0, "concrete") for x in at]
        rails = [Box(float(x), -1.06, 2.6, 0.04, front.ground_m + 1.0, front.ground_m, 0.0, "mesh") for x in at]
        parts = [*slabs, *rails]
    return parts
