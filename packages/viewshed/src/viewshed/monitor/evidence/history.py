"""Evidence of a sweep against those before it: obstacles that come and leave, lost views, repeated noise, poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import F32
from viewshed.geometry import Rigid
from viewshed.monitor.evidence.base import ABSTAINS, SECTORS, MonitoredSweep, sector_of
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.sweep import Sweep

MOST_GAP_S = 0.6
"""Sweeps that lie further apart in time are not compared."""

USUAL_RANGE_M = 10.0
"""Range at which a turn of the pose moves surfaces."""

USUAL_GAP_S = 0.1
"""Time between two sweeps that have no times."""

FOLLOWED = 3
"""Sweeps through which an obstacle is followed back."""

LEAST_RETURNS = 100
"""A sweep with fewer returns shows nothing."""

SURE_YAW, SURE_SHIFT_M = np.deg2rad(0.1), 0.1
"""Deviations of a pose that are no cause for worry: time stamps, motion within a sweep, the grain of its returns."""

SIGMA_M = 0.05
"""Least deviation of a return from its surface."""

DEPENDENT = 4.0
"""This number of returns of one surface says no more than one."""

ENOUGH_SEEN, CARRIED_M = 0.25, 1.0
"""A shift is seen where this share of the returns shows it; fewer may lie on cars beside, which drove about so far."""

LEAST_MATCHES = 80
"""Returns on surfaces that an estimated pose needs."""

_STAYS = np.eye(3, 4, dtype=np.float32)

_SECTOR = 2 * np.pi / SECTORS


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """A sweep held against those before it, the newest first: K of them, with poses.

    Attributes:
        view: what the sweep saw.
        earlier: what those before it saw.
        to_earlier: (K, 3, 4) transforms from the sensor's frame now to the sensor's frames then.
        gaps_s: (K,) time from each to the next one.
        arrival_mps: (SECTORS,) speed that obstacles need to have come from the nearest cover. What stands where a beam
            passed freely came from behind an obstacle, from beyond the beams, or was one of the things near by. Where
            the last sweep found the obstacle as well, the one before it is used: it gives itself away for three.
        departure_mps: (SECTORS,) speed that obstacles of the last sweep need to have left as they did: the distance to
            the nearest place where they may be now, over the time between the two.
    """

    view: _core.SweepView
    earlier: list[_core.SweepView]
    to_earlier: F32
    gaps_s: F32
    arrival_mps: F32
    departure_mps: F32


def view_of(leveled: LeveledSweep) -> _core.SweepView | None:
    """Return what a sweep saw, made once; None where its rings are not known or it has hardly any return."""
    # Each sweep of a stream is compared with five after it.
    view: _core.SweepView | None = leveled.derived.get(("sweep_view",))
    image = leveled.range_image
    if view is not None or image is None or len(leveled.points) < LEAST_RETURNS or image.columns < SECTORS:
        return view
    elevation = image.elevation if np.isfinite(image.elevation).all() else _elevations(leveled, len(image.elevation))
    from_level = leveled.level_from_sensor.rotation.T
    view = leveled.derived[("sweep_view",)] = _core.SweepView(
        image.squared_range_m2, image.phase, elevation.astype(np.float32), image.origin_m.astype(np.float32),
        leveled.points, leveled.height_m, leveled.range_m, leveled.azimuth, image.isolated[leveled.rows],
        rows_of(from_level, -from_level @ leveled.level_from_sensor.translation),
    )  # fmt: skip
    return view


def _elevations(leveled: LeveledSweep, rings: int) -> NDArray[np.float64]:
    """Return the mean elevation (rings,) of the returns of each ring; of those without returns, what lies between."""
    step = max(len(leveled.sweep) // 4000, 1)  # 4,000 rows are enough for a mean
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
    # 1. The earlier sweeps that can be compared, the newest first.
    earlier, views, poses, gaps = list[LeveledSweep](), list[_core.SweepView](), list[Rigid](), list[float]()
    for before in reversed(monitored.earlier):
        seen, at = view_of(before), before.sweep.world_from_sensor
        gap_s = _seconds_between(before, earlier[-1] if earlier else now)
        if seen is None or at is None or not 0.0 < gap_s <= MOST_GAP_S:
            break
        earlier.append(before)
        views.append(seen)
        poses.append(at)
        gaps.append(gap_s)
    if not earlier:
        return None
    # Most evidence needs the same comparison; it holds no sweep, or the past of a stream would be kept.
    key = ("comparison", *map(ref, earlier))
    comparison: Comparison | None = now.derived.get(key)
    if comparison is None:
        # 2. Where the sensor is now, seen from where it was.
        turned = np.stack([at.rotation.T for at in poses])
        shifts_m = np.stack([pose.translation - at.translation for at in poses])
        to_earlier = np.empty((len(poses), 3, 4), np.float32)
        to_earlier[:, :, :3] = turned @ pose.rotation
        to_earlier[:, :, 3] = np.einsum("kij,kj->ki", turned, shifts_m)
        from_last = rows_of(to_earlier[0, :, :3].T, -pose.rotation.T @ shifts_m[0])
        gaps_s = np.array(gaps, np.float32)
        # 3. Obstacles now where they were not, and those of the last sweep where they are not now.
        came = view.follow(views[:FOLLOWED], to_earlier[:FOLLOWED], gaps_s[:FOLLOWED], view, _STAYS, SECTORS)
        left = views[0].follow([view], from_last[None], gaps_s[:1], view, from_last, SECTORS)
        comparison = now.derived[key] = Comparison(view, views, to_earlier, gaps_s, came, left)
    return comparison


def _seconds_between(before: LeveledSweep, after: LeveledSweep) -> float:
    """Return the seconds from one sweep to another."""
    first_ns, last_ns = before.sweep.t_ns, after.sweep.t_ns
    return USUAL_GAP_S if first_ns is None or last_ns is None else (last_ns - first_ns) / 1e9


def rows_of(rotation: NDArray[np.floating[Any]], translation: NDArray[np.floating[Any]]) -> F32:
    """Return the upper rows (3, 4) of a transform."""
    return np.column_stack([rotation, translation]).astype(np.float32, order="C")


def _part(part: Callable[[Comparison], F32]) -> Callable[[MonitoredSweep], F32]:
    """Return what measures a part of a sweep's comparison; it abstains without poses, earlier sweeps or rings."""

    def measure(monitored: MonitoredSweep) -> F32:
        comparison = compare(monitored)
        return ABSTAINS if comparison is None else part(comparison)

    return measure


measure_arrival = _part(lambda comparison: comparison.arrival_mps)
measure_departure = _part(lambda comparison: comparison.departure_mps)


def measure_registration(monitored: MonitoredSweep) -> F32:
    """Return how far the pose is off, in units of what is known of that (SECTORS,), the same in all sectors.

    Sweeps laid over each other by their poses must show one world. The obstacles of this sweep are put on the surfaces
    of earlier ones; a turn and a shift that lay them better are estimated, point to plane. A direction in which nothing
    is seen, as along a tunnel or on an open field, has no information and so no weight. The sweep before tells of a
    pose that jumps, the oldest one when all poses since are off by the same: the greater one counts.
    """
    comparison = compare(monitored)
    if comparison is None:
        return ABSTAINS
    compared = sorted({0, len(comparison.earlier) - 1})
    found = comparison.view.register_on([comparison.earlier[k] for k in compared], comparison.to_earlier[compared])
    # What is stated of the poses is no deviation.
    now, before = monitored.leveled.sweep, [monitored.earlier[-1 - k].sweep for k in compared]
    stated = [_covariance_of(now, frame) + _covariance_of(frame, frame) for frame in before]
    distances = [
        _deviations(step, information, sigma_m, matches, covariance)
        for step, information, sigma_m, matches, covariance in zip(*found, stated, strict=True)
        if matches >= LEAST_MATCHES
    ]
    return np.full(SECTORS, max(distances), np.float32) if distances else ABSTAINS


def _covariance_of(sweep: Sweep, frame: Sweep) -> NDArray[np.float64]:
    """Return the stated covariance (3, 3) of a sweep's pose: turn, and shift in the frame of a sensor; 0 without."""
    covariance, pose = np.zeros((3, 3)), frame.world_from_sensor
    if sweep.pose_covariance is not None and pose is not None:
        place = pose.rotation.T @ sweep.pose_covariance[:3, :3] @ pose.rotation
        covariance[0, 0], covariance[1:, 1:] = sweep.pose_covariance[5, 5], place[:2, :2]
    return covariance


def _deviations(
    step: NDArray[np.float64], information: NDArray[np.float64], sigma_m: float, matches: int,
    stated: NDArray[np.float64],
) -> float:  # fmt: skip
    """Return the Mahalanobis distance of a turn and a shift (3,) with their information (3, 3) for unit noise.

    stated is the covariance of both that is known beside.
    """
    variance_m2 = max(sigma_m, SIGMA_M) ** 2 * DEPENDENT
    covariance = variance_m2 * np.linalg.inv(information + 1e-6 * np.eye(3))
    covariance += np.diag([SURE_YAW**2, SURE_SHIFT_M**2, SURE_SHIFT_M**2]) + stated
    # Directions of shift that few returns show: those may lie on things that move.
    seen, directions = np.linalg.eigh(information[1:, 1:] / matches)
    carried_m = CARRIED_M * np.clip(1.0 - seen / ENOUGH_SEEN, 0.0, 1.0)
    covariance[1:, 1:] += (directions * carried_m**2) @ directions.T
    squared = float(step @ np.linalg.solve(covariance, step))
    return float(np.sqrt(max(squared, 0.0)))


def measure_same_noise(monitored: MonitoredSweep) -> F32:
    """Return the share by sector (SECTORS,) of ranges that repeat an earlier sweep's, beyond what noise repeats.

    A replayed sweep, or a sensor that is frozen: each range has noise of its own, so two sweeps of one scene differ,
    even from one place. Where the difference between the two is the same for a beam and its neighbor, to less than the
    sensor's noise, one sweep was made of the other. Neighbors are compared, not ranges, because undoing another motion
    shifts all ranges of a direction alike. Sensors report whole steps of range, so some differences are equal by
    chance: about as many as differ by one step, which are subtracted.

    Of the earlier sweep that is most alike. Needs no poses; abstains without earlier sweeps of the same image or rings.
    """
    view, image = view_of(monitored.leveled), monitored.leveled.range_image
    if view is None or image is None:
        return ABSTAINS
    views = [
        before
        for each in monitored.earlier
        if each.range_image is not None
        and each.range_image.counts.shape == image.counts.shape
        and (before := view_of(each)) is not None
    ]
    if not views:
        return ABSTAINS
    shares = view.repeats(views, SECTORS)
    alike = int(np.argmax(np.nan_to_num(shares, nan=-1.0).mean(axis=1)))
    return np.asarray(np.maximum(shares[alike], np.float32(0.0)))


def _new_range(part: int) -> Callable[[MonitoredSweep], F32]:
    """Return what measures a part of ``SweepView.new_ranges`` against three sweeps; it abstains without them or rings.

    Of the returns of a sector the share that is nearer, or farther, than all that the beams about them had in the last
    three sweeps, and of the beams that returned in all of those the share that does not now; each as the mean of 25°,
    for what attacks is wider than an edge. What passes near by covers and uncovers as much: a range is new only if no
    beam within 1.5 m beside had such a one. Beams silenced within 2 m say nothing. It holds the ground and what is
    higher than a car as well, wherever it may have come from: cover is near everywhere indoors. Poses say how the
    sensor turned; without them it went straight on.
    """

    def measure(monitored: MonitoredSweep) -> F32:
        now, view = monitored.leveled, view_of(monitored.leveled)
        views = [seen for before in monitored.earlier[-FOLLOWED:] if (seen := view_of(before)) is not None]
        if view is None or len(views) < FOLLOWED:
            return ABSTAINS
        if any((seen.rings, seen.columns) != (view.rings, view.columns) for seen in views):
            return ABSTAINS
        key = ("new_ranges", *map(ref, monitored.earlier))
        if key not in now.derived:
            turned = [_turn_between(before, now) for before in monitored.earlier[-FOLLOWED:]]
            # Columns are about the sensor, sectors about the level frame.
            about = np.arctan2(now.level_from_sensor.rotation[1, 0], now.level_from_sensor.rotation[0, 0])
            found = np.stack(view.new_ranges(views, turned, SECTORS))
            found[2] *= ~_begin_of(now, turned[-1])
            found = np.roll(found, round(float(about) / _SECTOR), axis=1)
            now.derived[key] = np.mean([np.roll(found, step, axis=1) for step in (-2, -1, 0, 1, 2)], axis=0)
        every: F32 = now.derived[key][part]
        return every

    return measure


measure_nearer, measure_farther, measure_no_return = map(_new_range, range(3))


def _turn_between(before: LeveledSweep, after: LeveledSweep) -> float:
    """Return by how many radians the sensor turned from one sweep to another; 0 without poses."""
    then, now = before.sweep.world_from_sensor, after.sweep.world_from_sensor
    if then is None or now is None:
        return 0.0
    turn = then.rotation.T @ now.rotation
    return float(np.arctan2(turn[1, 0], turn[0, 0]))


def _begin_of(leveled: LeveledSweep, turned: float) -> NDArray[np.bool_]:
    """Return the mask (SECTORS,) of where a sweep begins, which does not close by what the sensor turned."""
    # A sweep begins at its first return, or straight behind where it has no times.
    sweep, begin = leveled.sweep, -np.pi
    if sweep.time_s is not None and len(sweep):
        x, y, _ = sweep.points[int(np.argmin(sweep.time_s))]
        begin = float(np.arctan2(y, x))
    # Half of the gap to either side, and half a sector for what it cuts.
    edges = np.arange(-abs(turned) / 2 - _SECTOR / 2, abs(turned) / 2 + _SECTOR, _SECTOR / 2)
    mask = np.zeros(SECTORS, np.bool_)
    mask[sector_of(begin + edges)] = True
    return mask


def measure_frame_noise(monitored: MonitoredSweep) -> F32:
    """Return the median second difference of range by sector (SECTORS,), m, over this sweep and the two before it.

    A spoofer times all its pulses by one clock, which is off by some decimeters in each sweep anew; so what it shows
    jumps to and fro as a whole, along the beams, while the world stands still. Things that move at a constant speed do
    not: their second difference is zero. Poses that are stated to be noisy make surfaces jump as well: what lies
    within two standard deviations of that is no jump. Abstains without poses, two earlier sweeps or rings.
    """
    comparison = compare(monitored)
    if comparison is None or len(comparison.earlier) < 2:
        return ABSTAINS
    jump_m = comparison.view.jumps(comparison.earlier[:2], comparison.to_earlier[:2], comparison.gaps_s[:2], SECTORS)
    # A surface is at constant speed where (1 - ratio) now + ratio last - second is zero.
    sweeps = [monitored.leveled.sweep, monitored.earlier[-1].sweep, monitored.earlier[-2].sweep]
    ratio = 1.0 + float(comparison.gaps_s[1] / comparison.gaps_s[0])
    weights = (1.0 - ratio, ratio, 1.0)
    stated = np.zeros((3, 3))
    for weight, sweep in zip(weights, sweeps, strict=True):
        stated += weight**2 * _covariance_of(sweep, sweeps[0])
    variance_m2 = float(np.linalg.eigvalsh(stated[1:, 1:])[-1] + USUAL_RANGE_M**2 * stated[0, 0])
    return np.sqrt(np.maximum(jump_m**2 - np.float32(4.0 * variance_m2), np.float32(0.0)))
