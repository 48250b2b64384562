"""What a stream holds: ground that earlier sweeps saw, the sensor's height, and how far it sees.

Ground does not move. Where a sweep sees none, it takes the height that an earlier one of its stream saw there, with a
deviation that has grown with time and distance, while both agree nearby on ground that both see; heights in between are
filled from both. Where they disagree the present sweep is believed, and what was held there is dropped. The height of
the sensor is that of the last sweeps where a single one differs, unless its returns speak for its own.

Each sweep hands on what it holds; none refers to the sweeps before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numba import njit

from viewshed.fov.height_map import HeightMap
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.preprocess.evidence import reach_of_sweep
from viewshed.preprocess.ground_fill import fill_ground
from viewshed.preprocess.leveling import Held, LeveledSweep, level

HEIGHTS = 7
"""The sensor's height is the median of those of the last so many sweeps, the present one among them, ..."""

FEWEST_HEIGHTS = 3
"""... if they are at least so many, ..."""

HEIGHT_OFF_M = 0.15
"""... and the present one is off by more than this."""

SUPPORT_KEPT = 0.8
"""At the held height at least this part of the present support must be left, or the carrier did change its height."""

STD_PER_ROOT_S, STD_PER_ROOT_M = 0.05, 0.01
"""Deviation in meters by which held ground grows: with the root of seconds, and with the root of meters driven, ..."""

TILT_STD = 0.002
"""... and by a doubt of the poses' attitudes (0.1°), the farther from the sensor the more."""

AGREE_M = 0.3
"""Two sweeps agree on ground that both see if their heights differ by no more than this, and twice their deviations."""

AROUND, AGREEING_SHARE = 3, 0.75
"""They agree around a node if this share does of the nodes at most so many rows and columns away that both see."""

MOST = 0.5
"""Where fewer of all nodes that both see agree than this share, a pose is wrong, and nothing is held."""

_APART_S = 1.0
"""Time between two sweeps that do not say theirs."""


def hold_over(sweeps: Sequence[LeveledSweep]) -> list[LeveledSweep]:
    """Return the sweeps of a stream, the oldest first, each with what those before it hold.

    Those that hold something already are taken as they are.

    Raises:
        ValueError: one of them has no pose.
    """
    held = list(sweeps[:1])
    for sweep in sweeps[1:]:
        held.append(sweep if sweep.held is not None else hold(sweep, held[-1]))
    return held


def hold(leveled: LeveledSweep, before: LeveledSweep) -> LeveledSweep:
    """Return a sweep with what an earlier one of its stream holds: the sensor's height, ground, and reach.

    Raises:
        ValueError: one of them has no pose.
    """
    at_height, held = _at_held_height(leveled, before)
    ground = _held_ground(at_height, before)
    heights_m = at_height.points[:, 2] - ground.at(at_height.points)
    heights_m.setflags(write=False)
    return replace(at_height, ground=ground, height_m=heights_m, held=held)


def pose_of(leveled: LeveledSweep) -> Rigid:
    """Return the pose of a sweep's ``level`` frame in the map.

    Raises:
        ValueError: it has none.
    """
    pose = leveled.world_from_level
    if pose is None:
        raise ValueError("sweeps must have poses to be seen together, got one without; give world_from_sensor")
    return pose


def _seconds(leveled: LeveledSweep, before: LeveledSweep) -> float:
    now_ns, before_ns = leveled.sweep.t_ns, before.sweep.t_ns
    return _APART_S if now_ns is None or before_ns is None else abs(now_ns - before_ns) / 1e9


def _at_held_height(leveled: LeveledSweep, before: LeveledSweep) -> tuple[LeveledSweep, Held]:
    """Return a sweep leveled at the height that the stream holds where its own is off, and what it hands on."""
    own_m, reach_m = _estimated_heights(leveled), reach_of_sweep(leveled)
    earlier_m = _estimated_heights(before) if before.held is None else before.held.heights_m
    model = leveled.sensor_id.model
    if model is None or model.reach_m is None:
        reach_m = max(reach_m, reach_of_sweep(before))
    held = Held((*earlier_m, *own_m)[-HEIGHTS:], reach_m)
    if leveled.sweep.sensor_height_m is not None or len(held.heights_m) < FEWEST_HEIGHTS:
        return leveled, held
    usual_m = float(np.median(held.heights_m))
    if abs(usual_m - leveled.sensor_height_m) <= HEIGHT_OFF_M:
        return leveled, held
    # Level again as if the height were known. The sweep itself goes on not to say it.
    again = level(leveled.sweep.replace(sensor_height_m=usual_m), BevGrid(1, leveled.ground.half_extent_m))
    if again.ground.support < SUPPORT_KEPT * leveled.ground.support:
        return leveled, held
    return replace(again, sweep=leveled.sweep), replace(held, is_height_held=True)


def _estimated_heights(leveled: LeveledSweep) -> tuple[float, ...]:
    """Return the height that a sweep's returns give; none where it was given or assumed."""
    is_estimated = leveled.sweep.sensor_height_m is None and leveled.ground.support > 0
    return (leveled.sensor_height_m,) if is_estimated else ()


def _held_ground(leveled: LeveledSweep, before: LeveledSweep) -> HeightMap:
    """Return the ground of a sweep with that of an earlier one where only that saw it and both agree around it."""
    now_from_before = pose_of(leveled).inverse() @ pose_of(before)
    now, earlier = leveled.ground, before.ground
    # What the earlier sweep saw, on the present lattice.
    driven_m = float(np.hypot(*now_from_before.translation[:2]))
    variance = STD_PER_ROOT_S**2 * _seconds(leveled, before) + STD_PER_ROOT_M**2 * driven_m
    moved_m, moved_std_m = np.zeros_like(now.heights_m), np.full_like(now.std_m, np.inf)
    _move_ground(
        earlier.heights_m, earlier.std_m, earlier.seen,
        np.float32(earlier.half_extent_m), np.float32(now.half_extent_m),
        now_from_before.inverse().as_matrix()[:2].astype(np.float32), now_from_before.as_matrix()[2].astype(np.float32),
        np.float32(variance), moved_m, moved_std_m,
    )  # fmt: skip
    taken = np.zeros_like(now.seen)
    _find_agreed(moved_m, moved_std_m, now.heights_m, now.std_m, now.seen, taken)
    if not taken.any():
        return now
    # Fill what neither saw from both; heights and plane are then counted from the sensor.
    height_m, seen = np.float32(leveled.sensor_height_m), now.seen | taken
    walked_m = np.where(taken, moved_m, now.heights_m) - height_m
    plane = np.array(now.plane, np.float32) - np.array([0.0, 0.0, height_m], np.float32)
    heights_m, std_m = fill_ground(walked_m, seen, plane, now.half_extent_m)
    std_m[taken] = moved_std_m[taken]
    return replace(now, heights_m=heights_m + height_m, std_m=std_m, seen=seen)


@njit(cache=True, nogil=True, error_model="numpy")
def _move_ground(
    before_m: Any, before_std_m: Any, before_seen: Any, before_half_m: Any, half_m: Any, before_from_now: Any,
    now_from_before: Any, variance: Any, moved_m: Any, moved_std_m: Any,
) -> None:  # pragma: no cover - compiled  # fmt: skip
    """Write heights and deviations (n, n) of what an earlier lattice (m, m) saw on the nodes of the present one.

    ``before_from_now`` (2, 4) gives x and y, ``now_from_before`` (4,) gives z: both frames are upright, so that
    positions turn about z alone. Bilinear between nodes; nothing is written where the nearest one was not seen.
    """
    m, n, half, one = before_m.shape[0], moved_m.shape[0], np.float32(0.5), np.float32(1.0)
    node_m, nodes_per_m = np.float32(2.0) * half_m / np.float32(n), np.float32(m) / (np.float32(2.0) * before_half_m)
    for i in range(n):
        x = (np.float32(i) + half) * node_m - half_m
        for j in range(n):
            y = (np.float32(j) + half) * node_m - half_m
            bx = before_from_now[0, 0] * x + before_from_now[0, 1] * y + before_from_now[0, 3]
            by = before_from_now[1, 0] * x + before_from_now[1, 1] * y + before_from_now[1, 3]
            u, v = (bx + before_half_m) * nodes_per_m - half, (by + before_half_m) * nodes_per_m - half
            if not (u >= 0.0 and v >= 0.0 and u < m - 1 and v < m - 1):
                continue
            p, q = int(u), int(v)
            fu, fv = u - np.float32(p), v - np.float32(q)
            if not before_seen[p + (fu >= half), q + (fv >= half)]:
                continue
            a, b, c, d = (one - fu) * (one - fv), (one - fu) * fv, fu * (one - fv), fu * fv
            z = a * before_m[p, q] + b * before_m[p, q + 1] + c * before_m[p + 1, q] + d * before_m[p + 1, q + 1]
            s = a * before_std_m[p, q] + b * before_std_m[p, q + 1]
            s += c * before_std_m[p + 1, q] + d * before_std_m[p + 1, q + 1]
            turned = now_from_before[0] * bx + now_from_before[1] * by + now_from_before[2] * z
            tilted = np.float32(TILT_STD**2) * (x * x + y * y)
            moved_m[i, j], moved_std_m[i, j] = turned + now_from_before[3], np.sqrt(s * s + variance + tilted)


@njit(cache=True, nogil=True, error_model="numpy")
def _find_agreed(
    moved_m: Any, moved_std_m: Any, heights_m: Any, std_m: Any, seen: Any, taken: Any
) -> None:  # pragma: no cover - compiled
    """Mark the nodes (n, n) that only the earlier sweep saw, where it is surer than the present one and agreed with.

    The nearest node that both see decides, by the share that agrees of the nodes around it that both see.
    """
    n = heights_m.shape[0]
    # Sums over the rectangle from (0, 0): nodes that both see, and those of them that agree.
    both, agree = np.zeros((n + 1, n + 1), np.int32), np.zeros((n + 1, n + 1), np.int32)
    for i in range(n):
        row_both, row_agree = np.int32(0), np.int32(0)
        for j in range(n):
            if seen[i, j] and moved_std_m[i, j] < np.inf:
                row_both += 1
                doubt_m = np.float32(2.0) * (std_m[i, j] + moved_std_m[i, j])
                row_agree += abs(moved_m[i, j] - heights_m[i, j]) <= np.float32(AGREE_M) + doubt_m
            both[i + 1, j + 1], agree[i + 1, j + 1] = both[i, j + 1] + row_both, agree[i, j + 1] + row_agree
    if agree[n, n] < MOST * both[n, n]:
        return  # a pose is wrong
    # Nodes that both see are at distance 0 and say whether they agree; without any all others may be taken.
    away, agreed = np.full((n, n), np.inf, np.float32), np.ones((n, n), np.bool_)
    for i in range(n):
        top, bottom = max(i - AROUND, 0), min(i + AROUND + 1, n)
        for j in range(n):
            if seen[i, j] and moved_std_m[i, j] < np.inf:
                left, right = max(j - AROUND, 0), min(j + AROUND + 1, n)
                near = both[bottom, right] - both[top, right] - both[bottom, left] + both[top, left]
                near_agree = agree[bottom, right] - agree[top, right] - agree[bottom, left] + agree[top, left]
                away[i, j], agreed[i, j] = np.float32(0.0), near_agree >= AGREEING_SHARE * near
    _spread_nearest(away, agreed)
    for i in range(n):
        for j in range(n):
            taken[i, j] = agreed[i, j] and not seen[i, j] and moved_std_m[i, j] < std_m[i, j]


@njit(cache=True, nogil=True, error_model="numpy")
def _spread_nearest(away: Any, label: Any) -> None:  # pragma: no cover - compiled
    """Give each node the label (n, n) of the nearest one at distance 0, by two passes of a chamfer distance (n, n)."""
    n, straight, diagonal = away.shape[0], np.float32(1.0), np.float32(1.4142135)
    for turn in range(2):
        step = 1 if turn == 0 else -1
        for a in range(n):
            i = a if turn == 0 else n - 1 - a
            for b in range(n):
                j = b if turn == 0 else n - 1 - b
                # The four neighbors that this pass has visited: one beside it, three in the row before.
                for k in range(4):
                    p, q = (i, j - step) if k == 0 else (i - step, j + k - 2)
                    if 0 <= p < n and 0 <= q < n:
                        found = away[p, q] + (diagonal if k % 2 == 1 else straight)
                        if found < away[i, j]:
                            away[i, j], label[i, j] = found, label[p, q]
