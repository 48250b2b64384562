"""Makers of people, street furniture, barriers and enclosures: each returns a `Thing` at the origin, along x.

Makers of plants: trunks are solid, crowns and hedges are volumes that a beam may pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from viewshed_lab.sim.assets.shapes import Box, Cylinder, Ellipsoid, ends_of
from viewshed_lab.sim.world import Thing, Track

_T = TypeVar("_T")
_OVERHEAD_M = 2.1
_POST_STEP_M = 4.0


def pick(rng: np.random.Generator, options: Sequence[_T]) -> _T:
    """Return one of ``options``, sampled uniformly.

    >>> pick(np.random.default_rng(0), ["only"])
    'only'
    """
    return options[int(rng.integers(len(options)))]


def place_at(thing: Thing, x_m: float, y_m: float, yaw: float = 0.0) -> Thing:
    """Return the thing at rest at (x, y) meters of the world, heading along ``yaw``."""
    return replace(thing, x_m=float(x_m), y_m=float(y_m), yaw=float(yaw))


def drive(thing: Thing, track: Track) -> Thing:
    """Return the thing, moving along ``track``."""
    x_m, y_m, yaw = track.at(0.0)
    return replace(thing, x_m=x_m, y_m=y_m, yaw=yaw, track=track)


def extent(thing: Thing, below_m: float = _OVERHEAD_M) -> tuple[float, float, float, float]:
    """Return rear, front, right and left ends in meters, in the thing's frame, of its parts that begin below a height.

    >>> extent(Thing("wall", (Box(1.0, 0.0, 4.0, 0.2, 2.0),)))
    (-1.0, 3.0, -0.1, 0.1)
    """
    ends = [ends_of(part) for part in thing.parts if part.bottom_m < below_m]
    if not ends:
        return 0.0, 0.0, 0.0, 0.0
    rear, right, front, left = zip(*ends, strict=True)
    return min(rear), max(front), min(right), max(left)


def footprint(thing: Thing, t_s: float = 0.0, below_m: float = _OVERHEAD_M) -> NDArray[np.float64]:
    """Return the corners (4, 2) in meters of the world, counter-clockwise, of the rectangle around :func:`extent`."""
    rear, front, right, left = extent(thing, below_m)
    x_m, y_m, yaw = thing.pose_at(t_s)
    corners = np.array([[rear, right], [front, right], [front, left], [rear, left]])
    turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    return np.asarray(corners @ turn + (x_m, y_m))


def person(rng: np.random.Generator, walking: bool = False) -> Thing:
    """Return a pedestrian of 1.1 to 1.95 m: two legs, body and head; the legs are apart along x if it walks."""
    tall = rng.uniform(1.1, 1.4) if rng.random() < 0.12 else rng.uniform(1.55, 1.95)
    stride = rng.uniform(0.08, 0.3) if walking else 0.0
    wide, hip, neck = rng.uniform(0.38, 0.54) * tall / 1.75, 0.47 * tall, 0.86 * tall
    leg = 0.075 * tall / 1.75
    parts = (
        Cylinder(stride, 0.1, leg, hip + 0.05, 0.0, "clothes"),
        Cylinder(-stride, -0.1, leg, hip + 0.05, 0.0, "clothes"),
        Box(0.0, 0.0, 0.26 * tall / 1.75, wide, neck, hip, 0.0, "clothes"),
        Ellipsoid(0.02, 0.0, 0.2, 0.17, tall, neck - 0.01, 0.0, "clothes"),
    )
    return Thing("pedestrian", parts)


def group(rng: np.random.Generator, x_m: float, y_m: float) -> list[Thing]:
    """Return two to four pedestrians who stand within 0.9 m of (x, y) and face one another."""
    count, turn = int(rng.integers(2, 5)), rng.uniform(0, 2 * np.pi)
    angles = turn + 2 * np.pi * np.arange(count) / count
    return [place_at(person(rng), x_m + 0.6 * np.cos(a), y_m + 0.6 * np.sin(a), a + np.pi) for a in angles.tolist()]


def pole(height_m: float, radius_m: float = 0.07, material: str = "metal") -> Thing:
    """Return a bare pole."""
    return Thing("pole", (Cylinder(0.0, 0.0, radius_m, height_m, material=material),))


def lamp_post(rng: np.random.Generator, reach_m: float = 1.8) -> Thing:
    """Return a street lamp of 5 to 9 m whose arm reaches forward."""
    high = rng.uniform(5.0, 9.0)
    arm = Box(reach_m / 2, 0.0, reach_m, 0.1, high, high - 0.1, 0.0, "metal")
    foot = Cylinder(0.0, 0.0, 0.14, 0.9, material="metal")
    return Thing("lamp_post", (Cylinder(0.0, 0.0, rng.uniform(0.06, 0.1), high, material="metal"), foot, arm))


def traffic_light(rng: np.random.Generator, reach_m: float = 0.0) -> Thing:
    """Return a signal on a post; with a reach, a second one hangs from an arm over the road ahead."""
    tall = 6.2 if reach_m else rng.uniform(3.2, 3.6)
    post = Cylinder(0.0, 0.0, 0.1 if reach_m else 0.06, tall, material="metal")
    head = Box(0.0, 0.2, 0.25, 0.3, 3.2, 2.3, 0.0, "dark_paint")
    if not reach_m:
        return Thing("traffic_light", (post, head))
    arm = Box(reach_m / 2, 0.0, reach_m, 0.14, tall, tall - 0.14, 0.0, "metal")
    return Thing("traffic_light", (post, head, arm, Box(reach_m - 0.3, 0.0, 0.3, 0.35, 5.9, 4.9, 0.0, "dark_paint")))


def sign(rng: np.random.Generator) -> Thing:
    """Return a traffic sign: a retroreflective plate that faces against the heading, on a pole."""
    size, low = rng.uniform(0.45, 0.8), rng.uniform(1.9, 2.4)
    plate = Box(-0.05, 0.0, 0.03, size, low + size, low, 0.0, "sign")
    return Thing("sign", (Cylinder(0.0, 0.0, 0.035, low + size, material="metal"), plate))


def bin_(rng: np.random.Generator) -> Thing:
    """Return a litter bin, or a wheeled household bin."""
    if rng.random() < 0.5:
        return Thing("bin", (Cylinder(0.0, 0.0, rng.uniform(0.2, 0.28), rng.uniform(0.75, 1.0), material="metal"),))
    return Thing("bin", (Box(0.0, 0.0, 0.6, 0.55, 1.05, 0.05, 0.0, "paint"), Box(0.0, 0.0, 0.7, 0.62, 1.1, 1.0)))


def bench() -> Thing:
    """Return a bench along x: seat, back and two feet."""
    feet = tuple(Box(x, 0.0, 0.08, 0.4, 0.42, material="metal") for x in (-0.7, 0.7))
    seat = Box(0.0, 0.0, 1.8, 0.45, 0.47, 0.42, 0.0, "wood")
    return Thing("bench", (seat, Box(0.0, -0.24, 1.8, 0.05, 0.88, 0.55, 0.0, "wood"), *feet))


def bus_shelter() -> Thing:
    """Return a shelter along x, open toward +y: panes on three sides and a roof."""
    panes = (
        Box(0.0, -0.65, 3.6, 0.02, 2.2, 0.15, 0.0, "glass"),
        Box(-1.8, 0.0, 0.02, 1.3, 2.2, 0.15, 0.0, "glass"),
        Box(1.8, 0.0, 0.02, 1.3, 2.2, 0.15, 0.0, "paint"),
    )
    posts = tuple(Box(x, -0.65, 0.07, 0.07, 2.3, material="metal") for x in (-1.8, 0.0, 1.8))
    return Thing("bus_shelter", (*panes, *posts, Box(0.0, 0.0, 3.8, 1.5, 2.45, 2.3, 0.0, "metal")))


def cabinet(rng: np.random.Generator) -> Thing:
    """Return a switch box on a sidewalk."""
    return Thing("cabinet", (Box(0.0, 0.0, rng.uniform(0.6, 1.4), 0.4, rng.uniform(0.9, 1.4), material="paint"),))


def wall(length_m: float, height_m: float, material: str = "brick", thick_m: float = 0.24) -> Thing:
    """Return a garden wall along x that lies along the slope."""
    return Thing("wall", (Box(0.0, 0.0, length_m, thick_m, height_m, material=material),), tilts=True)


def fence(length_m: float, height_m: float, material: str = "mesh") -> Thing:
    """Return a fence along x with posts at most 4 m apart and a field of wire mesh or of boards between them."""
    field = Box(0.0, 0.0, length_m, 0.04, height_m, 0.05, 0.0, material)
    posts = _posts(length_m, 0.05, height_m + 0.05)
    return Thing("fence", (field, *posts), tilts=True)


def guard_rail(length_m: float) -> Thing:
    """Return a steel guard rail along x, its beam at 0.45 to 0.75 m, with posts at most 4 m apart."""
    return Thing("guard_rail", (Box(0.0, 0.0, length_m, 0.12, 0.75, 0.45, 0.0, "metal"), *_posts(length_m, 0.1, 0.7)),
                 tilts=True)  # fmt: skip


def concrete_barrier(length_m: float) -> Thing:
    """Return a concrete step barrier along x of 0.85 m."""
    foot = Box(0.0, 0.0, length_m, 0.6, 0.3, material="concrete")
    return Thing("barrier", (foot, Box(0.0, 0.0, length_m, 0.26, 0.85, 0.2, 0.0, "concrete")), tilts=True)


def sound_wall(length_m: float, height_m: float) -> Thing:
    """Return a noise wall along x: panels of concrete or wood between posts."""
    panel = Box(0.0, 0.0, length_m, 0.16, height_m, material="concrete")
    return Thing("sound_wall", (panel, Box(length_m / 2, 0.0, 0.3, 0.4, height_m + 0.1, material="metal")), tilts=True)


def gantry(rng: np.random.Generator, span_m: float) -> Thing:
    """Return a sign bridge across a road that runs along x: posts at y of 0 and ``span_m``, two plates facing -x."""
    high = rng.uniform(6.3, 7.2)
    posts = tuple(Box(0.0, y, 0.4, 0.4, high, material="metal") for y in (0.0, span_m))
    beam = Box(0.0, span_m / 2, 0.5, span_m, high, high - 0.6, 0.0, "metal")
    plates = tuple(Box(-0.35, span_m * f, 0.1, 0.26 * span_m, high + 1.2, high - 1.3, 0.0, "sign") for f in (0.3, 0.7))
    return Thing("gantry", (*posts, beam, *plates))


def work_barrier() -> Thing:
    """Return a construction barrier along x: two reflective boards on feet and a lamp."""
    feet = tuple(Box(x, 0.0, 0.1, 0.5, 0.12, 0.0, 0.0, "rubber") for x in (-0.8, 0.8))
    boards = tuple(Box(0.0, 0.0, 2.0, 0.03, top, top - 0.25, 0.0, "sign") for top in (1.0, 0.55))
    return Thing("work_barrier", (*boards, *feet))


def cone() -> Thing:
    """Return a traffic cone of 0.75 m."""
    parts = (Box(0.0, 0.0, 0.36, 0.36, 0.06, 0.0, 0.0, "rubber"), Cylinder(0.0, 0.0, 0.11, 0.5, 0.0, "paint"))
    return Thing("cone", (*parts, Cylinder(0.0, 0.0, 0.05, 0.75, 0.5, "sign")))


def _posts(length_m: float, thick_m: float, top_m: float) -> tuple[Box, ...]:
    gaps = max(1, int(np.ceil(length_m / _POST_STEP_M)))
    along = [length_m * (k / gaps - 0.5) for k in range(gaps)]
    return tuple(Box(x, 0.0, thick_m, thick_m, top_m, material="metal") for x in along)


def tree(rng: np.random.Generator, clear_m: float = 2.3, crown_m: float = 5.0) -> Thing:
    """Return a broad-leaved tree whose crown begins about ``clear_m`` up and is about ``crown_m`` wide."""
    bottom = clear_m + rng.uniform(0.0, 0.8)
    deep, wide = rng.uniform(0.7, 1.2) * crown_m, rng.uniform(0.75, 1.0) * crown_m
    trunk = Cylinder(0.0, 0.0, rng.uniform(0.09, 0.26), bottom + 0.35 * deep, material="bark")
    return Thing("tree", (trunk, *_clumps(rng, (wide, deep), bottom, int(rng.integers(3, 6)))))


def conifer(rng: np.random.Generator) -> Thing:
    """Return a conifer of 5 to 12 m: three tiers that narrow upward."""
    high, wide = rng.uniform(5.0, 12.0), rng.uniform(2.2, 3.6)
    tiers = [(0.06, 0.55, 1.0), (0.3, 0.8, 0.72), (0.58, 1.0, 0.42)]
    parts = [Ellipsoid(0.0, 0.0, wide * w, wide * w, high * top, high * low, 0.0, "leaves") for low, top, w in tiers]
    return Thing("tree", (Cylinder(0.0, 0.0, 0.12, 0.6 * high, material="bark"), *parts))


def bush(rng: np.random.Generator, width_m: float = 1.4) -> Thing:
    """Return a bush of one to three rounded clumps, within ``width_m`` across."""
    tall = width_m * rng.uniform(0.6, 1.1)
    parts = [Ellipsoid(0.0, 0.0, 0.8 * width_m, 0.9 * width_m, tall, -0.2, rng.uniform(0, 3), "hedge")]
    for _ in range(int(rng.integers(0, 3))):
        x, y, size = rng.uniform(-0.2, 0.2), rng.uniform(-0.2, 0.2), rng.uniform(0.4, 0.55)
        parts.append(Ellipsoid(x * width_m, y * width_m, size * width_m, size * width_m, tall * size * 1.7, -0.1,
                               0.0, "hedge"))  # fmt: skip
    return Thing("bush", tuple(parts))


def hedge(rng: np.random.Generator, length_m: float, height_m: float) -> Thing:
    """Return a clipped hedge along x that lies along the slope, its top a little uneven."""
    pieces = max(1, round(length_m / 6.0))
    step = length_m / pieces
    tops = rng.uniform(0.93, 1.05, pieces) * height_m
    parts = [Box((k + 0.5 - pieces / 2) * step, 0.0, step, 0.7, float(top), material="hedge")
             for k, top in enumerate(tops)]  # fmt: skip
    return Thing("hedge", tuple(parts), tilts=True)


def _clumps(rng: np.random.Generator, size: tuple[float, float], bottom_m: float, count: int) -> list[Ellipsoid]:
    """Return ellipsoids of leaves that fill a crown ``size`` (wide, deep) above ``bottom_m``."""
    wide, deep = size
    middle = Ellipsoid(0.0, 0.0, 0.8 * wide, 0.8 * wide, bottom_m + deep, bottom_m + 0.05 * deep, 0.0, "leaves")
    turn, clumps = rng.uniform(0, 2 * np.pi), [middle]
    for k in range(count - 1):
        angle, share, low = turn + 2 * np.pi * k / (count - 1), rng.uniform(0.4, 0.55), rng.uniform(0.0, 0.35)
        x, y = 0.25 * wide * np.cos(angle), 0.25 * wide * np.sin(angle)
        clumps.append(Ellipsoid(float(x), float(y), share * wide, share * wide, bottom_m + (low + 0.6) * deep,
                                bottom_m + low * deep, 0.0, "leaves"))  # fmt: skip
    return clumps
