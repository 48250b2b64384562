"""Evidence against the last sweeps: obstacles that appear or vanish, new ranges, repeated noise, poses that jump."""

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

MAX_GAP_S = 0.6
"""Sweeps farther apart in time are not compared."""

USUAL_RANGE_M = 10.0
"""Typical range of a surface: converts a yaw error of the pose into meters."""

USUAL_GAP_S = 0.1
"""Assumed time between sweeps without times."""

FOLLOWED = 3
"""Number of earlier sweeps through which an obstacle is tracked back."""

MIN_RETURNS = 100
"""Minimum number of returns of a sweep that can be compared."""

SURE_YAW, SURE_SHIFT_M = np.deg2rad(0.1), 0.1
"""Normal pose errors (standard deviation): time stamps, motion within a sweep, spacing of its returns."""

SIGMA_M = 0.05
"""Minimum standard deviation of a return from its surface."""

DEPENDENT = 4.0
"""Returns of one surface are correlated: this many count as one."""

ENOUGH_SEEN, CARRIED_M = 0.25, 1.0
"""A direction of shift is well observed if this share of the returns constrains it. Fewer may lie on moving cars, which
adds up to this standard deviation."""

MIN_MATCHES = 80
"""Minimum number of returns on surfaces for an estimate of the pose."""

_IDENTITY = np.eye(3, 4, dtype=np.float32)

_SECTOR = 2 * np.pi / SECTORS


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """A sweep compared with K earlier ones that have poses, the newest first.

    Attributes:
        view: of the sweep.
        earlier: views of the earlier sweeps.
        to_earlier: (K, 3, 4) transforms from the current sensor frame to the earlier ones.
        gaps_s: (K,) time from each earlier sweep to the next one.
        arrival_mps: (SECTORS,) minimum speed at which obstacles came from the nearest cover. An obstacle where a beam
            passed freely before came from behind an obstacle, from outside the beams, or is a nearby object that moved.
            If the last sweep saw it too, the one before that is used, so an appearance shows for three sweeps.
        departure_mps: (SECTORS,) minimum speed at which obstacles of the last sweep left: the distance to the nearest
            place where they can be now, over the time between the two.
    """

    view: _core.SweepView
    earlier: list[_core.SweepView]
    to_earlier: F32
    gaps_s: F32
    arrival_mps: F32
    departure_mps: F32


def view_of(leveled: LeveledSweep) -> _core.SweepView | None:
    """Return the (cached) view of a sweep; None if its rings are not known or it has too few returns."""
    # Cached, because each sweep of a stream is compared with five later ones.
    view: _core.SweepView | None = leveled.derived.get(("sweep_view",))
    image = leveled.range_image
    if view is not None or image is None or len(leveled.points) < MIN_RETURNS or image.columns < SECTORS:
        return view
    elevation = image.elevation if np.isfinite(image.elevation).all() else _elevations(leveled, len(image.elevation))
    from_level = leveled.level_from_sensor.rotation.T
    view = leveled.derived[("sweep_view",)] = _core.SweepView(
        image.squared_range_m2, image.phase, elevation.astype(np.float32), image.origin_m.astype(np.float32),
        leveled.points, leveled.height_m, leveled.range_m, leveled.azimuth, image.isolated[leveled.rows],
        transform_rows(from_level, -from_level @ leveled.level_from_sensor.translation),
    )  # fmt: skip
    return view


def _elevations(leveled: LeveledSweep, rings: int) -> NDArray[np.float64]:
    """Return the mean elevation (rings,) of each ring's returns, interpolated for rings without returns."""
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
    """Return a sweep compared with the earlier ones, back to the first that is not comparable; None if none is.

    A sweep without a view or a pose, or one that is not older than the next, is not comparable.
    """
    now = monitored.leveled
    view, pose = view_of(now), now.sweep.world_from_sensor
    if view is None or pose is None:
        return None
    # 1. Comparable earlier sweeps, the newest first.
    earlier, views, poses, gaps = list[LeveledSweep](), list[_core.SweepView](), list[Rigid](), list[float]()
    for before in reversed(monitored.earlier):
        seen, at = view_of(before), before.sweep.world_from_sensor
        gap_s = _seconds_between(before, earlier[-1] if earlier else now)
        if seen is None or at is None or not 0.0 < gap_s <= MAX_GAP_S:
            break
        earlier.append(before)
        views.append(seen)
        poses.append(at)
        gaps.append(gap_s)
    if not earlier:
        return None
    # Cached for all evidence. The key holds weak references, so that the past of a stream is not kept alive.
    key = ("comparison", *map(ref, earlier))
    comparison: Comparison | None = now.derived.get(key)
    if comparison is None:
        # 2. Transforms from the current sensor frame to the earlier ones.
        turned = np.stack([at.rotation.T for at in poses])
        shifts_m = np.stack([pose.translation - at.translation for at in poses])
        to_earlier = np.empty((len(poses), 3, 4), np.float32)
        to_earlier[:, :, :3] = turned @ pose.rotation
        to_earlier[:, :, 3] = np.einsum("kij,kj->ki", turned, shifts_m)
        from_last = transform_rows(to_earlier[0, :, :3].T, -pose.rotation.T @ shifts_m[0])
        gaps_s = np.array(gaps, np.float32)
        # 3. Obstacles that appeared, and obstacles of the last sweep that vanished.
        came = view.follow(views[:FOLLOWED], to_earlier[:FOLLOWED], gaps_s[:FOLLOWED], view, _IDENTITY, SECTORS)
        left = views[0].follow([view], from_last[None], gaps_s[:1], view, from_last, SECTORS)
        comparison = now.derived[key] = Comparison(view, views, to_earlier, gaps_s, came, left)
    return comparison


def _seconds_between(before: LeveledSweep, after: LeveledSweep) -> float:
    """Return the seconds from one sweep to another."""
    first_ns, last_ns = before.sweep.t_ns, after.sweep.t_ns
    return USUAL_GAP_S if first_ns is None or last_ns is None else (last_ns - first_ns) / 1e9


def transform_rows(rotation: NDArray[np.floating[Any]], translation: NDArray[np.floating[Any]]) -> F32:
    """Return the upper rows (3, 4) of a transform."""
    return np.column_stack([rotation, translation]).astype(np.float32, order="C")


def _part(part: Callable[[Comparison], F32]) -> Callable[[MonitoredSweep], F32]:
    """Return the measure of one field of the comparison; it abstains without poses, earlier sweeps or rings."""

    def measure(monitored: MonitoredSweep) -> F32:
        comparison = compare(monitored)
        return ABSTAINS if comparison is None else part(comparison)

    return measure


measure_arrival = _part(lambda comparison: comparison.arrival_mps)
measure_departure = _part(lambda comparison: comparison.departure_mps)


def measure_registration(monitored: MonitoredSweep) -> F32:
    """Return the Mahalanobis distance of the pose from scan registration (SECTORS,), the same in all sectors.

    Point-to-plane registration estimates the yaw and shift that align this sweep's obstacles with the surfaces of
    earlier sweeps. Directions without structure (along a tunnel, on an open field) carry no information and no weight.
    The last sweep reveals a pose that jumps, the oldest one a common offset of all poses since; the larger counts.
    """
    comparison = compare(monitored)
    if comparison is None:
        return ABSTAINS
    compared = sorted({0, len(comparison.earlier) - 1})
    fits = comparison.view.register_on([comparison.earlier[k] for k in compared], comparison.to_earlier[compared])
    # The stated covariance of the poses is allowed for.
    now, before = monitored.leveled.sweep, [monitored.earlier[-1 - k].sweep for k in compared]
    stated = [_covariance_of(now, frame) + _covariance_of(frame, frame) for frame in before]
    distances = [
        _deviations(step, information, sigma_m, matches, covariance)
        for step, information, sigma_m, matches, covariance in zip(*fits, stated, strict=True)
        if matches >= MIN_MATCHES
    ]
    return np.full(SECTORS, max(distances), np.float32) if distances else ABSTAINS


def _covariance_of(sweep: Sweep, frame: Sweep) -> NDArray[np.float64]:
    """Return the stated covariance (3, 3) of a sweep's yaw and shift, in the sensor frame of ``frame``; 0 without."""
    covariance, pose = np.zeros((3, 3)), frame.world_from_sensor
    if sweep.pose_covariance is not None and pose is not None:
        place = pose.rotation.T @ sweep.pose_covariance[:3, :3] @ pose.rotation
        covariance[0, 0], covariance[1:, 1:] = sweep.pose_covariance[5, 5], place[:2, :2]
    return covariance


def _deviations(
    step: NDArray[np.float64], information: NDArray[np.float64], sigma_m: float, matches: int,
    stated: NDArray[np.float64],
) -> float:  # fmt: skip
    """Return the Mahalanobis distance of yaw and shift (3,), given their information (3, 3) at unit noise.

    ``stated`` is the stated covariance of the poses, which is added.
    """
    variance_m2 = max(sigma_m, SIGMA_M) ** 2 * DEPENDENT
    covariance = variance_m2 * np.linalg.inv(information + 1e-6 * np.eye(3))
    covariance += np.diag([SURE_YAW**2, SURE_SHIFT_M**2, SURE_SHIFT_M**2]) + stated
    # Inflate directions of shift that few returns constrain: those may lie on moving objects.
    seen, directions = np.linalg.eigh(information[1:, 1:] / matches)
    carried_m = CARRIED_M * np.clip(1.0 - seen / ENOUGH_SEEN, 0.0, 1.0)
    covariance[1:, 1:] += (directions * carried_m**2) @ directions.T
    squared = float(step @ np.linalg.solve(covariance, step))
    return float(np.sqrt(max(squared, 0.0)))


def measure_same_noise(monitored: MonitoredSweep) -> F32:
    """Return the share (SECTORS,) of ranges whose noise repeats an earlier sweep's, beyond chance.

    Detects a replayed sweep or a frozen sensor. Each range has independent noise, so two sweeps of one scene differ,
    even from one place. If the difference between two sweeps is equal for a beam and its neighbor, to less than the
    sensor's noise, one sweep was made from the other. Neighbors are compared instead of ranges, because a motion
    correction shifts all ranges of a direction alike. Ranges are quantized, so some differences are equal by chance:
    about as many as differ by one step, which are subtracted.

    Uses the most similar earlier sweep. Needs no poses; abstains without rings or earlier sweeps of the same image
    size.
    """
    view, image = view_of(monitored.leveled), monitored.leveled.range_image
    if view is None or image is None:
        return ABSTAINS
    views = [
        before
        for sweep in monitored.earlier
        if sweep.range_image is not None
        and sweep.range_image.counts.shape == image.counts.shape
        and (before := view_of(sweep)) is not None
    ]
    if not views:
        return ABSTAINS
    shares = view.repeats(views, SECTORS)
    most_similar = int(np.argmax(np.nan_to_num(shares, nan=-1.0).mean(axis=1)))
    return np.asarray(np.maximum(shares[most_similar], np.float32(0.0)))


def _new_range(part: int) -> Callable[[MonitoredSweep], F32]:
    """Return the measure of one part of ``SweepView.new_ranges``; it abstains without rings or three earlier sweeps.

    The parts are the share of a sector's returns that are nearer (0) or farther (1) than all ranges of the beams around
    them in the last three sweeps, and the share of beams that returned in all three but not now (2). Each is averaged
    over 25°, because an attack is wider than an edge. Passing objects cover and uncover ranges too, so a range is new
    only if no beam within 1.5 m to the side had a similar one. Beams silenced within 2 m do not count. Ground and
    objects higher than a car count too, whether or not cover is near, because indoors cover is near everywhere. Poses
    give the turn of the sensor; without them it is taken as 0.
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
            turns = [_turn_between(before, now) for before in monitored.earlier[-FOLLOWED:]]
            # Columns are in the sensor frame, sectors in the level frame.
            yaw = np.arctan2(now.level_from_sensor.rotation[1, 0], now.level_from_sensor.rotation[0, 0])
            shares = np.stack(view.new_ranges(views, turns, SECTORS))
            shares[2] *= ~_seam_of(now, turns[-1])
            shares = np.roll(shares, round(float(yaw) / _SECTOR), axis=1)
            now.derived[key] = np.mean([np.roll(shares, step, axis=1) for step in (-2, -1, 0, 1, 2)], axis=0)
        share: F32 = now.derived[key][part]
        return share

    return measure


measure_nearer, measure_farther, measure_no_return = map(_new_range, range(3))


def _turn_between(before: LeveledSweep, after: LeveledSweep) -> float:
    """Return the yaw in radians by which the sensor turned from one sweep to another; 0 without poses."""
    then, now = before.sweep.world_from_sensor, after.sweep.world_from_sensor
    if then is None or now is None:
        return 0.0
    turn = then.rotation.T @ now.rotation
    return float(np.arctan2(turn[1, 0], turn[0, 0]))


def _seam_of(leveled: LeveledSweep, turn: float) -> NDArray[np.bool_]:
    """Return the mask (SECTORS,) of the seam where a sweep begins and ends: the sensor's turn leaves a gap there."""
    # A sweep begins at its first return, or straight behind if it has no times.
    sweep, begin = leveled.sweep, -np.pi
    if sweep.time_s is not None and len(sweep):
        x, y, _ = sweep.points[int(np.argmin(sweep.time_s))]
        begin = float(np.arctan2(y, x))
    # Half of the gap to either side, and half a sector for sectors that it cuts.
    edges = np.arange(-abs(turn) / 2 - _SECTOR / 2, abs(turn) / 2 + _SECTOR, _SECTOR / 2)
    mask = np.zeros(SECTORS, np.bool_)
    mask[sector_of(begin + edges)] = True
    return mask


def measure_frame_noise(monitored: MonitoredSweep) -> F32:
    """Return the median second difference of range (SECTORS,), m, over this sweep and the two before it.

    A spoofer times all its pulses by one clock, which is off by some decimeters anew in each sweep, so its phantom
    jumps back and forth along the beams as a whole. Objects at constant speed have a second difference of zero. Noisy
    poses make surfaces jump too: two standard deviations of their stated covariance are subtracted. Abstains without
    poses, two earlier sweeps or rings.
    """
    comparison = compare(monitored)
    if comparison is None or len(comparison.earlier) < 2:
        return ABSTAINS
    jump_m = comparison.view.jumps(comparison.earlier[:2], comparison.to_earlier[:2], comparison.gaps_s[:2], SECTORS)
    # Constant speed means (1 - ratio) · now + ratio · last - second = 0; errors of the poses propagate accordingly.
    sweeps = [monitored.leveled.sweep, monitored.earlier[-1].sweep, monitored.earlier[-2].sweep]
    ratio = 1.0 + float(comparison.gaps_s[1] / comparison.gaps_s[0])
    weights = (1.0 - ratio, ratio, 1.0)
    stated = np.zeros((3, 3))
    for weight, sweep in zip(weights, sweeps, strict=True):
        stated += weight**2 * _covariance_of(sweep, sweeps[0])
    variance_m2 = float(np.linalg.eigvalsh(stated[1:, 1:])[-1] + USUAL_RANGE_M**2 * stated[0, 0])
    return np.asarray(np.sqrt(np.maximum(jump_m**2 - 4.0 * variance_m2, 0.0)), np.float32)
