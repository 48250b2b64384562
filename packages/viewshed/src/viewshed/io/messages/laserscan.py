"""Convert sensor_msgs/LaserScan (a 2-D laser) to a planar Sweep at z = 0 of its frame, and back."""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from viewshed.sweep import MAX_POINTS, REVOLUTION_S, PlanarScan, Sweep


class LaserScan(Protocol):
    """The fields of the message that are read; angles in radians, ranges in meters, times in seconds."""

    angle_min: float
    angle_max: float
    angle_increment: float
    time_increment: float
    range_min: float
    range_max: float
    ranges: NDArray[np.float32]
    intensities: NDArray[np.float32]


def sweep_of_scan(scan: LaserScan) -> Sweep:
    """Convert a message to a planar sweep (N returns, meters).

    A range from ``range_min`` to ``range_max`` is a return. +inf is a no-return beam, free up to ``range_max`` (ROS
    enhancement proposal 117). NaN, -inf (below the minimum range) and ranges outside the limits are ignored, as if the
    beam did not exist. Times count from the first beam.

    Raises:
        ValueError: a field is missing or not finite, the limits are invalid, or the angles do not match the number of
            ranges or exceed one turn.
    """
    ranges = np.asarray(scan.ranges, np.float32)
    intensity = np.asarray(scan.intensities, np.float32)
    _check(scan, ranges, intensity)
    index = np.arange(ranges.size)
    angle = scan.angle_min + index * scan.angle_increment
    azimuth = np.remainder(angle + np.pi, 2 * np.pi) - np.pi
    hit = (ranges >= scan.range_min) & (ranges <= scan.range_max) & np.isfinite(ranges)
    range_m, hit_azimuth = ranges[hit].astype(np.float64), azimuth[hit]
    points = np.zeros((hit_azimuth.size, 3), np.float32)
    points[:, 0], points[:, 1] = range_m * np.cos(hit_azimuth), range_m * np.sin(hit_azimuth)
    return Sweep(
        points,
        intensity[hit] if intensity.size else None,
        azimuth=hit_azimuth.astype(np.float32),
        time_s=(index[hit] * scan.time_increment).astype(np.float32),
        infer_sensor=False,
        planar=PlanarScan(azimuth[ranges == np.inf], float(scan.range_max)),
    )


def scan_of_sweep(sweep: Sweep) -> dict[str, Any]:
    """Return the fields of a message that :func:`sweep_of_scan` converts back to the same planar sweep.

    Missing beams are NaN. Ranges are restored to a part in ten million; beams that are not evenly spaced are moved to
    the nearest hundredth of a degree.

    Raises:
        ValueError: the sweep is not planar.

    >>> sweep = Sweep(np.array([[2.0, 0, 0], [0, 3.0, 0]]), planar=PlanarScan(np.array([0.7854]), 30.0))
    >>> scan_of_sweep(sweep)["ranges"].tolist()
    [2.0, inf, 3.0]
    """
    if sweep.planar is None:
        raise ValueError("a sweep must be planar to become a LaserScan; write it as a cloud")
    x, y, _ = sweep.points.astype(np.float64).T
    hit_angles = np.arctan2(y, x) if sweep.azimuth is None else sweep.azimuth.astype(np.float64)
    angle = np.concatenate([hit_angles, sweep.planar.open_azimuth.astype(np.float64)])
    first, step = float(angle.min()) if angle.size else 0.0, _even_step(angle)
    index = np.rint((angle - first) / step).astype(np.intp)
    ranges = np.full(index.max(initial=0) + 1, np.nan, np.float32)
    ranges[index[len(hit_angles) :]] = np.inf
    ranges[index[: len(hit_angles)]] = np.hypot(x, y)
    intensities = np.zeros(ranges.size if sweep.intensity is not None else 0, np.float32)
    if sweep.intensity is not None:
        intensities[index[: len(hit_angles)]] = sweep.intensity
    return {
        "angle_min": first,
        "angle_max": first + step * (ranges.size - 1),
        "angle_increment": step,
        "range_max": float(sweep.planar.max_range_m),
        "ranges": ranges,
        "intensities": intensities,
    }


_MIN_GAP = 1e-5
"""Angles that differ by less than this are the same beam, in radians."""

_MIN_STEP = 2 * math.pi / 36_000


def _even_step(angle: NDArray[np.float64]) -> float:
    """Return the largest step of a regular grid, from the minimum, that contains all angles (K,); else 0.01°."""
    gaps = np.diff(np.sort(angle))
    gaps = gaps[gaps > _MIN_GAP]
    if not gaps.size:
        return _MIN_STEP
    span = float(angle.max() - angle.min())
    # If beams are missing, the smallest gap may be several steps.
    for parts in range(1, 9):
        # Refine the step by the span: its rounding error is that of a gap, but spread over many steps.
        step: float = span / round(parts * span / float(gaps.min()))
        steps_from_min = (angle - angle.min()) / step
        if (np.abs(steps_from_min - np.rint(steps_from_min)) < 0.1).all():
            return step
    return _MIN_STEP


def _check(scan: LaserScan, ranges: NDArray[np.float32], intensity: NDArray[np.float32]) -> None:
    """Raise ValueError if the fields of a message are invalid or inconsistent."""
    if ranges.ndim != 1 or ranges.size > MAX_POINTS:
        raise ValueError(f"ranges must be (N,), at most {MAX_POINTS} of them, got shape {ranges.shape}")
    if intensity.shape not in ((0,), ranges.shape):
        raise ValueError(f"intensities must be as many as ranges, or none, got {intensity.size} of {ranges.size}")
    for name in ("angle_min", "angle_max", "angle_increment", "time_increment", "range_min"):
        if not np.isfinite(getattr(scan, name)):
            raise ValueError(f"{name} must be finite, got {getattr(scan, name):g}")
    if not 0 <= scan.range_min < scan.range_max:  # also true if range_max is NaN
        raise ValueError(
            f"range_min and range_max must satisfy 0 ≤ range_min < range_max, got {scan.range_min:g} and"
            f" {scan.range_max:g} m"
        )
    step, steps = abs(scan.angle_increment), max(ranges.size - 1, 0)
    if steps and not 0 < step * steps <= 2 * np.pi + step:
        raise ValueError(
            f"a scan must be at most one turn, got {ranges.size} ranges every {scan.angle_increment:g} rad"
        )
    # In some drivers angle_max is the last beam, in others one step past it.
    span = scan.angle_max - scan.angle_min
    if abs(span - scan.angle_increment * steps) > 2 * step + 0.01 * abs(span):
        raise ValueError(
            f"ranges must be those of angle_min to angle_max, got {ranges.size} every {scan.angle_increment:g} rad from"
            f" {scan.angle_min:g} to {scan.angle_max:g}"
        )
    if abs(scan.time_increment) * steps > REVOLUTION_S:
        raise ValueError(f"a scan must take at most {REVOLUTION_S:g} s, got {scan.time_increment * steps:g} s")
