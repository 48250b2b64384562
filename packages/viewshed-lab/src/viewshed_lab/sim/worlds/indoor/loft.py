"""A loft: walls at any angle, columns, low ceilings and low beams, sometimes the slant of a roof."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from viewshed_lab.sim.assets import furniture
from viewshed_lab.sim.assets.furniture import Maker, place_group
from viewshed_lab.sim.assets.shapes import Box, Cylinder, Shape
from viewshed_lab.sim.world import AgentPlan, Thing, World
from viewshed_lab.sim.worlds.indoor.agents import Building, inhabited
from viewshed_lab.sim.worlds.indoor.floor_plan import FloorPlan, floor, shrunk
from viewshed_lab.sim.worlds.indoor.halls import back_wall
from viewshed_lab.sim.worlds.indoor.walls import around, build, ceiling
from viewshed_lab.sim.worlds.layout import Rect

_PIECE_M = 0.55

_PIECES: tuple[tuple[Maker, int], ...] = (
    (furniture.desk, 6), (furniture.dining, 3), (furniture.sofa, 4), (furniture.low_table, 3), (furniture.shelf, 6),
    (furniture.boxes, 6), (furniture.plant, 5), (furniture.bed, 2), (furniture.meeting, 1), (furniture.standing, 4),
    (furniture.bench, 3), (furniture.chair, 6), (furniture.talking, 2),
)  # fmt: skip


def loft(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a loft with the robots of ``plan``."""
    floor_plan, top = FloorPlan(rng), rng.uniform(2.15, 2.9)
    half_x, half_y = rng.uniform(16.5, 22.0), rng.uniform(16.5, 20.0)
    inside = (-half_x, -half_y, half_x, half_y)
    slanted, walls = rng.random() < 0.5, around(inside, 0.3, "brick")
    build(floor_plan, walls if slanted else [back_wall(rng, wall) for wall in walls], max(top, 2.2))
    _roof(floor_plan, inside, top, slanted)
    for _ in range(int(rng.integers(6, 15))):
        _slanted(floor_plan, inside, top)
    _columns(floor_plan, inside, top)
    for maker, max_count in _PIECES:
        for _ in range(int(rng.integers(max_count // 2, max_count + 1))):
            if maker in (furniture.shelf, furniture.sofa, furniture.desk, furniture.bench) and rng.random() < 0.5:
                floor_plan.against(inside, maker)
            else:
                floor_plan.inside(shrunk(inside, 0.5), maker)
    building = Building("loft", inside, top, 4, (inside,) * 3)
    return inhabited(floor_plan, floor(None, inside, "wood"), building, plan)


def _roof(floor_plan: FloorPlan, inside: Rect, top_m: float, slanted: bool) -> None:
    """Add a level ceiling with beams, or one that comes down in steps toward two walls."""
    rng = floor_plan.rng
    if not slanted:
        floor_plan.things.extend(ceiling(inside, top_m, "wood"))
    else:
        wide, low = rng.uniform(1.5, 4.0), rng.uniform(1.2, 1.7)
        steps = np.linspace(0.0, 1.0, 6)
        parts: list[Shape] = []
        for side in (-1, 1):
            for a, b in pairwise(steps.tolist()):
                y = side * (inside[3] - (a + b) / 2 * wide)
                bottom = low + (top_m - low) * (a + b) / 2
                parts.append(Box(0.0, y, inside[2] - inside[0], wide / 5, top_m + 0.25, bottom, 0.0, "wood"))
        parts.append(Box(0.0, 0.0, inside[2] - inside[0], 2 * (inside[3] - wide), top_m + 0.25, top_m, 0.0, "wood"))
        floor_plan.add((Thing("ceiling", tuple(parts), z_m=0.0),))
    deep = rng.uniform(0.12, min(0.35, top_m - 1.95))
    for x in np.arange(inside[0] + 1.5, inside[2] - 1.0, rng.uniform(2.5, 5.0)).tolist():
        beam = Box(x, 0.0, 0.16, inside[3] - inside[1] - 8.2, top_m, top_m - deep, 0.0, "wood")
        floor_plan.things.append(Thing("beam", (beam,), z_m=0.0))


def _slanted(floor_plan: FloorPlan, inside: Rect, top_m: float) -> None:
    """Add a wall at any angle, of plaster, brick, glass or half height, in short pieces, where there is room."""
    rng = floor_plan.rng
    for _ in range(6):
        x, y = rng.uniform(inside[0] + 2.5, inside[2] - 2.5), rng.uniform(inside[1] + 2.5, inside[3] - 2.5)
        long, yaw, bent = rng.uniform(2.5, 7.5), rng.uniform(-3.1, 3.1), rng.uniform(-0.12, 0.12)
        draw = rng.random()
        thick, high = (0.02, top_m - 0.05) if draw < 0.2 else (0.14, top_m if draw < 0.75 else rng.uniform(0.7, 1.5))
        material = "glass" if draw < 0.2 else ("plaster", "brick", "wood")[int(rng.integers(3))]
        count, pieces, turn = max(2, round(long / _PIECE_M)), list[Thing](), yaw
        for _ in range(count):
            part = Box(0.0, 0.0, 1.03 * long / count, thick, high, 0.0, 0.0, material)
            pieces += place_group((Thing("wall", (part,)),), float(x), float(y), float(turn))
            turn += bent
            x, y = x + long / count * np.cos(turn), y + long / count * np.sin(turn)
        free = [floor_plan.clear(furniture.footprint((one,)), 0.9) for one in pieces]
        within = all(inside[0] + 1.2 < one.x_m < inside[2] - 1.2 and inside[1] + 1.2 < one.y_m < inside[3] - 1.2
                     for one in pieces)  # fmt: skip
        if all(free) and within:
            floor_plan.add(tuple(pieces))
            return


def _columns(floor_plan: FloorPlan, inside: Rect, top_m: float) -> None:
    """Add columns on a grid that is rotated relative to the walls."""
    rng = floor_plan.rng
    pitch, turn = rng.uniform(4.0, 7.0), rng.uniform(0, np.pi / 2)
    size, rounded = rng.uniform(0.2, 0.45), rng.random() < 0.4
    c, s = np.cos(turn), np.sin(turn)
    part: Shape = (Cylinder(0.0, 0.0, size / 2, top_m, 0.0, "metal") if rounded
                   else Box(0.0, 0.0, size, size, top_m, 0.0, 0.0, "wood"))  # fmt: skip
    for u in np.arange(-28.0, 28.0, pitch).tolist():
        for v in np.arange(-28.0, 28.0, pitch).tolist():
            x, y = c * u - s * v, s * u + c * v
            if abs(x) < inside[2] - 1.0 and abs(y) < inside[3] - 1.0:
                floor_plan.put(place_group((Thing("pillar", (part,)),), float(x), float(y), float(turn)), 0.5)
