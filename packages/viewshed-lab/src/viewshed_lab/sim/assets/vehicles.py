"""Makers of vehicles: each returns a `Thing` centered on its origin, heading along x, that tilts with the ground."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from viewshed_lab.sim.assets.shapes import Box, Cylinder, Ellipsoid
from viewshed_lab.sim.assets.street import pick
from viewshed_lab.sim.world import Thing

_ABSORBING = 0.05
"""Share of vehicles whose paint returns no light."""

_DARK = 0.22
"""Share of vehicles in dark paint."""

_SENSOR_CLEARANCE_M = 0.25
"""Smallest height of a sensor above the roof of its car."""

_ROOF_M = 0.08
"""Thickness of a roof."""


class _Car(NamedTuple):
    """Bounds of length, width and height in meters; the cabin's share of the length, and its center."""

    long_m: tuple[float, float]
    wide_m: tuple[float, float]
    tall_m: tuple[float, float]
    cabin: tuple[float, float]


_SEDAN = _Car((4.4, 5.0), (1.78, 1.92), (1.4, 1.5), (0.54, -0.05))
_HATCHBACK = _Car((3.6, 4.4), (1.65, 1.82), (1.42, 1.56), (0.68, -0.14))
_WAGON = _Car((4.5, 4.95), (1.78, 1.9), (1.45, 1.55), (0.7, -0.13))
_OFF_ROADER = _Car((4.3, 5.0), (1.85, 2.0), (1.62, 1.85), (0.7, -0.12))
_PICKUP = _Car((5.0, 5.3), (1.85, 1.98), (1.7, 1.85), (0.36, 0.03))


def car(rng: np.random.Generator) -> Thing:
    """Return a sedan, hatchback, wagon, off-roader or pickup of 3.6 to 5.3 m; one in twenty returns no light."""
    kind = pick(rng, (_SEDAN, _HATCHBACK, _HATCHBACK, _WAGON, _OFF_ROADER, _PICKUP))
    long, wide, tall = (rng.uniform(*size) for size in (kind.long_m, kind.wide_m, kind.tall_m))
    return Thing("car", _body(long, wide, tall, kind.cabin, _paint(rng)), tilts=True)


def van(rng: np.random.Generator) -> Thing:
    """Return a delivery van of 4.9 to 6.2 m."""
    long, wide, tall, paint = rng.uniform(4.9, 6.2), rng.uniform(1.9, 2.05), rng.uniform(1.95, 2.7), _paint(rng)
    nose = 0.17 * long
    parts = (
        Box(-nose / 2, 0.0, long - nose, wide, tall, 0.3, 0.0, paint),
        Box(long / 2 - nose / 2, 0.0, nose, wide, 1.15, 0.28, 0.0, paint),
        Box(long / 2 - 0.75 * nose, 0.0, nose / 2, wide - 0.2, 0.82 * tall, 1.15, 0.0, paint),
    )
    return Thing("van", (*parts, *_axles(0.32 * long, wide, 0.68)), tilts=True)


def truck(rng: np.random.Generator) -> Thing:
    """Return a rigid truck of 7 to 10 m: cab, gap, box body over a frame."""
    long, tall, paint = rng.uniform(7.0, 10.0), rng.uniform(3.1, 3.9), _paint(rng)
    cab, body = 2.0, long - 2.4
    parts = (
        Box(long / 2 - cab / 2, 0.0, cab, 2.4, 2.8, 0.45, 0.0, paint),
        Box(-long / 2 + body / 2, 0.0, body, 2.5, tall, 1.05, 0.0, pick(rng, ("paint", "metal", paint))),
        Box(0.0, 0.0, long - 0.6, 0.9, 1.05, 0.6, 0.0, "dark_paint"),
    )
    return Thing("truck", (*parts, *_axles(0.33 * long, 2.45, 1.0)), tilts=True)


def semi_truck(rng: np.random.Generator) -> Thing:
    """Return a tractor with a trailer, 14 to 16.5 m."""
    long, tall, paint = rng.uniform(14.0, 16.5), rng.uniform(3.7, 4.0), _paint(rng)
    body = long - 2.9
    parts = (
        Box(long / 2 - 1.1, 0.0, 2.2, 2.45, rng.uniform(3.1, 3.8), 0.4, 0.0, paint),
        Box(-long / 2 + body / 2, 0.0, body, 2.5, tall, 1.15, 0.0, pick(rng, ("paint", "metal"))),
        Box(0.0, 0.0, long - 1.0, 0.9, 1.15, 0.7, 0.0, "dark_paint"),
        Box(-long / 2 + 2.4, 0.0, 3.6, 2.4, 1.0, 0.0, 0.0, "rubber"),
    )
    axles = (Box(long / 2 - 1.3, 0.0, 1.0, 2.4, 1.0, 0.0, 0.0, "rubber"),
             Box(long / 2 - 4.2, 0.0, 1.0, 2.4, 1.0, 0.0, 0.0, "rubber"))  # fmt: skip
    return Thing("truck", (*parts, *axles), tilts=True)


def bus(rng: np.random.Generator) -> Thing:
    """Return a city bus of 10 to 12.5 m with long panes that beams may pass."""
    long, tall, paint = rng.uniform(10.0, 12.5), rng.uniform(2.95, 3.2), _paint(rng)
    panes = tuple(Box(0.0, y, long - 0.8, 0.02, 2.35, 1.2, 0.0, "glass") for y in (-1.24, 1.24))
    parts = (
        Box(0.0, 0.0, long, 2.52, 1.2, 0.32, 0.0, paint),
        Box(0.0, 0.0, long, 2.52, tall, 2.35, 0.0, paint),
        Box(-long / 2 + 0.2, 0.0, 0.4, 2.52, 2.35, 1.2, 0.0, paint),
        Box(long / 2 - 0.1, 0.0, 0.2, 2.52, 2.35, 1.2, 0.0, "glass"),
        Box(-0.1 * long, 0.0, 0.3, 2.4, 2.35, 1.2, 0.0, paint),
    )
    return Thing("bus", (*parts, *panes, *_axles(0.3 * long, 2.5, 0.95)), tilts=True)


def cyclist(rng: np.random.Generator) -> Thing:
    """Return a rider on a bicycle of 1.75 m."""
    tall = rng.uniform(1.55, 1.85)
    wheels = tuple(Box(x, 0.0, 0.66, 0.05, 0.68, 0.0, 0.0, "rubber") for x in (-0.53, 0.53))
    parts = (
        Box(0.0, 0.0, 1.0, 0.05, 0.85, 0.45, 0.0, "metal"),
        Box(0.45, 0.0, 0.1, 0.55, 1.08, 1.0, 0.0, "metal"),
        Box(-0.05, 0.0, 0.3, 0.32, 0.95, 0.35, 0.0, "clothes"),
        Ellipsoid(0.02, 0.0, 0.5, 0.46, tall - 0.2, 0.85, 0.0, "clothes"),
        Ellipsoid(0.2, 0.0, 0.24, 0.2, tall, tall - 0.27, 0.0, "clothes"),
    )
    return Thing("cyclist", (*wheels, *parts), tilts=True)


def motorcycle(rng: np.random.Generator) -> Thing:
    """Return a rider on a motorcycle of 2.1 m."""
    tall = rng.uniform(1.45, 1.65)
    wheels = tuple(Box(x, 0.0, 0.64, 0.14, 0.64, 0.0, 0.0, "rubber") for x in (-0.72, 0.72))
    parts = (
        Box(0.0, 0.0, 1.3, 0.36, 0.85, 0.25, 0.0, _paint(rng)),
        Box(0.5, 0.0, 0.12, 0.75, 1.1, 0.9, 0.0, "metal"),
        Ellipsoid(-0.15, 0.0, 0.5, 0.5, tall - 0.22, 0.7, 0.0, "clothes"),
        Ellipsoid(0.05, 0.0, 0.28, 0.26, tall, tall - 0.28, 0.0, "paint"),
    )
    return Thing("motorcycle", (*wheels, *parts), tilts=True)


def sensor_car(rng: np.random.Generator, sensor_height_m: float) -> tuple[Thing, float]:
    """Return a vehicle with a mast for a sensor at a height above ground, and the sensor's offset ahead of its center.

    Below 1.35 m it is a small delivery robot; above, a car of about 1.5 m whose roof is at least 0.25 m below the
    sensor: as in nuScenes and KITTI it hides about half of the lowest rings, to the front and rear, and little
    sideways.
    """
    roof = sensor_height_m - _SENSOR_CLEARANCE_M
    if sensor_height_m < 1.35:
        body = (Box(0.0, 0.0, 0.75, 0.5, roof, 0.4 * roof, 0.0, "paint"), *_axles(0.25, 0.5, 0.4 * roof + 0.02))
        return Thing("robot", body, tilts=True), 0.0
    tall, long = min(roof, rng.uniform(1.42, 1.52)), rng.uniform(4.1, 4.9)
    paint = "paint" if rng.random() < 0.8 else "dark_paint"
    parts = _body(long, rng.uniform(1.68, 1.78), tall - 0.07, (0.62, -0.04), paint)
    ahead = rng.uniform(-0.35, -0.1)
    mast = Cylinder(ahead, 0.0, 0.05, sensor_height_m - 0.1, tall - 0.02, "metal")
    rack = Box(0.0, 0.0, 0.9, 1.0, tall, tall - 0.08, 0.0, "metal")
    return Thing("car", (*parts, rack, mast), tilts=True), ahead


_STREET: tuple[tuple[float, Callable[[np.random.Generator], Thing]], ...] = (
    (0.76, car), (0.86, van), (0.9, truck), (0.94, bus), (0.97, motorcycle), (1.0, cyclist),
)  # fmt: skip

_HIGHWAY: tuple[tuple[float, Callable[[np.random.Generator], Thing]], ...] = (
    (0.68, car), (0.8, van), (0.86, truck), (0.95, semi_truck), (0.97, bus), (1.0, motorcycle),
)  # fmt: skip


def street_vehicle(rng: np.random.Generator) -> Thing:
    """Return a vehicle of town traffic: mostly cars."""
    return _one_of(rng, _STREET)


def highway_vehicle(rng: np.random.Generator) -> Thing:
    """Return a vehicle of highway traffic: cars, vans and trucks."""
    return _one_of(rng, _HIGHWAY)


def parked_vehicle(rng: np.random.Generator) -> Thing:
    """Return a parked vehicle: a car, sometimes a van."""
    return van(rng) if rng.random() < 0.1 else car(rng)


def _one_of(rng: np.random.Generator, table: tuple[tuple[float, Callable[[np.random.Generator], Thing]], ...]) -> Thing:
    draw = rng.random()
    return next(maker for share, maker in table if draw <= share)(rng)


def _paint(rng: np.random.Generator) -> str:
    draw = rng.random()
    return "absorber" if draw < _ABSORBING else "dark_paint" if draw < _ABSORBING + _DARK else "paint"


def _body(long: float, wide: float, tall: float, cabin: tuple[float, float], paint: str) -> tuple[Box, ...]:
    """Return lower body, windows in two steps for the slanted screens, roof, axles; ``cabin``: its share and center."""
    belt, share, middle = 0.58 * tall, cabin[0] * long, cabin[1] * long
    step = (belt + 0.5 * (tall - belt), wide - 0.18, wide - 0.34)
    return (
        Box(0.0, 0.0, long, wide, belt, 0.14 * tall, 0.0, paint),
        Box(middle, 0.0, share, step[1], step[0], belt, 0.0, "cabin"),
        Box(middle - 0.02 * long, 0.0, 0.74 * share, step[2], tall - _ROOF_M, step[0], 0.0, "cabin"),
        Box(middle - 0.02 * long, 0.0, 0.74 * share, step[2], tall, tall - _ROOF_M, 0.0, paint),
        *_axles(0.3 * long, wide, 0.62),
    )


def _axles(half_base_m: float, wide: float, wheel_m: float) -> tuple[Box, Box]:
    """Return the front and the rear axle, each as one box for both wheels."""
    return (
        Box(half_base_m, 0.0, wheel_m, wide - 0.04, wheel_m, 0.0, 0.0, "rubber"),
        Box(-half_base_m, 0.0, wheel_m, wide - 0.04, wheel_m, 0.0, 0.0, "rubber"),
    )
