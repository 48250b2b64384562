"""BeamImage: every beam of one revolution, those that returned and those that did not, where they began and pointed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewshed.beams import recover_beams
from viewshed.labels.image_kernels import fill_image, fired, mean_times, settle
from viewshed.labels.motion import Drift
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep

Floats = NDArray[np.float32]
_SAMPLED = 4000
_NEAR_COLUMNS = 2
_ALMOST = 0.98


@dataclass(frozen=True, slots=True, eq=False)
class BeamImage:
    """The beams of one revolution. C columns by azimuth, R rings from the lowest up, in the axes of ``level``.

    Attributes:
        origin_m: (C, R, 3) float32 start of each beam from the sensor's reference position.
        direction: (C, R, 3) float32 unit vectors.
        depth_m: (C, R) float32 metres from start to return, 0 where there was none.
        pixels: (C, R) int32 row of the return in the sweep, -1 where there was none.
        max_range_m: how far the sensor sees.
        model: the sensor's beams, or None where they had to be told from the returns.
    """

    origin_m: Floats
    direction: Floats
    depth_m: Floats
    pixels: NDArray[np.int32]
    max_range_m: float
    model: LidarModel | None

    @property
    def returned(self) -> NDArray[np.bool_]:
        """Which beams returned, (C, R)."""
        return self.pixels >= 0


def beam_image(sweep: Sweep, level_from_sensor: NDArray[np.float64], drift: Drift) -> BeamImage:
    """Return the beams of ``sweep`` with the motion within the revolution undone.

    The firing pattern is that of the sweep's model, else of its rings and azimuth step. Each return is its own beam;
    missing beams lie on the pattern.

    Args:
        sweep: the revolution; its points are in the reference frame, that of the middle of the revolution.
        level_from_sensor: rotation (3, 3).
        drift: how the sensor moved; needs the times of the returns, else it is left out.
    """
    seconds, model = _seconds(sweep), sweep.model
    found = recover_beams(sweep if sweep.ring is not None else _still(sweep, level_from_sensor, drift, seconds))
    elevation, rise, offset = _tables(found.elevation, model)
    pose = (level_from_sensor.astype(np.float32), drift.velocity_mps.astype(np.float32), np.float32(drift.yaw_rate))
    start, way, length, azimuth = fired(sweep.points, found.ring, seconds, pose, (rise, offset))
    columns = _count(azimuth, {found.columns} if model is None else {found.columns, model.azimuth_columns})
    column, phase = _columns(azimuth, columns)
    pixels = np.full((columns, len(elevation)), -1, np.int32)
    settle(found.ring, column, length, pixels)
    step = np.float32(2 * np.pi / columns)
    times = mean_times(column, seconds, columns)
    shape = pixels.shape
    out = np.empty((*shape, 3), np.float32), np.empty((*shape, 3), np.float32), np.empty(shape, np.float32)
    nominal = (np.float32(phase * step - np.pi), step, times, elevation, rise, offset)
    fill_image(pixels, (start, way, length), nominal, pose, out)
    return BeamImage(*out, pixels, _reach(model, length), model)


def _tables(elevation: NDArray[np.float64], model: LidarModel | None) -> tuple[Floats, Floats, Floats]:
    """Return elevation, height of the start and azimuth offset of each ring (R,)."""
    rings = len(elevation)
    if model is None or model.rings != rings:
        return elevation.astype(np.float32), np.zeros(rings, np.float32), np.zeros(rings, np.float32)
    tables = (model.elevation, model.origin_m, model.azimuth_offset)
    first, second, third = (table.astype(np.float32) for table in tables)
    return first, second, third


def _seconds(sweep: Sweep) -> Floats:
    """Return the time (N,) of each return from the middle of the revolution; 0 where they are not told."""
    if sweep.time_s is None or not len(sweep):
        return np.zeros(len(sweep), np.float32)
    middle = (float(sweep.time_s.min()) + float(sweep.time_s.max())) / 2
    return (sweep.time_s - np.float32(middle)).astype(np.float32)


def _still(sweep: Sweep, level_from_sensor: NDArray[np.float64], drift: Drift, seconds: Floats) -> Sweep:
    """Return the sweep with each point as the sensor saw it when it fired: rings are told from directions."""
    if not (drift.yaw_rate or drift.velocity_mps.any()):
        return sweep
    x, y, z = (sweep.points @ level_from_sensor.T - np.outer(seconds, drift.velocity_mps)).T
    c, s = np.cos(drift.yaw_rate * seconds), np.sin(drift.yaw_rate * seconds)
    return sweep.replace(points=np.stack([c * x + s * y, c * y - s * x, z], axis=-1) @ level_from_sensor)


def _count(azimuth: Floats, likely: set[int]) -> int:
    """Return the number of columns that firing azimuths (N,) fit best, of the likely ones and those next to them."""
    some = azimuth[:: max(len(azimuth) // _SAMPLED, 1)].astype(np.float64)
    near = sorted({columns + more for columns in likely for more in range(-_NEAR_COLUMNS, _NEAR_COLUMNS + 1)})
    fits = [abs(np.exp(1j * columns * some).sum()) for columns in near]
    plain = [
        columns for columns, fit in zip(near, fits, strict=True) if columns in likely and fit > _ALMOST * max(fits)
    ]
    return max(plain[-1] if plain else near[int(np.argmax(fits))], 4)


def _columns(azimuth: Floats, columns: int) -> tuple[NDArray[np.int64], float]:
    """Return the column (N,) of firing azimuths, and where in a column firings lie, in [0, 1).

    The circular mean of the remainders tells the sensor's phase.
    """
    position = (azimuth.astype(np.float64) / (2 * np.pi) + 0.5) * columns
    turn = np.exp(2j * np.pi * position).sum() if len(position) else -1.0
    phase = round(float(np.angle(turn) / (2 * np.pi)), 6) % 1.0
    return np.floor(position - phase + 0.5).astype(np.int64) % columns, phase


def _reach(model: LidarModel | None, length: Floats) -> float:
    if model is not None:
        return model.max_range_m
    return float(length.max(initial=0.0))
