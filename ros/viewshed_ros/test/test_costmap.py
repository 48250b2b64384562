"""A costmap with and without clearing by what is visible: a room with walls, and a body that hides 90° behind it."""

import math

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import LaserScan

from viewshed.estimators import load_estimator
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed_ros import nav2
from viewshed_ros.conversions import INPUTS, stamp_of
from viewshed_ros.layers import PosedEstimate, clearing

BEAMS, MAX_M = 1080, 12.0
GRID = BevGrid(160, 12.0)
WALLS = [
    ((6.0, -11.0), (6.0, -2.0)), ((6.0, 2.0), (6.0, 11.0)),  # ahead, with a door
    ((-11.0, 5.0), (2.0, 5.0)), ((-3.0, -4.0), (4.0, -4.0)), ((2.5, 1.5), (3.5, 2.5)),
]  # fmt: skip
BODY_HALF = math.pi / 4
"""The robot's body hides directions within this of straight behind."""


class Costmap:
    """Marks obstacles and clears them; the robot stands still at the origin."""

    def __init__(self, grid: BevGrid) -> None:
        self.grid = grid
        self.marked = np.zeros(grid.shape, np.bool_)

    def mark(self, points: NDArray[np.float64]) -> None:
        """Mark the cells of points (N, 2)."""
        cells, inside = self.grid.index(points)
        self.marked[cells[inside, 0], cells[inside, 1]] = True

    def clear_frustum(self, range_m: float) -> None:
        """Clear all that lies within the sensor's range, as a layer does that takes no occlusion into account."""
        self.marked[np.hypot(self.grid.centers[..., 0], self.grid.centers[..., 1]) <= range_m] = False

    def clear_beams(self, ends: NDArray[np.float64], least_m: float) -> None:
        """Clear the cells between ``least_m`` and the ends (N, 2) of beams from the origin, without the ends' own."""
        for end in ends:
            length = float(np.hypot(*end))
            along = np.arange(least_m, length - self.grid.cell_m / 2, self.grid.cell_m / 4)
            cells, inside = self.grid.index(end * (along[:, None] / max(length, 1e-9)))
            self.marked[cells[inside, 0], cells[inside, 1]] = False


def ranges_at(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the range (N,) at which beams meet a wall; infinite where they meet none."""
    nearest = np.full(angle.shape, np.inf)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    for start, end in WALLS:
        a, along = np.array(start), np.array(end) - np.array(start)
        across = direction[:, 0] * along[1] - direction[:, 1] * along[0]
        with np.errstate(divide="ignore", invalid="ignore"):
            range_m = (a[0] * along[1] - a[1] * along[0]) / across
            share = (a[0] * direction[:, 1] - a[1] * direction[:, 0]) / across
        hit = (range_m > 0) & (share >= 0) & (share <= 1)
        nearest = np.where(hit, np.minimum(nearest, range_m), nearest)
    return nearest


def scan() -> LaserScan:
    """Return what the laser measures: nothing in the directions that the body hides."""
    angle = -math.pi + 2 * math.pi / BEAMS * np.arange(BEAMS)
    ranges = np.where(ranges_at(angle) <= MAX_M, ranges_at(angle), np.inf)
    ranges[np.abs(angle) > math.pi - BODY_HALF] = np.nan
    message = LaserScan(angle_min=-math.pi, angle_max=math.pi, angle_increment=2 * math.pi / BEAMS)
    message.range_min, message.range_max, message.ranges = 0.1, MAX_M, ranges.astype(np.float32).tolist()
    message.header.stamp, message.header.frame_id = stamp_of(1), "laser"
    return message


def truth() -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which cells the laser sees to be free, and which a wall or the body hides, exactly.

    Of the rest, where walls stand or the edge of a shadow cuts the cell, nothing is asked.
    """
    corners = GRID.centers[..., None, :] + GRID.cell_m / 2 * np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)])
    angle, range_m = np.arctan2(corners[..., 1], corners[..., 0]), np.hypot(corners[..., 0], corners[..., 1])
    by_body = np.abs(angle) > math.pi - BODY_HALF
    before_wall = range_m < ranges_at(angle.ravel()).reshape(angle.shape)
    within = (range_m <= MAX_M).all(axis=-1)
    seen = (before_wall & ~by_body).all(axis=-1) & within
    return seen, (by_body | ~before_wall).all(axis=-1) & within


def cleared(with_view: bool) -> NDArray[np.bool_]:
    """Return which cells of a costmap, all of them marked before, are cleared by one scan."""
    costmap = Costmap(GRID)
    costmap.marked[:] = True
    sweep = INPUTS["scan"].sweep(scan())
    if with_view:
        estimate = load_estimator("shadow_map", grid=GRID, target="pedestrian").estimate(sweep)
        view = PosedEstimate(
            estimate, stamp_of(1), "laser", Rigid.identity(), "map", np.zeros(72, np.bool_), 0.0, nav2.SpeedLimits()
        )  # fmt: skip
        ends = INPUTS["cloud"].sweep(clearing(view)).points[:, :2]
        costmap.clear_beams(ends.astype(np.float64), nav2.blind_m(estimate))
    else:
        costmap.clear_frustum(MAX_M)
    costmap.mark(sweep.points[:, :2].astype(np.float64))
    return ~costmap.marked


def test_hardly_anything_hidden_is_cleared_and_hardly_anything_seen_is_kept() -> None:
    seen, hidden = truth()
    without, with_view = cleared(False), cleared(True)
    wrong_before, wrong_now = (without & hidden).sum(), (with_view & hidden).sum()
    right_before, right_now = (without & seen).sum(), (with_view & seen).sum()
    print(f"wrongly cleared: {wrong_before} cells without, {wrong_now} with; rightly: {right_before} and {right_now}")
    assert hidden.sum() > 0.3 * seen.sum()
    assert wrong_now <= 0.05 * wrong_before
    assert right_now >= 0.95 * right_before
