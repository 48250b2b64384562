"""LidarModel: the beam table of a sensor; and the beam tables shipped with the package."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed._extras import load, plugins
from viewshed.arrays import as_int, frozen

MAX_RINGS = 4096

_TOML_KEYS = {
    "name", "elevations_deg", "azimuth_offsets_deg", "origins_m", "azimuth_columns",
    "min_range_m", "max_range_m", "reach_m", "reach_source", "source", "fires_rings", "inferred",
}  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class LidarModel:
    """The beams of a spinning LiDAR; ring 0 is the lowest beam.

    Attributes:
        name: the sensor's usual name, for example ``HDL-32E``.
        elevation: (rings,) float64 radians above the horizon, strictly ascending.
        azimuth_offset: (rings,) float64 radians to add to the firing azimuth, counter-clockwise from above; zeros if
            left out.
        origin_m: (rings,) float64 meters: height of the beam above the sensor's origin at horizontal range 0, so that
            its height at range r is ``origin_m + r * tan(elevation)``; zeros if left out.
        azimuth_columns: firings in one revolution.
        min_range_m: nearer returns are the sensor itself or null returns.
        max_range_m: farthest return of this sensor.
        source: where the table comes from.
        shots: (azimuth_columns, rings, 2) float64 radians: azimuth and elevation of every shot in firing order, NaN
            where nothing is fired; for a sensor whose pattern is not its rings, or whose field is below 360°. None if
            each column fires every ring at its azimuth. Only the simulator reads it. Without rings, ``elevation``
            has equal steps from the lowest shot to the highest.
        reach_m: range at which a target of 10 % reflectivity that faces the sensor has a detection probability of
            50 %, or None if not stated.
        reach_source: where ``reach_m`` comes from.
        fires_rings: False for a sensor with a pattern without rings (Livox): no rings are recovered from its returns,
            and ``elevation`` has equal steps from the lowest shot to the highest, which the simulator fires.
        inferred: whether the sensor may be inferred from points. False if another sensor has similar beams, or if the
            table was not verified on real sweeps.

    Raises:
        ValueError: an attribute is invalid.
    """

    name: str
    elevation: NDArray[np.float64]
    azimuth_columns: int
    azimuth_offset: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    origin_m: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    min_range_m: float = 0.5
    max_range_m: float = 100.0
    source: str = ""
    reach_m: float | None = None
    reach_source: str = ""
    shots: NDArray[np.float64] | None = None
    fires_rings: bool = True
    inferred: bool = True

    def __post_init__(self) -> None:
        elevation = np.array(self.elevation, dtype=np.float64)
        if elevation.ndim != 1 or not 1 <= elevation.size <= MAX_RINGS or not np.isfinite(elevation).all():
            raise ValueError(f"{self.name}: elevations must be 1 to {MAX_RINGS} finite numbers")
        if (np.diff(elevation) <= 0).any() or np.abs(elevation).max() > np.pi / 2:
            raise ValueError(f"{self.name}: elevations must ascend strictly within ±90°; ring 0 is the lowest beam")
        object.__setattr__(self, "azimuth_columns", as_int(f"{self.name}: azimuth_columns", self.azimuth_columns))
        if not 4 <= self.azimuth_columns <= 36_000:
            raise ValueError(f"{self.name}: azimuth_columns must lie in [4, 36000], got {self.azimuth_columns}")
        if not 0 <= self.min_range_m < self.max_range_m < 10_000:
            raise ValueError(f"{self.name}: ranges must satisfy 0 ≤ min_range_m < max_range_m < 10000")
        if self.reach_m is not None and not self.min_range_m < self.reach_m <= self.max_range_m:
            raise ValueError(
                f"{self.name}: reach_m must lie in (min_range_m, max_range_m = {self.max_range_m:g}],"
                f" got {self.reach_m:g}; leave it out where it is not known"
            )
        object.__setattr__(self, "elevation", frozen(elevation))
        for key in ("azimuth_offset", "origin_m"):
            object.__setattr__(self, key, self._per_ring(key))
        if self.shots is not None:
            object.__setattr__(self, "shots", frozen(self._checked_shots(np.array(self.shots, dtype=np.float64))))

    def _checked_shots(self, shots: NDArray[np.float64]) -> NDArray[np.float64]:
        shape = (self.azimuth_columns, self.rings, 2)
        if shots.shape != shape or np.isinf(shots).any() or (np.isnan(shots[..., 0]) != np.isnan(shots[..., 1])).any():
            raise ValueError(f"{self.name}: shots must be {shape} radians, NaN in pairs, got {shots.shape}")
        if np.isnan(shots).all() or np.nanmax(np.abs(shots[..., 1])) > np.pi / 2:
            raise ValueError(f"{self.name}: shots must have elevations within ±90°, and be one or more")
        return shots

    def _per_ring(self, key: str) -> NDArray[np.float64]:
        array = np.array(getattr(self, key), dtype=np.float64)
        if array.size == 0:
            array = np.zeros(self.rings)
        if array.shape != (self.rings,) or not np.isfinite(array).all():
            raise ValueError(f"{self.name}: {key} must be {self.rings} finite numbers, one a ring, got {array.shape}")
        return frozen(array)

    @property
    def rings(self) -> int:
        """Number of beams in a column."""
        return int(self.elevation.size)

    @property
    def fired(self) -> NDArray[np.bool_] | None:
        """(azimuth_columns, rings) bool mask of the fired shots, or None if all are fired."""
        return None if self.shots is None else ~np.isnan(self.shots[..., 0])

    @property
    def azimuth_step(self) -> float:
        """Angle between two firings in radians."""
        return 2.0 * np.pi / self.azimuth_columns

    @classmethod
    def from_toml(cls, path: str | Path) -> LidarModel:
        """Return the model in a TOML file, with the keys of the shipped beam tables (angles in degrees).

        Raises:
            ValueError: the file is not TOML, or a key is missing, unknown or out of range.
            OSError: the file cannot be read.
        """
        return _parse(Path(path).read_bytes(), str(path))


def _parse(raw: bytes, where: str) -> LidarModel:
    table = _table(raw, where)
    missing = {"name", "elevations_deg", "azimuth_columns"} - table.keys()
    unknown = table.keys() - _TOML_KEYS
    if missing or unknown:
        raise ValueError(f"{where}: missing keys {sorted(missing)}, unknown keys {sorted(unknown)}")
    try:
        return LidarModel(
            name=_text(table, "name"),
            elevation=np.deg2rad(_numbers(table, "elevations_deg")),
            azimuth_columns=table["azimuth_columns"],
            azimuth_offset=np.deg2rad(_numbers(table, "azimuth_offsets_deg")),
            origin_m=_numbers(table, "origins_m"),
            min_range_m=_number("min_range_m", table.get("min_range_m", 0.5)),
            max_range_m=_number("max_range_m", table.get("max_range_m", 100.0)),
            source=_text(table, "source"),
            reach_m=_number("reach_m", table["reach_m"]) if "reach_m" in table else None,
            reach_source=_text(table, "reach_source"),
            fires_rings=_flag(table, "fires_rings"),
            inferred=_flag(table, "inferred"),
        )
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error


def _table(raw: bytes, where: str) -> dict[str, Any]:
    try:
        return tomllib.loads(raw.decode("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{where} must be a TOML beam table: {error}") from error


def _text(table: dict[str, Any], key: str) -> str:
    value = table.get(key, "")
    if not isinstance(value, str) or (key == "name" and not value):
        raise ValueError(f"{key} must be text in quotes, got {value!r}")
    return value


def _flag(table: dict[str, Any], key: str) -> bool:
    """Return the boolean under ``key``, true if it is left out."""
    value = table.get(key, True)
    if not isinstance(value, bool):
        raise ValueError(f"{key} must be true or false, got {value!r}")
    return value


def _number(key: str, value: Any) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise ValueError(f"{key} must be a number, got {value!r}")
    return float(value)


def _numbers(table: dict[str, Any], key: str) -> NDArray[np.float64]:
    """Return the list of numbers under ``key``, empty if it is left out."""
    value = table.get(key, [])
    if not isinstance(value, list):
        raise ValueError(f"{key} must be a list of numbers, got {value!r}")
    return np.array([_number(key, item) for item in value], dtype=np.float64)


@lru_cache(maxsize=1)
def inferable_sensors() -> tuple[str, ...]:
    """Return the names of the sensors that may be inferred from points, in alphabetical order."""
    return tuple(name for name in sensor_names() if lidar_model(name).inferred)


@lru_cache(maxsize=1)
def sensor_names() -> tuple[str, ...]:
    """Return the names of the shipped beam tables, in alphabetical order."""
    tables = resources.files("viewshed") / "beam_tables"
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in tables.iterdir() if entry.name.endswith(".toml")))


def lidar_model(name: str) -> LidarModel:
    """Return the beam table called ``name`` (case and punctuation are ignored), or the one in the TOML file ``name``.

    Installed packages can add tables by entry points ``viewshed.sensors``, each the path of a TOML file.

    Raises:
        ValueError: no table has this name; the message lists all names.

    >>> lidar_model("vlp-16").rings
    16
    """
    if name.endswith(".toml"):
        return LidarModel.from_toml(name)
    for known in sensor_names():
        if _normalized(known) == _normalized(name):
            return _shipped(known)
    added = plugins("sensors")
    for known, point in added.items():
        if _normalized(known) == _normalized(name):
            return LidarModel.from_toml(
                load(point, lambda path: isinstance(path, str | Path), "the path of a TOML file")
            )
    names = ", ".join([*sensor_names(), *added])
    raise ValueError(f"sensor must be one of {names} or a TOML file, got {name!r}")


@lru_cache(maxsize=64)
def _shipped(name: str) -> LidarModel:
    return _parse((resources.files("viewshed") / "beam_tables" / f"{name}.toml").read_bytes(), f"{name}.toml")


def _normalized(name: str) -> str:
    return "".join(letter for letter in name.lower() if letter.isalnum())
