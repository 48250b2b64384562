"""From named columns (PCD fields, PLY properties, feather columns) to Columns."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.io.columns import Columns
from viewshed.io.frames import IDENTITY
from viewshed.io.rings import matched_azimuth, matched_time_s
from viewshed.sweep import Sweep

MARK = "viewshed sweep"
"""A comment in files that this package wrote: ring counts from the lowest beam, azimuth and time are ours."""

_INTENSITY = ("intensity", "i", "reflectivity", "reflectance", "scalar_intensity", "remission")
_RING = ("ring", "channel", "laser", "laser_id", "laser_number", "ring_id", "scalar_ring", "line")
_AZIMUTH = ("azimuth",)
_TIME = ("time", "time_s", "timestamp", "time_stamp", "t", "offset_time", "offset_ns")
WANTED = frozenset(("x", "y", "z", *_INTENSITY, *_RING, *_AZIMUTH, *_TIME))
"""Lower-case names of columns that are read; the others are skipped."""


def columns_of_table(table: Mapping[str, NDArray[Any]], frame: Rigid | None, *, ours: bool) -> Columns:
    """Return Columns from lower-case names → (N,) numbers; ``ours`` tells that this package wrote the file.

    Raises:
        ValueError: x, y or z is missing, or rings are not whole numbers.
    """
    missing = [name for name in "xyz" if name not in table]
    if missing:
        raise ValueError(f"must have columns x, y and z, {', '.join(missing)} not found among {', '.join(table)}")
    points = np.empty((len(table["x"]), 3), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        for axis, name in enumerate("xyz"):
            points[:, axis] = table[name]
        intensity = _first(table, _INTENSITY)
        intensity = None if intensity is None else intensity.astype(np.float32)
    laser = _whole(_first(table, _RING))
    time, azimuth = _first(table, _TIME), _first(table, _AZIMUTH)
    if not ours:
        azimuth = None if azimuth is None else matched_azimuth(azimuth, points)
        time = None if time is None else matched_time_s(time)
    return Columns(
        points, intensity,
        ring=laser.astype(np.int16) if ours and laser is not None else None,
        laser=None if ours else laser,
        azimuth=azimuth, time_s=time, frame=IDENTITY if frame is None else frame,
    )  # fmt: skip


def _first(table: Mapping[str, NDArray[Any]], names: tuple[str, ...]) -> NDArray[Any] | None:
    return next((table[name] for name in names if name in table), None)


def _whole(laser: NDArray[Any] | None) -> NDArray[np.int64] | None:
    if laser is None:
        return None
    number = laser.astype(np.float64)
    if number.size and not ((number >= 0) & (number < 4096) & (number == np.floor(number))).all():
        raise ValueError("ring must be whole numbers in [0, 4096)")
    return number.astype(np.int64)


def table_of_sweep(sweep: Sweep) -> NDArray[Any]:
    """Return the sweep's columns as one little-endian structured array (N,); columns it lacks are left out."""
    columns: dict[str, tuple[str, NDArray[Any] | None]] = {
        "x": ("<f4", sweep.points[:, 0]), "y": ("<f4", sweep.points[:, 1]), "z": ("<f4", sweep.points[:, 2]),
        "intensity": ("<f4", sweep.intensity), "ring": ("<i2", sweep.ring),
        "azimuth": ("<f4", sweep.azimuth), "time": ("<f4", sweep.time_s),
    }  # fmt: skip
    present = {name: (kind, values) for name, (kind, values) in columns.items() if values is not None}
    table = np.empty(len(sweep), np.dtype([(name, kind) for name, (kind, _) in present.items()]))
    for name, (_, values) in present.items():
        table[name] = values
    return table
