"""Random land for training: heights, roads, edges, decks, roofs and things are sampled without any style.

A network that estimates unseen ground must not learn what a street or a quay looks like. So all parts are sampled
independently: noise of several octaves, terraces, a sunken or raised road, ditches and berms, platforms and pits with
vertical faces and ramps, water, decks and roofs on posts, walls with openings, stairs, and things anywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed_lab.sim.assets.buildings import town_house
from viewshed_lab.sim.assets.country import animal, bale, barrels, container, heap, pipes, rock
from viewshed_lab.sim.assets.shapes import Box, Cylinder, Shape, material_index
from viewshed_lab.sim.assets.street import bush, conifer, fence, hedge, lamp_post, person, pick, pole, tree, wall
from viewshed_lab.sim.assets.vehicles import parked_vehicle, street_vehicle
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import AgentPlan, Thing, World
from viewshed_lab.sim.worlds.drop_roads import Drop, mirrored
from viewshed_lab.sim.worlds.layout import assembled, lines_of, within
from viewshed_lab.sim.worlds.roadway import HALF_M, Bend, random_bend
from viewshed_lab.sim.worlds.site_plan import beside
from viewshed_lab.sim.worlds.traffic import Pace, driven

_PACE = Pace(110.0, 50.0, (1.0, 12.0), (6.0, 25.0, 150.0))

_STEP_M = 2.0
"""Distance of the terrain's lines within 76 m; beyond, it is 6 m."""

_SOLID, _GLASS = ("concrete", "plaster", "brick", "wood", "metal", "dark_paint"), ("glass", "window", "tinted")
_SOILS = ("grass", "concrete", "asphalt", "brick", "rubber")

_THINGS: tuple[Callable[[np.random.Generator], Thing], ...] = (
    parked_vehicle, street_vehicle, parked_vehicle, person, bush, conifer, container, barrels, pipes, bale, rock,
    animal, lamp_post,
    lambda rng: tree(rng, rng.uniform(0.5, 3.0), rng.uniform(2.0, 8.0)),
    lambda rng: heap(rng, rng.uniform(2.0, 9.0)),
    lambda rng: pole(rng.uniform(0.8, 8.0)),
    lambda rng: wall(rng.uniform(1.0, 25.0), rng.uniform(0.3, 6.0), pick(rng, _SOLID)),
    lambda rng: fence(rng.uniform(2.0, 20.0), rng.uniform(0.8, 2.5)),
    lambda rng: hedge(rng, rng.uniform(2.0, 15.0), rng.uniform(0.6, 2.5)),
    lambda rng: town_house(rng, rng.uniform(6.0, 25.0), rng.uniform(6.0, 14.0), plain=True),
)  # fmt: skip
"""Makers of the things that are scattered over the land."""


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """Heights of several octaves, each interpolated between random values on its own lattice."""

    lengths_m: tuple[float, ...]  # side of a lattice's cells
    values_m: tuple[F64, ...]  # (n, n) heights at its nodes

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Noise:
        """Return noise with wavelengths of 160 to 5 m; all waves are equally steep, or the long ones steeper."""
        lengths = tuple(160.0 * 2.0**-k for k in range(6))
        steep, fade = 0.16 * rng.random() ** 2, rng.uniform(0.35, 1.1)
        values = [
            rng.normal(0.0, 0.5 * steep * fade**k * length, (int(2 * HALF_M / length) + 4,) * 2)
            for k, length in enumerate(lengths)
        ]
        return cls(lengths, tuple(values))

    def at(self, x: F64, y: F64, octaves: int = 6) -> F64:
        """Return heights at points of equal shape, of the first octaves only."""
        z = np.zeros(np.broadcast(x, y).shape)
        for length, values in zip(self.lengths_m[:octaves], self.values_m, strict=False):
            u, v = ((np.clip(at, -HALF_M, HALF_M) + HALF_M) / length for at in (x, y))
            i, j = u.astype(np.intp), v.astype(np.intp)
            a, b = ((at - node) ** 2 * (3.0 - 2.0 * (at - node)) for at, node in ((u, i), (v, j)))
            z += (1 - a) * ((1 - b) * values[i, j] + b * values[i, j + 1])
            z += a * ((1 - b) * values[i + 1, j] + b * values[i + 1, j + 1])
        return z


@dataclass(frozen=True, slots=True)
class Ridge:
    """A ditch or a berm along a line that bends."""

    bend: Bend  # the line
    turned: bool  # whether it runs along y instead of x
    beside_m: float  # distance from the axis of the bend
    rise_m: float  # height of its center line; negative for a ditch
    flat_m: float  # half the width of its level middle
    slope_m: float  # width of the slopes beside it

    def at(self, x: F64, y: F64) -> F64:
        """Return its heights above the land at points of equal shape."""
        along, across = (y, x) if self.turned else (x, y)
        off = np.abs(across - self.bend.axis(along) - self.beside_m)
        return np.asarray(self.rise_m * np.clip(1.0 - (off - self.flat_m) / self.slope_m, 0.0, 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class Land:
    """Heights and materials of a land."""

    noise: Noise  # relief of the land
    terrace_m: float  # height of terraces; 0 for none
    bend: Bend  # the axis of the road
    half_m: float  # half the width of the road
    rise_m: float  # height of the road above the land around it; negative if sunken
    bank_m: float  # width of its banks
    ridges: tuple[Ridge, ...]  # ditches and berms
    drops: tuple[Drop, ...]  # platforms and pits with vertical faces; depths are below the land at their center
    water_m: float  # level up to which the land is filled with water; -inf for none
    materials: tuple[str, str, str]  # of road, land, banks

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Land:
        """Return one."""
        noise, bend, half = Noise.drawn(rng), random_bend(rng, 0.4, (90.0, 420.0)), rng.uniform(1.8, 9.0)
        terrace = rng.uniform(0.3, 3.5) if rng.random() < 0.25 else 0.0
        rise = 0.0 if rng.random() < 0.4 else rng.normal(0.0, 2.5)
        ridges = tuple(_ridge(rng, bend, half) for _ in range(rng.poisson(1.2)))
        drops = tuple(_drop(rng, bend, half) for _ in range(rng.poisson(1.2)))
        water = float(np.quantile(noise.values_m[0], rng.uniform(0.02, 0.3))) if rng.random() < 0.15 else -np.inf
        materials = (pick(rng, _SOILS[1:]), pick(rng, _SOILS), pick(rng, _SOILS))
        return cls(noise, terrace, bend, half, rise, rng.uniform(0.06, 9.0), ridges, drops, water, materials)

    def _coordinates(self, x: F64, y: F64) -> tuple[F64, F64]:
        along, across = self.bend.coordinates(x, y)
        return np.clip(along, -HALF_M, HALF_M), np.abs(across) - self.half_m

    def height(self, x: F64, y: F64) -> F64:
        """Return the ground's z in meters at points of equal shape."""
        # 1. The relief of the land, in steps where it has terraces, with ditches and berms.
        land = self.noise.at(x, y)
        if self.terrace_m:
            steps, share = np.divmod(land / self.terrace_m, 1.0)
            land = self.terrace_m * (steps + np.clip(8.0 * share - 7.0, 0.0, 1.0))
        for ridge in self.ridges:
            land = land + ridge.at(x, y)
        land = np.where(land < self.water_m, self.water_m, land)
        # 2. The road follows only the long waves, raised or sunken; its banks blend into the land.
        along, beyond = self._coordinates(x, y)
        road = self.noise.at(along, self.bend.axis(along), 2) + self.rise_m
        share = np.clip(beyond / self.bank_m, 0.0, 1.0)
        z = np.where(beyond <= 0.0, road, road + share * (land - road))
        # 3. Platforms and pits.
        for drop in self.drops:
            middle = np.array((drop.rect[0] + drop.rect[2]) / 2), np.array((drop.rect[1] + drop.rect[3]) / 2)
            z = drop.lowered(z, x, y, float(self.noise.at(*middle)))
        return np.asarray(z)

    def material(self, x: F64, y: F64) -> NDArray[np.uint8]:
        """Return the material of the ground, rows (…,) of ``MATERIALS``."""
        _, beyond = self._coordinates(x, y)
        road, land, bank = (material_index(name) for name in self.materials)
        out = np.where(beyond <= 0.0, road, np.where(beyond < self.bank_m, bank, land))
        wet = (beyond > self.bank_m) & (self.noise.at(x, y) < self.water_m)
        for drop in self.drops:
            out = np.where(within(drop.rect, x, y), material_index(drop.floor), out)
        return np.where(wet, material_index("absorber"), out).astype(np.uint8)

    def terrain(self) -> Terrain:
        """Return the terrain, with lines at the upright faces."""
        near = np.arange(-76.0, 76.1, _STEP_M)
        far = np.arange(82.0, HALF_M, 6.0)
        plain = [*(-far), *near, *far, -HALF_M, HALF_M]
        faces = [drop.lines() for drop in self.drops]
        x_m, y_m = (lines_of([*plain, *(edge for one in faces for edge in one[axis])], HALF_M) for axis in (0, 1))
        return Terrain.of(x_m, y_m, self.height, self.material)


def land(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return random land with the agents of ``plan`` on its road."""
    lie = Land.drawn(rng)
    masts, site = beside(rng, plan, lie.bend, lie.half_m + 1.0, lie.half_m)
    site.reserve(*(edge for drop in lie.drops for edge in drop.edges()))
    built = [maker(rng, lie) for maker in (_deck, _roof, _walls, _stairs) if rng.random() < 0.35]
    for part in built:
        site.stand(*part)
    count = int(120 * rng.random() ** 2)
    site.scatter(rng, [pick(rng, _THINGS)(rng) for _ in range(count)], (-70.0, -70.0, 70.0, 70.0))
    lanes = [lie.bend.lane(side * 0.5 * lie.half_m, side > 0) for side in (-1, 1)]
    moving = driven(rng, plan, lanes, _PACE, street_vehicle)
    return assembled("land", lie.terrain(), plan, site.things, moving, masts)


def _ridge(rng: np.random.Generator, bend: Bend, half_m: float) -> Ridge:
    """Return a ditch or berm beside the road, or anywhere off it."""
    rise = rng.choice((-1.0, 1.0)) * rng.uniform(0.2, 3.5)
    flat, slope = rng.uniform(0.0, 3.0), rng.uniform(0.3, 3.0) * abs(rise)
    if rng.random() < 0.6:
        return Ridge(
            bend, False, rng.choice((-1, 1)) * (half_m + flat + slope + rng.uniform(0.3, 12.0)), rise, flat, slope
        )
    return Ridge(random_bend(rng, 0.6), bool(rng.random() < 0.5), rng.uniform(-70.0, 70.0), rise, flat, slope)


def _drop(rng: np.random.Generator, bend: Bend, half_m: float) -> Drop:
    """Return a pit or a platform beside the road, often with a ramp."""
    long, wide = rng.uniform(4.0, 70.0), rng.uniform(4.0, 45.0)
    x0, near = rng.uniform(-75.0, 75.0 - long), half_m + rng.uniform(0.3, 20.0)
    side = int(rng.choice((-1, 1)))
    axis = bend.axis(np.linspace(x0, x0 + long, 16))
    near += float(max(side * axis.max() if side > 0 else -axis.min(), 0.0))
    deep = rng.normal(0.0, 3.0)
    ramp = None
    if rng.random() < 0.4 and long > 12.0 and wide > 6.0:
        ramp = mirrored((x0, near + 0.5, x0 + rng.uniform(6.0, long - 2.0), near + rng.uniform(3.0, wide - 1.0)), side)
    floor = "absorber" if deep > 0.5 and rng.random() < 0.15 else pick(rng, _SOILS)
    return Drop(mirrored((x0, near, x0 + long, near + wide), side), float(deep), floor, ramp)


def _slab(
    rng: np.random.Generator, lie: Land, kind: str, rect: tuple[float, float, float, float], under_m: float
) -> list[Thing]:
    """Return a slab (x, across, long, wide) above the road, on posts beside the road."""
    x, across, long, wide = rect
    thick, turn, radius = rng.uniform(0.15, 1.4), rng.uniform(-0.3, 0.3), rng.uniform(0.08, 0.5)
    material = pick(rng, _SOLID)
    slab = lie.bend.put(
        Thing(kind, (Box(0.0, 0.0, long, wide, under_m + thick, under_m, 0.0, material),)), x, across, turn
    )
    c, s = np.cos(slab.yaw), np.sin(slab.yaw)
    posts: list[Shape] = []
    for u in (long * np.linspace(-0.45, 0.45, int(rng.integers(2, 6)))).tolist():
        for v in (-0.47 * wide, 0.47 * wide):
            _, beside = lie.bend.coordinates(np.array(slab.x_m + c * u - s * v), np.array(slab.y_m + s * u + c * v))
            if abs(beside) > lie.half_m + 1.0:
                posts.append(Cylinder(u, v, radius, under_m, -4.0, material))
    along = np.linspace(x - 0.5 * np.hypot(long, wide), x + 0.5 * np.hypot(long, wide), 33)
    return [replace(slab, parts=(*slab.parts, *posts), z_m=float(lie.height(along, lie.bend.axis(along)).max()))]


def _deck(rng: np.random.Generator, lie: Land) -> list[Thing]:
    """Return a bridge across the road."""
    x, long = rng.uniform(-60.0, 60.0), rng.uniform(3.0, 14.0)
    under = rng.uniform(3.2, 8.0)
    return _slab(rng, lie, "deck", (x, 0.0, long, rng.uniform(30.0, 90.0)), under)


def _roof(rng: np.random.Generator, lie: Land) -> list[Thing]:
    """Return a roof on posts over or beside the road, as low as a garage's ceiling or as high as a hall's."""
    long, wide = rng.uniform(6.0, 80.0), rng.uniform(6.0, 50.0)
    across = 0.0 if rng.random() < 0.6 else rng.choice((-1.0, 1.0)) * (lie.half_m + 0.6 * wide)
    return _slab(rng, lie, "roof", (rng.uniform(-40.0, 40.0), across, long, wide), 2.1 + 6.0 * rng.random() ** 2)


def _walls(rng: np.random.Generator, lie: Land) -> list[Thing]:
    """Return walls along both sides of the road with openings and panes, as of a hall, a yard or a tunnel."""
    start, high = rng.uniform(-70.0, 0.0), rng.uniform(1.0, 8.0)
    end = start + rng.uniform(15.0, 110.0)
    things: list[Thing] = []
    for side in (-1, 1):
        across, at = side * (lie.half_m + rng.uniform(1.2, 15.0)), start
        while at < end:
            long = rng.uniform(1.0, 14.0)
            if rng.random() < 0.75:
                material = pick(rng, _GLASS if rng.random() < 0.25 else _SOLID)
                piece = wall(long, high, material, rng.uniform(0.04, 0.4))
                things.append(lie.bend.put(piece, at + long / 2, across))
            at += long
    return things


def _stairs(rng: np.random.Generator, lie: Land) -> list[Thing]:
    """Return a flight of stairs beside the road, up from it."""
    rise, run, wide = rng.uniform(0.12, 0.2), rng.uniform(0.25, 0.45), rng.uniform(1.2, 12.0)
    steps = int(rng.integers(3, 25))
    parts = tuple(Box(run * k, 0.0, run * 1.02, wide, rise * (k + 1), -0.5, 0.0, "concrete") for k in range(steps))
    side = int(rng.choice((-1, 1)))
    across = side * (lie.half_m + rng.uniform(1.0, 6.0))
    return [lie.bend.put(Thing("stairs", parts), rng.uniform(-40.0, 40.0), across, side * np.pi / 2)]
