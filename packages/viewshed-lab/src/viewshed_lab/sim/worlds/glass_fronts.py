"""A street of glass: shops, showrooms and offices whose fronts beams pass, with what stands behind them."""

from __future__ import annotations

import numpy as np

from viewshed_lab.sim.assets.buildings import glass_front, glass_hall
from viewshed_lab.sim.assets.shapes import Box
from viewshed_lab.sim.assets.street import wall
from viewshed_lab.sim.world import AgentPlan, Thing, World
from viewshed_lab.sim.worlds.frontage import Side
from viewshed_lab.sim.worlds.layout import Span, plots
from viewshed_lab.sim.worlds.street import street_of


def glass_fronts(rng: np.random.Generator, plan: AgentPlan) -> World:
    """Return a street between glass fronts with the agents of ``plan``."""
    return street_of(rng, plan, "glass_fronts", _fronts, 0.02)


def _fronts(rng: np.random.Generator, side: Side, span_m: Span) -> list[Thing]:
    """Return a row of glass fronts; between some of them walls, and before some of them balustrades of glass."""
    things: list[Thing] = []
    front, end = side.road.edge_m + side.setback_m, span_m[0]
    for middle, length in plots(rng, span_m, (9.0, 26.0), 6.0, 0.25):
        if middle - length / 2 - end > 1.0:
            closing = wall(middle - length / 2 - end - 0.3, rng.uniform(1.0, 2.4))
            things.append(side.put(closing, (middle - length / 2 + end) / 2, front + rng.uniform(1.0, 4.0)))
        end = middle + length / 2
        back = rng.uniform(0.0, 3.0) if rng.random() < 0.4 else 0.0
        maker = glass_hall if rng.random() < 0.15 and back > 1.7 else glass_front
        things.append(side.put(maker(rng, length, side.depth_m), middle, front + back))
        if back > 1.2 and maker is glass_front and rng.random() < 0.5:
            things.append(side.put(_balustrade(0.6 * length), middle, front + 0.2))
    return things


def _balustrade(length_m: float) -> Thing:
    """Return a waist-high balustrade of glass along x with posts and a handrail."""
    stands = [Box(float(x), 0.0, 0.05, 0.05, 1.05, -0.3, 0.0, "metal")
              for x in np.linspace(-0.5, 0.5, max(2, round(length_m / 1.5))) * length_m]  # fmt: skip
    rail = Box(0.0, 0.0, length_m, 0.05, 1.1, 1.05, 0.0, "metal")
    return Thing("balustrade", (Box(0.0, 0.0, length_m, 0.02, 1.05, 0.1, 0.0, "window"), *stands, rail))
