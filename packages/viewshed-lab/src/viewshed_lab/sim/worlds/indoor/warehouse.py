"""A warehouse: racks with goods on pallets, floor storage, staging in front of the gates, forklifts, people."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from viewshed_lab.sim.assets import furniture
from viewshed_lab.sim.assets import warehouse as stock
from viewshed_lab.sim.assets.furniture import Maker, place_group
from viewshed_lab.sim.assets.shapes import Box
from viewshed_lab.sim.world import AgentPlan, Thing, World
from viewshed_lab.sim.worlds.indoor.agents import Building, inhabited
from viewshed_lab.sim.worlds.indoor.floor_plan import FloorPlan, Rise, floor, lay, shrunk
from viewshed_lab.sim.worlds.indoor.walls import Opening, Wall, around, build, ceiling
from viewshed_lab.sim.worlds.layout import Rect

_QUARTERS = (0.0, np.pi / 2, np.pi, -np.pi / 2)
_STAGING_M, _CROSS_M, _MAX_PARTS = 10.0, 3.2, 560

_STAGED: tuple[tuple[Maker, int], ...] = (
    (stock.forklift, 2), (stock.conveyor, 1), (stock.pallet, 8), (stock.cage, 4), (stock.cart, 3),
    (furniture.table, 2), (furniture.boxes, 5), (furniture.standing, 4),
)  # fmt: skip


def warehouse(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a warehouse with racks along y and gates at one end."""
    floor_plan, top = FloorPlan(rng), rng.uniform(6.5, 10.0)
    half_x, half_y = rng.uniform(19.0, 23.0), rng.uniform(18.0, 21.0)
    inside = (-half_x, -half_y, half_x, half_y)
    gates = 3 if rng.random() < 0.5 else 1
    walls = around(inside, 0.25, "metal" if rng.random() < 0.5 else "concrete")
    walls[gates] = _with_gates(rng, walls[gates])
    walls[gates - 1] = replace(walls[gates - 1], openings=(Opening(rng.uniform(-6, 6), 1.1, "ajar"),))
    build(floor_plan, walls, top)
    trucks = [one for one in walls[gates].openings if one.kind == "gate"]
    floor_plan.things.extend(truck for one in trucks for truck in _truck(rng, one, walls[gates], gates))
    floor_plan.things.extend(ceiling(inside, top, "metal"))
    edge = half_y - _STAGING_M if gates == 3 else _STAGING_M - half_y
    low, high = (-half_x, -half_y, half_x, edge), (-half_x, edge, half_x, half_y)
    staging, store = (high, low) if gates == 3 else (low, high)  # the floor before the gates, and the rest
    edge = _racks(floor_plan, store, top)
    _floor_storage(floor_plan, (edge, store[1] + 1.5, store[2] - 1.0, store[3] - 1.0))
    rise = _dock(floor_plan, staging, gates) if rng.random() < 0.5 else None
    for maker, limit in _STAGED:
        for _ in range(int(rng.integers(limit // 2, limit + 1))):
            floor_plan.inside(shrunk(staging, 1.0), maker, _QUARTERS if maker is not furniture.standing else ())
    _along_walls(floor_plan, inside, gates)
    _roof(floor_plan, inside, top)
    building = Building("warehouse", inside, top, 3, (store, staging, staging) + ((rise.rect,) if rise else ()))
    return inhabited(floor_plan, floor(rise, inside, "concrete"), building, plan)


def _with_gates(rng: np.random.Generator, wall: Wall) -> Wall:
    """Return a wall with a row of gates, some of them open."""
    spots = np.arange(wall.start_m + 3.5, wall.stop_m - 3.0, rng.uniform(4.5, 6.5)).tolist()
    kinds = [str(rng.choice(("roller", "gate"), p=(0.6, 0.4))) for _ in spots]
    return replace(wall, openings=tuple(Opening(u, 2.8, kind, 3.1) for u, kind in zip(spots, kinds, strict=True)))


def _truck(rng: np.random.Generator, gate: Opening, wall: Wall, side: int) -> tuple[Thing, ...]:
    """Return a trailer with its open end at a gate."""
    if rng.random() < 0.3:
        return ()
    out = 4.0 + wall.thick_m
    turn = -np.pi / 2 if side == 3 else np.pi / 2
    return place_group(stock.trailer(rng), gate.middle_m, wall.at_m + (out if side == 3 else -out), turn)


def _racks(floor_plan: FloorPlan, store: Rect, top_m: float) -> float:
    """Add racks back to back along y with a cross aisle, and return the x where they end."""
    rng = floor_plan.rng
    aisle, levels = rng.uniform(2.6, 3.6), int(rng.integers(2, 4)) if top_m > 8.8 else 2
    long = store[3] - store[1] - 2 * _CROSS_M
    bays = int((long - _CROSS_M) / 2 / (stock.BAY_M + 0.1))
    x = store[0] + 0.7
    _rack_row(floor_plan, x, store, bays, levels)
    x += 0.6 + aisle
    for _ in range(min(5 - levels, int((store[2] - x - 7.0) / (2.4 + aisle)))):
        _rack_row(floor_plan, x + 0.57, store, bays, levels)
        _rack_row(floor_plan, x + 0.57 + 1.2, store, bays, levels)
        x += 2.4 + aisle
    return x


def _rack_row(floor_plan: FloorPlan, x_m: float, store: Rect, bays: int, levels: int) -> None:
    """Add the two halves of a row and guards at its ends."""
    middle, half = (store[1] + store[3]) / 2, bays * (stock.BAY_M + 0.1) / 2
    for side in (-1, 1):
        y = middle + side * (_CROSS_M / 2 + half)
        floor_plan.put(place_group(stock.rack(floor_plan.rng, bays, levels), x_m, y))
        floor_plan.put(place_group(stock.bollard(floor_plan.rng), x_m, y + side * (half + 0.25)))


def _floor_storage(floor_plan: FloorPlan, rect: Rect) -> None:
    """Add blocks of stacked pallets with lanes between them."""
    rng = floor_plan.rng
    x = rect[0]
    while x + 2.8 < rect[2]:
        y = rect[1]
        while y + 1.3 < rect[3]:
            if rng.random() < 0.4 and floor_plan.parts < _MAX_PARTS:
                for k in range(int(rng.integers(1, 4))):
                    floor_plan.put(place_group(stock.stack(rng), x + 0.45 + 0.9 * k, y + 0.65, rng.normal(0.0, 0.015)))
            y += 1.4 if rng.random() < 0.7 else 3.0
        x += 2.8 + rng.uniform(2.2, 3.2)


def _dock(floor_plan: FloorPlan, staging: Rect, gates: int) -> Rise | None:
    """Return a strip of floor before some gates that lies higher, with a ramp up to it."""
    rng = floor_plan.rng
    long, deep, height = rng.uniform(6.0, 12.0), 3.2, rng.uniform(0.1, 0.25)
    x = rng.uniform(staging[0] + 1.0, staging[2] - long - 1.0)
    y = staging[3] - deep if gates == 3 else staging[1]
    rect = (x, y, x + long, y + deep)
    rise = Rise(rect, height, (x, y, x + height / 0.08, y + deep), 0)
    lay(floor_plan, rise)
    floor_plan.reserve(*((a - 0.3, b - 0.3, c + 0.3, d + 0.3) for a, b, c, d in rise.steps()))
    return rise


def _along_walls(floor_plan: FloorPlan, inside: Rect, gates: int) -> None:
    sides = tuple(side for side in range(4) if side != gates)
    for maker, limit in ((furniture.extinguisher, 4), (furniture.locker, 2), (furniture.shelf, 3), (stock.pallet, 4),
                        (stock.cage, 2), (furniture.desk, 2)):  # fmt: skip
        for _ in range(int(floor_plan.rng.integers(1, limit + 1))):
            floor_plan.against(inside, maker, sides)


def _roof(floor_plan: FloorPlan, inside: Rect, top_m: float) -> None:
    """Add girders below the roof, columns along the walls, and lamps over the floor."""
    lines = np.linspace(inside[0] + 1.0, inside[2] - 1.0, 6).tolist()
    for x in lines:
        girder = Box(x, 0.0, 0.25, inside[3] - inside[1], top_m, top_m - 0.7, 0.0, "metal")
        floor_plan.things.append(Thing("beam", (girder,), z_m=0.0))
        for y in (inside[1] + 0.2, inside[3] - 0.2):
            post = Box(0.0, 0.0, 0.25, 0.3, top_m - 0.7, -1.0, 0.0, "metal")
            floor_plan.put((Thing("pillar", (post,), x_m=x, y_m=y),))
