"""Makers of plants: trunks are solid, crowns and hedges are volumes that a beam may pass."""

from __future__ import annotations

import numpy as np

from viewshed.sim.shapes import Box, Cylinder, Ellipsoid
from viewshed.sim.world import Thing


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


def hedge(rng: np.random.Generator, length_m: float, height_m: float, thick_m: float = 0.7) -> Thing:
    """Return a clipped hedge along x that lies along the slope, its top a little uneven."""
    pieces = max(1, round(length_m / 6.0))
    step = length_m / pieces
    tops = rng.uniform(0.93, 1.05, pieces) * height_m
    parts = [Box((k + 0.5 - pieces / 2) * step, 0.0, step, thick_m, float(top), material="hedge")
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
