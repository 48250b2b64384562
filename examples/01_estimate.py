"""Estimate the field of view of a sweep and query it."""

import numpy as np

from viewshed import ESTIMATORS, GRIDS, CellState, read_sweep
from viewshed.io.samples import junction_path

sweep = read_sweep(junction_path())
print(f"{len(sweep)} points, rings {sweep.ring is not None}")

estimate = ESTIMATORS["shadow_map"](GRIDS["road"]).estimate(sweep)
print(f"visible {estimate.area_m2():.0f} m², hidden {estimate.share(CellState.HIDDEN):.0%} of the grid")

for place in ([10.0, 0.0], [-10.0, 3.0], [22.0, 18.0]):
    x, y = place
    prob = estimate.at(np.array(place))
    state = CellState(estimate.state[tuple(estimate.grid.index(np.array(place))[0])]).name
    print(f"a car {x:+.0f} m ahead, {y:+.0f} m left would be seen with probability {prob:.2f} ({state})")

polygon = estimate.polygon()
holes = sum(len(part.interiors) for part in polygon.geoms)
inner = estimate.inner_polygon(64)
print(f"polygon: {len(polygon.geoms)} parts, {holes} holes; 64 vertices keep {inner.area / polygon.area:.0%} of it")
