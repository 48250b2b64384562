"""Roads beside an edge where the ground drops by 2 to 6 m: construction pits, quays, loading yards, terraces.

Pits and quays have vertical faces, ramps, and guards along their edges.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed_lab.sim.assets.buildings import town_house
from viewshed_lab.sim.assets.country import (
    barrels,
    container,
    dumper,
    excavator,
    heap,
    pipes,
    scaffold,
    site_office,
    tower_crane,
)
from viewshed_lab.sim.assets.shapes import Box, Cylinder, material_index
from viewshed_lab.sim.assets.street import (
    bench,
    bin_,
    concrete_barrier,
    cone,
    fence,
    group,
    guard_rail,
    lamp_post,
    person,
    pick,
    place_at,
    pole,
    sign,
    tree,
    wall,
    work_barrier,
)
from viewshed_lab.sim.assets.vehicles import parked_vehicle, street_vehicle, truck
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import AgentPlan, Thing, World
from viewshed_lab.sim.worlds.layout import Rect, Span, assembled, lines_of, plots, spots, within
from viewshed_lab.sim.worlds.roadsides import climb, fields
from viewshed_lab.sim.worlds.roadway import HALF_M, LEVEL, Bend, Roadway
from viewshed_lab.sim.worlds.site_plan import SitePlan, beside
from viewshed_lab.sim.worlds.traffic import Pace, driven

FACE_M = 0.03
"""Width over which the ground falls at a vertical face."""


@dataclass(frozen=True, slots=True)
class Drop:
    """A lower part of the ground with a level floor and vertical faces."""

    rect: Rect  # its area
    deep_m: float  # depth of the floor below the road beside its center
    floor: str  # material of the floor; ``absorber`` is water
    # a part of ``rect`` that descends along x from the ground to the floor, or None
    ramp: Rect | None = None

    def lines(self) -> tuple[list[float], list[float]]:
        """Return the edges of the ground in x and in y."""
        rects = [self.rect] if self.ramp is None else [self.rect, self.ramp]
        return ([edge + step for one in rects for edge in one[::2] for step in (-FACE_M / 2, FACE_M / 2)],
                [edge + step for one in rects for edge in one[1::2] for step in (-FACE_M / 2, FACE_M / 2)])  # fmt: skip

    def edges(self) -> list[shapely.Polygon]:
        """Return the areas to keep free: within 0.3 m of its faces, and on its ramp."""
        ramp = [] if self.ramp is None else [shapely.box(*self.ramp)]
        return [shapely.box(*self.rect).exterior.buffer(0.3), *ramp]

    def lowered(self, z: F64, x: F64, y: F64, level_m: float) -> F64:
        """Return heights ``z`` at places of the same shape with this drop in them; ``level_m`` is the road's."""
        floor = np.where(within(self.rect, x, y), level_m - self.deep_m, z)
        if self.ramp is None:
            return floor
        share = np.clip((x - self.ramp[0]) / (self.ramp[2] - self.ramp[0]), 0.0, 1.0)
        return np.where(within(self.ramp, x, y), z + share * (level_m - self.deep_m - z), floor)


def terrain_with(road: Roadway, drops: list[Drop]) -> Terrain:
    """Return the terrain of a straight road along x with drops beside it."""
    levels = [float(road.height(np.array((d.rect[0] + d.rect[2]) / 2), np.array(0.0))) for d in drops]
    edges_x, edges_y = ([edge for one in drops for edge in one.lines()[k]] for k in (0, 1))

    def height(x: F64, y: F64) -> F64:
        z = road.height(x, y)
        for drop, level in zip(drops, levels, strict=True):
            z = drop.lowered(z, x, y, level)
        return z

    def material(x: F64, y: F64) -> NDArray[np.uint8]:
        out = road.material(x, y)
        for drop in drops:
            inside, face = (within(drop.rect, x, y, by) for by in (-FACE_M, FACE_M))
            out = np.where(inside, material_index(drop.floor), np.where(face, material_index("concrete"), out))
        return out.astype(np.uint8)

    plain = np.linspace(-HALF_M, HALF_M, 26)
    across = [way * at for way in (-1, 1) for at in (road.edge_m, road.edge_m + 1.5, road.edge_m + 4.0)]
    return Terrain.of(
        lines_of([*plain, *edges_x], HALF_M), lines_of([*plain, *across, 0.0, *edges_y], HALF_M), height, material
    )


def guarded(rng: np.random.Generator, span_m: Span, y_m: float) -> list[Thing]:
    """Return the guard of an edge along x: a rail, a barrier, a fence, posts, boards, cones, or nothing."""
    makers: tuple[tuple[float, float, Callable[[], Thing]], ...] = (
        (0.12, 4.0, lambda: replace(guard_rail(3.95), tilts=False)),
        (0.24, 4.0, lambda: replace(concrete_barrier(3.95), tilts=False)),
        (0.42, 3.5, lambda: replace(fence(3.45, 2.0), tilts=False)),
        (0.52, 3.5, lambda: replace(fence(3.45, 1.1), tilts=False)),
        (0.62, 2.5, lambda: pole(0.8, 0.09)),
        (0.7, 2.4, work_barrier),
        (0.76, 3.0, cone),
    )
    draw = rng.random()
    chosen = next(((step, maker) for share, step, maker in makers if draw < share), None)
    if chosen is None:
        return []
    step, maker = chosen
    gap = rng.uniform(*span_m)  # a way through
    return [place_at(maker(), x, y_m) for x in np.arange(span_m[0] + step / 2, span_m[1] - step / 2, step).tolist()
            if abs(x - gap) > 3.0 and abs(x) < HALF_M - 3.0]  # fmt: skip


def mirrored(rect: Rect, side: int) -> Rect:
    """Return a rectangle left of the x axis, or for side -1 its mirror image right of it."""
    return rect if side > 0 else (rect[0], -rect[3], rect[2], -rect[1])


_PIT_PACE = Pace(110.0, 50.0, (3.0, 12.0), (6.0, 25.0, 90.0))

_MACHINES: tuple[Callable[[np.random.Generator], Thing], ...] = (
    excavator, dumper, pipes, barrels, lambda rng: heap(rng, rng.uniform(2.0, 6.0)), person, container,
    lambda rng: scaffold(rng, rng.uniform(5.0, 10.0), 2),
)  # fmt: skip


def pit(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a street beside one to three construction pits, with the agents of ``plan``.

    Construction pits beside a street: upright faces of 2 to 6 m next to the drive lane, machines and ramps in them.
    """
    road = Roadway(
        Bend(0.0, 300.0, 0.0), climb(rng, 0.03), 2 if rng.random() < 0.2 else 1, rng.uniform(2.8, 3.5),
        rng.uniform(0.4, 1.6), LEVEL, rough=fields(rng, 0.3, 0.01), soil=pick(rng, ("grass", "concrete")),
    )  # fmt: skip
    side = pick(rng, (-1, 1))
    drops = _pits(rng, road, side)
    masts, site = beside(rng, plan, road.bend, road.edge_m + 0.9, road.edge_m - 0.2, (-side,))
    for drop in drops:
        _guard(rng, site, drop)
    site.reserve(*(edge for drop in drops for edge in drop.edges()))
    for drop in drops:
        _fill(rng, site, drop)
    _opposite(rng, site, road, -side)
    moving = driven(rng, plan, road.lane_lines(), _PIT_PACE, street_vehicle)
    return assembled("pit", terrain_with(road, drops), plan, site.things, moving, masts)


def _pits(rng: np.random.Generator, road: Roadway, side: int) -> list[Drop]:
    """Return pits on one side one after another, often with a ramp; sometimes one across the road as well."""
    drops, at = [], -rng.uniform(40.0, 70.0)
    while at < 45.0:
        long, wide, deep = rng.uniform(18.0, 60.0), rng.uniform(9.0, 32.0), rng.uniform(2.0, 6.0)
        near = road.edge_m + rng.uniform(0.7, 4.0)
        ramp = None
        if rng.random() < 0.6 and long > 25.0 and wide > 12.0:
            far, run = near + wide, min(deep / rng.uniform(0.12, 0.3), long - 6.0)
            ramp = mirrored((at, far - 4.0, at + run, far), side)
        rect, floor = mirrored((at, near, at + long, near + wide), side), pick(rng, ("grass", "concrete"))
        drops.append(Drop(rect, deep, floor, ramp))
        at += long + rng.uniform(6.0, 40.0)
    if rng.random() < 0.35:
        long, near = rng.uniform(8.0, 25.0), road.edge_m + rng.uniform(1.5, 5.0)
        x = rng.uniform(-40.0, 20.0)
        rect = mirrored((x, near, x + long, near + rng.uniform(3.0, 10.0)), -side)
        drops.append(Drop(rect, rng.uniform(1.0, 4.0), "concrete"))
    return drops


def _guard(rng: np.random.Generator, site: SitePlan, drop: Drop) -> None:
    """Put a guard along the edge at the road, and a tipper on the ramp."""
    x0, y0, x1, y1 = drop.rect
    for thing in guarded(rng, (x0 - 1.0, x1 + 1.0), y0 - 0.4 if y0 > 0 else y1 + 0.4):
        site.put(thing, 0.02)
    if drop.ramp is not None and rng.random() < 0.5:
        a, b, c, d = drop.ramp
        site.put(place_at(dumper(rng), (a + c) / 2, (b + d) / 2, pick(rng, (0.0, np.pi))))


def _fill(rng: np.random.Generator, site: SitePlan, drop: Drop) -> None:
    """Put machines on the floor of a pit, and huts, containers and heaps behind it."""
    x0, y0, x1, y1 = drop.rect
    side, far = (1, y1) if y0 > 0 else (-1, y0)
    count = int(rng.integers(2, 9))
    site.scatter(rng, [_MACHINES[int(rng.integers(len(_MACHINES)))](rng) for _ in range(count)], drop.rect)
    beyond = mirrored((x0 - 4.0, abs(far) + 3.5, x1 + 4.0, abs(far) + 14.0), side)
    yard = [pick(rng, (site_office, container, barrels, pipes))(rng) for _ in range(int(rng.integers(1, 6)))]
    site.scatter(rng, [*yard, *(heap(rng, rng.uniform(3.0, 8.0)) for _ in range(int(rng.integers(0, 3))))], beyond)


def _opposite(rng: np.random.Generator, site: SitePlan, road: Roadway, side: int) -> None:
    """Put parked vehicles, lamps, trees, people and a row of houses or walls on the other side of the street."""
    turn, setback = (np.pi if side > 0 else 0.0), rng.uniform(4.0, 12.0)
    if rng.random() < 0.7:
        for x in spots(rng, (-HALF_M, HALF_M), 5.8, (0.3, rng.uniform(1.0, 14.0))):
            site.put(place_at(parked_vehicle(rng), x, side * (road.edge_m + 1.0), turn))
    for x in spots(rng, (-HALF_M, HALF_M), 1.0, (5.0, 30.0)):
        thing = pick(rng, (lamp_post(rng), sign(rng), tree(rng, 2.4, 4.0), person(rng), cone()))
        site.put(place_at(thing, x, side * (road.edge_m + 2.7), -side * np.pi / 2))
    for at in rng.uniform(-50, 50, int(rng.integers(0, 3))).tolist():
        site.put_all(group(rng, at, side * (road.edge_m + 3.6)))
    house_row(rng, site, plots(rng, (-HALF_M, HALF_M), (9.0, 24.0), 8.0, 0.35), side * (road.edge_m + setback))


def house_row(rng: np.random.Generator, site: SitePlan, lots: list[Span], y_m: float) -> None:
    """Put a row of houses whose fronts lie at ``y_m`` and face the x axis, a wall where there is no room for one."""
    facing = 0.0 if y_m > 0 else np.pi
    for x, long in lots:
        if not site.put(place_at(town_house(rng, long, 11.0, abs(x) > 45.0), x, y_m, facing)):
            site.put(place_at(wall(0.5 * long, 2.0), x, y_m))


_QUAY_PACE = Pace(110.0, 50.0, (3.0, 11.0), (6.0, 25.0, 110.0))


def quay(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a road along the edge of a quay or of a lower yard, with the agents of ``plan``.

    A road along an edge: quays, loading yards and terraces where the ground drops by 2 to 6 m beside the lane.
    """
    road = Roadway(
        Bend(0.0, 300.0, 0.0), climb(rng, 0.012), 1, rng.uniform(2.8, 3.6), rng.uniform(0.3, 1.5), LEVEL,
        rough=fields(rng, 0.2, 0.005), soil=pick(rng, ("concrete", "asphalt", "grass")),
    )  # fmt: skip
    side, water = pick(rng, (-1, 1)), rng.random() < 0.45
    drops = _edges(rng, road, side, water)
    masts, site = beside(rng, plan, road.bend, road.edge_m + 0.9, road.edge_m - 0.2, (-side,))
    near = min(abs(edge) for edge in drops[0].rect[1::2])
    for thing in guarded(rng, (-HALF_M, HALF_M), side * (near - 0.4)):
        site.put(thing, 0.02)
    site.reserve(*(edge for drop in drops for edge in drop.edges()))
    _below(rng, site, drops[0], side, water)
    _behind(rng, site, road, -side)
    moving = driven(rng, plan, road.lane_lines(), _QUAY_PACE, street_vehicle)
    return assembled("quay", terrain_with(road, drops), plan, site.things, moving, masts)


def _edges(rng: np.random.Generator, road: Roadway, side: int, water: bool) -> list[Drop]:
    """Return the lower ground, as far as the world goes, and sometimes a second step down, or an inlet."""
    near, deep = road.edge_m + rng.uniform(0.6, 6.0), rng.uniform(2.0, 6.0)
    floor = "absorber" if water else pick(rng, ("asphalt", "concrete", "grass"))
    ramp = None
    if not water and rng.random() < 0.5:
        x = rng.uniform(-60.0, 20.0)
        ramp = mirrored((x, near, x + deep / rng.uniform(0.1, 0.2), near + rng.uniform(4.0, 6.0)), side)
    drops = [Drop(mirrored((-HALF_M - 1.0, near, HALF_M + 1.0, HALF_M + 1.0), side), deep, floor, ramp)]
    if rng.random() < 0.5:
        out = near + rng.uniform(15.0, 40.0)
        below = "absorber" if water or rng.random() < 0.5 else floor
        rect = mirrored((-HALF_M - 1.0, out, HALF_M + 1.0, HALF_M + 1.0), side)
        drops.append(Drop(rect, deep + rng.uniform(1.0, 4.0), below))
    return drops


def _below(rng: np.random.Generator, site: SitePlan, drop: Drop, side: int, water: bool) -> None:
    """Put ships on the water, or vehicles, goods and people into the lower yard."""
    near = drop.rect[1] if side > 0 else -drop.rect[3]
    if water:
        for x in spots(rng, (-90.0, 90.0), 18.0, (2.0, rng.uniform(20.0, 120.0))):
            site.put(place_at(_ship(rng, drop.deep_m), x, side * (near + 3.2)))
        return
    makers = (container, parked_vehicle, truck, barrels, pipes, person)
    goods = [pick(rng, makers)(rng) for _ in range(int(rng.integers(5, 40)))]
    low, high = side * (near + 3.0), side * (near + rng.uniform(15.0, 60.0))
    site.scatter(rng, goods, (-100.0, min(low, high), 100.0, max(low, high)))


def _ship(rng: np.random.Generator, deep_m: float) -> Thing:
    """Return a barge or a boat along x, its foot on the water."""
    long, deck = rng.uniform(9.0, 17.0), rng.uniform(0.8, 2.6)
    parts = (
        Box(0.0, 0.0, long, 4.2, deck, -0.3, 0.0, pick(rng, ("dark_paint", "paint"))),
        Box(-0.3 * long, 0.0, 0.2 * long, 3.0, deck + 2.3, deck, 0.0, "paint"),
        Cylinder(0.1 * long, 0.0, 0.08, deck + 0.6 * deep_m + 2.0, deck, "metal"),
    )
    return Thing("ship", parts)


def _behind(rng: np.random.Generator, site: SitePlan, road: Roadway, side: int) -> None:
    """Put parked vehicles, goods or benches, trees, cranes, houses or sheds on the landward side of a quay."""
    port = rng.random() < 0.5
    y = side * (road.edge_m + 2.2)
    for x in spots(rng, (-HALF_M, HALF_M), 1.2, (3.0, 22.0)):
        thing = pick(rng, (lamp_post(rng), bin_(rng), bench(), person(rng), sign(rng), tree(rng, 2.4, 4.5)))
        site.put(place_at(thing, x, y, -side * np.pi / 2))
    for x in spots(rng, (-HALF_M, HALF_M), 13.0, (1.0, 25.0)):
        thing = container(rng) if port else parked_vehicle(rng)
        site.put(place_at(thing, x, side * (road.edge_m + rng.uniform(5.0, 7.0)), rng.normal(0.0, 0.05)))
    if port and rng.random() < 0.7:
        site.put(place_at(tower_crane(rng), rng.uniform(-40, 40), side * (road.edge_m + 11.0), rng.uniform(-3, 3)))
    for at in rng.uniform(-50, 50, int(rng.integers(0, 4))).tolist():
        site.put_all(group(rng, at, side * (road.edge_m + 3.5)))
    if rng.random() < 0.8:
        house_row(rng, site, plots(rng, (-HALF_M, HALF_M), (10.0, 28.0), 14.0, 0.5), side * (road.edge_m + 16.0))
