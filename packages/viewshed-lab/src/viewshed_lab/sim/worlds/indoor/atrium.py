"""An atrium: galleries at several levels around it, stairs, glass, and often a well in its floor with a level below."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viewshed_lab.sim.assets import furniture
from viewshed_lab.sim.assets import warehouse as stock
from viewshed_lab.sim.assets.furniture import Group, Maker, place_group
from viewshed_lab.sim.assets.shapes import Box, Cylinder, Shape, material_index
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import AgentPlan, Thing, World
from viewshed_lab.sim.worlds.indoor.agents import Building, inhabited
from viewshed_lab.sim.worlds.indoor.floor_plan import FloorPlan, shrunk
from viewshed_lab.sim.worlds.indoor.hall import back_wall, gallery, glass_wall, scattered, stairs_up
from viewshed_lab.sim.worlds.indoor.walls import around, build, ceiling
from viewshed_lab.sim.worlds.layout import Rect, within

_HALF_M, _FACE_M = 60.0, 0.02

_BELOW: tuple[Maker, ...] = (
    stock.bistro, stock.planter, stock.totem, furniture.talking, furniture.standing, furniture.plant, stock.stall,
)  # fmt: skip


def atrium(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return an atrium of two to four storeys with the robots of ``plan`` on its ground floor."""
    floor_plan, rise, storeys = FloorPlan(rng), rng.uniform(3.0, 4.2), int(rng.integers(2, 5))
    half_x, half_y = rng.uniform(17.0, 24.0), rng.uniform(17.0, 21.0)
    inside, top = (-half_x, -half_y, half_x, half_y), storeys * rise + rng.uniform(-0.4, 0.6)
    glazed = {k for k in range(4) if rng.random() < 0.45}
    build(floor_plan, [glass_wall(rng, wall, top) if k in glazed else back_wall(rng, wall)
                 for k, wall in enumerate(around(inside, 0.35, "concrete"))], top)  # fmt: skip
    floor_plan.things.extend(ceiling(inside, top, "metal"))
    well = _well(rng, inside) if rng.random() < 0.65 else None
    if well is not None:
        floor_plan.steps += _edges(well)
        floor_plan.reserve(tuple(np.add(well, (-0.5, -0.5, 0.5, 0.5)).tolist()))
        floor_plan.things += _balustrade(rng, well)
    deep = rng.uniform(2.5, 4.5, 4)
    sides = [side for side in range(4) if rng.random() < 0.75]
    for storey in range(1, storeys):
        for side in sides:
            level, foot = storey * rise - 0.3, -1.0 if storey == 1 else (storey - 1) * rise
            floor_plan.add(gallery(inside, side, float(deep[side]), level, foot))
            if storey == 1 and rng.random() < 0.6:
                stairs_up(floor_plan, inside, side, float(deep[side]), level)
    scattered(floor_plan, inside, tuple(side for side in range(4) if side not in glazed) or (0,))
    _bridges(floor_plan, inside, rise, storeys)
    depth = rng.uniform(3.0, 4.5)
    if well is not None:
        floor_plan.things += _down_there(rng, well)
    building = Building("atrium", inside, top, 5, (inside,) * 3)
    return inhabited(floor_plan, _floor(inside, well, depth), building, plan)


def _well(rng: np.random.Generator, inside: Rect) -> Rect:
    """Return an opening in the floor, somewhere near the middle."""
    wide, long = rng.uniform(5.0, 13.0), rng.uniform(5.0, 13.0)
    x = rng.uniform(inside[0] + 6.5, inside[2] - 6.5 - wide)
    y = rng.uniform(inside[1] + 6.5, inside[3] - 6.5 - long)
    return x, y, x + wide, y + long


def _edges(rect: Rect) -> list[Rect]:
    x0, y0, x1, y1 = rect
    return [(x0, y0, x0, y1), (x0, y0, x1, y0), (x1, y0, x1, y1), (x0, y1, x1, y1)]


def _balustrade(rng: np.random.Generator, well: Rect) -> list[Thing]:
    """Return a balustrade around the well: panes, or bars, or a low wall."""
    kind, things = int(rng.integers(3)), []
    for x0, y0, x1, y1 in _edges(tuple(np.add(well, (-0.15, -0.15, 0.15, 0.15)).tolist())):
        x, y, long, wide = (x0 + x1) / 2, (y0 + y1) / 2, x1 - x0 + 0.02, y1 - y0 + 0.02
        parts: list[Shape] = [Box(x, y, max(long, 0.05), max(wide, 0.05), 1.1, 1.05, 0.0, "metal")]
        if kind == 0:
            parts.append(Box(x, y, long, wide, 1.05, 0.05, 0.0, "glass"))
        elif kind == 1:
            ends = np.linspace(-0.5, 0.5, max(2, round(max(long, wide) / 0.45)))
            parts += [Cylinder(x + float(u) * long, y + float(u) * wide, 0.015, 1.05, 0.0, "metal") for u in ends]
        else:
            parts.append(Box(x, y, max(long, 0.15), max(wide, 0.15), 1.0, 0.0, 0.0, "plaster"))
        things.append(Thing("balustrade", tuple(parts), z_m=0.0))
    return things


def _down_there(rng: np.random.Generator, well: Rect) -> Group:
    """Return what stands on the lower level: it is seen from above only."""
    things: list[Thing] = []
    middle = ((well[0] + well[2]) / 2, (well[1] + well[3]) / 2)
    for k in range(int(rng.integers(1, 5))):
        maker = _BELOW[int(rng.integers(len(_BELOW)))]
        angle, away = rng.uniform(0, 2 * np.pi), min(well[2] - well[0], well[3] - well[1]) / 4
        x, y = middle[0] + away * np.cos(angle + k * np.pi / 2), middle[1] + away * np.sin(angle + k * np.pi / 2)
        things += place_group(maker(rng), float(x), float(y), rng.uniform(-3, 3))[:1]
    return tuple(things)


def _bridges(floor_plan: FloorPlan, inside: Rect, rise_m: float, storeys: int) -> None:
    """Add footbridges overhead from side to side, with balustrades of glass, at any storey."""
    rng = floor_plan.rng
    for storey in range(1, storeys):
        if rng.random() < 0.35:
            y, z = rng.uniform(inside[1] + 5.0, inside[3] - 5.0), storey * rise_m
            long = inside[2] - inside[0] - 5.0
            rails = [Box(0.0, y + w * 1.2, long, 0.02, z + 1.05, z, 0.0, "glass") for w in (-1, 1)]
            slab = Box(0.0, y, long, 2.4, z, z - 0.3, 0.0, "concrete")
            floor_plan.things.append(Thing("gallery", (slab, *rails), z_m=0.0))


def _floor(inside: Rect, well: Rect | None, depth_m: float) -> Terrain:
    """Return the ground floor with the well in it, ``depth_m`` deep with upright faces."""
    hole = shrunk(well, 0.0) if well is not None else (0.0, 0.0, 0.0, 0.0)
    xs, ys = ([-_HALF_M, *inside[k::2], _HALF_M] for k in (0, 1))
    if well is not None:
        xs += [edge + step for edge in hole[::2] for step in (-_FACE_M / 2, _FACE_M / 2)]
        ys += [edge + step for edge in hole[1::2] for step in (-_FACE_M / 2, _FACE_M / 2)]

    def height(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(within(hole, x, y), -depth_m, 0.0)

    def material(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.uint8]:
        return np.where(within(inside, x, y), material_index("concrete"), material_index("asphalt")).astype(np.uint8)

    return Terrain.of(xs, ys, height, material)
