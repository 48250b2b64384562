"""Corruptions: weather, sensor faults and surroundings that degrade a sweep, in five severities each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F32, F64
from viewshed.geometry import Rigid, attitude_of, polar, rotation_from_quaternion
from viewshed.grid import BevGrid
from viewshed.preprocess.leveling import level
from viewshed.preprocess.ring_recovery import rings_of_sweep
from viewshed.sensors import LidarModel
from viewshed.sweep import Sweep
from viewshed_lab._config import Between, Checked, Share
from viewshed_lab.sim.assets.shapes import PER_M, material_index
from viewshed_lab.sim.lidar.measurement import air, detection_probability, particle_reach_m
from viewshed_lab.sim.lidar.optics import Optics, optics_of
from viewshed_lab.sim.lidar.weather import CONDITIONS, Conditions

NEAREST_M = 0.05
"""Minimum range of a return that is moved along its ray."""

_EXTENT = BevGrid(256, 64.0)


class Corruption(Protocol):
    """A benign degradation of a sweep. The clean sweep is never modified; equal generators give equal bytes."""

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return the degraded sweep: rows are removed or moved, never added; their order and other columns are kept."""
        ...


@runtime_checkable
class InTheWorld(Corruption, Protocol):
    """A corruption by things at fixed places in the world, which sensors at other poses see at the same places."""

    def place(self, sweep: Sweep, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return random places (K, 3) of the things, in meters in the sensor's frame."""
        ...

    def apply_at(self, sweep: Sweep, places: NDArray[np.float64], rng: np.random.Generator) -> Sweep:
        """Return the sweep with the things at ``places`` (K, 3), in meters in its sensor's frame."""
        ...


def ranges_of(sweep: Sweep) -> F32:
    """Return the range of each return (N,) float32 from the sensor's origin, in meters.

    >>> ranges_of(Sweep(np.array([[3.0, 4.0, 12.0]]))).tolist()
    [13.0]
    """
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", sweep.points, sweep.points)), np.float32)


def at_ranges(sweep: Sweep, range_m: NDArray[np.floating[Any]]) -> Sweep:
    """Return ``sweep`` with each return moved along its ray to ``range_m`` (N,); returns at the origin stay there.

    >>> at_ranges(Sweep(np.array([[0.0, 2.0, 0.0]])), np.array([3.0])).points.tolist()
    [[0.0, 3.0, 0.0]]
    """
    before = ranges_of(sweep)
    factor = np.where(before > 0, np.maximum(range_m, NEAREST_M) / np.maximum(before, 1e-12), 1.0)
    return sweep.replace(points=sweep.points * factor[:, None].astype(np.float32))


def heights_of(sweep: Sweep) -> F32:
    """Return the height of each return (N,) float32 above local ground in meters; NaN for null and ego returns."""
    heights = np.full(len(sweep), np.nan, np.float32)
    if len(sweep):
        leveled = level(sweep, _EXTENT)
        heights[leveled.rows] = leveled.height_m
    return heights


@dataclass(frozen=True, slots=True)
class DroppedBeams(Checked):
    """Random beams return nothing."""

    share: Share  # of the returns; their number is rounded

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` without a random share of its returns."""
        keep = np.ones(len(sweep), np.bool_)
        keep[rng.permutation(len(sweep))[: round(self.share * len(sweep))]] = False
        return sweep.select(keep)


@dataclass(frozen=True, slots=True)
class DroppedSectors(Checked):
    """Sectors of the revolution are lost, by missing packets or dirt on the window."""

    sectors: Annotated[int, Between(0, 360)]  # number of sectors; they may overlap
    width_deg: Annotated[float, Between(0, 360)]  # of each sector

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` without the returns whose points have azimuths in the sectors."""
        azimuth = polar(sweep.points)[1]
        keep = np.ones(len(sweep), np.bool_)
        for middle in rng.uniform(-np.pi, np.pi, self.sectors):
            apart = np.abs((azimuth - middle + np.pi) % (2 * np.pi) - np.pi)
            keep &= apart > np.deg2rad(self.width_deg) / 2
        return sweep.select(keep)


@dataclass(frozen=True, slots=True)
class DeadRings(Checked):
    """Some of the lasers are dead. Needs rings."""

    share: Share  # of the sensor's rings; their number is rounded, at least one

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` without the dead rings, which are drawn from all rings of the sensor.

        Raises:
            ValueError: the sweep's rings are not known.
        """
        if len(sweep) == 0:
            return sweep
        beams = rings_of_sweep(sweep)
        dead = rng.permutation(beams.rings)[: max(1, round(self.share * beams.rings))]
        return sweep.select(~np.isin(beams.ring, dead))


@dataclass(frozen=True, slots=True)
class FewerBeams(Checked):
    """A sensor with fewer rings: the lowest ``kept`` of each ``of`` neighboring rings remain. Needs rings."""

    kept: int  # rings that remain in each group
    of: Annotated[int, Between(1, 4096)]  # rings in a group

    def __post_init__(self) -> None:
        Checked.__post_init__(self)
        Between(1, self.of).check("kept", self.kept)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` without the other rings; ring numbers are kept, and ``rng`` is not used.

        Raises:
            ValueError: the sweep's rings are not known.
        """
        if len(sweep) == 0:
            return sweep
        ring = rings_of_sweep(sweep).ring
        return sweep.select((ring >= 0) & (ring % self.of < self.kept))


PERIOD_S = 0.1
"""Duration of a revolution if the sweep has no times."""


@dataclass(frozen=True, slots=True)
class RangeNoise(Checked):
    """Normal noise along the ray, added to the sensor's own."""

    sigma_m: Annotated[float, Between(0, 10)]  # standard deviation

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` with noisy ranges."""
        return at_ranges(sweep, ranges_of(sweep) + self.sigma_m * rng.standard_normal(len(sweep)))


@dataclass(frozen=True, slots=True)
class MotionDistortion(Checked):
    """Ego motion without deskewing: each return stays in the sensor's frame at its own time.

    The sensor drives forward and turns to a random side at constant rates; the middle of the revolution is the
    reference. Times are those of the sweep; without them they follow azimuth, from -π to π in :data:`PERIOD_S`.
    """

    speed_mps: Annotated[float, Between(0, 100)]  # forward
    yaw_rate_degps: Annotated[float, Between(0, 360)]  # magnitude

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` distorted by the motion; firing azimuths and times are unchanged."""
        time_s = _from_middle_s(sweep)
        turned = -time_s * np.deg2rad(self.yaw_rate_degps) * (1 if rng.random() < 0.5 else -1)
        x, y, z = sweep.points.T
        x = x - self.speed_mps * time_s
        c, s = np.cos(turned), np.sin(turned)
        return sweep.replace(points=np.stack([c * x - s * y, s * x + c * y, z], axis=1).astype(np.float32))


def _from_middle_s(sweep: Sweep) -> NDArray[np.float64]:
    """Return the time of each return (N,) relative to the middle of the revolution, in seconds."""
    if sweep.time_s is not None and len(sweep) and np.ptp(sweep.time_s) > 0:
        time_s = sweep.time_s.astype(np.float64)
        return np.asarray(time_s - (time_s.min() + time_s.max()) / 2)
    return polar(sweep.points)[1].astype(np.float64) * (PERIOD_S / (2 * np.pi))


@dataclass(frozen=True, slots=True)
class Miscalibration(Checked):
    """The attitude is wrong by a tilt about a random horizontal axis; without an attitude, the tilt becomes it."""

    tilt_deg: Annotated[float, Between(0, 45)]  # angle between the reported and the true vertical

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` with wrong attitude and wrong rotation of its pose; the points are unchanged."""
        known, pose = sweep.known_attitude, sweep.world_from_sensor
        level_from_sensor = np.eye(3) if known is None else rotation_from_quaternion(known)
        tilt = _tilt(float(rng.uniform(-np.pi, np.pi)), np.deg2rad(self.tilt_deg))
        error = level_from_sensor.T @ tilt @ level_from_sensor
        return sweep.replace(
            attitude=attitude_of(level_from_sensor @ error),
            world_from_sensor=None if pose is None else Rigid(pose.rotation @ error, pose.translation),
        )


def _tilt(heading: float, angle: float) -> NDArray[np.float64]:
    """Return the rotation (3, 3) by ``angle`` about the horizontal axis at ``heading`` (Rodrigues)."""
    x, y = np.cos(heading), np.sin(heading)
    cross = np.array([[0.0, 0.0, y], [0.0, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross), np.float64)


@dataclass(frozen=True, slots=True)
class Slope(Checked):
    """A slope in a random direction: points beyond its foot are raised in proportion to their distance from it."""

    grade: Annotated[float, Between(-1, 1)]  # rise over run
    start_m: Annotated[float, Between(0, 1000)]  # distance of the foot from the sensor

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` sheared along the sensor's z; x, y and rings are unchanged."""
        return self.apply_at(sweep, self.place(sweep, rng), rng)

    def place(self, sweep: Sweep, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return two points (2, 3): the nearest one of the foot of the slope, and one a meter uphill from it."""
        heading = rng.uniform(-np.pi, np.pi)
        uphill = np.array([np.cos(heading), np.sin(heading), 0.0])
        return np.stack([self.start_m * uphill, (self.start_m + 1.0) * uphill])

    def apply_at(self, sweep: Sweep, places: NDArray[np.float64], rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` with a slope that starts at the first of ``places`` (2, 3) and rises toward the second."""
        foot, above = places[:, :2]
        beyond = (sweep.points[:, :2] - foot) @ (above - foot)
        points = sweep.points.copy()
        points[:, 2] += (self.grade * np.maximum(beyond, 0)).astype(np.float32)
        return sweep.replace(points=points)


ABOVE_GROUND_M = 0.3
"""Glass patches are centered on returns higher than this above local ground, if there are any."""

BUSH_RANGES_M = (3.0, 40.0)
"""Minimum and maximum horizontal range of bushes."""

BEFORE_SURFACE = (0.3, 0.9)
"""Minimum and maximum range of a bush, as a share of the range of the surface that it hides."""


@dataclass(frozen=True, slots=True)
class GlassPatches(Checked):
    """Glass, mirrors and absorbers: contiguous patches of surfaces return nothing."""

    patches: Annotated[int, Between(0, 1000)]  # number of patches
    radius_m: Annotated[float, Between(0, 100)]  # returns within this distance of a patch's center are removed

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` without the patches."""
        return self.apply_at(sweep, self.place(sweep, rng), rng)

    def place(self, sweep: Sweep, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return the centers (patches, 3) of the patches: random returns above the ground, else any returns."""
        if len(sweep) == 0:
            return np.zeros((0, 3))
        raised = np.flatnonzero(heights_of(sweep) > ABOVE_GROUND_M)
        chosen = rng.choice(raised if len(raised) else len(sweep), self.patches)
        return np.asarray(sweep.points[chosen], np.float64)

    def apply_at(self, sweep: Sweep, places: NDArray[np.float64], rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` without the patches around ``places`` (K, 3)."""
        keep = np.ones(len(sweep), np.bool_)
        for center in places.astype(np.float32):
            offset = sweep.points - center
            keep &= np.einsum("ij,ij->i", offset, offset) > self.radius_m**2
        return sweep.select(keep)


@dataclass(frozen=True, slots=True)
class Vegetation(Checked):
    """Bushes in front of surfaces: balls of leaves that stop a beam after a random path length (Beer's law)."""

    bushes: Annotated[int, Between(0, 1000)]  # number of bushes
    radius_m: Annotated[float, Between(0, BUSH_RANGES_M[0] - 0.5)]  # of each
    # stops per meter of path; default: the simulator's leaves
    per_m: Annotated[float, Between(0, 1e6)] = float(PER_M[material_index("leaves")])

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` with the returns of stopped beams moved along their rays into the bushes."""
        return self.apply_at(sweep, self.place(sweep, rng), rng)

    def place(self, sweep: Sweep, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return the centers (bushes, 3) of the bushes, each in front of a return; none if all returns are near."""
        flat_m = np.hypot(sweep.points[:, 0], sweep.points[:, 1])
        hidden = np.flatnonzero(flat_m * BEFORE_SURFACE[0] > BUSH_RANGES_M[0])
        if len(hidden) == 0:
            return np.zeros((0, 3))
        chosen = hidden[rng.integers(len(hidden), size=self.bushes)]
        share = np.minimum(rng.uniform(*BEFORE_SURFACE, self.bushes), BUSH_RANGES_M[1] / flat_m[chosen])
        return np.asarray(sweep.points[chosen] * share[:, None], np.float64)

    def apply_at(self, sweep: Sweep, places: NDArray[np.float64], rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` with bushes around ``places`` (K, 3)."""
        if len(places) == 0:
            return sweep
        range_m = ranges_of(sweep).astype(np.float64)
        direction = sweep.points / np.maximum(range_m, 1e-9)[:, None]
        for center in places:
            self._stop_beams(center, direction, range_m, rng)
        return at_ranges(sweep, range_m)

    def _stop_beams(
        self,
        center: NDArray[np.float64],
        direction: NDArray[np.float64],
        range_m: NDArray[np.float64],
        rng: np.random.Generator,
    ) -> None:
        """Shorten the ranges (N,) of the beams that stop in the ball around ``center``, in place."""
        nearest = direction @ center
        half2 = self.radius_m**2 - (center @ center - nearest**2)
        crossing = np.flatnonzero((half2 > 0) & (nearest > 0) & (range_m > 0))
        half = np.sqrt(half2[crossing])
        path = rng.standard_exponential(len(crossing)) / max(self.per_m, 1e-9)
        stop = nearest[crossing] - half + path
        stopped = (path < 2 * half) & (stop < range_m[crossing])
        range_m[crossing[stopped]] = stop[stopped]


REFLECTIVITY = 0.2
"""Assumed reflectivity of every surface: the real one is unknown, as intensities have no common scale."""

GROUND_M = 0.2
"""Returns lower than this above local ground are ground, which may be wet."""

NO_SENSOR = (Optics(), (0.5, 100.0))
"""Assumed optics, and minimum and maximum range in meters, of an unknown sensor."""

FAINT = 0.05
"""Returns of particles get this quantile of the sweep's intensities."""

_WEAK = 3.0


@dataclass(frozen=True, slots=True)
class Weather:
    """Weather conditions of the simulator, applied to a sweep that was measured in clear air.

    A return of signal s was detected with probability F(s) = 1 / (1 + s⁻⁴). In weather its signal is s' = s · wet ·
    exp(-2 α r), and it survives with probability F(s') / F(s). A particle in the air replaces a return if its signal
    is stronger. Range noise grows from σ √(1 + 3 / s) to σ · noise · √(1 + 3 / s'). All as in
    ``sim.lidar.measurement``; s = 0.2 / 0.1 · (reach / r)², as the surface's own reflectivity is unknown.
    """

    conditions: Conditions  # of the simulator; its shares of missing beams, dead rings and sectors are not used

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` in this weather; beams without a return stay without one."""
        optics, (near_m, far_m) = _sensor(sweep.model)
        range_m = np.maximum(ranges_of(sweep).astype(np.float64), 1e-3)
        kept_light, particle_m, glint = self._air(optics, far_m, range_m, rng)
        dry = REFLECTIVITY / 0.1 * (optics.reach_m / range_m) ** 2
        signal = dry * kept_light * np.where(heights_of(sweep) < GROUND_M, self.conditions.wet, 1.0)
        seen = rng.random(len(sweep)) * _detected(dry) < _detected(signal)
        hit = (particle_m > near_m) & (particle_m < range_m) & (glint > np.where(seen, signal, 0.0))
        noise = _extra_noise(dry, signal, optics.sigma_m, self.conditions.noise) * rng.standard_normal(len(sweep))
        moved = at_ranges(sweep, np.where(hit, particle_m, range_m + noise))
        return _fainter(moved, kept_light, hit).select(seen | hit)

    def _air(self, optics: Optics, far_m: float, range_m: F64, rng: np.random.Generator) -> tuple[F64, F64, F64]:
        """Return transmittance, range in meters of a particle in the beam, and the particle's signal, each (N,).

        The range is infinite where the beam meets no detectable particle.
        """
        loss, particles = air(optics, self.conditions, far_m)
        kept_light = np.interp(range_m, np.linspace(0.0, far_m, len(loss) - 1), loss[:-1])
        quantile, size = rng.random((2, len(range_m)))
        particle_m = _interpolate(particles, quantile)
        reach_m = particle_reach_m(optics, self.conditions, far_m)
        return kept_light, particle_m, 1 + size / (1 - size) * (reach_m / particle_m) ** 2


def _interpolate(table: NDArray[np.float32], quantile: F64) -> F64:
    """Return the table's values at quantiles (N,) in [0, 1), linearly interpolated; inf if the upper entry is inf."""
    position = quantile * (len(table) - 1)
    low = position.astype(np.intp)
    ends = table.astype(np.float64)[np.stack([low, low + 1])]
    finite = np.isfinite(ends[1])
    range_m = np.full(len(quantile), np.inf)
    range_m[finite] = ends[0][finite] + (ends[1][finite] - ends[0][finite]) * (position - low)[finite]
    return np.asarray(np.maximum(range_m, 1e-3), np.float64)


def _sensor(model: LidarModel | None) -> tuple[Optics, tuple[float, float]]:
    """Return optics, minimum and maximum range in meters; an infinite reach becomes that of an unknown sensor."""
    if model is None:
        return NO_SENSOR
    optics = optics_of(model)
    if np.isinf(optics.reach_m):
        optics = Optics(optics.sigma_m, NO_SENSOR[0].reach_m, optics.missing_share)
    return optics, (model.min_range_m, model.max_range_m)


def _detected(signal: F64) -> F64:
    return detection_probability(signal.astype(np.float32)).astype(np.float64)


def _extra_noise(dry: F64, signal: F64, sigma_m: float, factor: float) -> F64:
    """Return the standard deviation (N,) in meters of the range noise that weather adds."""
    added = factor**2 * (1 + _WEAK / np.maximum(signal, 1e-3)) - (1 + _WEAK / dry)
    return np.asarray(sigma_m * np.sqrt(np.maximum(added, 0.0)), np.float64)


def _fainter(sweep: Sweep, kept_light: F64, hit: NDArray[np.bool_]) -> Sweep:
    """Return ``sweep`` with attenuated intensities, and those of particles where ``hit``."""
    if sweep.intensity is None or len(sweep) == 0:
        return sweep
    faint = np.quantile(sweep.intensity, FAINT)
    return sweep.replace(intensity=np.where(hit, faint, sweep.intensity * kept_light).astype(np.float32))


__all__ = [
    "CORRUPTIONS", "SEVERITIES", "Corruption", "DeadRings", "DroppedBeams", "DroppedSectors", "FewerBeams",
    "GlassPatches", "InTheWorld", "Miscalibration", "MotionDistortion", "RangeNoise", "Slope", "Vegetation", "Weather",
]  # fmt: skip


_COLUMNS = ("extinction_per_m", "particles_per_m", "wet", "noise")
_WEATHER: dict[str, tuple[str | tuple[float, ...], ...]] = {
    "rain": ((0.0007, 0.0015, 0.7, 1.05), "rain", (0.0021, 0.0075, 0.4, 1.2), "heavy_rain", (0.0054, 0.03, 0.25, 1.5)),
    "fog": ((0.006, 0.01, 0.9, 1.1), "fog", (0.03, 0.11, 0.75, 1.3), "dense_fog", (0.12, 0.8, 0.65, 1.5)),
    "snow": ((0.0013, 0.01, 0.95, 1.1), "snow", (0.0058, 0.03, 0.85, 1.3), (0.0118, 0.05, 0.8, 1.4),
             (0.0225, 0.08, 0.75, 1.5)),
}  # fmt: skip
"""By name and severity: a name in ``CONDITIONS``, or values of ``_COLUMNS`` that replace those of ``CONDITIONS``."""


def _like(name: str, numbers: tuple[float, ...]) -> Conditions:
    return replace(CONDITIONS[name], **dict(zip(_COLUMNS, numbers, strict=True)))


SEVERITIES: dict[str, tuple[Corruption, ...]] = {
    **{name: tuple(Weather(CONDITIONS[row] if isinstance(row, str) else _like(name, row)) for row in rows)
       for name, rows in _WEATHER.items()},
    "dropped_beams": tuple(map(DroppedBeams, (0.05, 0.1, 0.2, 0.4, 0.7))),
    "dropped_sectors": tuple(map(DroppedSectors, (1, 1, 1, 2, 3), (5.0, 15.0, 30.0, 30.0, 45.0))),
    "dead_rings": tuple(map(DeadRings, (0.03, 0.06, 0.12, 0.25, 0.5))),
    "fewer_beams": tuple(map(FewerBeams, (3, 1, 1, 1, 1), (4, 2, 3, 4, 8))),
    "range_noise": tuple(map(RangeNoise, (0.02, 0.05, 0.1, 0.2, 0.4))),
    "motion": tuple(map(MotionDistortion, (2.0, 5.0, 10.0, 20.0, 30.0), (2.0, 5.0, 10.0, 20.0, 40.0))),
    "attitude": tuple(map(Miscalibration, (0.5, 1.0, 1.5, 2.0, 3.0))),
    "glass": tuple(map(GlassPatches, (1, 2, 4, 8, 16), (1.0, 1.5, 2.0, 2.5, 3.0))),
    "vegetation": tuple(map(Vegetation, (2, 4, 8, 12, 20), (0.8, 1.0, 1.2, 1.5, 2.0))),
    "slope": tuple(map(Slope, (0.02, 0.04, 0.06, 0.09, 0.12), (5.0, 5.0, 5.0, 5.0, 5.0))),
}  # fmt: skip
"""By name, from severity 1 to 5. Rain: 5, 10, 25, 50 and 100 mm/h. Fog: 500, 200, 100, 50 and 25 m of visibility.
Snow: 1, 2, 3, 5 and 8 mm/h."""


def _of_severity(name: str, severity: int) -> Corruption:
    if isinstance(severity, bool) or severity not in (1, 2, 3, 4, 5):
        raise ValueError(f"severity must be a whole number from 1 to 5, got {severity!r}")
    return SEVERITIES[name][int(severity) - 1]


CORRUPTIONS: dict[str, Callable[[int], Corruption]] = {name: partial(_of_severity, name) for name in SEVERITIES}
"""By name: ``CORRUPTIONS[name](severity).apply(sweep, rng)``, severity from 1 to 5."""
