"""A parking garage: a ceiling on columns, parked cars, low walls, ramps up and down, lower ground outside or none."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed_lab.sim.assets.buildings import town_house
from viewshed_lab.sim.assets.shapes import Box, Cylinder, Shape, material_index
from viewshed_lab.sim.assets.street import person, pick, place_at, tree
from viewshed_lab.sim.assets.vehicles import car
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import AgentPlan, Thing, World
from viewshed_lab.sim.worlds.layout import Mast, Rect, assembled, lines_of, within
from viewshed_lab.sim.worlds.parking import aisle_walkers, aisles_driven
from viewshed_lab.sim.worlds.roadway import HALF_M
from viewshed_lab.sim.worlds.traffic import Lane, Rider, straight_lane

_BAY_M, _DEEP_M, _AISLE_M, _END_M, _RAMP_M = 2.6, 5.0, 6.2, 6.5, 4.4
_FACE_M = 0.03


@dataclass(frozen=True, slots=True)
class Storey:
    """One storey of a garage: its floor is level at 0."""

    half_x_m: float  # from its center to the outer walls
    aisles_m: tuple[float, ...]  # y of the aisles' axes
    low_y_m: float  # smallest y, where the strip of ramps begins
    high_y_m: float  # largest y
    rise_m: float  # from floor to floor
    slab_m: float  # thickness of the ceiling
    # whether the floor rises (up) or falls (down) along x, from which end; height at the far end
    ramps: tuple[tuple[Rect, float], ...]
    outside_m: float  # height of the ground around; above the ceiling for a basement
    free_m: float  # clear height below hanging things, above the sensors of vehicles

    @property
    def top_m(self) -> float:
        """Height of the ceiling."""
        return self.rise_m - self.slab_m

    @property
    def row_m(self) -> float:
        """Half the length of the rows of bays."""
        return self.half_x_m - _END_M

    def height(self, x: F64, y: F64) -> F64:
        """Return z of the ground at points of equal shape."""
        inside = (np.abs(x) < self.half_x_m) & (y > self.low_y_m) & (y < self.high_y_m)
        z = np.where(inside, 0.0, self.outside_m)
        for ramp, end in self.ramps:
            z = np.where(within(ramp, x, y), end * (x - ramp[0]) / (ramp[2] - ramp[0]), z)
        return np.asarray(z)

    def terrain(self) -> Terrain:
        """Return floor, ramps and the ground around."""
        xs = [-self.half_x_m, self.half_x_m, *(edge for rect, _ in self.ramps for edge in rect[::2])]
        ys = [self.low_y_m, self.high_y_m, *(edge for rect, _ in self.ramps for edge in rect[1::2])]
        plain = np.linspace(-HALF_M, HALF_M, 13)
        x_m, y_m = ([edge + step for edge in edges for step in (-_FACE_M / 2, _FACE_M / 2)] for edges in (xs, ys))

        def material(x: F64, y: F64) -> NDArray[np.uint8]:
            inside = (np.abs(x) < self.half_x_m) & (y > self.low_y_m) & (y < self.high_y_m)
            return np.where(inside, material_index("concrete"), material_index("asphalt")).astype(np.uint8)

        return Terrain.of(lines_of([*plain, *x_m], HALF_M), lines_of([*plain, *y_m], HALF_M), self.height, material)


def garage(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a storey of a parking garage, in a basement or up to four storeys up, with the agents of ``plan``."""
    storey = _storey(rng, plan.sensor_height_m)
    still = [*_ceiling(rng, storey), *_columns(rng, storey), *_shell(rng, storey), *_ramp_walls(rng, storey)]
    bays, masts = _bays(rng, storey), _masts(rng, plan.roadside, storey)
    still += [*bays, *_overhead(rng, storey)]
    if storey.outside_m < 0.0:
        still += _around(rng, storey)
    moving = _traffic(rng, plan, storey)
    return replace(assembled("garage", storey.terrain(), plan, still, moving, masts), indoor=True)


def _storey(rng: np.random.Generator, sensor_m: float) -> Storey:
    units, slab = int(rng.integers(1, 4)), rng.uniform(0.25, 0.45)
    half_x = rng.uniform(24.0, 48.0)
    clear = max(rng.uniform(2.1, 3.0), sensor_m + rng.uniform(0.3, 0.8))
    pitch = 2 * _DEEP_M + _AISLE_M
    half_y = units * pitch / 2
    aisles = tuple(float((k + 0.5) * pitch - half_y) for k in range(units))
    # Ramps lie side by side at the lowest y: the first climbs along x, the second falls.
    rise, ramps, low = clear + slab, [], -half_y
    for end, chance in ((rise, 0.7), (-rise, 0.6)):
        run = rise / rng.uniform(0.12, 0.18)
        if rng.random() < chance and run < 1.7 * half_x:
            x = rng.uniform(-half_x + 1.0, half_x - 1.0 - run)
            ramps.append(((x, low - _RAMP_M, x + run, low - 0.3), end))
            low -= _RAMP_M
    level = rng.random()
    outside = rise + 0.5 if level < 0.35 else -rise * int(rng.integers(0, 4)) - 0.25
    free = max(1.95, sensor_m + 0.15)
    return Storey(half_x, aisles, low - 0.3, half_y + 0.3, rise, slab, tuple(ramps), outside, free)


def _ceiling(rng: np.random.Generator, one: Storey) -> list[Thing]:
    """Return the slab above, open over a ramp that climbs, and the one over that opening; beams below the slab."""
    x, low, high, top = one.half_x_m, one.low_y_m, one.high_y_m, one.top_m
    opened = [rect for rect, end in one.ramps if end > 0]
    pieces: list[Rect] = [(-x, low, x, high)]
    if opened:
        a, b, c, d = opened[0]
        a += 0.5 * (c - a) * (2.0 / one.rise_m)  # the lower part of the ramp lies under the slab
        pieces = [(-x, low, x, b), (-x, d, x, high), (-x, b, a, d), (c, b, x, d)]
    parts: list[Shape] = [_slab(rect, top, one.rise_m) for rect in pieces if rect[2] > rect[0] and rect[3] > rect[1]]
    if opened:
        parts.append(_slab((-x, low, x, high), one.rise_m + top, 2 * one.rise_m))
    deep = rng.uniform(0.15, 0.4)
    if top - deep > one.free_m and rng.random() < 0.7:
        step = rng.uniform(5.0, 8.5)
        parts += [Box(at, (one.aisles_m[0] - 8.0 + high) / 2, 0.35, high - one.aisles_m[0] + 8.0, top, top - deep, 0.0,
                      "concrete") for at in np.arange(-x + 2.0, x - 1.0, step).tolist()]  # fmt: skip
    return [Thing("ceiling", tuple(parts), z_m=0.0)]


def _slab(rect: Rect, bottom_m: float, top_m: float) -> Box:
    x0, y0, x1, y1 = rect
    return Box((x0 + x1) / 2, (y0 + y1) / 2, x1 - x0, y1 - y0, top_m, bottom_m, 0.0, "concrete")


def _columns(rng: np.random.Generator, one: Storey) -> list[Thing]:
    """Return columns between the bays, between back-to-back rows and along the outer walls."""
    every, size = int(rng.integers(2, 4)), rng.uniform(0.3, 0.6)
    round_ones, top = rng.random() < 0.3, one.top_m
    lines = [y + way * (_AISLE_M / 2 + _DEEP_M - 0.45) for y in one.aisles_m for way in (-1, 1)]
    count = int(2 * one.row_m / _BAY_M)
    things = []
    for y in lines:
        for k in range(0, count + 1, every):
            x = (k - count / 2) * _BAY_M
            part: Shape = (Cylinder(0.0, 0.0, size / 2, top, -0.5) if round_ones
                           else Box(0.0, 0.0, min(size, 0.42), size, top, -0.5, 0.0, "concrete"))  # fmt: skip
            things.append(Thing("pillar", (part,), x, y))
    return things


def _shell(rng: np.random.Generator, one: Storey) -> list[Thing]:
    """Return the outer walls: up to the ceiling in a basement, else walls, or parapets below an opening or a mesh."""
    x, low, high = one.half_x_m, one.low_y_m, one.high_y_m
    sides = ((0.0, low + 0.1, 2 * x, 0.2), (0.0, high - 0.1, 2 * x, 0.2), (-x + 0.1, (low + high) / 2, 0.2, high - low),
             (x - 0.1, (low + high) / 2, 0.2, high - low))  # fmt: skip
    things, sunk = [], min(one.outside_m, 0.0) - 1.0
    for at_x, at_y, long, wide in sides:
        draw, parapet = rng.random(), rng.uniform(0.8, 1.25)
        top = one.top_m if one.outside_m > 0.0 or draw < 0.25 else parapet
        parts: list[Shape] = [Box(at_x, at_y, long, wide, top, sunk, 0.0, "concrete")]
        if top == parapet and draw < 0.5:
            parts.append(Box(at_x, at_y, max(long - 0.4, 0.04), max(wide - 0.16, 0.04), one.top_m, top, 0.0, "mesh"))
        things.append(Thing("wall", tuple(parts), z_m=0.0))
    return things


def _ramp_walls(rng: np.random.Generator, one: Storey) -> list[Thing]:
    """Return walls along the ramps: low where one falls, low or up to the ceiling where one climbs."""
    things = []
    for (a, _, c, d), end in one.ramps:
        top = one.top_m if end > 0 and rng.random() < 0.5 else rng.uniform(0.8, 1.1)
        middle, long = (a + c) / 2 + 0.5 * (3.0 if c - a > 12.0 else 0.0), c - a - (3.0 if c - a > 12.0 else 0.0)
        things.append(Thing("wall", (Box(middle, d + 0.15, long, 0.2, top, -0.5, 0.0, "concrete"),), z_m=0.0))
        if end < 0:
            things.append(Thing("wall", (Box(c + 0.15, d - 2.0, 0.2, 3.9, 1.0, -0.5, 0.0, "concrete"),), z_m=0.0))
    return things


def _bays(rng: np.random.Generator, one: Storey) -> list[Thing]:
    """Return parked cars, wheel stops, and low walls between rows that stand back to back."""
    things, taken = [], rng.uniform(0.2, 0.9)
    count, stops, walls = int(2 * one.row_m / _BAY_M), rng.random() < 0.4, rng.random() < 0.4
    for number, y in enumerate(one.aisles_m):
        for way in (-1, 1):
            across = y + way * (_AISLE_M / 2 + _DEEP_M / 2 - 0.25)
            for k in range(count):
                x = (k + 0.5 - count / 2) * _BAY_M
                if rng.random() < taken:
                    turn = pick(rng, (-1, 1)) * np.pi / 2 + rng.normal(0, 0.02)
                    things.append(place_at(car(rng), x + rng.uniform(-0.08, 0.08), across, turn))
                elif rng.random() < 0.03:
                    things.append(place_at(person(rng), x, across, rng.uniform(-3, 3)))
            if walls and way > 0 and number + 1 < len(one.aisles_m):
                wall = Box(0.0, 0.0, 2 * one.row_m, 0.12, rng.uniform(0.6, 1.1), -0.5, 0.0, "concrete")
                things.append(place_at(Thing("wall", (wall,)), 0.0, y + _AISLE_M / 2 + _DEEP_M))
            elif stops:
                stop = Box(0.0, 0.0, 2 * one.row_m, 0.1, 0.1, -0.1, 0.0, "rubber")
                things.append(place_at(Thing("stop", (stop,)), 0.0, across + way * (_DEEP_M / 2 + 0.18)))
    return things


def _overhead(rng: np.random.Generator, one: Storey) -> list[Thing]:
    """Return pipes, lamps and hanging signs below the ceiling."""
    parts: list[Shape] = []
    top = one.top_m
    for y in one.aisles_m:
        side, low = pick(rng, (-1, 1)), top - rng.uniform(0.12, 0.3)
        if rng.random() < 0.6:
            parts.append(Box(0.0, y + side * 2.4, 2 * one.row_m, 0.12, low + 0.1, low, 0.0, "metal"))
        lamps = np.arange(-one.row_m + 2.0, one.row_m, rng.uniform(4.0, 8.0)).tolist()
        parts += [Box(x, y, 1.3, 0.12, top - 0.02, top - 0.12, 0.0, "metal") for x in lamps]
        if top - 0.32 > one.free_m:
            spots = rng.uniform(-0.8, 0.8, int(rng.integers(0, 3))) * one.row_m
            parts += [Box(x, y, 0.08, 1.2, top - 0.05, top - 0.32, 0.0, "sign") for x in spots.tolist()]
    return [Thing("duct", tuple(parts), z_m=0.0)]


def _masts(rng: np.random.Generator, count: int, one: Storey) -> list[Mast]:
    """Return sensors just below the ceiling at the edges of aisles, on poles from floor to ceiling."""
    posts = []
    for k in range(count):
        y, side = pick(rng, one.aisles_m), pick(rng, (-1, 1))
        x = (k + 0.5 - count / 2) * 1.6 * one.row_m / count
        tilt, roll = np.deg2rad(rng.uniform(1.0, 8.0)), np.deg2rad(np.clip(rng.normal(0.0, 1.2), -4, 4))
        yaw = -side * np.pi / 2 + rng.normal(0.0, 0.4)
        posts.append(Mast(x, y + side * (_AISLE_M / 2 - 0.75), one.top_m - 0.5, float(yaw), float(tilt), float(roll)))
    return posts


def _around(rng: np.random.Generator, one: Storey) -> list[Thing]:
    """Return houses and trees around a garage above the ground."""
    things: list[Thing] = []
    gap = rng.uniform(9.0, 25.0)
    for yaw, out, half in ((0.0, one.high_y_m, one.half_x_m), (np.pi, -one.low_y_m, one.half_x_m),
                           (-np.pi / 2, one.half_x_m, 25.0), (np.pi / 2, one.half_x_m, 25.0)):  # fmt: skip
        c, s = np.cos(yaw), np.sin(yaw)
        for u in np.arange(-half + 8.0, half, 26.0).tolist():
            if rng.random() < 0.7:
                thing = town_house(rng, rng.uniform(12.0, 24.0), 11.0, True)
                things.append(place_at(thing, c * u - s * (out + gap), s * u + c * (out + gap), yaw))
        for u in rng.uniform(-half, half, int(rng.integers(0, 4))).tolist():
            v = out + 5.0
            things.append(place_at(tree(rng, 2.5, 6.0), c * u - s * v, s * u + c * v))
    return things


def _traffic(rng: np.random.Generator, plan: AgentPlan, one: Storey) -> list[Rider]:
    """Return slow cars both ways in the aisles, and people who walk along them."""
    roam = one.row_m + 1.5
    lanes: list[tuple[Lane, float]] = []
    for y in one.aisles_m:
        lanes += [(straight_lane(0.0, y - 1.4, 0.0), roam), (straight_lane(0.0, y + 1.4, np.pi), roam)]
    riders = aisles_driven(rng, plan, lanes, (12.0, 60.0, 240.0))
    for y in one.aisles_m:
        riders += aisle_walkers(rng, y, roam - 2.0, roam, plan.duration_s)
    return riders
