"""Furnishing of rooms: furniture by use of the room, and its placement."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from viewshed_lab.sim.assets import furniture
from viewshed_lab.sim.assets.furniture import Maker
from viewshed_lab.sim.worlds.indoor.floor_plan import FloorPlan
from viewshed_lab.sim.worlds.layout import Rect

Wish = tuple[str, Maker, float]
"""Placement (``wall``, ``corner``, ``middle`` or ``anywhere``), maker, and mean number (fractions are chances)."""

FURNISHING: dict[str, tuple[Wish, ...]] = {
    "office": (
        ("wall", furniture.desk, 2.5), ("wall", furniture.cabinet, 1.3), ("wall", furniture.shelf, 0.6),
        ("corner", furniture.plant, 0.6), ("wall", furniture.bin_, 0.7), ("wall", furniture.whiteboard, 0.5),
        ("anywhere", furniture.boxes, 0.4), ("anywhere", furniture.standing, 0.4),
    ),
    "meeting": (
        ("middle", furniture.meeting, 1.0), ("wall", furniture.mirror, 0.8), ("wall", furniture.whiteboard, 0.8),
        ("corner", furniture.plant, 0.8), ("wall", furniture.cabinet, 0.6), ("anywhere", furniture.standing, 0.3),
    ),
    "lounge": (
        ("wall", furniture.sofa, 1.6), ("middle", furniture.low_table, 1.0), ("wall", furniture.locker, 0.7),
        ("anywhere", furniture.dining, 1.2), ("corner", furniture.plant, 1.5), ("anywhere", furniture.talking, 0.5),
    ),
    "living": (
        ("wall", furniture.sofa, 1.7), ("middle", furniture.low_table, 1.0), ("wall", furniture.shelf, 0.9),
        ("wall", furniture.mirror, 0.6), ("wall", furniture.cabinet, 1.0), ("corner", furniture.plant, 1.0),
        ("anywhere", furniture.dining, 0.6), ("anywhere", furniture.sitting, 0.4),
    ),
    "bedroom": (
        ("wall", furniture.bed, 1.2), ("wall", furniture.cabinet, 1.6), ("wall", furniture.mirror, 0.4),
        ("wall", furniture.desk, 0.4), ("wall", furniture.chair, 0.5), ("corner", furniture.plant, 0.4),
        ("anywhere", furniture.boxes, 0.3),
    ),
    "kitchen": (
        ("wall", furniture.counter, 1.5), ("anywhere", furniture.dining, 1.0), ("wall", furniture.cabinet, 0.6),
        ("corner", furniture.bin_, 0.8), ("anywhere", furniture.standing, 0.4),
    ),
    "study": (
        ("wall", furniture.desk, 1.2), ("wall", furniture.shelf, 2.0), ("wall", furniture.sofa, 0.5),
        ("anywhere", furniture.boxes, 0.8), ("corner", furniture.plant, 0.6), ("anywhere", furniture.sitting, 0.3),
    ),
    "bathroom": (
        ("wall", furniture.bath, 0.7), ("wall", furniture.basin, 1.2), ("wall", furniture.toilet, 1.0),
        ("wall", furniture.cabinet, 0.4), ("corner", furniture.bin_, 0.5),
    ),
    "store": (
        ("wall", furniture.shelf, 2.2), ("wall", furniture.boxes, 2.5), ("anywhere", furniture.boxes, 0.8),
    ),
    "hallway": (
        ("wall", furniture.cabinet, 1.2), ("wall", furniture.extinguisher, 1.5), ("wall", furniture.bin_, 1.0),
        ("wall", furniture.chair, 1.5), ("wall", furniture.mirror, 0.6), ("corner", furniture.plant, 0.8),
    ),
    "bare": (
        ("wall", furniture.cabinet, 1.2), ("wall", furniture.sofa, 0.3), ("anywhere", furniture.boxes, 0.4),
    ),
    "corridor": (
        ("wall", furniture.extinguisher, 0.6), ("wall", furniture.bin_, 0.35), ("wall", furniture.bench, 0.3),
        ("wall", furniture.whiteboard, 0.5), ("wall", furniture.radiator, 0.3), ("wall", furniture.cabinet, 0.15),
    ),
    "niche": (
        ("wall", furniture.locker, 0.45), ("wall", furniture.bench, 0.35), ("wall", furniture.plant, 0.5),
        ("wall", furniture.extinguisher, 0.6),
    ),
}  # fmt: skip
"""Rooms by use."""


_BARE_PARTS = 75


def furnish(floor_plan: FloorPlan, room: Rect, use: str, sides: tuple[int, ...] = (0, 1, 2, 3)) -> None:
    """Furnish a room whose walls have the inner faces ``room``; what does not fit is left out.

    Args:
        floor_plan: the building.
        room: meters.
        use: a name of ``FURNISHING``.
        sides: which of its sides have walls: 0 lowest x, 1 lowest y, 2 highest x, 3 highest y.
    """
    for spot, maker, mean in FURNISHING[use]:
        for _ in range(int(mean) + (floor_plan.rng.random() < mean % 1)):
            if spot in ("wall", "corner"):
                floor_plan.against(room, maker, sides, corner=spot == "corner")
            else:
                floor_plan.inside(_part(room, spot), maker, tuple(np.arange(4) * np.pi / 2) if spot == "middle" else ())


def furnish_all(
    floor_plan: FloorPlan, rooms: Sequence[tuple[Rect, str]], hub_m: tuple[float, float], parts: int
) -> tuple[Rect, ...]:
    """Furnish rooms from the nearest to a hub on; once the building has ``parts`` parts, the others are bare or empty.

    Returns:
        The rooms that are fully furnished.
    """

    def far(k: int) -> float:
        x0, y0, x1, y1 = rooms[k][0]
        dx, dy = max(x0 - hub_m[0], 0.0, hub_m[0] - x1), max(y0 - hub_m[1], 0.0, hub_m[1] - y1)
        return float(np.hypot(dx, dy)) + 0.1 * float(np.hypot((x0 + x1) / 2 - hub_m[0], (y0 + y1) / 2 - hub_m[1]))

    lived: list[Rect] = []
    for k in sorted(range(len(rooms)), key=far):
        room, use = rooms[k]
        over = floor_plan.parts - parts
        if over < 0:
            lived.append(room)
        if over < _BARE_PARTS:
            furnish(floor_plan, room, use if over < 0 else "bare")
    return tuple(lived)


def _part(room: Rect, spot: str) -> Rect:
    """Return the room, or only its middle."""
    if spot == "anywhere":
        return room
    x0, y0, x1, y1 = room
    dx, dy = 0.16 * (x1 - x0), 0.16 * (y1 - y0)
    return x0 + dx, y0 + dy, x1 - dx, y1 - dy
