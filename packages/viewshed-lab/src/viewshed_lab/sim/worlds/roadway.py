"""Roads that bend and climb: axis, banks, terrain, and rows of things along them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed_lab.sim.assets.shapes import material_index
from viewshed_lab.sim.assets.street import pick, place_at
from viewshed_lab.sim.terrain import Terrain
from viewshed_lab.sim.world import Thing
from viewshed_lab.sim.worlds.layout import Mast, Span, mast
from viewshed_lab.sim.worlds.outdoor_ground import Relief
from viewshed_lab.sim.worlds.traffic import Lane, line_lane

HALF_M = 112.0
"""Half the side of a world."""

_CROWN, _MAX_LINES = 0.02, 46

_ROUGH_FROM_M, _ROUGH_OVER_M = 6.0, 20.0
"""Distances beyond the bank at which the roughness of the land begins, and at which it is full."""


@dataclass(frozen=True, slots=True)
class Bend:
    """The axis of a road: a sine along x through the origin."""

    swing_m: float  # amplitude
    wave_m: float  # wavelength
    phase: float  # of the sine

    def axis(self, x: F64) -> F64:
        """Return y of the axis in meters."""
        turn = 2 * np.pi / self.wave_m
        return np.asarray(self.swing_m * (np.sin(turn * x + self.phase) - np.sin(self.phase)))

    def heading(self, x: F64) -> F64:
        """Return the heading of the axis in radians."""
        turn = 2 * np.pi / self.wave_m
        return np.asarray(np.arctan(self.swing_m * turn * np.cos(turn * x + self.phase)))

    def at(self, x_m: float, across_m: float) -> tuple[float, float, float]:
        """Return x, y and heading at ``across_m`` meters left of the axis."""
        yaw = float(self.heading(np.array(x_m)))
        y = float(self.axis(np.array(x_m)))
        return x_m - across_m * float(np.sin(yaw)), y + across_m * float(np.cos(yaw)), yaw

    def put(self, thing: Thing, x_m: float, across_m: float, turn: float = 0.0) -> Thing:
        """Return the thing beside the axis at ``x_m``, turned from its heading."""
        x, y, yaw = self.at(x_m, across_m)
        return place_at(thing, x, y, yaw + turn)

    def lane(self, across_m: float, back: bool) -> Lane:
        """Return the lane ``across_m`` meters left of the axis, along it or ``back``; its meter 0 is at x = 0."""
        x = np.arange(-1500.0, 1501.0, 10.0)
        yaw = self.heading(x)
        xy = np.column_stack([x - across_m * np.sin(yaw), self.axis(x) + across_m * np.cos(yaw)])
        line = line_lane(xy[::-1] if back else xy)
        return Lane(line.xy_m, line.arc_m - line.arc_m[len(x) // 2], line.yaw)

    def coordinates(self, x: F64, y: F64) -> tuple[F64, F64]:
        """Return x of the nearest point of the axis, and the distance to its left, of points (…,), meters.

        Two Newton steps from the point beside: exact to a few centimeters within 30 m of gentle bends.
        """
        along = np.asarray(x, np.float64)
        for _ in range(2):
            yaw = self.heading(along)
            along = along + ((x - along) * np.cos(yaw) + (y - self.axis(along)) * np.sin(yaw)) * np.cos(yaw)
        yaw = self.heading(along)
        return along, (y - self.axis(along)) * np.cos(yaw) - (x - along) * np.sin(yaw)


def random_bend(rng: np.random.Generator, steepest: float, waves_m: Span = (150.0, 420.0)) -> Bend:
    """Return an axis whose heading differs from x by at most about ``steepest`` radians."""
    wave = rng.uniform(*waves_m)
    return Bend(rng.uniform(0.1, 1.0) * steepest * wave / (2 * np.pi), wave, rng.uniform(0, 2 * np.pi))


@dataclass(frozen=True, slots=True)
class Bank:
    """The ground beside a road, from the edge of its shoulder outward."""

    beyond_m: tuple[float, ...]  # ascending distances from the edge, the first 0
    rise_m: tuple[float, ...]  # heights there above the edge; constant beyond the last one

    def at(self, beyond: F64) -> F64:
        """Return heights above the edge at distances (…,) beyond it, in meters."""
        return np.asarray(np.interp(beyond, self.beyond_m, self.rise_m))


LEVEL = (Bank((0.0, 1.0), (0.0, 0.0)),) * 2
"""Level ground on the left and on the right."""


@dataclass(frozen=True, slots=True)
class Swell:
    """Variation of the banks' height along a road: ``mean`` + ``share`` · sin(2π x / ``wave_m`` + ``phase``)."""

    mean: float = 1.0
    share: float = 0.0
    wave_m: float = 200.0
    phase: float = 0.0

    def at(self, along: F64) -> F64:
        """Return the factor (…,) of the banks' heights."""
        return np.asarray(self.mean + self.share * np.sin(2 * np.pi * along / self.wave_m + self.phase))


AS_HIGH = Swell()
"""Banks of the same height all along."""

EVEN = Relief((0.0, 0.0), (0.0, 0.0), (100.0, 100.0), (0.0, 0.0))
"""Level land."""


@dataclass(frozen=True, slots=True)
class Roadway:
    """A road of one to three lanes each way on a bend, with a bank at either side."""

    bend: Bend  # its axis
    grade: Relief  # heights along it; only its part along x counts
    lanes: int  # each way
    lane_m: float  # width of a lane
    shoulder_m: float  # from the outermost lane to where the banks begin
    banks: tuple[Bank, Bank]  # on the left and on the right
    swell: Swell = AS_HIGH  # variation of the banks' heights along the road
    rough: Relief = EVEN  # relief of the land away from it
    soil: str = "grass"  # material of the banks
    paved: str = "asphalt"  # material of the road

    @property
    def edge_m(self) -> float:
        """From the axis to where the banks begin."""
        return self.lanes * self.lane_m + self.shoulder_m

    def foot_m(self, side: int) -> float:
        """From the axis to where the land is level, left (1) or right (-1)."""
        return self.edge_m + self.bank(side).beyond_m[-1]

    def lane_lines(self) -> list[Lane]:
        """Return the lanes: from the innermost outward, in alternating directions."""
        across = [(k + 0.5) * self.lane_m for k in range(self.lanes)]
        return [self.bend.lane(at if back else -at, back) for at in across for back in (False, True)]

    def height(self, x: F64, y: F64) -> F64:
        """Return the ground's z in meters at points of equal shape."""
        along, across = self.bend.coordinates(x, y)
        off = np.abs(across)
        left, right = (bank.at(off - self.edge_m) for bank in self.banks)
        bank = np.where(across > 0, left, right) * self.swell.at(along)
        road = self.grade.at(along, np.zeros_like(along)) - _CROWN * np.clip(off, 0.0, self.edge_m)
        wide = np.where(across > 0, self.banks[0].beyond_m[-1], self.banks[1].beyond_m[-1])
        free = np.clip((off - self.edge_m - wide - _ROUGH_FROM_M) / _ROUGH_OVER_M, 0.0, 1.0)
        return np.asarray(road + bank + free * self.rough.at(x, y))

    def material(self, x: F64, y: F64) -> NDArray[np.uint8]:
        """Return the material of the ground, rows (…,) of ``MATERIALS``."""
        _, across = self.bend.coordinates(x, y)
        paved = np.abs(across) < self.edge_m - 0.3
        return np.where(paved, material_index(self.paved), material_index(self.soil)).astype(np.uint8)

    def terrain(self, along_m: float = 5.0, across_m: float = 1.4) -> Terrain:
        """Return the terrain: lines ``along_m`` apart in x, and ``across_m`` in y where road and banks lie."""
        x_m = np.linspace(-HALF_M, HALF_M, round(2 * HALF_M / along_m) + 1)
        axis = self.bend.axis(np.linspace(-HALF_M, HALF_M, 60))
        low, high = float(axis.min()) - self.foot_m(-1) - 1.0, float(axis.max()) + self.foot_m(1) + 1.0
        low, high = max(low, -HALF_M + 12.0), min(high, HALF_M - 12.0)
        near = np.linspace(low, high, min(max(2, round((high - low) / across_m)), _MAX_LINES))
        far = [np.linspace(-HALF_M, low, 7)[:-1], near, np.linspace(high, HALF_M, 7)[1:]]
        return Terrain.of(x_m, np.concatenate(far), self.height, self.material)

    def bank(self, side: int) -> Bank:
        """Return the bank on the left (1) or on the right (-1)."""
        return self.banks[0] if side > 0 else self.banks[1]


def row(
    bend: Bend, maker: Callable[[float], Thing], span_m: Span, across_m: float, piece_m: float = 8.0, turn: float = 0.0
) -> list[Thing]:
    """Return pieces of a rail, fence, hedge or wall that follow a bend, ``maker(length)`` each.

    Pieces lie along x of their own frame; they are 5 cm shorter than their part of the line ``across_m`` from the axis.
    """
    count = max(1, round((span_m[1] - span_m[0]) / piece_m))
    edges = np.linspace(*span_m, count + 1)
    things = []
    for start, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        (x0, y0, _), (x1, y1, _) = bend.at(start, across_m), bend.at(end, across_m)
        piece = maker(max(float(np.hypot(x1 - x0, y1 - y0)) - 0.05, 0.2))
        things.append(place_at(piece, (x0 + x1) / 2, (y0 + y1) / 2, float(np.arctan2(y1 - y0, x1 - x0)) + turn))
    return things


def masts_beside(
    rng: np.random.Generator, count: int, bend: Bend, across_m: float, sides: Sequence[int] = (-1, 1)
) -> list[Mast]:
    """Return ``count`` masts along the middle 80 m of a road, ``across_m`` from its axis, that look at it."""
    masts_placed = []
    for k in range(count):
        side, along = pick(rng, sides), (k + 0.5 - count / 2) * 80.0 / count + rng.uniform(-5, 5)
        x, y, _ = bend.at(along, side * across_m)
        masts_placed.append(mast(rng, x, y, bend.at(along + rng.uniform(-20, 20), 0.0)[:2]))
    return masts_placed
