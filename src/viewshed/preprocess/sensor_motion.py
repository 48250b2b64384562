"""How a spinning sensor moved while it measured, told by its points alone.

Points that were put straight lie in one frame, though each was measured from where the sensor was at its time. Seen
from one place the elevations of a beam are blurred then. A sensor turns evenly, so its place follows from the azimuth:
that motion is sought from which the elevations gather most, and undone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from viewshed._numba import BLOCK, atan2, split

FARTHEST_M = 3.5
"""Longest way that is tried, in one revolution: 35 m/s at ten revolutions a second."""

_SEAMS = (-np.pi, np.pi / 2, 0.0, -np.pi / 2)
"""Azimuths at which a revolution may begin and end, ..."""

_REFERENCES = (0.5, 0.0, 1.0)
"""... and parts of the turn from there, counter-clockwise, at which the sensor may have been at the origin."""

_STEP_M, _HEADINGS = 0.4, 8
"""Ways that are tried first: in steps of this, forth and back in so many headings."""

_CLIMB = 0.1
"""A sensor that is pitched moves up or down in its own frame: so much of the way is tried as well."""

_FINEST_M, _RISE = 0.004, 0.25
"""They are improved in ever smaller steps down to this one; upward in steps of a quarter."""

_FEW, _SAMPLE = 384, 2048
"""Returns by which a way is found, and by which it is improved."""

_NEAREST_M = 2.0
"""Nearer returns do not tell it: the azimuth at which they were measured differs from that of the point."""

_BINS = tuple(float(np.deg2rad(width)) for width in (0.2, 0.1, 0.03))
"""Widths of the bins of elevation, in their sine: for steps above 10 cm, above 5 cm, and below."""

_SHARP, _SMOOTH = 0.8, 0.26
"""Elevations that gather in the finest bins as much as in the widest ones are sharp, smooth ones 0.15 times as much. A
motion with a larger share than the first is taken at once. With a smaller one than the second from any place of the
first seam the sensor has no rings, or the points are not in its frame."""

_FEWEST_RETURNS = 256

_TIMES = 3

Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class SensorMotion:
    """An even motion during one revolution.

    Attributes:
        way_m: (3,) float64 meters from the beginning to the end, counter-clockwise, in the frame of the points.
        seam: azimuth in radians at which the revolution begins and ends.
        reference: part of the turn from there, counter-clockwise, at which the sensor was at the origin.
    """

    way_m: NDArray[np.float64]
    seam: float
    reference: float

    def undo(self, points: Floats) -> Floats:
        """Return points (N, 3) as the sensor measured them, each in its frame at that time."""
        way_m, seam, reference = self.way_m.astype(np.float32), np.float32(self.seam), np.float32(self.reference)
        measured: Floats = _undo(points, way_m, seam, reference)
        return measured


def find_motion(points: Floats) -> SensorMotion | None:
    """Return the motion by which the elevations of points (N, 3) gather most; None where they gather by none."""
    if len(points) < _FEWEST_RETURNS:
        return None
    sample = points[np.random.default_rng(0).integers(len(points), size=2 * _SAMPLE)]
    sample = sample[np.hypot(sample[:, 0], sample[:, 1]) > _NEAREST_M][:_SAMPLE]
    if len(sample) < _FEWEST_RETURNS:
        return None
    x, y, z = np.ascontiguousarray(sample.T)
    azimuth = np.arctan2(y, x)
    best, most, sharpest = None, 0, 0.0
    for seam in _SEAMS:
        for reference in _REFERENCES:
            turn = _turns(azimuth, np.float32(seam), np.float32(reference))
            way_m, gathered, widely = _search(x, y, z, turn, *_BINS)
            sharpest = max(sharpest, gathered / widely)
            if gathered > most:
                best, most = SensorMotion(way_m, seam, reference), gathered
            if sharpest > _SHARP:
                return best
        if sharpest < _SMOOTH:
            return None
    return best


@njit(cache=True, nogil=True, error_model="numpy")
def _turns(azimuth: Any, seam: Any, reference: Any) -> Any:  # pragma: no cover - compiled
    """Return the part of a turn (N,) from the place where the sensor was at the origin to where it looked."""
    turn = np.empty(azimuth.shape[0], np.float32)
    for n in range(azimuth.shape[0]):
        turn[n] = _turn(azimuth[n], seam, reference)
    return turn


@njit(cache=True, nogil=True, inline="always", error_model="numpy")
def _turn(azimuth: Any, seam: Any, reference: Any) -> Any:  # pragma: no cover - compiled
    """Return the same of one azimuth."""
    part = (azimuth - seam) * np.float32(0.5 / np.pi)
    return part - np.floor(part) - reference


@njit(cache=True, nogil=True, error_model="numpy")
def _undo(points: Any, way_m: Any, seam: Any, reference: Any) -> Any:  # pragma: no cover - compiled
    """Return points (N, 3) less the sensor's place; the azimuth at which each was measured follows from the result."""
    out = np.empty_like(points)
    x, y, z = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    u, v, turn = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    for start in range(0, points.shape[0], BLOCK):
        count = split(points, start, x, y, z)
        u[:count], v[:count] = x[:count], y[:count]
        for _ in range(_TIMES):
            _step_back(x[:count], y[:count], way_m, seam, reference, u, v, turn)
        for k in range(count):
            out[start + k, 0], out[start + k, 1], out[start + k, 2] = u[k], v[k], z[k] - turn[k] * way_m[2]
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def _step_back(
    x: Any, y: Any, way_m: Any, seam: Any, reference: Any, u: Any, v: Any, turn: Any
) -> None:  # pragma: no cover - compiled
    """Write the part of the turn at which points were measured, by their azimuth, and then where they were seen.

    A loop of its own without branches, so that it vectorizes.
    """
    for k in range(x.shape[0]):
        part = _turn(atan2(v[k], u[k]), seam, reference)
        turn[k], u[k], v[k] = part, x[k] - part * way_m[0], y[k] - part * way_m[1]


@njit(cache=True, nogil=True, error_model="numpy")
def _search(
    x: Any, y: Any, z: Any, turn: Any, coarse: Any, fine: Any, finest: Any
) -> Any:  # pragma: no cover - compiled
    """Return the way (3,) by which the elevations of points (N,) gather most, and how much in finest and widest bins.

    ``turn`` (N,) is the part of the way at which each was measured; then follow widths of three histograms' bins.
    """
    # 1. Level ways, by a few of the points.
    way_m, tried = np.zeros(3), np.zeros(3)
    counts = np.empty(int(2.0 / coarse) + 1, np.int32)
    few = slice(0, _FEW)
    best = _gathered(x[few], y[few], z[few], turn[few], way_m, counts)
    steps = int(FARTHEST_M / _STEP_M)
    for heading in range(_HEADINGS):
        for k in range(-steps, steps + 1):
            for climb in range(-1, 2):
                tried[0] = k * _STEP_M * np.cos(heading * np.pi / _HEADINGS)
                tried[1] = k * _STEP_M * np.sin(heading * np.pi / _HEADINGS)
                tried[2] = k * _STEP_M * climb * _CLIMB
                gathered = _gathered(x[few], y[few], z[few], turn[few], tried, counts)
                if gathered > best:
                    best = gathered
                    way_m[:] = tried
    # 2. Along each axis, by all of them: steps and bins become smaller.
    step = _STEP_M / 2
    while step > _FINEST_M:
        counts = np.empty(int(2.0 / (coarse if step > 0.1 else fine if step > 0.05 else finest)) + 1, np.int32)
        best = _gathered(x, y, z, turn, way_m, counts)
        for _ in range(_TIMES + 1):
            before = best
            for k in range(6):
                tried[:] = way_m
                tried[k // 2] += (step if k % 2 else -step) * (_RISE if k // 2 == 2 else 1.0)
                gathered = _gathered(x, y, z, turn, tried, counts)
                if gathered > best:
                    best = gathered
                    way_m[:] = tried
            if best == before:
                break
        step /= 2
    return way_m, best, _gathered(x, y, z, turn, way_m, np.empty(int(2.0 / coarse) + 1, np.int32))


@njit(cache=True, nogil=True, error_model="numpy")
def _gathered(x: Any, y: Any, z: Any, turn: Any, way_m: Any, counts: Any) -> Any:  # pragma: no cover - compiled
    """Return how much the elevations of points (N,) gather after a motion: the sum of squares of their histogram.

    Positions in the histogram come first, since a loop that counts does not vectorize.
    """
    size = x.shape[0]
    at = np.empty(size, np.int32)
    half, one = np.float32(0.5 * (counts.shape[0] - 1)), np.float32(1.0)
    dx, dy, dz = np.float32(way_m[0]), np.float32(way_m[1]), np.float32(way_m[2])
    for k in range(size):
        u, v, w = x[k] - turn[k] * dx, y[k] - turn[k] * dy, z[k] - turn[k] * dz
        at[k] = np.int32((w / np.sqrt(u * u + v * v + w * w) + one) * half)
    counts[:] = 0
    for k in range(size):
        counts[np.uint32(at[k])] += 1
    total = np.int64(0)
    for b in range(counts.shape[0]):
        total += counts[b] * counts[b]
    return total
