"""sensor_msgs/LaserScan as a Sweep: the scan of a 2-D laser, in the plane z = 0 of its own frame."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from viewshed.sweep import MAX_POINTS, REVOLUTION_S, PlanarScan, Sweep


class LaserScan(Protocol):
    """The parts of the message that are read; angles in radians, ranges in meters, times in seconds."""

    angle_min: float
    angle_max: float
    angle_increment: float
    time_increment: float
    range_min: float
    range_max: float
    ranges: NDArray[np.float32]
    intensities: NDArray[np.float32]


def sweep_of_scan(scan: LaserScan) -> Sweep:
    """Return the planar sweep (N returns, meters) of a message.

    A range from ``range_min`` to ``range_max`` is a return. +inf is a beam that met nothing up to ``range_max`` (ROS
    enhancement proposal 117). NaN, -inf (nearer than the sensor measures) and ranges outside the limits say nothing,
    as if there were no such beam. Times count from the first beam.

    Raises:
        ValueError: a number is missing or not finite, the limits are no limits, or the angles are not those of one turn
            of so many ranges.
    """
    ranges = np.asarray(scan.ranges, np.float32)
    intensity = np.asarray(scan.intensities, np.float32)
    _check(scan, ranges, intensity)
    number = np.arange(ranges.size)
    angle = scan.angle_min + number * scan.angle_increment
    azimuth = np.remainder(angle + np.pi, 2 * np.pi) - np.pi
    hit = (ranges >= scan.range_min) & (ranges <= scan.range_max) & np.isfinite(ranges)
    returned, at = ranges[hit].astype(np.float64), azimuth[hit]
    points = np.zeros((at.size, 3), np.float32)
    points[:, 0], points[:, 1] = returned * np.cos(at), returned * np.sin(at)
    return Sweep(
        points,
        intensity[hit] if intensity.size else None,
        azimuth=at.astype(np.float32),
        time_s=(number[hit] * scan.time_increment).astype(np.float32),
        infer_sensor=False,
        planar=PlanarScan(azimuth[ranges == np.inf], float(scan.range_max)),
    )


def _check(scan: LaserScan, ranges: NDArray[np.float32], intensity: NDArray[np.float32]) -> None:
    """Raise a ValueError unless the numbers of a message agree."""
    if ranges.ndim != 1 or ranges.size > MAX_POINTS:
        raise ValueError(f"ranges must be (N,), at most {MAX_POINTS} of them, got shape {ranges.shape}")
    if intensity.shape not in ((0,), ranges.shape):
        raise ValueError(f"intensities must be as many as ranges, or none, got {intensity.size} of {ranges.size}")
    _check_finite(scan, "angle_min", "angle_max", "angle_increment", "time_increment", "range_min")
    if not 0 <= scan.range_min < scan.range_max:  # also where the maximum is no number
        raise ValueError(f"range_min and range_max must be limits, got {scan.range_min:g} and {scan.range_max:g} m")
    step, steps = abs(scan.angle_increment), max(ranges.size - 1, 0)
    if steps and not 0 < step * steps <= 2 * np.pi + step:
        raise ValueError(
            f"a scan must be at most one turn, got {ranges.size} ranges every {scan.angle_increment:g} rad"
        )
    # Drivers disagree on whether the last angle is that of the last beam or of the one after it.
    span = scan.angle_max - scan.angle_min
    if abs(span - scan.angle_increment * steps) > 2 * step + 0.01 * abs(span):
        raise ValueError(
            f"ranges must be those of angle_min to angle_max, got {ranges.size} every {scan.angle_increment:g} rad from"
            f" {scan.angle_min:g} to {scan.angle_max:g}"
        )
    if abs(scan.time_increment) * steps > REVOLUTION_S:
        raise ValueError(f"a scan must take at most {REVOLUTION_S:g} s, got {scan.time_increment * steps:g} s")


def _check_finite(scan: Any, *names: str) -> None:
    for name in names:
        if not np.isfinite(getattr(scan, name)):
            raise ValueError(f"{name} must be finite, got {getattr(scan, name):g}")
