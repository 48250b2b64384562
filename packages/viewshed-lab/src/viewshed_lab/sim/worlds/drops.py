"""Ground that falls away beside a drive lane: pits and quays with upright faces, ramps into them, what guards them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed_lab.sim.assets.shapes import material_index
from viewshed_lab.sim.assets.street import concrete_barrier, cone, fence, guard_rail, place_at, pole, work_barrier
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import Thing
from viewshed_lab.sim.worlds.layout import Rect, Span, lines_of, within
from viewshed_lab.sim.worlds.roadway import HALF_M, Roadway

FACE_M = 0.03
"""Width over which the ground falls at an upright face."""


@dataclass(frozen=True, slots=True)
class Drop:
    """A part of the ground that lies lower, with upright faces."""

    rect: Rect  # where
    deep_m: float  # below the road beside its middle, level
    floor: str  # what it is made of; ``absorber`` is water
    # a part of ``rect`` whose end at the lowest x is on the ground's level and whose other end on the floor's, or None
    ramp: Rect | None = None

    def lines(self) -> tuple[list[float], list[float]]:
        """Return where the ground has its edges, in x and in y."""
        rects = [self.rect] if self.ramp is None else [self.rect, self.ramp]
        return ([edge + step for one in rects for edge in one[::2] for step in (-FACE_M / 2, FACE_M / 2)],
                [edge + step for one in rects for edge in one[1::2] for step in (-FACE_M / 2, FACE_M / 2)])  # fmt: skip

    def edges(self) -> list[shapely.Polygon]:
        """Return where nothing may stand: within 0.3 m of its faces, and on its ramp."""
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
    """Return what guards an edge along x: a rail, a barrier, a fence, posts, boards, cones, or nothing at all."""
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
