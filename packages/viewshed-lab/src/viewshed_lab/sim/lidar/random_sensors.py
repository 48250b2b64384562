"""Random sensors: uneven beam tables with calibration errors, limited fields of view, patterns without rings.

A family gives the bounds of its sensors, from which a generator samples. The sensors are simulated by the same code as
those of the beam tables.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from viewshed.sensors import LidarModel, lidar_model
from viewshed.sweep import Sweep
from viewshed_lab._config import one_of
from viewshed_lab.sim.lidar.optics import optics_of

PATTERNS = ("rings", "rosette", "weave")
"""``rings`` rotates about its axis; ``rosette`` deflects beams by two rotating prisms about the forward axis (Liu,
Zhang & Hong 2021, the Livox Mid-40 and Avia); ``weave`` rotates while its beams nod (the Livox Mid-360)."""

ORDERS = ("fired", "by_ring", "shuffled")
"""``fired``: in firing order; ``by_ring``: grouped by ring, the lowest first; ``shuffled``."""

COLUMNS = ("ring", "time_s", "intensity")
"""Columns of a sweep that a family's sensors may leave out."""

_SLOTS = 16
"""Consecutive shots per column of a pattern without rings."""

_MIN_GAP = np.deg2rad(0.08)
"""Smallest elevation step of a random beam table."""

Span = tuple[float, float]


@dataclass(frozen=True, slots=True)
class SensorFamily:
    """Bounds from which sensors are sampled uniformly; equal bounds fix the value.

    Raises:
        ValueError: a name is unknown or a number is out of range.
    """

    name: str  # of the family
    pattern: str  # of ``PATTERNS``
    rings: tuple[int, int]  # number of rings; not used by patterns without rings
    # firings per revolution; for patterns without rings a sixteenth of the shots per sweep
    columns: tuple[int, int]
    lowest_deg: tuple[float, float]  # elevation of the lowest beam, or of the lower edge without rings
    highest_deg: tuple[float, float]  # elevation of the highest beam, or of the upper edge without rings
    unevenness: tuple[float, float]  # of elevation steps: 0 is even, 1 is exponentially distributed
    azimuth_offset_deg: float  # standard deviation of the rings' azimuths from their column's
    calibration_deg: float  # standard deviation of each ring's elevation and azimuth from the delivered beam table
    range_offset_m: float  # standard deviation of each ring's constant range error
    field_deg: tuple[float, float]  # width of the field of view about the forward axis; 360 is a full revolution
    max_range_m: tuple[float, float]  # of returns
    min_range_m: float  # of returns
    order: str  # of the points, of ``ORDERS``
    leaves_out: tuple[str, ...]  # of ``COLUMNS``, missing in its sweeps

    def __post_init__(self) -> None:
        one_of(f"{self.name}: pattern", self.pattern, PATTERNS)
        one_of(f"{self.name}: order", self.order, ORDERS)
        if not set(self.leaves_out) <= set(COLUMNS):
            raise ValueError(f"{self.name}: leaves_out must be among {', '.join(COLUMNS)}, got {self.leaves_out}")
        if self.pattern != "rings" and ("ring" not in self.leaves_out or self.order == "by_ring"):
            raise ValueError(
                f"{self.name}: {self.pattern} has no rings: leaves_out must list ring, and order must not be by_ring"
            )
        for key in ("rings", "columns", "lowest_deg", "highest_deg", "unevenness", "field_deg", "max_range_m"):
            low, high = getattr(self, key)
            if not low <= high:
                raise ValueError(f"{self.name}: {key} must ascend, got {low}, {high}")
        if not (self.lowest_deg[1] < self.highest_deg[0] and 0 < self.field_deg[0] <= self.field_deg[1] <= 360):
            raise ValueError(f"{self.name}: lowest_deg must lie below highest_deg, and field_deg within (0, 360]")


@dataclass(frozen=True, slots=True, eq=False)
class DrawnSensor:
    """A sampled sensor: its true beams, and the beam table that it is delivered with."""

    name: str  # of its family, or of its beam table
    model: LidarModel  # true beams; for a pattern without rings those of one sweep
    table: LidarModel | None  # delivered beam table, without calibration errors; None for a pattern without rings
    range_offset_m: NDArray[np.float64]  # (rings,) float64 constant range error of each ring
    order: str = "fired"  # of ``ORDERS``
    leaves_out: tuple[str, ...] = ()  # of ``COLUMNS``

    @classmethod
    def of_table(cls, name: str) -> DrawnSensor:
        """Return the sensor of a beam table, without calibration errors.

        Raises:
            ValueError: no table has this name.
        """
        model = lidar_model(name)
        return cls(name, model, model, np.zeros(model.rings))

    def deliver(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return the sweep as the sensor delivers it: with range errors per ring, in its order, without some columns.

        Args:
            sweep: of :attr:`model`, with rings.
            rng: for shuffling.

        Raises:
            ValueError: the sweep has no rings.
        """
        ring = sweep.ring
        if ring is None:
            raise ValueError(f"sweep must have the rings of {self.model.name}, got none; call deliver only once")
        # Range errors move points along their beams, which are their directions from the sensor.
        range_m = np.maximum(np.linalg.norm(sweep.points, axis=1), 1e-3)
        factor = 1.0 + self.range_offset_m[ring] / range_m
        points = (sweep.points * factor[:, None]).astype(np.float32)
        sweep = sweep.replace(points=points, model=self.table)
        if self.order == "by_ring":
            sweep = sweep.select(np.argsort(ring, kind="stable"))
        elif self.order == "shuffled":
            sweep = sweep.select(rng.permutation(len(sweep)))
        return sweep.replace(**dict.fromkeys(self.leaves_out))


def draw_sensor(family: SensorFamily, rng: np.random.Generator, sweep: int = 0) -> DrawnSensor:
    """Sample a sensor of a family; the same generator state gives the same sensor.

    Args:
        family: bounds.
        rng: random generator.
        sweep: number of the sweep: a pattern without rings continues from the previous sweep.
    """
    columns = int(rng.integers(family.columns[0], family.columns[1] + 1))
    low, high = (np.deg2rad(rng.uniform(*bounds)) for bounds in (family.lowest_deg, family.highest_deg))
    field, max_range_m = np.deg2rad(rng.uniform(*family.field_deg)), float(rng.uniform(*family.max_range_m))
    name = f"{family.name} {rng.integers(2**32):08x}"
    if family.pattern != "rings":
        shots = _shots(family.pattern, rng, columns, (low, high, field), sweep)
        ladder = np.linspace(np.nanmin(shots[..., 1]), np.nanmax(shots[..., 1]), _SLOTS)
        model = LidarModel(
            name, ladder, columns, min_range_m=family.min_range_m, max_range_m=max_range_m, shots=shots
        )  # fmt: skip
        offsets = rng.normal(0.0, family.range_offset_m, _SLOTS)
        return DrawnSensor(family.name, model, None, offsets, family.order, family.leaves_out)
    # The delivered table: rings in uneven steps, each with its own azimuth offset.
    rings = int(rng.integers(family.rings[0], family.rings[1] + 1))
    elevation = _uneven(rng, rings, low, high, rng.uniform(*family.unevenness))
    offset = rng.normal(0.0, np.deg2rad(family.azimuth_offset_deg), rings)
    table = LidarModel(name, elevation, columns, offset, np.zeros(0), family.min_range_m, max_range_m)
    table = replace(table, reach_m=optics_of(table).reach_m, reach_source="the simulator's optics")
    # The true beams: every ring has a small error that never reaches its neighbor.
    error = np.deg2rad(family.calibration_deg)
    gap = np.diff(elevation, prepend=-np.pi, append=np.pi)
    max_error = 0.4 * np.minimum(gap[:-1], gap[1:])
    true_elevation = elevation + np.clip(rng.normal(0.0, error, rings), -max_error, max_error)
    model = replace(table, elevation=true_elevation, azimuth_offset=offset + rng.normal(0.0, error, rings))
    if field < 2 * np.pi:
        model = replace(model, shots=_within_field(model, field))
    offsets = rng.normal(0.0, family.range_offset_m, rings)
    return DrawnSensor(family.name, model, table, offsets, family.order, family.leaves_out)


def _uneven(rng: np.random.Generator, rings: int, low: float, high: float, unevenness: float) -> NDArray[np.float64]:
    """Return ascending elevations (rings,) from ``low`` to ``high``; steps are between even and exponential."""
    steps = (1 - unevenness) + unevenness * rng.exponential(1.0, rings - 1)
    spare = max((high - low) - _MIN_GAP * (rings - 1), 0.0)
    gaps = _MIN_GAP + spare * steps / steps.sum()
    return low + np.concatenate([[0.0], np.cumsum(gaps)])


def _within_field(model: LidarModel, field: float) -> NDArray[np.float64]:
    """Return the shots (C, R, 2) of a rotating model that fires only within a field about the forward axis."""
    columns = -np.pi + (np.arange(model.azimuth_columns) + 0.5) * model.azimuth_step
    azimuth = columns[:, None] + model.azimuth_offset
    shots = np.stack([azimuth, np.broadcast_to(model.elevation, azimuth.shape)], axis=-1)
    shots[np.abs(columns) > field / 2] = np.nan
    return shots


def _shots(
    pattern: str, rng: np.random.Generator, columns: int, bounds: tuple[float, float, float], sweep: int
) -> NDArray[np.float64]:
    """Return shots (C, 16, 2) of a pattern without rings, in firing order; ``bounds``: lower and upper edge, width."""
    low, high, field = bounds
    # Phases of two motors whose speeds have no common period, so the scanned directions differ between sweeps.
    turns, ratio = rng.uniform(10.0, 20.0), rng.uniform(0.55, 0.8) * np.sqrt(2)
    start = rng.uniform(0.0, 2 * np.pi, 2)
    phase = 2 * np.pi * (sweep + (np.arange(columns * _SLOTS) + 0.5) / (columns * _SLOTS))
    first, second = start[0] + turns * phase, start[1] - ratio * turns * phase
    if pattern == "rosette":
        # Each prism deflects by half of the field; the sum of two rotating vectors is the rosette.
        across, up = np.cos(first) + np.cos(second), np.sin(first) + np.sin(second)
        azimuth, elevation = field / 4 * across, (low + high) / 2 + (high - low) / 4 * up
    else:
        # The azimuth rotates many times per sweep while the elevation oscillates.
        azimuth = (first + np.pi) % (2 * np.pi) - np.pi
        elevation = low + (high - low) * (0.5 + np.arcsin(np.sin(ratio * 7.0 * phase + start[1])) / np.pi)
        azimuth[np.abs(azimuth) > field / 2] = np.nan
        elevation[np.isnan(azimuth)] = np.nan
    return np.stack([azimuth, elevation], axis=-1).reshape(columns, _SLOTS, 2)
