"""The ground of outdoor worlds: slope, gentle relief, roads with crown and curbs, speed bumps, sidewalks, lawns."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed_lab.sim.assets.shapes import material_index
from viewshed_lab.sim.terrain import Terrain

_CURB_WIDTH_M = 0.03
_CROWN = 0.02
_FALL = 0.015
_BUMP_HALF_M, _BUMP_M = 1.0, 0.09


@dataclass(frozen=True, slots=True)
class Relief:
    """A slope with long waves on it."""

    slope: tuple[float, float]  # rise per meter of x and of y
    wave_m: tuple[float, float]  # height of the waves along x and y
    length_m: tuple[float, float]  # length of the waves along x and y
    phase: tuple[float, float]  # of the waves, radians

    def at(self, x: F64, y: F64) -> F64:
        """Return heights in meters at x and y of equal shape."""
        height = self.slope[0] * x + self.slope[1] * y
        for along, wave, length, phase in zip((x, y), self.wave_m, self.length_m, self.phase, strict=True):
            height = height + wave * np.sin(2 * np.pi * along / length + phase)
        return np.asarray(height)


def relief(rng: np.random.Generator, steepest: float = 0.06, wave_m: float = 0.5) -> Relief:
    """Return a slope, mostly gentle, of at most ``steepest``, with waves of 90 to 220 m."""
    slope, turn = steepest * 0.8 * rng.random() ** 2, rng.uniform(0, 2 * np.pi)
    ways = (float(slope * np.cos(turn)), float(slope * np.sin(turn)))
    waves = (rng.uniform(0, wave_m), rng.uniform(0, wave_m))
    lengths = (rng.uniform(90, 220), rng.uniform(90, 220))
    return Relief(ways, waves, lengths, (rng.uniform(0, 6.28), rng.uniform(0, 6.28)))


@dataclass(frozen=True, slots=True)
class Road:
    """The cross-section of a straight road with curbs."""

    half_m: float  # from its axis to the curb
    walk_m: float  # width of the sidewalk beyond the curb
    curb_m: float  # height of the curb

    @property
    def edge_m(self) -> float:
        """Distance from the axis to the outer edge of the sidewalk, where the lots begin."""
        return self.half_m + self.walk_m

    def lines(self) -> list[float]:
        """Return the positions of the ground's edges across the road."""
        right = [self.half_m, self.half_m + _CURB_WIDTH_M, self.edge_m]
        return [0.0, *right, *(-line for line in right)]


@dataclass(frozen=True, slots=True)
class Ground:
    """Roads along x and y through the origin, sidewalks along them, and lots between."""

    relief: Relief  # relief of the land
    along: Road  # the road along x
    across: Road | None = None  # the road along y, or None
    lot_m: float = 0.0  # height of the lots above the sidewalk
    lot_material: str = "grass"  # material of the lots
    bumps_m: tuple[float, ...] = ()  # x of speed bumps across the road

    def terrain(self, half_x_m: float, half_y_m: float, step_m: float = 9.0) -> Terrain:
        """Return the terrain over ±half_x and ±half_y meters, with lines at most about ``step_m`` apart."""
        bumps = [at + shift for at in self.bumps_m for shift in (-_BUMP_HALF_M, -0.5, 0.5, _BUMP_HALF_M)]
        x_m = _lines(half_x_m, step_m, (self.across.lines() if self.across else []) + bumps)
        y_m = _lines(half_y_m, step_m, self.along.lines())
        return Terrain.of(x_m, y_m, self._height, self._material)

    def _height(self, x: F64, y: F64) -> F64:
        beyond, walk = self._curb_distance(x, y)
        road = _crown(self.along, y)
        curb_m = self.along.curb_m
        if self.across is not None:
            road, curb_m = np.maximum(road, _crown(self.across, x)), max(curb_m, self.across.curb_m)
        raised = curb_m + _FALL * np.clip(beyond, 0.0, walk) + self.lot_m * (beyond > walk + 0.5)
        profile = np.where(beyond > _CURB_WIDTH_M / 2, raised, road)
        for at in self.bumps_m:
            profile = profile + _BUMP_M * (beyond < -0.3) * np.interp(np.abs(x - at), [0.5, _BUMP_HALF_M], [1.0, 0.0])
        return np.asarray(self.relief.at(x, y) + profile)

    def _material(self, x: F64, y: F64) -> NDArray[np.uint8]:
        beyond, walk = self._curb_distance(x, y)
        lot, paving, road = (material_index(name) for name in (self.lot_material, "concrete", "asphalt"))
        return np.where(beyond > walk, lot, np.where(beyond > 0.0, paving, road)).astype(np.uint8)

    def _curb_distance(self, x: F64, y: F64) -> tuple[F64, F64]:
        """Return the distance of each point beyond the nearest curb (negative on a road), and the sidewalk's width."""
        far = np.full(np.broadcast(x, y).shape, np.inf)
        walk = np.zeros_like(far)
        for road, across in ((self.along, y), (self.across, x)):
            if road is not None:
                beyond = np.abs(across) - road.half_m
                walk = np.where(beyond - road.walk_m < far - walk, road.walk_m, walk)
                far = np.minimum(far, beyond)
        return far, walk


def _crown(road: Road, across: F64) -> F64:
    return np.asarray(_CROWN * np.clip(road.half_m - np.abs(across), 0.0, None))


def _lines(half_m: float, step_m: float, edges: list[float]) -> F64:
    """Return ascending lines: the edges, and evenly spaced lines in gaps wider than a step."""
    inner = sorted({round(edge, 4) for edge in edges if abs(edge) < half_m - 0.5})
    known = [-half_m, *inner, half_m]
    pieces = [np.linspace(a, b, max(1, round((b - a) / step_m)) + 1)[:-1] for a, b in pairwise(known)]
    return np.concatenate([*pieces, [half_m]])
