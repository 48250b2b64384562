"""Evidence of the sensor's state: numbers of a whole sweep that change slowly without an attack.

None needs rings or a pose, except that ``measure_isolated`` needs rings. None is meaningful by itself: a monitor
compares it with the stream's own past.
"""

from __future__ import annotations

from itertools import pairwise
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from viewshed import _core
from viewshed.arrays import F32, Mask
from viewshed.grid import BevGrid
from viewshed.monitor.evidence.base import ABSTAINS, SECTORS, MonitoredSweep
from viewshed.monitor.evidence.history import USUAL_GAP_S
from viewshed.preprocess.leveling import LeveledSweep

_NEAR_M = 2.0
"""Near returns lie within this range: the vehicle itself, or something that blinds the sensor."""

_STEP_SHARE, _STEP_M = 0.03, 0.05
"""Consecutive returns are on one surface if their ranges differ by less than this share and distance."""

_MIN_RETURNS = 200

_GROUND_M = 0.3
"""Ground returns lie within this height above or below the local ground."""

_CELLS, _CELL_M, _SHIFTS = 256, 0.25, 16
"""Grid that aligns sweeps: cells a side, their size, and the largest shift in cells (4 m)."""

_MIN_CELLS, _CLEARER_BY = 20, 3
"""A shift is known if it matches at least 20 cells, and 3 more than any shift that is not adjacent to it."""


def measure_sensor_height(monitored: MonitoredSweep) -> F32:
    """Return the height of the sensor above the ground in meters (SECTORS,), the same in all sectors."""
    return _everywhere(monitored.leveled.sensor_height_m if len(monitored.leveled.points) else np.nan)


def measure_returns(monitored: MonitoredSweep) -> F32:
    """Return the number of usable returns (SECTORS,), the same in all sectors."""
    return _everywhere(len(monitored.leveled.points))


def measure_near_returns(monitored: MonitoredSweep) -> F32:
    """Return the share of returns within 2 m (SECTORS,), the same in all sectors."""
    points = monitored.leveled.sweep.points
    near = np.einsum("ij,ij->i", points, points) < _NEAR_M**2
    return _everywhere(near.mean() if len(points) else np.nan)


def measure_range_noise(monitored: MonitoredSweep) -> F32:
    """Return the noise of range in meters (SECTORS,), the same in all sectors.

    The lower quartile of second differences of range between consecutive returns on one surface, in storage order:
    sensors store returns in the order of firing, or ring by ring.
    """
    points = monitored.leveled.sweep.points
    return _everywhere(_core.range_noise(points, _STEP_SHARE, _STEP_M, _MIN_RETURNS))


def measure_ground_roughness(monitored: MonitoredSweep) -> F32:
    """Return the median distance in meters of ground returns from the ground (SECTORS,), the same in all sectors."""
    height_m = np.abs(monitored.leveled.height_m)
    ground = height_m[height_m < _GROUND_M]
    return _everywhere(np.median(ground) if len(ground) >= _MIN_RETURNS else np.nan)


def measure_isolated(monitored: MonitoredSweep) -> F32:
    """Return the share of isolated returns (SECTORS,), the same in all sectors; abstains if rings are not known.

    No neighboring beam confirms an isolated return: it is noise, rain or a spoofed point, not a surface. Also abstains
    if rings were only inferred from the points, because their errors isolate returns and vary from sweep to sweep.
    """
    image, layout = monitored.leveled.range_image, monitored.leveled.sensor_id.layout
    if image is None or layout is not None or not len(image.isolated):
        return ABSTAINS
    return _everywhere(image.isolated.mean())


def measure_jump(monitored: MonitoredSweep) -> F32:
    """Return the jump of the sensor in meters against its recent velocity (SECTORS,), the same in all sectors.

    The shift that best aligns the obstacle cells of two sweeps gives a velocity; the last one is compared with the
    median of those before. Abstains if too few obstacles match, or if they match another shift as well.
    """
    sweeps = (*monitored.earlier, monitored.leveled)
    velocities = [_shift_m(before, after) / _gap_s(before, after) for before, after in pairwise(sweeps)]
    known = [velocity for velocity in velocities[:-1] if np.isfinite(velocity).all()]
    if len(known) < 2:
        return ABSTAINS
    return _everywhere(float(np.hypot(*((velocities[-1] - np.median(known, axis=0)) * _gap_s(*sweeps[-2:])))))


def _gap_s(before: LeveledSweep, after: LeveledSweep) -> float:
    first_ns, last_ns = before.sweep.t_ns, after.sweep.t_ns
    gap_s = USUAL_GAP_S if first_ns is None or last_ns is None else (last_ns - first_ns) / 1e9
    return max(gap_s, 1e-3)


def _shift_m(before: LeveledSweep, after: LeveledSweep) -> NDArray[np.float64]:
    """Return the shift (2,) in meters, up to ``_SHIFTS`` cells, that best aligns obstacle cells; NaN if ambiguous."""
    key = ("shift", ref(before))
    shift: NDArray[np.float64] | None = after.derived.get(key)
    if shift is None:
        down, across, cells, elsewhere = _core.best_shift(_obstacles_of(after), _obstacles_of(before), _SHIFTS)
        is_known = cells >= _MIN_CELLS and cells - elsewhere >= _CLEARER_BY
        shift = after.derived[key] = np.array([down, across], np.float64) * (_CELL_M if is_known else np.nan)
    return shift


def _obstacles_of(leveled: LeveledSweep) -> Mask:
    """Return the mask (_CELLS, _CELLS) of cells around the sensor that contain an obstacle return."""
    cells: Mask | None = leveled.derived.get(("obstacles_about",))
    if cells is None:
        cells = leveled.derived[("obstacles_about",)] = leveled.obstacle_cells(BevGrid(_CELLS, _CELLS * _CELL_M / 2))
    return cells


def _everywhere(value: float) -> F32:
    return np.full(SECTORS, value, np.float32)
