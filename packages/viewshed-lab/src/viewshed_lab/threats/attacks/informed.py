"""Attacks that know every rule of a monitor and obey them as far as physics permits (family 15).

A whole object vanishes, replaced by the background beside it; or a real object appears a second time.
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
"""Wins every attacked beam and adds no noise: the planned ranges already contain the sensor's noise."""

_JUMP_M = 1.2
"""Returns of neighboring beams belong to one object if their depths differ by less."""

_REACH = 2
"""Maximum distance of neighboring beams in rings or columns; over 1, so that a lost beam does not split an object."""

_BASE_DEPTH_M = 0.5
"""Returns below an object, too low for an obstacle, are its base if their depths differ by less than this."""

_SIDE = 8
"""Number of columns on either side of an object from which its background is estimated."""

_BEHIND_M = 0.3
"""Minimum distance of the background behind the object that it replaces."""

_MIN_RETURNS = 12
"""Minimum number of returns of an object that is attacked."""

_VANISHING_SHARE = 0.5
"""Minimum share of an object's beams with a known background."""

_DOWN = -0.005
"""Maximum z of the direction of a beam that shows ground; flatter beams show none that could be continued."""

_ON_GROUND_M = 0.8
"""The lowest return of an object on the ground is lower than this; hanging objects hide nothing."""

_OPEN_M = 3.0
"""Minimum of the median distance between a copy and the returns behind it."""

_OCCLUDED_SHARE = 0.1
"""Maximum share of a copy's beams that a nearer object occludes."""

_PLACES = 300
"""Number of random pairs of object and azimuth that are tried for a copy."""

_MARGIN_DEG = 4.0
"""Margin of the wedge: a beam that starts beside the sensor's origin has other azimuths at other depths."""

_GROUND_M = 0.2
"""Maximum difference of the ground's height below a copy and below its object."""


@dataclass(frozen=True, slots=True, eq=False)
class _RayImage:
    """Range image of a sweep, R rings by C columns, with its objects."""

    rays: Rays  # (K,) all beams with a ring
    number: Ints  # (R, C) index of the pixel's ray, -1 if none was fired
    depth_m: F64  # (R, C) +inf without a return
    objects: Ints  # (R, C) index of the pixel's object, -1 for none
    count: int  # number of objects

    @property
    def obstacle(self) -> Mask:
        """Mask (R, C) of the pixels that belong to an object."""
        return self.objects >= 0


@lru_cache(maxsize=2)
def _image_of(sweep: Sweep) -> _RayImage:
    """Return the range image of a sweep; its objects are the connected components of the obstacle pixels."""
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
    """Return the object index (R, C) of each obstacle pixel and their number: neighbors of similar depth connect."""
    pixels = np.arange(depth_m.size).reshape(depth_m.shape)
    pairs = []
    for step in range(1, _REACH + 1):
        shifted_m = np.roll(np.where(obstacle, depth_m, np.inf), -step, axis=1)
        with np.errstate(invalid="ignore"):
            along = obstacle & (np.abs(shifted_m - depth_m) < _JUMP_M)
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
    """The pixels of one object, including its base."""

    ring: Ints  # (P,) of its pixels
    column: Ints  # (P,) relative to ``first``, not wrapped
    first: int  # its first column
    columns: int  # number of its columns


@lru_cache(maxsize=2)
def _objects_in_reach(sweep: Sweep, near_m: float, sector_deg: float, budget: int | None) -> list[_Object]:
    """Return the objects nearer than ``near_m`` on the ground, within the sector's width and the budget of beams.

    Objects with too few returns are left out.
    """
    image = _image_of(sweep)
    circle = image.depth_m.shape[1]
    ring, column = np.nonzero(image.obstacle)
    label, depth_m = image.objects[ring, column], image.depth_m[ring, column]
    near = np.full(image.count, np.inf)
    np.minimum.at(near, label, depth_m)
    fits = (near < near_m) & (np.bincount(label, minlength=image.count) >= _MIN_RETURNS)
    objects = []
    for number in np.flatnonzero(fits):
        mine = label == number
        first, width = _arc(column[mine], circle)
        rays = image.rays.select(image.number[ring[mine], column[mine]])
        if width * 360.0 / circle + _MARGIN_DEG < sector_deg and _lowest_m(sweep, rays, rays.depth_m) < _ON_GROUND_M:
            ahead = (column[mine] - first) % circle
            objects.append(_with_base(image, ring[mine], ahead, first, width))
    return [one for one in objects if budget is None or len(one.ring) <= budget]


def _arc(column: Ints, circle: int) -> tuple[int, int]:
    """Return the first column and the width of the shortest arc that covers the given columns of a circle."""
    columns = np.unique(column)
    gap = np.diff(columns, append=columns[0] + circle)
    widest = int(gap.argmax())
    return int(columns[(widest + 1) % len(columns)]), int(circle - gap[widest] + 1)


def _with_base(image: _RayImage, ring: Ints, ahead: Ints, first: int, width: int) -> _Object:
    """Return the object with its base: in each column, lower pixels of similar depth that are too low for obstacles."""
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
    """Parameters of the attacks on objects near the sensor."""

    budget: Budget = None  # maximum number of beams of an object; None for any
    sector_deg: Sector = 30.0  # maximum width of an object
    azimuth: Azimuth = None  # of the vanishing object (nearest to it) or of the copy, sensor's frame; None draws one
    near_m: Range = 25.0  # objects nearer than this vanish or are copied
    spoofer: Spoofer = EXACT_SPOOFER  # success rate and range noise


@dataclass(frozen=True, slots=True)
class VanishedObject(_OfObjects):
    """A whole object vanishes: each of its beams reports what the same ring shows beside the object.

    Where both sides show ground, ground continues at their heights; else the farther side continues. No part of the
    object is left, no return lies below the ground or behind a surface, and noise and lost beams match those beside
    it. Without an object that fits into the sector, the sweep is unchanged.
    """

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and the record of its changes."""
        image = _image_of(sweep)
        objects = _objects_in_reach(sweep, self.near_m, self.sector_deg, self.budget)
        if self.azimuth is None:
            objects = _shuffled(objects, rng)
        else:  # nearest in azimuth first
            off = np.array([_azimuth_of(image, one) for one in objects]) - self.azimuth
            objects = [objects[k] for k in np.argsort(np.abs((off + np.pi) % (2 * np.pi) - np.pi), kind="stable")]
        for chosen in objects:
            number, background_m = _background(sweep, image, chosen, rng)
            behind = background_m > image.rays.depth_m[number] + _BEHIND_M
            if behind.mean() > _VANISHING_SHARE:
                target_m = np.full(len(image.rays), LEAVE)
                target_m[number] = np.where(behind, background_m, LEAVE)
                return self.spoofer.spoof(sweep, image.rays, target_m, _wedge_of(image, number), rng)
        return untouched(sweep)


def _shuffled(objects: list[_Object], rng: np.random.Generator) -> list[_Object]:
    """Return the objects in a random order, weighted as by :func:`_random_object`."""
    left, order = list(objects), list[_Object]()
    while left:
        order.append(left.pop(_random_object(left, rng)))
    return order


def _random_object(objects: list[_Object], rng: np.random.Generator) -> int:
    """Return the index of a random object, with probability proportional to its returns: large ones hide more."""
    returns = np.array([len(one.ring) for one in objects], np.float64)
    return int(rng.choice(len(objects), p=returns / returns.sum()))


def _azimuth_of(image: _RayImage, one: _Object) -> float:
    """Return the azimuth of an object's center in the sensor's frame."""
    number = image.number[one.ring, (one.first + one.column) % image.depth_m.shape[1]]
    return _wedge_of(image, number[number >= 0]).azimuth


def _wedge_of(image: _RayImage, number: Ints) -> Wedge:
    """Return a wedge around the rays ``number``, with a margin for their returns at other depths."""
    x, y, _ = image.rays.direction[number].T
    azimuth = np.arctan2(y, x)
    center = float(np.arctan2(np.sin(azimuth).mean(), np.cos(azimuth).mean()))
    off = np.abs((azimuth - center + np.pi) % (2 * np.pi) - np.pi)
    return Wedge(center, min(2 * float(off.max()) + np.deg2rad(_MARGIN_DEG), 2 * np.pi))


@dataclass(frozen=True, slots=True, eq=False)
class _Side:
    """Background that the beams of a ring show on one side of an object."""

    depth_m: float  # median depth, +inf if most beams did not return
    height_m: float  # median height in the level frame if they show ground, else NaN
    residual_m: F64  # (S,) residuals of the depths from a straight line through them
    lost_share: float  # share of beams without a return


_NOTHING_SEEN = _Side(np.inf, np.nan, np.zeros(1), 0.0)


def _background(sweep: Sweep, image: _RayImage, chosen: _Object, rng: np.random.Generator) -> tuple[Ints, F64]:
    """Return the rays (P,) of an object and their depths (P,) without it, estimated from the beams beside it."""
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
    """Return the background that a ring shows in some columns (_SIDE,)."""
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
    """Return the residuals of depths (S,) from a straight line, scaled to the standard deviation of their noise."""
    if len(depth_m) < 4:
        return np.zeros(1)
    along = np.arange(len(depth_m))
    slope, at_first_m = np.polyfit(along, depth_m, 1)
    off_m: F64 = (depth_m - at_first_m - slope * along) * np.sqrt(len(depth_m) / (len(depth_m) - 2))
    return off_m


def _between(left: _Side, right: _Side, share: F64, start_z: F64, down: F64, rng: np.random.Generator) -> F64:
    """Return background depths (P,) between two sides, at ``share`` (P,) of the way from left to right.

    If both sides show ground, interpolate its height; if both show surfaces of similar depth, interpolate the depth;
    else the farther side continues. Noise and losses are sampled from the sides. Rays start at height ``start_z`` (P,)
    and their direction has z ``down`` (P,).
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
    """A real object of the sweep appears a second time, at another azimuth, in front of everything there.

    Its surface, edges, noise and losses are those of a real one. It stands on ground of the same height, where the view
    is open; without such a place the sweep is unchanged. At a given azimuth, the largest object that fits is copied.
    """

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and the record of its changes."""
        image = _image_of(sweep)
        objects = _objects_in_reach(sweep, self.near_m, self.sector_deg, self.budget)
        circle = image.depth_m.shape[1]
        for chosen, turn in self._places(image, objects, rng):
            column = (chosen.first + chosen.column) % circle
            number = image.number[chosen.ring, (column + turn) % circle]
            depth_m = image.depth_m[chosen.ring, column]
            number, depth_m = number[number >= 0], depth_m[number >= 0]
            if len(number) and _is_open(sweep, image, chosen, turn, depth_m, number):
                holes = _holes(image, chosen, turn)
                left = len(holes) if self.budget is None else self.budget - len(number)
                target_m = np.full(len(image.rays), LEAVE)
                target_m[holes[:left]] = NO_RETURN
                target_m[number] = np.where(image.rays.depth_m[number] > depth_m - _BASE_DEPTH_M, depth_m, LEAVE)
                return self.spoofer.spoof(sweep, image.rays, target_m, _wedge_of(image, number), rng)
        return untouched(sweep)

    def _places(
        self, image: _RayImage, objects: list[_Object], rng: np.random.Generator
    ) -> Iterator[tuple[_Object, int]]:
        """Yield objects and the columns by which to turn them: random pairs, or to ``azimuth``, the largest first."""
        circle = image.depth_m.shape[1]
        if self.azimuth is None:
            for turn in rng.integers(circle, size=_PLACES if objects else 0):
                yield objects[_random_object(objects, rng)], int(turn)
            return
        for one in sorted(objects, key=lambda one: -len(one.ring)):
            yield one, round((self.azimuth - _azimuth_of(image, one)) * circle / (2 * np.pi)) % circle


def _is_open(sweep: Sweep, image: _RayImage, chosen: _Object, turn: int, depth_m: F64, number: Ints) -> bool:
    """Return whether a copy is clear of the object, in front of everything there, on ground of the same height."""
    circle = image.depth_m.shape[1]
    distance = min(turn, circle - turn)
    behind_m = image.rays.depth_m[number] - depth_m
    occluded = np.mean(behind_m < -_BASE_DEPTH_M)
    if distance <= chosen.columns + _SIDE or occluded > _OCCLUDED_SHARE or np.median(behind_m) < _OPEN_M:
        return False
    source = image.number[chosen.ring, (chosen.first + chosen.column) % circle]
    lowest_m = _lowest_m(sweep, image.rays.select(source), image.rays.depth_m[source])
    return abs(_lowest_m(sweep, image.rays.select(number), depth_m) - lowest_m) < _GROUND_M


def _lowest_m(sweep: Sweep, rays: Rays, depth_m: F64) -> float:
    """Return the height above ground of the lowest point of rays (K,) at depths (K,), in meters."""
    start, direction = level_rays(sweep, rays)
    points = start + depth_m[:, None] * direction
    return float((points[:, 2] - scene_of(sweep).ground.at(points[:, :2])).min())


def _holes(image: _RayImage, chosen: _Object, turn: int) -> Ints:
    """Return the rays inside a copy's outline where the real object has no return: the copy must have none either."""
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
