"""Model of a laser spoofer: which beams it controls, and how exactly it sets their ranges.

Helpers that aim an attack find the level frame, ground and obstacles of the scene in the victim's own sweep. Helpers
that build the attacked sweep put forged returns into firing order and fill all columns.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64, Mask
from viewshed.grid import GRIDS
from viewshed.preprocess.leveling import OBSTACLE_HEIGHTS_M, LeveledSweep, level
from viewshed.sweep import Sweep
from viewshed_lab._config import Between, Checked
from viewshed_lab.sim.lidar.optics import Optics, optics_of
from viewshed_lab.threats.attacks.base import Tampered, Wedge
from viewshed_lab.threats.attacks.beam_lattice import BeamLattice, Rays, lattice_of, within

COLUMNS = ("points", "intensity", "ring", "azimuth", "time_s")
"""Columns of a sweep, with one value per return."""


@dataclass(frozen=True, slots=True, eq=False)
class Forged:
    """A forged returns."""

    points: NDArray[np.float32]  # (A, 3) float32 meters, sensor frame
    ring: NDArray[Any]  # (A,) ring, -1 if unknown
    column: NDArray[Any]  # (A,) azimuth column, -1 if unknown
    row: NDArray[np.intp]  # (A,) row of the return that it replaces, -1 for none


def untouched(sweep: Sweep, wedge: Wedge | None = None) -> Tampered:
    """Return the record of an unchanged sweep."""
    none = np.zeros(len(sweep), np.bool_)
    return Tampered(sweep, none, none, wedge)


def assemble(sweep: Sweep, removed: Mask, forged: Forged, wedge: Wedge | None, rng: np.random.Generator) -> Tampered:
    """Return the sweep without the rows ``removed`` (N,) and with the forged returns, in the sensor's storage order.

    A return that replaces another takes its row, ring, azimuth and time; any other is stored next to its neighbor on
    the beams. Intensities are drawn from those of the sweep.
    """
    # Sort the forged returns among the kept rows: a key is a row, or lies between two.
    source, key = _neighbors(sweep, forged)
    order = np.argsort(key, kind="stable")
    kept = np.flatnonzero(~removed)
    index = np.insert(kept, np.searchsorted(kept, key[order]), len(sweep) + order)
    columns = {"points": forged.points} | _columns(sweep, forged, source, rng)
    changed = {name: np.concatenate([getattr(sweep, name), column])[index] for name, column in columns.items()}
    return Tampered(sweep.replace(**changed), index >= len(sweep), removed, wedge)


def add_points(sweep: Sweep, points: NDArray[Any], rng: np.random.Generator) -> Tampered:
    """Return the sweep with free points (A, 3) added, each stored next to the return of the nearest beam."""
    points = points.astype(np.float32)
    ring = column = none = np.full(len(points), -1)
    lattice = lattice_of(sweep)
    if lattice is not None:
        ring, column = lattice.nearest_pixels(points)
    elif sweep.model is not None:
        x, y, z = points.T.astype(np.float64)
        ring = np.abs(np.arctan2(z, np.hypot(x, y))[:, None] - sweep.model.elevation).argmin(axis=1)
    return assemble(sweep, np.zeros(len(sweep), np.bool_), Forged(points, ring, column, none), None, rng)


def _neighbors(sweep: Sweep, forged: Forged) -> tuple[NDArray[np.intp], F64]:
    """Return the row (A,) of the replaced or nearest return, -1 for none, and a sort key (A,) among the rows."""
    row, key = forged.row.copy(), forged.row.astype(np.float64)
    new = np.flatnonzero(row < 0)
    key[new] = len(sweep)
    lattice = lattice_of(sweep)
    if lattice is not None and len(new):
        row[new], key[new] = lattice.storage_keys(forged.ring[new], forged.column[new])
    return row, key


def _columns(
    sweep: Sweep, forged: Forged, source: NDArray[np.intp], rng: np.random.Generator
) -> dict[str, NDArray[Any]]:
    """Return the columns of the forged returns, except points, for those that the sweep has."""
    columns: dict[str, NDArray[Any]] = {}
    if sweep.intensity is not None:
        intensity = sweep.intensity if len(sweep) else np.zeros(1, np.float32)
        columns["intensity"] = intensity[rng.integers(len(intensity), size=len(source))]
    if sweep.ring is not None:
        source_ring = _take(sweep.ring, source, np.int16(0))
        columns["ring"] = np.where(forged.ring >= 0, forged.ring, source_ring).astype(np.int16)
    if sweep.azimuth is not None:
        point_azimuth = np.arctan2(forged.points[:, 1], forged.points[:, 0])
        columns["azimuth"] = np.where(source >= 0, _take(sweep.azimuth, source, np.float32(0)), point_azimuth)
    if sweep.time_s is not None:
        columns["time_s"] = _times(sweep.time_s, forged, source, lattice_of(sweep))
    return columns


def _take(column: NDArray[Any], source: NDArray[np.intp], default: Any) -> NDArray[Any]:
    """Return the values of ``column`` at rows ``source`` (A,), ``default`` where the row is -1."""
    return np.append(column, default)[source]


def _times(
    time_s: NDArray[np.float32], forged: Forged, source: NDArray[np.intp], lattice: BeamLattice | None
) -> NDArray[np.float32]:
    """Return times (A,) in seconds: those of the columns if known, else those of the neighbors."""
    times = _take(time_s, source, np.float32(0))
    if lattice is not None and lattice.firing.time_s is not None:
        times = np.where(forged.row >= 0, times, lattice.firing.time_s[forged.column])
    return times.astype(np.float32)


RELIABILITY: dict[str, float] = {"VLP-16": 0.985, "VLP-32C": 0.83, "OS1-32": 0.44, "OS1-32 gradient": 0.44}
"""Share of the attacked beams that a spoofer controls ("wins"), by the name of the sensor."""

DEFAULT_RELIABILITY = 0.985
"""The same for other sensors."""

LEAVE, NO_RETURN = np.nan, np.inf
"""Special target depths: leave the beam unchanged; make it return nothing."""

FULL_CIRCLE = Wedge(0.0, 2 * np.pi)

UNKNOWN_OPTICS = Optics()
"""Assumed optics of an unknown sensor."""

_MAX_RANGE_M = 100.0
"""Assumed maximum range of an unknown sensor."""

_NEAR_M, _NEAR_SHARE = 25.0, 0.01
"""A sweep is indoors if at most this share of its returns lies beyond this range."""

_ROUNDS = 4
"""Iterations to find the depth at which a beam hits the ground."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundBox:
    """A box on the ground, in the level frame."""

    center: tuple[float, float]  # (x, y), meters
    heading: float  # yaw of its long axis, radians
    size_m: tuple[float, float, float]  # length, width, height
    ground_m: float  # z of its bottom


@lru_cache(maxsize=2)
def scene_of(sweep: Sweep) -> LeveledSweep:
    """Return ``sweep`` leveled on the road grid, or on the indoor grid if hardly any return lies beyond 25 m."""
    x, y, _ = sweep.points.T
    far = np.count_nonzero(x * x + y * y > _NEAR_M**2)
    return level(sweep, GRIDS["road" if far > _NEAR_SHARE * len(sweep) else "indoor"])


def is_obstacle(sweep: Sweep, rays: Rays) -> Mask:
    """Return the rays (K,) with returns more than 0.3 m above local ground, without ego and null returns."""
    leveled = scene_of(sweep)
    raised = np.zeros(len(sweep) + 1, np.bool_)  # the last entry is for rays without a return: row -1
    raised[leveled.rows] = leveled.height_m > OBSTACLE_HEIGHTS_M[0]
    return np.asarray(raised[rays.row])


def random_obstacle_azimuth(sweep: Sweep, near_m: float, far_m: float, rng: np.random.Generator) -> float | None:
    """Return the azimuth of a random obstacle return between two ranges, in the sensor's frame; None without any."""
    leveled = scene_of(sweep)
    low, high = OBSTACLE_HEIGHTS_M
    fits = (leveled.height_m > low) & (leveled.height_m < high) & (leveled.range_m > near_m) & (leveled.range_m < far_m)
    return _random_azimuth(sweep, leveled.rows[fits], rng)


def random_open_azimuth(sweep: Sweep, range_m: float, rng: np.random.Generator) -> float:
    """Return the azimuth of a random return beyond ``range_m``, where a ghost can be seen; any azimuth without one."""
    leveled = scene_of(sweep)
    return azimuth_or_random(_random_azimuth(sweep, leveled.rows[leveled.range_m > range_m], rng), rng)


def _random_azimuth(sweep: Sweep, rows: NDArray[Any], rng: np.random.Generator) -> float | None:
    """Return the azimuth of a random one of the returns ``rows``; None without any."""
    if len(rows) == 0:
        return None
    x, y, _ = sweep.points[rows[rng.integers(len(rows))]].astype(np.float64)
    return float(np.arctan2(y, x))


def azimuth_or_random(azimuth: float | None, rng: np.random.Generator) -> float:
    """Return ``azimuth``, or a random one if it is None."""
    return float(rng.uniform(-np.pi, np.pi)) if azimuth is None else azimuth


def level_rays(sweep: Sweep, rays: Rays) -> tuple[F64, F64]:
    """Return starts (K, 3) in meters and directions (K, 3) in the level frame; z = 0 is the ground below the sensor."""
    to_level = scene_of(sweep).level_from_sensor
    return to_level @ rays.start_m, rays.direction @ to_level.rotation.T


def position_at(sweep: Sweep, azimuth: float, range_m: float) -> tuple[float, float, float]:
    """Return x, y and azimuth in the level frame of the place at an azimuth of the sensor's frame and a range."""
    rotation = scene_of(sweep).level_from_sensor.rotation
    x, y, _ = rotation @ np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    level_azimuth = float(np.arctan2(y, x))
    return range_m * np.cos(level_azimuth), range_m * np.sin(level_azimuth), level_azimuth


def ground_at(sweep: Sweep, x_m: float, y_m: float) -> float:
    """Return z of the ground at (x, y) in the level frame, in meters."""
    return float(scene_of(sweep).ground.at(np.array([[x_m, y_m]]))[0])


def to_sensor(sweep: Sweep, points: NDArray[Any]) -> F64:
    """Transform points (A, 3) from the level frame to the sensor's frame."""
    return scene_of(sweep).level_from_sensor.inverse() @ points


def street_depth_m(sweep: Sweep, rays: Rays, wall_m: float) -> F64:
    """Return the depths (K,) of rays on an empty street that ends at a wall at range ``wall_m``, in meters.

    A ray ends at the ground (its depth is found by fixed-point iteration on the ground's height) or at the wall,
    whichever is nearer.
    """
    ground = scene_of(sweep).ground
    start, direction = level_rays(sweep, rays)
    flat = np.maximum(np.hypot(direction[:, 0], direction[:, 1]), 1e-6)
    wall = wall_m / flat
    down = direction[:, 2] < -1e-4
    depth = wall.copy()
    for _ in range(_ROUNDS):
        below = ground.at(start[:, :2] + depth[:, None] * direction[:, :2]).astype(np.float64)
        depth = np.where(down, np.clip((below - start[:, 2]) / np.minimum(direction[:, 2], -1e-4), 0.0, wall), wall)
    return depth


def chord_m(start: F64, direction: F64, box: GroundBox) -> tuple[F64, F64]:
    """Return the depths (K,) in meters at which rays (K, 3) enter and leave a box; +inf and -inf if they miss it.

    Slab method (Kay and Kajiya 1986).
    """
    c, s = np.cos(box.heading), np.sin(box.heading)
    rotation = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    center = np.array([*box.center, box.ground_m + box.size_m[2] / 2])
    start, direction = (start - center) @ rotation.T, direction @ rotation.T
    direction = np.where(np.abs(direction) < 1e-12, 1e-12, direction)
    half = np.array(box.size_m) / 2
    first, second = (-half - start) / direction, (half - start) / direction
    enter, leave = np.minimum(first, second).max(axis=1), np.maximum(first, second).min(axis=1)
    hit = (enter > 0.0) & (enter <= leave)
    return np.where(hit, enter, np.inf), np.where(hit, leave, -np.inf)


@dataclass(frozen=True, slots=True)
class Spoofer(Checked):
    """A spoofer: one forged return for each beam that it controls ("wins")."""

    # share of the attacked beams that it wins; None takes it from ``RELIABILITY`` by the sensor's name
    reliability: Annotated[float | None, Between(0.0, 1.0)] = None
    # noise of each range along its ray; None is the sensor's own noise of a strong return
    point_sigma_m: Annotated[float | None, Between(0.0, 10.0)] = 0.10
    frame_sigma_m: Annotated[float, Between(0.0, 10.0)] = 0.35  # noise common to all ranges of a sweep

    def wins(self, sweep: Sweep, count: int, rng: np.random.Generator) -> Mask:
        """Return which of ``count`` beams are won, (count,) bool."""
        name = "" if sweep.model is None else sweep.model.name
        share = RELIABILITY.get(name, DEFAULT_RELIABILITY) if self.reliability is None else self.reliability
        return rng.random(count) < share

    def spoof(self, sweep: Sweep, rays: Rays, target_m: F64, wedge: Wedge, rng: np.random.Generator) -> Tampered:
        """Return ``sweep`` with the won rays at target depths (K,) in meters, ``LEAVE`` or ``NO_RETURN``.

        A return outside the sensor's range limits is lost. A beam whose return would leave the wedge is unchanged.
        """
        won = np.flatnonzero(~np.isnan(target_m))
        won = won[self.wins(sweep, len(won), rng)]
        rays = rays.select(won)
        depth_m = self.reported_m(sweep, rays, target_m[won], rng)
        low_m, high_m = limits_m(sweep)
        reported = (depth_m >= low_m) & (depth_m <= high_m)
        points = rays.at(np.where(reported, depth_m, 0.0))
        changed = ~reported | within(points, wedge)
        if not changed.any():
            return untouched(sweep, wedge)
        removed = np.zeros(len(sweep), np.bool_)
        removed[rays.row[changed & (rays.row >= 0)]] = True
        added = reported & changed
        forged = Forged(points[added], rays.ring[added], rays.column[added], rays.row[added])
        return assemble(sweep, removed, forged, wedge, rng)

    def spoof_nearest(
        self,
        sweep: Sweep,
        rays: Rays,
        candidates: Mask,
        target_m: F64,
        wedge: Wedge,
        budget: int | None,
        rng: np.random.Generator,
    ) -> Tampered:
        """Spoof at most ``budget`` of the rays in the mask ``candidates`` (K,), those nearest to the wedge's center."""
        chosen = choose_nearest(rays, candidates, wedge, budget)
        return self.spoof(sweep, rays, np.where(chosen, target_m, LEAVE), wedge, rng)

    def sigma_m(self, sweep: Sweep) -> float:
        """Return the standard deviation of each range in meters: ``point_sigma_m``, or that of the sensor."""
        if self.point_sigma_m is not None:
            return self.point_sigma_m
        return (UNKNOWN_OPTICS if sweep.model is None else optics_of(sweep.model)).sigma_m

    def reported_m(self, sweep: Sweep, rays: Rays, target_m: F64, rng: np.random.Generator) -> F64:
        """Return the reported depths (K,) of won rays: with noise, rounded to the sensor's range step if known."""
        sigma_m = self.sigma_m(sweep)
        noise_m = rng.normal(0.0, 1.0) * self.frame_sigma_m + rng.normal(0.0, 1.0, len(rays)) * sigma_m
        lattice = lattice_of(sweep)
        step_m = 0.0 if lattice is None else lattice.step_m
        noisy_m = target_m + noise_m
        return np.rint(noisy_m / step_m) * step_m if step_m > 0 else noisy_m


MEASURED_SPOOFER = Spoofer()
"""As measured on commercial sensors."""

NOISELESS_SPOOFER = Spoofer(point_sigma_m=0.0, frame_sigma_m=0.0)
"""For ranges that are random anyway, or recorded with the noise of their own sweep."""

CLEAN_SPOOFER = Spoofer(point_sigma_m=None, frame_sigma_m=0.0)
"""Sets ranges as exactly as the sensor measures them, so that its noise does not expose it."""


def limits_m(sweep: Sweep) -> tuple[float, float]:
    """Return the minimum and maximum depth in meters that the sensor reports; assumed if the sensor is unknown."""
    if sweep.model is not None:
        return max(sweep.model.min_range_m, 0.05), sweep.model.max_range_m
    if len(sweep) == 0:
        return 0.5, _MAX_RANGE_M
    farthest2 = float((sweep.points.astype(np.float64) ** 2).sum(axis=1).max())
    return 0.5, max(_MAX_RANGE_M, float(np.sqrt(farthest2)))


def choose_nearest(rays: Rays, candidates: NDArray[Any], wedge: Wedge, budget: int | None) -> Mask:
    """Return the mask (K,) of rays to attack: the ``budget`` of ``candidates`` (K,) nearest to the wedge's azimuth."""
    if budget is None or int(candidates.sum()) <= budget:
        return np.asarray(candidates, np.bool_)
    azimuth = np.arctan2(rays.direction[:, 1], rays.direction[:, 0])
    apart = np.abs((azimuth - wedge.azimuth + np.pi) % (2 * np.pi) - np.pi)
    rows = np.flatnonzero(candidates)
    chosen = np.zeros(len(rays), np.bool_)
    chosen[rows[np.argsort(apart[rows], kind="stable")[:budget]]] = True
    return chosen


def choose_random(candidates: Mask, budget: int | None, rng: np.random.Generator) -> Mask:
    """Return the mask (K,) of rays to attack: at most ``budget`` random ones of ``candidates`` (K,)."""
    rows = np.flatnonzero(candidates)
    chosen = np.zeros(len(candidates), np.bool_)
    chosen[rng.permutation(rows)[: len(rows) if budget is None else budget]] = True
    return chosen
