"""Ground, height and attitude of the sensor carried over from earlier sweeps of a stream.

Ground is static. Nodes that a sweep does not see take the height from the earlier sweep, if both sweeps agree on ground
that both see nearby; their standard deviation grows with time and distance. Nodes that neither sees are predicted from
both. Where the sweeps disagree, the current one wins and the carried-over ground is dropped. If the sensor height of a
sweep differs from that of the last sweeps, theirs is used, unless the returns support its own. Height and attitude of a
sensor at rest are constant: those that most of the last estimates are close to.

Each sweep stores what it carries over and holds no reference to earlier sweeps.

The motion of the sensor comes from the poses. Without poses, a :class:`Rest` carries over while the returns show that
the sensor stands still.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from viewshed import _core
from viewshed.arrays import F32
from viewshed.fov.height_map import HeightMap
from viewshed.geometry import Rigid, attitude_of
from viewshed.grid import BevGrid
from viewshed.preprocess.leveling import Held, LeveledSweep, level
from viewshed.preprocess.streams import FORGET_S, why_anew
from viewshed.sweep import Sweep

ESTIMATES = 7
"""Number of last sweeps, including the current one, whose median height is the sensor's usual height."""

MIN_ESTIMATES = 3
"""Minimum number of known heights for that median."""

HEIGHT_TOLERANCE_M = 0.15
"""Maximum difference between a sweep's own height and the usual one; beyond it the usual height is tried."""

MIN_SUPPORT_RATIO = 0.8
"""Minimum ratio of ground support at the usual height to that at the own height; below it the sensor has moved up or
down, and its own height is kept."""

TILT_TOLERANCE = np.radians(2.0)
"""Maximum angle between two estimates of one attitude."""

REST_TOLERANCE_M, REST_TOLERANCE = 0.02, np.radians(0.1)
"""Maximum difference in height and in attitude between a sweep's own estimate and the usual one at rest."""

STD_PER_ROOT_S, STD_PER_ROOT_M = 0.05, 0.01
"""Growth in meters of the standard deviation of carried-over ground, per root of seconds and of meters driven."""

STILL_M, STILL_SHARE, STILL_PIXELS = 0.05, 0.8, 500
"""A sensor stands still if this share of at least ``STILL_PIXELS`` pixels keep their range within ``STILL_M``."""

_DEFAULT_PERIOD_S = 1.0
"""Assumed time between two sweeps without time stamps."""


def hold_over(sweeps: Sequence[LeveledSweep]) -> list[LeveledSweep]:
    """Return the sweeps of a stream, oldest first, each with ground and height carried over from the previous one.

    Sweeps that already carry something over are not changed.

    Raises:
        ValueError: a sweep has no pose.
    """
    held = list(sweeps[:1])
    for sweep in sweeps[1:]:
        held.append(sweep if sweep.held is not None else hold(sweep, held[-1]))
    return held


@dataclass(slots=True, eq=False)
class Rest:
    """Carries over ground and height of a sensor without poses while it stands still.

    The sensor stands still while most pixels of its range image have the same range as when it came to rest. Limit: a
    long corridor or an open field looks the same from every place. A sensor that moves there is taken to stand still,
    and carries over ground and height from another place.
    """

    _since_m: F32 | None = None  # (rings, columns) range image of the first sweep at rest
    _before: LeveledSweep | None = None

    def hold(self, leveled: LeveledSweep) -> LeveledSweep:
        """Return the next sweep with ground and height carried over; unchanged if the sensor moved or has a pose."""
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
    """Return whether two range images in meters (+inf for no return) were taken from the same place."""
    if since_m is None or now_m is None or since_m.shape != now_m.shape:
        return False
    both = np.isfinite(since_m) & np.isfinite(now_m)
    apart_m = np.abs(since_m[both] - now_m[both])
    return apart_m.size >= STILL_PIXELS and float(np.mean(apart_m <= STILL_M)) >= STILL_SHARE


def hold(leveled: LeveledSweep, before: LeveledSweep, now_from_before: Rigid | None = None) -> LeveledSweep:
    """Return a sweep with sensor height and ground carried over from an earlier sweep of its stream.

    Args:
        leveled: the sweep.
        before: the earlier sweep.
        now_from_before: pose of the earlier sensor frame in the current one; None takes it from the sweeps' poses.

    Raises:
        ValueError: a sweep has no pose and ``now_from_before`` is None.
    """
    at_height, held = _leveled_as_held(leveled, before, at_rest=now_from_before is not None)
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
        ValueError: the sweep has no pose.
    """
    pose = leveled.world_from_level
    if pose is None:
        raise ValueError("sweeps must have poses to be seen together, got one without; give world_from_sensor")
    return pose


def _seconds(leveled: LeveledSweep, before: LeveledSweep) -> float:
    now_ns, before_ns = leveled.sweep.t_ns, before.sweep.t_ns
    return _DEFAULT_PERIOD_S if now_ns is None or before_ns is None else abs(now_ns - before_ns) / 1e9


def _leveled_as_held(leveled: LeveledSweep, before: LeveledSweep, at_rest: bool) -> tuple[LeveledSweep, Held]:
    """Return the sweep, leveled by the usual height if its own differs too much, and the estimates to carry over.

    At rest, the same holds for the attitude.
    """
    sweep = leveled.sweep
    earlier = _estimated(before) if before.held is None else before.held.estimates
    held = Held((*earlier, *_estimated(leveled))[-ESTIMATES:])
    if not _is_estimated(sweep) or len(held.estimates) < (1 if at_rest else MIN_ESTIMATES):
        return leveled, held
    usual = _likeliest(held.estimates, before.level_from_sensor) if at_rest else _median_height(held.estimates)
    usual_m = float(usual.translation[2])
    is_height_usual = abs(usual_m - leveled.sensor_height_m) <= (REST_TOLERANCE_M if at_rest else HEIGHT_TOLERANCE_M)
    is_attitude_usual = not at_rest or _tilt(usual, leveled.level_from_sensor) <= REST_TOLERANCE
    if is_height_usual and is_attitude_usual:
        return leveled, held
    # Level again with the usual height and attitude as given; keep the original sweep, whose own are not given.
    attitude = attitude_of(usual.rotation) if at_rest else sweep.attitude
    at_usual = level(
        sweep.replace(sensor_height_m=usual_m, attitude=attitude), BevGrid(1, leveled.ground.half_extent_m),
        leveled.sensor_id,
    )  # fmt: skip
    if not at_rest and at_usual.ground.support < MIN_SUPPORT_RATIO * leveled.ground.support:
        return leveled, held
    return replace(at_usual, sweep=sweep), replace(held, is_height_held=sweep.sensor_height_m is None)


def _is_estimated(sweep: Sweep) -> bool:
    """Return whether height or attitude of a sweep are estimated from its returns."""
    return sweep.sensor_height_m is None or sweep.known_attitude is None


def _estimated(leveled: LeveledSweep) -> tuple[Rigid, ...]:
    """Return ``level_from_sensor`` as estimated from a sweep's returns; empty if it was given or assumed."""
    return (leveled.level_from_sensor,) if _is_estimated(leveled.sweep) and leveled.ground.support > 0 else ()


def _median_height(estimates: Sequence[Rigid]) -> Rigid:
    """Return the last estimate at the median of all heights."""
    height_m = float(np.median([estimate.translation[2] for estimate in estimates]))
    return Rigid(estimates[-1].rotation, np.array([0.0, 0.0, height_m]))


def _likeliest(estimates: Sequence[Rigid], before: Rigid) -> Rigid:
    """Return ``level_from_sensor`` at rest: the one with most estimates nearby; ``before`` wins ties."""
    candidates = [before, *sorted(estimates, key=lambda estimate: float(estimate.translation[2]))]
    near = [[other for other in estimates if _is_near(one, other)] for one in candidates]
    best = max(range(len(candidates)), key=lambda k: len(near[k]))
    return before if best == 0 else Rigid(candidates[best].rotation, _median_height(near[best]).translation)


def _is_near(one: Rigid, other: Rigid) -> bool:
    apart_m = abs(one.translation[2] - other.translation[2])
    return bool(apart_m <= HEIGHT_TOLERANCE_M and _tilt(one, other) <= TILT_TOLERANCE)


def _tilt(one: Rigid, other: Rigid) -> float:
    """Return the angle between the verticals of two transforms ``level_from_sensor``."""
    return float(np.arccos(np.clip(one.rotation[2] @ other.rotation[2], -1.0, 1.0)))


def _held_ground(leveled: LeveledSweep, before: LeveledSweep, now_from_before: Rigid) -> HeightMap:
    """Return the ground of a sweep, completed by nodes that only the earlier sweep saw, if both agree around them.

    ``now_from_before`` maps the ``level`` frame of the earlier sweep to that of the current one.
    """
    now, earlier = leveled.ground, before.ground
    driven_m = float(np.hypot(*now_from_before.translation[:2]))
    variance_m2 = STD_PER_ROOT_S**2 * _seconds(leveled, before) + STD_PER_ROOT_M**2 * driven_m
    ground = _core.held_ground(
        now.heights_m, now.std_m, now.seen, now.half_extent_m,
        earlier.heights_m, earlier.std_m, earlier.seen, earlier.half_extent_m,
        now_from_before.inverse().as_matrix()[:2].astype(np.float32), now_from_before.as_matrix()[2].astype(np.float32),
        variance_m2,
    )  # fmt: skip
    if ground is None:
        return now
    heights_m, std_m, seen = ground
    # Nodes that neither saw are predicted anew, beside more that is known.
    image = leveled.range_image
    heights_m, std_m = _core.complete_ground(
        leveled.points, leveled.azimuth, leveled.range_m, None if image is None else image.isolated, leveled.rows,
        leveled.sensor_height_m, heights_m, std_m, seen, now.half_extent_m,
    )  # fmt: skip
    return replace(now, heights_m=heights_m, std_m=std_m, seen=seen)
