"""Sensors drawn at random: uneven beam tables with calibrations of their own, limited fields, patterns without rings.

A family says within which bounds its sensors lie; a generator draws one. All are fired and measured by the same code as
the sensors of the beam tables.
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
"""``rings`` turns about its axis; ``rosette`` steers its beams through two turning prisms about the forward axis (Liu,
Zhang & Hong 2021, the Livox Mid-40 and Avia); ``weave`` turns while its beams nod (the Livox Mid-360)."""

ORDERS = ("fired", "by_ring", "shuffled")
"""``fired``: as the sensor fires; ``by_ring``: all returns of a ring together, the lowest first; ``shuffled``."""

COLUMNS = ("ring", "time_s", "intensity")
"""Columns of a sweep that a family's sensors may leave out."""

_SLOTS = 16
"""Shots in one column of a pattern without rings: neighbors in time."""

_LEAST_GAP = np.deg2rad(0.08)
"""Beams of a random table are at least so far apart."""

Span = tuple[float, float]


@dataclass(frozen=True, slots=True)
class SensorFamily:
    """Bounds within which sensors are drawn, uniformly; two equal bounds are one value.

    Raises:
        ValueError: a name is unknown or a number is out of range.
    """

    name: str  # of the family
    pattern: str  # of ``PATTERNS``
    rings: tuple[int, int]  # number of rings; not used by patterns without rings
    # firings in one revolution; of a pattern without rings a sixteenth of its shots in one sweep
    columns: tuple[int, int]
    # elevation of the lowest beam. Patterns without rings: that of the field's lower edge.
    lowest_deg: tuple[float, float]
    highest_deg: tuple[float, float]  # elevation of the highest beam, or of the upper edge
    unevenness: tuple[float, float]  # 0 for even steps from ring to ring; at 1 steps differ as exponential numbers do
    azimuth_offset_deg: float  # standard deviation of the azimuths of the rings from that of their column
    calibration_deg: float  # standard deviation of each ring's elevation and azimuth from the table that is handed out
    range_offset_m: float  # standard deviation of the error that all ranges of a ring have
    field_deg: tuple[float, float]  # width of the field about the forward axis; 360 is a whole revolution
    max_range_m: tuple[float, float]  # farthest return
    min_range_m: float  # nearest return
    order: str  # of ``ORDERS``, in which its points arrive
    leaves_out: tuple[str, ...]  # of ``COLUMNS``, those that its sweeps never have

    def __post_init__(self) -> None:
        one_of(f"{self.name}: pattern", self.pattern, PATTERNS)
        one_of(f"{self.name}: order", self.order, ORDERS)
        if not set(self.leaves_out) <= set(COLUMNS):
            raise ValueError(f"{self.name}: leaves_out must be among {', '.join(COLUMNS)}, got {self.leaves_out}")
        if self.pattern != "rings" and ("ring" not in self.leaves_out or self.order == "by_ring"):
            raise ValueError(f"{self.name}: {self.pattern} must leave out ring, and no order by_ring: it has none")
        for key in ("rings", "columns", "lowest_deg", "highest_deg", "unevenness", "field_deg", "max_range_m"):
            low, high = getattr(self, key)
            if not low <= high:
                raise ValueError(f"{self.name}: {key} must ascend, got {low}, {high}")
        if not (self.lowest_deg[1] < self.highest_deg[0] and 0 < self.field_deg[0] <= self.field_deg[1] <= 360):
            raise ValueError(f"{self.name}: lowest_deg must lie below highest_deg, and field_deg within (0, 360]")


@dataclass(frozen=True, slots=True, eq=False)
class DrawnSensor:
    """A sensor as it was built, and what its maker says of it."""

    name: str  # of its family, or of its beam table
    model: LidarModel  # its beams as they are; of a pattern without rings those of one sweep
    # the beam table that is handed out with it, without its own calibration; None for a pattern without rings
    table: LidarModel | None
    range_offset_m: NDArray[np.float64]  # (rings,) float64 error of all ranges of each ring
    order: str = "fired"  # of ``ORDERS``
    leaves_out: tuple[str, ...] = ()  # of ``COLUMNS``

    @classmethod
    def of_table(cls, name: str) -> DrawnSensor:
        """Return the sensor of a beam table, built as its maker says.

        Raises:
            ValueError: no table has this name.
        """
        model = lidar_model(name)
        return cls(name, model, model, np.zeros(model.rings))

    def deliver(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return the sweep as the sensor hands it out: ranges off by ring, in its order, columns left out.

        Args:
            sweep: of :attr:`model`, with rings.
            rng: shuffles.

        Raises:
            ValueError: the sweep has no rings.
        """
        ring = sweep.ring
        if ring is None:
            raise ValueError(f"sweep must have rings as {self.model.name} fires them, got none; deliver it once")
        # Ranges are wrong along each beam; the points' direction from the sensor is that of their beam.
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
    """Return a sensor of a family; the same state of the generator gives the same sensor.

    Args:
        family: its bounds.
        rng: draws it.
        sweep: number of the sweep: a pattern without rings goes on from the end of the sweep before.
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
    # The table that is handed out: rings in uneven steps, each with an azimuth of its own.
    rings = int(rng.integers(family.rings[0], family.rings[1] + 1))
    elevation = _uneven(rng, rings, low, high, rng.uniform(*family.unevenness))
    offset = rng.normal(0.0, np.deg2rad(family.azimuth_offset_deg), rings)
    table = LidarModel(name, elevation, columns, offset, np.zeros(0), family.min_range_m, max_range_m)
    table = replace(table, reach_m=optics_of(table).reach_m, reach_source="the simulator's optics")
    # The sensor as built: every ring is off a little, never past its neighbor.
    error = np.deg2rad(family.calibration_deg)
    gap = np.diff(elevation, prepend=-np.pi, append=np.pi)
    most = 0.4 * np.minimum(gap[:-1], gap[1:])
    built = elevation + np.clip(rng.normal(0.0, error, rings), -most, most)
    model = replace(table, elevation=built, azimuth_offset=offset + rng.normal(0.0, error, rings))
    if field < 2 * np.pi:
        model = replace(model, shots=_within_field(model, field))
    offsets = rng.normal(0.0, family.range_offset_m, rings)
    return DrawnSensor(family.name, model, table, offsets, family.order, family.leaves_out)


def _uneven(rng: np.random.Generator, rings: int, low: float, high: float, unevenness: float) -> NDArray[np.float64]:
    """Return ascending elevations (rings,) from ``low`` to ``high`` in steps between even and exponential."""
    steps = (1 - unevenness) + unevenness * rng.exponential(1.0, rings - 1)
    spare = max((high - low) - _LEAST_GAP * (rings - 1), 0.0)
    gaps = _LEAST_GAP + spare * steps / steps.sum()
    return low + np.concatenate([[0.0], np.cumsum(gaps)])


def _within_field(model: LidarModel, field: float) -> NDArray[np.float64]:
    """Return the shots (C, R, 2) of a model that turns and fires only within a field about the forward axis."""
    columns = -np.pi + (np.arange(model.azimuth_columns) + 0.5) * model.azimuth_step
    azimuth = columns[:, None] + model.azimuth_offset
    shots = np.stack([azimuth, np.broadcast_to(model.elevation, azimuth.shape)], axis=-1)
    shots[np.abs(columns) > field / 2] = np.nan
    return shots


def _shots(
    pattern: str, rng: np.random.Generator, columns: int, bounds: tuple[float, float, float], sweep: int
) -> NDArray[np.float64]:
    """Return shots (C, 16, 2) of a pattern without rings, in time; ``bounds`` are both edges and the field's width."""
    low, high, field = bounds
    # Phases of two motors whose speeds share no common period: what is scanned differs from sweep to sweep.
    turns, ratio = rng.uniform(10.0, 20.0), rng.uniform(0.55, 0.8) * np.sqrt(2)
    start = rng.uniform(0.0, 2 * np.pi, 2)
    phase = 2 * np.pi * (sweep + (np.arange(columns * _SLOTS) + 0.5) / (columns * _SLOTS))
    first, second = start[0] + turns * phase, start[1] - ratio * turns * phase
    if pattern == "rosette":
        # Each prism deflects by half of the field; the sum of two turning arrows draws the rosette.
        across, up = np.cos(first) + np.cos(second), np.sin(first) + np.sin(second)
        azimuth, elevation = field / 4 * across, (low + high) / 2 + (high - low) / 4 * up
    else:
        # Turns in azimuth many times a sweep while the elevation goes up and down.
        azimuth = (first + np.pi) % (2 * np.pi) - np.pi
        elevation = low + (high - low) * (0.5 + np.arcsin(np.sin(ratio * 7.0 * phase + start[1])) / np.pi)
        azimuth[np.abs(azimuth) > field / 2] = np.nan
        elevation[np.isnan(azimuth)] = np.nan
    return np.stack([azimuth, elevation], axis=-1).reshape(columns, _SLOTS, 2)
