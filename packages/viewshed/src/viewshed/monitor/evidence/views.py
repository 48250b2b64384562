"""What the sweeps before this one saw, made once for each sweep, and how they lie to each other in space and time."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import F32
from viewshed.geometry import Rigid
from viewshed.monitor.evidence.base import SECTORS, MonitoredSweep
from viewshed.preprocess.leveling import LeveledSweep

MOST_GAP_S = 0.6
"""Sweeps that lie further apart in time are not compared."""

USUAL_GAP_S = 0.1
"""Time between two sweeps that do not say theirs."""

FOLLOWED = 3
"""Sweeps through which an obstacle is followed back."""

LEAST_RETURNS = 100
"""A sweep with fewer returns shows nothing."""

_STAYS = np.eye(3, 4, dtype=np.float32)

_ROWS_FOR_ELEVATION = 4000


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """A sweep held against those before it, the newest first: K of them, with poses.

    Attributes:
        view: what the sweep saw.
        earlier: what those before it saw.
        to_earlier: (K, 3, 4) transforms from the sensor's frame now to the sensor's frames then.
        gaps_s: (K,) time from each to the next one.
        arrival_mps: (SECTORS,) speed with which obstacles must have come where the sweeps before looked through.
        appeared_m2: (SECTORS,) area of obstacles through which the last sweep looked.
        departure_mps: (SECTORS,) speed with which obstacles of the last sweep must have left.
        vanished_m2: (SECTORS,) area of obstacles of the last sweep through which this one looks.
        lost: (SECTORS,) share of the last sweep's obstacles at whose places no beam returns now.
        pierced: (SECTORS,) share of the last sweep's obstacles through which a beam passes now while beams on both
            sides of it end there.
    """

    view: _core.SweepView
    earlier: list[_core.SweepView]
    to_earlier: F32
    gaps_s: F32
    arrival_mps: F32
    appeared_m2: F32
    departure_mps: F32
    vanished_m2: F32
    lost: F32
    pierced: F32


def view_of(leveled: LeveledSweep) -> _core.SweepView | None:
    """Return what a sweep saw; None where its rings are not known or it has hardly any return."""
    # Each sweep of a stream is compared with five after it.
    key = ("sweep_view",)
    view: _core.SweepView | None = leveled.derived.get(key)
    if view is None:
        view = leveled.derived[key] = _make_view(leveled)
    return view


def _make_view(leveled: LeveledSweep) -> _core.SweepView | None:
    image = leveled.range_image
    if image is None or len(leveled.points) < LEAST_RETURNS or image.columns < SECTORS:
        return None
    elevation = image.elevation if np.isfinite(image.elevation).all() else _elevations(leveled, len(image.elevation))
    return _core.SweepView(
        image.squared_range_m2, image.phase, elevation.astype(np.float32), image.origin_m.astype(np.float32),
        leveled.points, leveled.height_m, leveled.range_m, leveled.azimuth, image.isolated[leveled.rows],
        _inverse(leveled.level_from_sensor),
    )  # fmt: skip


def _elevations(leveled: LeveledSweep, rings: int) -> NDArray[np.float64]:
    """Return the mean elevation (rings,) of the returns of each ring; of those without returns, what lies between."""
    step = max(len(leveled.sweep) // _ROWS_FOR_ELEVATION, 1)
    points, ring = leveled.sweep.points[::step].astype(np.float64), leveled.sensor_id.ring
    assert ring is not None  # there is a range image
    ring = ring[::step]
    used = (ring >= 0) & (np.abs(points).sum(axis=1) > 1.0)
    elevation = np.arctan2(points[used, 2], np.hypot(points[used, 0], points[used, 1]))
    count = np.bincount(ring[used], minlength=rings)
    mean = np.bincount(ring[used], elevation, rings) / np.maximum(count, 1)
    known = np.flatnonzero(count)
    return mean if len(known) == 0 else np.interp(np.arange(rings), known, mean[known])


def compare(monitored: MonitoredSweep) -> Comparison | None:
    """Return a sweep held against those before it, up to the first of them that cannot be compared; None without any.

    That is one without a view or a pose, or that is not before the next one by its time.
    """
    now = monitored.leveled
    view, pose = view_of(now), now.sweep.world_from_sensor
    if view is None or pose is None:
        return None
    earlier = _usable(monitored)
    if not earlier:
        return None
    # Most evidence asks for the same comparison; it holds no sweep, or the past of a stream would be kept.
    key = ("comparison", *map(ref, earlier))
    known: Comparison | None = now.derived.get(key)
    if known is not None:
        return known
    # 1. Where the sensor was, seen from where it is.
    poses = [each.sweep.world_from_sensor or pose for each in earlier]
    turned = np.stack([each.rotation.T for each in poses])
    shifts_m = np.stack([pose.translation - each.translation for each in poses])
    to_earlier = np.empty((len(poses), 3, 4), np.float32)
    to_earlier[:, :, :3] = turned @ pose.rotation
    to_earlier[:, :, 3] = np.einsum("kij,kj->ki", turned, shifts_m)
    from_last = np.empty((1, 3, 4), np.float32)
    from_last[0, :, :3] = to_earlier[0, :, :3].T
    from_last[0, :, 3] = -pose.rotation.T @ shifts_m[0]
    gaps_s = np.array([seconds_between(*pair) for pair in pairwise([*reversed(earlier), now])][::-1], np.float32)
    views = [each_view for each in earlier if (each_view := view_of(each)) is not None]
    # 2. Obstacles now where they were not, and those of the last sweep where they are not now.
    came = view.follow(views[:FOLLOWED], to_earlier[:FOLLOWED], gaps_s[:FOLLOWED], view, _STAYS, SECTORS)
    left = views[0].follow([view], from_last, gaps_s[:1], view, from_last[0], SECTORS)
    comparison = Comparison(view, views, to_earlier, gaps_s, *came[:2], *left)
    now.derived[key] = comparison
    return comparison


def _usable(monitored: MonitoredSweep) -> list[LeveledSweep]:
    """Return the earlier sweeps that can be compared, the newest first."""
    usable: list[LeveledSweep] = []
    after = monitored.leveled
    for before in reversed(monitored.earlier):
        if before.sweep.world_from_sensor is None or view_of(before) is None:
            break
        if not 0.0 < seconds_between(before, after) <= MOST_GAP_S:
            break
        usable.append(before)
        after = before
    return usable


def seconds_between(before: LeveledSweep, after: LeveledSweep) -> float:
    """Return the seconds from one sweep to another."""
    first_ns, last_ns = before.sweep.t_ns, after.sweep.t_ns
    return USUAL_GAP_S if first_ns is None or last_ns is None else (last_ns - first_ns) / 1e9


def _inverse(transform: Rigid) -> F32:
    """Return the upper rows (3, 4) of a transform's inverse."""
    rows = np.empty((3, 4), np.float32)
    rows[:, :3] = transform.rotation.T
    rows[:, 3] = -transform.rotation.T @ transform.translation
    return rows


def around(area_m2: F32) -> F32:
    """Return the sum of each sector of (SECTORS,) and two on either side: a car near by is 25° wide."""
    ends = np.concatenate([area_m2[-2:], area_m2, area_m2[:2]])
    return np.convolve(ends, np.ones(5, np.float32), "valid").astype(np.float32)
