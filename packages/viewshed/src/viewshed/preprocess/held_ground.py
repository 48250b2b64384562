"""What a stream carries over: ground that earlier sweeps saw, and the sensor's height.

Ground does not move. Where a sweep sees none, it takes the height that an earlier one of its stream saw there, with a
deviation that has grown with time and distance, while both agree nearby on ground that both see; heights in between are
filled from both. Where they disagree the present sweep is believed, and what was carried over is dropped. The height of
the sensor is that of the last sweeps where a single one differs, unless its returns speak for its own. Of a sensor at
rest it is one number: the one that most of the last estimates are near to.

Each sweep hands on what it carries over; none refers to the sweeps before it.

Where the sensor is now comes from the poses. Without them a :class:`Rest` holds while the returns show that it stands
still.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from viewshed import _core
from viewshed.arrays import F32
from viewshed.fov.height_map import HeightMap
from viewshed.geometry import Rigid
from viewshed.grid import BevGrid
from viewshed.preprocess.leveling import Held, LeveledSweep, level
from viewshed.preprocess.streams import FORGET_S, why_anew

HEIGHTS = 7
"""The sensor's height is the median of those of the last ``HEIGHTS`` sweeps, the present one among them, ..."""

FEWEST_HEIGHTS = 3
"""... if at least this number of them are known, ..."""

HEIGHT_OFF_M = 0.15
"""... and the present one is off by more than this."""

SUPPORT_KEPT = 0.8
"""Least part of the present support at the height carried over; with less the carrier did change its height."""

REST_OFF_M = 0.02
"""At rest a height is set aside for the likeliest one if it is off by more than this."""

STD_PER_ROOT_S, STD_PER_ROOT_M = 0.05, 0.01
"""Growth in meters of the deviation of ground carried over: with the root of seconds and of meters driven."""

STILL_M, STILL_SHARE, STILL_PIXELS = 0.05, 0.8, 500
"""A sensor stands still while this share of at least ``STILL_PIXELS`` pixels keep their range to ``STILL_M``."""

_APART_S = 1.0
"""Time between two sweeps that do not say theirs."""


def hold_over(sweeps: Sequence[LeveledSweep]) -> list[LeveledSweep]:
    """Return the sweeps of a stream, the oldest first, each with what those before it carry over.

    Those that carry something over already are taken as they are.

    Raises:
        ValueError: one of them has no pose.
    """
    held = list(sweeps[:1])
    for sweep in sweeps[1:]:
        held.append(sweep if sweep.held is not None else hold(sweep, held[-1]))
    return held


@dataclass(slots=True, eq=False)
class Rest:
    """What a sensor without poses carries over while it stands still.

    It stands still while most pixels of its range image have the range that they had when it came to rest. A long
    corridor and an open field look the same from every place. A sensor that moves there is taken to stand, and carries
    over height and ground of a place that looks the same.
    """

    _since_m: F32 | None = None  # (rings, columns) range image of the sweep with which it came to rest
    _before: LeveledSweep | None = None

    def hold(self, leveled: LeveledSweep) -> LeveledSweep:
        """Return the next sweep of the stream with what those before it hold; as it is if it moved, or has a pose."""
        before, sweep = self._before, leveled.sweep
        now_m = None if leveled.range_image is None else leveled.range_image.range_m
        if (
            before is not None
            and sweep.world_from_sensor is None
            and not why_anew(before.sweep.t_ns, sweep.t_ns, FORGET_S)
            and _is_same_place(self._since_m, now_m)
        ):
            leveled = hold(leveled, before, Rigid.identity())
        else:
            self._since_m = now_m
        self._before = leveled
        return leveled


def _is_same_place(since_m: F32 | None, now_m: F32 | None) -> bool:
    """Return whether two range images, +inf where nothing returned, were taken from one place."""
    if since_m is None or now_m is None or since_m.shape != now_m.shape:
        return False
    both = np.isfinite(since_m) & np.isfinite(now_m)
    apart_m = np.abs(since_m[both] - now_m[both])
    return apart_m.size >= STILL_PIXELS and float(np.mean(apart_m <= STILL_M)) >= STILL_SHARE


def hold(leveled: LeveledSweep, before: LeveledSweep, now_from_before: Rigid | None = None) -> LeveledSweep:
    """Return a sweep with what an earlier one of its stream holds: the sensor's height and ground.

    Args:
        leveled: the sweep.
        before: the earlier one.
        now_from_before: pose of the sensor then in its frame now; None takes it from the poses of both.

    Raises:
        ValueError: one of them has no pose, and ``now_from_before`` is not given.
    """
    at_height, held = _at_held_height(leveled, before, at_rest=now_from_before is not None)
    if leveled.sweep.planar is not None:  # sees no ground
        return replace(leveled, held=held)
    if now_from_before is None:
        level_from_level = pose_of(at_height).inverse() @ pose_of(before)
    else:
        level_from_level = at_height.level_from_sensor @ now_from_before @ before.level_from_sensor.inverse()
    ground = _held_ground(at_height, before, level_from_level)
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


def _at_held_height(leveled: LeveledSweep, before: LeveledSweep, at_rest: bool) -> tuple[LeveledSweep, Held]:
    """Return a sweep leveled at the height that the stream holds where its own is off, and what it hands on."""
    own_m = _estimated_heights(leveled)
    earlier_m = _estimated_heights(before) if before.held is None else before.held.heights_m
    held = Held((*earlier_m, *own_m)[-HEIGHTS:])
    if leveled.sweep.sensor_height_m is not None or len(held.heights_m) < (1 if at_rest else FEWEST_HEIGHTS):
        return leveled, held
    usual_m = _likeliest_height(held.heights_m, before) if at_rest else float(np.median(held.heights_m))
    if abs(usual_m - leveled.sensor_height_m) <= (REST_OFF_M if at_rest else HEIGHT_OFF_M):
        return leveled, held
    # Level again as if the height were known. The sweep itself goes on not to say it.
    again = level(
        leveled.sweep.replace(sensor_height_m=usual_m), BevGrid(1, leveled.ground.half_extent_m), leveled.sensor_id
    )
    if not at_rest and again.ground.support < SUPPORT_KEPT * leveled.ground.support:
        return leveled, held
    return replace(again, sweep=leveled.sweep), replace(held, is_height_held=True)


def _likeliest_height(heights_m: Sequence[float], before: LeveledSweep) -> float:
    """Return the one height of a sensor at rest: that with the most estimates around it, of as many the earlier one."""
    estimates = np.array(heights_m)
    candidates = np.array([before.sensor_height_m, *np.sort(estimates)])
    near = np.abs(estimates - candidates[:, None]) <= HEIGHT_OFF_M
    best = int(np.argmax(near.sum(axis=1)))
    return float(candidates[best] if best == 0 else np.median(estimates[near[best]]))


def _estimated_heights(leveled: LeveledSweep) -> tuple[float, ...]:
    """Return the height that a sweep's returns give; none where it was given or assumed."""
    is_estimated = leveled.sweep.sensor_height_m is None and leveled.ground.support > 0
    return (leveled.sensor_height_m,) if is_estimated else ()


def _held_ground(leveled: LeveledSweep, before: LeveledSweep, now_from_before: Rigid) -> HeightMap:
    """Return the ground of a sweep with that of an earlier one where only that saw it and both agree around it.

    ``now_from_before`` is the pose of the ``level`` frame of the earlier one in that of the sweep.
    """
    now, earlier = leveled.ground, before.ground
    driven_m = float(np.hypot(*now_from_before.translation[:2]))
    variance_m2 = STD_PER_ROOT_S**2 * _seconds(leveled, before) + STD_PER_ROOT_M**2 * driven_m
    found = _core.held_ground(
        now.heights_m, now.std_m, now.seen, now.half_extent_m,
        earlier.heights_m, earlier.std_m, earlier.seen, earlier.half_extent_m,
        now_from_before.inverse().as_matrix()[:2].astype(np.float32), now_from_before.as_matrix()[2].astype(np.float32),
        variance_m2, now.plane, leveled.sensor_height_m,
    )  # fmt: skip
    if found is None:
        return now
    heights_m, std_m, seen = found
    return replace(now, heights_m=heights_m, std_m=std_m, seen=seen)
