"""Attackers who know every rule of a monitor and keep them as far as physics permits (family 15).

A whole object vanishes before the background that its neighborhood shows; a real object appears a second time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from viewshed.arrays import F64, Mask
from viewshed.sweep import Sweep
from viewshed_lab._config import Azimuth, Budget, Checked, Range, Sector
from viewshed_lab.threats.attacks.base import Tampered, Wedge
from viewshed_lab.threats.attacks.beam_lattice import Rays, lattice_of, rays_in
from viewshed_lab.threats.attacks.spoofer import (
    FULL_CIRCLE,
    LEAVE,
    NO_RETURN,
    Spoofer,
    is_obstacle,
    level_rays,
    scene_of,
    untouched,
)

Ints = NDArray[np.intp]

EXACT_SPOOFER = Spoofer(1.0, 0.0, 0.0)
"""One that wins every beam it aims at and adds no noise: its ranges have that of the sensor already."""

_JUMP_M = 1.2
"""Returns of neighboring beams belong to one object where their depths differ by less."""

_REACH = 2
"""Beams are neighbors up to this number of rings and columns apart: a lost one does not cut an object in two."""

_BASE_DEPTH_M = 0.5
"""Returns below an object, too low for an obstacle, and less than this nearer or farther, are the object's base."""

_SIDE = 8
"""Columns to either side of a gap whose beams tell what is behind it."""

_BEHIND_M = 0.3
"""Least distance of a background behind what it replaces."""

_FEWEST = 12
"""Returns of the smallest object that is worth an attack."""

_VANISHING_SHARE = 0.5
"""An object vanishes where something is known to lie behind at least this share of its beams."""

_DOWN = -0.005
"""Beams that fall by less than this a meter show no ground that could be continued."""

_ON_GROUND_M = 0.8
"""What stands on the ground has a return lower than this; what hangs hides nothing."""

_OPEN_M = 3.0
"""Half of the beams of a copy went farther than it by at least this."""

_OCCLUDED_SHARE = 0.1
"""Beams of a copy that something nearer may keep."""

_PLACES = 300
"""Objects and azimuths that are tried for a copy."""

_MARGIN_DEG = 4.0
"""Margin of a wedge about what vanishes or appears: returns seen from a start beside the sensor move sideways."""

_GROUND_M = 0.2
"""Largest difference of the ground's height below a copy and below its object."""


@dataclass(frozen=True, slots=True, eq=False)
class _RayImage:
    """All beams of a sweep, R rings by C columns."""

    rays: Rays  # (K,) of the sweep
    number: Ints  # (R, C) of the ray of each pixel, -1 where none was fired
    depth_m: F64  # (R, C) +inf where there is no return
    objects: Ints  # (R, C) number of the object that each pixel belongs to, -1 for none
    count: int  # how many objects there are

    @property
    def obstacle(self) -> Mask:
        """Whether each pixel (R, C) belongs to an object."""
        return self.objects >= 0


@lru_cache(maxsize=2)
def _image_of(sweep: Sweep) -> _RayImage:
    """Return the beams of a sweep with its objects: obstacles that hang together in depth."""
    rays = rays_in(sweep, FULL_CIRCLE, empty=True)
    rays = rays.select(rays.ring >= 0)
    lattice = lattice_of(sweep)
    shape = (0, 0) if lattice is None else lattice.rows.shape
    number = np.full(shape, -1)
    number[rays.ring, rays.column] = np.arange(len(rays))
    depth_m, obstacle = np.full(shape, np.inf), np.zeros(shape, np.bool_)
    depth_m[rays.ring, rays.column] = rays.depth_m
    obstacle[rays.ring, rays.column] = is_obstacle(sweep, rays)
    return _RayImage(rays, number, depth_m, *_objects(depth_m, obstacle))


def _objects(depth_m: F64, obstacle: Mask) -> tuple[Ints, int]:
    """Return the object (R, C) of each obstacle pixel and their number: neighbors that are about as far away."""
    pixels = np.arange(depth_m.size).reshape(depth_m.shape)
    pairs = []
    for step in range(1, _REACH + 1):
        turned = np.roll(np.where(obstacle, depth_m, np.inf), -step, axis=1)
        with np.errstate(invalid="ignore"):
            along = obstacle & (np.abs(turned - depth_m) < _JUMP_M)
            up = obstacle[:-step] & obstacle[step:] & (np.abs(depth_m[:-step] - depth_m[step:]) < _JUMP_M)
        pairs.append(np.stack([pixels[along], np.roll(pixels, -step, axis=1)[along]]))
        pairs.append(np.stack([pixels[:-step][up], pixels[step:][up]]))
    one, other = np.concatenate(pairs, axis=1)
    graph = coo_array((np.ones(len(one), np.int8), (one, other)), shape=(depth_m.size, depth_m.size))
    _, label = connected_components(graph, directed=False)
    objects = np.full(depth_m.shape, -1)
    _, objects[obstacle] = np.unique(label.reshape(depth_m.shape)[obstacle], return_inverse=True)
    return objects, int(objects.max(initial=-1)) + 1


@dataclass(frozen=True, slots=True, eq=False)
class _Object:
    """The pixels of one object, its low parts included."""

    ring: Ints  # (P,) of its pixels
    column: Ints  # (P,) from ``first`` on, without the turn at the end of the circle
    first: int  # its first column
    columns: int  # how many columns it has


@lru_cache(maxsize=2)
def _objects_in_reach(sweep: Sweep, near_m: float, sector_deg: float, budget: int | None) -> list[_Object]:
    """Return the objects nearer than ``near_m`` that stand on the ground, fit into a sector and have few enough beams.

    An object whose returns are too few is none.
    """
    image = _image_of(sweep)
    circle = image.depth_m.shape[1]
    ring, column = np.nonzero(image.obstacle)
    label, depth_m = image.objects[ring, column], image.depth_m[ring, column]
    near = np.full(image.count, np.inf)
    np.minimum.at(near, label, depth_m)
    fits = (near < near_m) & (np.bincount(label, minlength=image.count) >= _FEWEST)
    found = []
    for number in np.flatnonzero(fits):
        mine = label == number
        first, width = _arc(column[mine], circle)
        rays = image.rays.select(image.number[ring[mine], column[mine]])
        if width * 360.0 / circle + _MARGIN_DEG < sector_deg and _lowest_m(sweep, rays, rays.depth_m) < _ON_GROUND_M:
            ahead = (column[mine] - first) % circle
            found.append(_with_base(image, ring[mine], ahead, first, width))
    return [one for one in found if budget is None or len(one.ring) <= budget]


def _arc(column: Ints, circle: int) -> tuple[int, int]:
    """Return the first column and the width of the shortest arc that holds all of some columns."""
    some = np.unique(column)
    gap = np.diff(some, append=some[0] + circle)
    widest = int(gap.argmax())
    return int(some[(widest + 1) % len(some)]), int(circle - gap[widest] + 1)


def _with_base(image: _RayImage, ring: Ints, ahead: Ints, first: int, width: int) -> _Object:
    """Return an object with the pixels right below it in each column that are about as near, too low for obstacles."""
    circle = image.depth_m.shape[1]
    lowest = np.full(width, image.depth_m.shape[0])
    np.minimum.at(lowest, ahead, ring)
    rings, columns = [ring], [ahead]
    for at in range(width):
        bottom = int(lowest[at])
        if bottom == image.depth_m.shape[0]:
            continue
        depth_m = image.depth_m[:bottom, (first + at) % circle]
        own_m = image.depth_m[bottom, (first + at) % circle]
        low = np.flatnonzero(np.abs(depth_m - own_m) < _BASE_DEPTH_M)
        rings.append(low)
        columns.append(np.full(len(low), at))
    return _Object(np.concatenate(rings), np.concatenate(columns), first, width)


@dataclass(frozen=True, slots=True)
class _OfObjects(Checked):
    """The parameters that attacks on the objects near a sensor share."""

    budget: Budget = None  # objects with more beams are left alone; None for any
    sector_deg: Sector = 30.0  # objects must be narrower than this
    azimuth: Azimuth = None  # in the sensor's frame, of the object nearest to it or of the copy; None draws one
    near_m: Range = 25.0  # objects nearer than this vanish, or are copied
    spoofer: Spoofer = EXACT_SPOOFER  # how well the beams are won


@dataclass(frozen=True, slots=True)
class VanishedObject(_OfObjects):
    """A whole object vanishes: each of its beams reports what the same ring shows beside the object.

    Ground goes on where both sides show ground, at the heights that they show; else the farther side goes on. No part
    of the object is left, nothing lies below the ground, nothing is seen through; noise and lost beams are as beside
    it. Without an object that fits into the sector nothing is done.
    """

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        image = _image_of(sweep)
        objects = _objects_in_reach(sweep, self.near_m, self.sector_deg, self.budget)
        if self.azimuth is None:
            objects = _drawn(objects, rng)
        else:  # the nearest first
            apart = np.array([_azimuth_of(image, one) for one in objects]) - self.azimuth
            objects = [objects[k] for k in np.argsort(np.abs((apart + np.pi) % (2 * np.pi) - np.pi), kind="stable")]
        for chosen in objects:
            number, background_m = _background(sweep, image, chosen, rng)
            behind = background_m > image.rays.depth_m[number] + _BEHIND_M
            if behind.mean() > _VANISHING_SHARE:
                wanted_m = np.full(len(image.rays), LEAVE)
                wanted_m[number] = np.where(behind, background_m, LEAVE)
                return self.spoofer.spoof(sweep, image.rays, wanted_m, _wedge_of(image, number), rng)
        return untouched(sweep)


def _drawn(objects: list[_Object], rng: np.random.Generator) -> list[_Object]:
    """Return the objects in an order drawn at random, as :func:`_random_one` draws them."""
    left, order = list(objects), list[_Object]()
    while left:
        order.append(left.pop(_random_one(left, rng)))
    return order


def _random_one(objects: list[_Object], rng: np.random.Generator) -> int:
    """Return the number of an object drawn in proportion to its returns: large ones hide more."""
    returns = np.array([len(one.ring) for one in objects], np.float64)
    return int(rng.choice(len(objects), p=returns / returns.sum()))


def _azimuth_of(image: _RayImage, one: _Object) -> float:
    """Return the azimuth of an object's middle in the sensor's frame."""
    number = image.number[one.ring, (one.first + one.column) % image.depth_m.shape[1]]
    return _wedge_of(image, number[number >= 0]).azimuth


def _wedge_of(image: _RayImage, number: Ints) -> Wedge:
    """Return a wedge that holds some rays, with a margin for their returns at other depths."""
    x, y, _ = image.rays.direction[number].T
    azimuth = np.arctan2(y, x)
    middle = float(np.arctan2(np.sin(azimuth).mean(), np.cos(azimuth).mean()))
    apart = np.abs((azimuth - middle + np.pi) % (2 * np.pi) - np.pi)
    return Wedge(middle, min(2 * float(apart.max()) + np.deg2rad(_MARGIN_DEG), 2 * np.pi))


@dataclass(frozen=True, slots=True, eq=False)
class _Side:
    """What the beams of a ring show beside a gap."""

    depth_m: float  # their median depth, +inf where most did not return
    height_m: float  # their median height in the level frame where they show ground, else NaN
    residual_m: F64  # (S,) how far each return is behind a straight line through them
    lost_share: float  # of the beams, those that did not return


_NOTHING_SEEN = _Side(np.inf, np.nan, np.zeros(1), 0.0)


def _background(sweep: Sweep, image: _RayImage, chosen: _Object, rng: np.random.Generator) -> tuple[Ints, F64]:
    """Return the rays (P,) of an object and what they would report without it, in meters, by the beams beside it."""
    circle = image.depth_m.shape[1]
    number = image.number[chosen.ring, (chosen.first + chosen.column) % circle]
    start, direction = level_rays(sweep, image.rays)
    background_m = np.full(len(number), NO_RETURN)
    for ring in np.unique(chosen.ring[number >= 0]):
        mine = (chosen.ring == ring) & (number >= 0)
        ahead = chosen.column[mine]
        low, high = int(ahead.min()), int(ahead.max())
        left, right = (
            _side(image, start, direction, ring, (chosen.first + first + np.arange(_SIDE)) % circle)
            for first in (low - _SIDE, high + 1)
        )
        share = (ahead - low + 1) / (high - low + 2)
        background_m[mine] = _between(left, right, share, start[number[mine], 2], direction[number[mine], 2], rng)
    fired = number >= 0
    return number[fired], background_m[fired]


def _side(image: _RayImage, start: F64, direction: F64, ring: int, columns: Ints) -> _Side:
    """Return what the beams of a ring show in some columns (_SIDE,)."""
    number = image.number[ring, columns]
    number = number[number >= 0]
    seen = number[np.isfinite(image.rays.depth_m[number])]
    if len(seen) * 2 < len(columns):
        return _NOTHING_SEEN
    lost_share = 1.0 - len(seen) / len(number)
    ground = ~image.obstacle[ring, image.rays.column[seen]] & (direction[seen, 2] < _DOWN)
    if ground.sum() * 2 <= len(seen):
        depth_m = image.rays.depth_m[seen]
        return _Side(float(np.median(depth_m)), np.nan, _residuals(depth_m), lost_share)
    seen = seen[ground]
    depth_m = image.rays.depth_m[seen]
    height_m = float(np.median(start[seen, 2] + depth_m * direction[seen, 2]))
    off_m = depth_m - (height_m - start[seen, 2]) / direction[seen, 2]
    return _Side(float(np.median(depth_m)), height_m, _residuals(off_m), lost_share)


def _residuals(depth_m: F64) -> F64:
    """Return how far depths (S,) are off a straight line through them, as large as their noise is."""
    if len(depth_m) < 4:
        return np.zeros(1)
    along = np.arange(len(depth_m))
    slope, at_first_m = np.polyfit(along, depth_m, 1)
    off_m: F64 = (depth_m - at_first_m - slope * along) * np.sqrt(len(depth_m) / (len(depth_m) - 2))
    return off_m


def _between(left: _Side, right: _Side, share: F64, start_z: F64, down: F64, rng: np.random.Generator) -> F64:
    """Return depths (P,) between two sides, ``share`` (P,) of the way from left to right.

    Ground between ground, its height by that of both; a surface between two of about the same depth; else what is
    farther goes on to the other side's edge. Noise and losses are those of the sides. Rays start at ``start_z`` (P,)
    and fall by ``down`` (P,) a meter.
    """
    sides = [left, right]
    if np.isfinite(left.height_m) and np.isfinite(right.height_m):
        depth_m = _to_ground(left.height_m + share * (right.height_m - left.height_m), start_z, down)
    elif abs(left.depth_m - right.depth_m) < 0.1 * min(left.depth_m, right.depth_m) and np.isfinite(left.depth_m):
        depth_m = left.depth_m + share * (right.depth_m - left.depth_m)
    else:
        sides = [max(sides, key=lambda side: side.depth_m)]
        ground_m = _to_ground(sides[0].height_m, start_z, down)
        depth_m = ground_m if np.isfinite(sides[0].height_m) else np.full(len(share), sides[0].depth_m)
    residual_m = np.concatenate([side.residual_m for side in sides])
    lost = rng.random(len(share)) < np.mean([side.lost_share for side in sides])
    return np.where(lost, NO_RETURN, depth_m + rng.choice(residual_m, len(share)))


def _to_ground(height_m: F64 | float, start_z: F64, down: F64) -> F64:
    return np.where(down < _DOWN, (height_m - start_z) / np.minimum(down, _DOWN), NO_RETURN)


@dataclass(frozen=True, slots=True)
class CopiedObject(_OfObjects):
    """A real object of the sweep appears a second time, at another azimuth, before everything that is there.

    Its surface, edges, noise and losses are those of a real one. It stands on ground of the same height, where the view
    is open. Without such an object and place nothing is done. At a given azimuth the largest object that fits is shown.
    """

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        image = _image_of(sweep)
        objects = _objects_in_reach(sweep, self.near_m, self.sector_deg, self.budget)
        circle = image.depth_m.shape[1]
        for chosen, turn in self._places(image, objects, rng):
            column = (chosen.first + chosen.column) % circle
            number = image.number[chosen.ring, (column + turn) % circle]
            depth_m = image.depth_m[chosen.ring, column]
            number, depth_m = number[number >= 0], depth_m[number >= 0]
            if len(number) and _is_open(sweep, image, chosen, turn, depth_m, number):
                hollows = _hollows(image, chosen, turn)
                left = len(hollows) if self.budget is None else self.budget - len(number)
                wanted_m = np.full(len(image.rays), LEAVE)
                wanted_m[hollows[:left]] = NO_RETURN
                wanted_m[number] = np.where(image.rays.depth_m[number] > depth_m - _BASE_DEPTH_M, depth_m, LEAVE)
                return self.spoofer.spoof(sweep, image.rays, wanted_m, _wedge_of(image, number), rng)
        return untouched(sweep)

    def _places(
        self, image: _RayImage, objects: list[_Object], rng: np.random.Generator
    ) -> Iterator[tuple[_Object, int]]:
        """Yield objects and the columns by which each is turned: as it comes, or the largest first to one azimuth."""
        circle = image.depth_m.shape[1]
        if self.azimuth is None:
            for turn in rng.integers(circle, size=_PLACES if objects else 0):
                yield objects[_random_one(objects, rng)], int(turn)
            return
        for one in sorted(objects, key=lambda one: -len(one.ring)):
            yield one, round((self.azimuth - _azimuth_of(image, one)) * circle / (2 * np.pi)) % circle


def _is_open(sweep: Sweep, image: _RayImage, chosen: _Object, turn: int, depth_m: F64, number: Ints) -> bool:
    """Return whether a copy would stand before all that is there, apart from the object itself, on level ground."""
    circle = image.depth_m.shape[1]
    apart = min(turn, circle - turn)
    farther_m = image.rays.depth_m[number] - depth_m
    occluded = np.mean(farther_m < -_BASE_DEPTH_M)
    if apart <= chosen.columns + _SIDE or occluded > _OCCLUDED_SHARE or np.median(farther_m) < _OPEN_M:
        return False
    source = image.number[chosen.ring, (chosen.first + chosen.column) % circle]
    lowest_m = _lowest_m(sweep, image.rays.select(source), image.rays.depth_m[source])
    return abs(_lowest_m(sweep, image.rays.select(number), depth_m) - lowest_m) < _GROUND_M


def _lowest_m(sweep: Sweep, rays: Rays, depth_m: F64) -> float:
    """Return how high the lowest return of some rays (K,) at depths (K,) is above the ground."""
    start, direction = level_rays(sweep, rays)
    points = start + depth_m[:, None] * direction
    return float((points[:, 2] - scene_of(sweep).ground.at(points[:, :2])).min())


def _hollows(image: _RayImage, chosen: _Object, turn: int) -> Ints:
    """Return the rays below a copy's upper edge whose pixels of the real object did not return: nor may these."""
    circle = image.depth_m.shape[1]
    low, high = np.full(chosen.columns, image.depth_m.shape[0]), np.full(chosen.columns, -1)
    np.minimum.at(low, chosen.column, chosen.ring)
    np.maximum.at(high, chosen.column, chosen.ring)
    ring, ahead = np.indices((image.depth_m.shape[0], chosen.columns))
    within = (ring > low) & (ring < high)
    column = (chosen.first + ahead) % circle
    lost = within & (image.number[ring, column] >= 0) & np.isinf(image.depth_m[ring, column])
    number: Ints = image.number[ring[lost], (column[lost] + turn) % circle]
    return number[number >= 0]
