"""Corruptions: what degrades a sweep without anybody's intent, in five severities each."""

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
"""A return that is moved along its ray stays at least this far from the sensor."""

_EXTENT = BevGrid(256, 64.0)


class Corruption(Protocol):
    """Anything benign that degrades a sweep. The clean sweep is never modified; the same generator, the same bytes."""

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return the worse sweep: rows are removed or moved, never added, and keep their order and other columns."""
        ...


@runtime_checkable
class InTheWorld(Corruption, Protocol):
    """A corruption by things that stand in the world: seen from elsewhere, they are where they were."""

    def place(self, sweep: Sweep, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return where the things stand (K, 3), in the sensor's frame of a sweep."""
        ...

    def apply_at(self, sweep: Sweep, places: NDArray[np.float64], rng: np.random.Generator) -> Sweep:
        """Return a sweep with the things at ``places`` (K, 3) in its sensor's frame."""
        ...


def ranges_of(sweep: Sweep) -> F32:
    """Return the range of each return (N,) float32 from the sensor's origin, in meters.

    >>> ranges_of(Sweep(np.array([[3.0, 4.0, 12.0]]))).tolist()
    [13.0]
    """
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", sweep.points, sweep.points)), np.float32)


def at_ranges(sweep: Sweep, range_m: NDArray[np.floating[Any]]) -> Sweep:
    """Return ``sweep`` with each return moved along its ray to ``range_m`` (N,) meters; one at the origin stays there.

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
    """Beams chosen at random return nothing."""

    share: Share  # of the returns, rounded to whole ones

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` without the share."""
        keep = np.ones(len(sweep), np.bool_)
        keep[rng.permutation(len(sweep))[: round(self.share * len(sweep))]] = False
        return sweep.select(keep)


@dataclass(frozen=True, slots=True)
class DroppedSectors(Checked):
    """Sectors of the revolution are lost: packets that did not arrive, dirt on the window."""

    sectors: Annotated[int, Between(0, 360)]  # how many; they may overlap
    width_deg: Annotated[float, Between(0, 360)]  # of each

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` without returns in the sectors, by the azimuths of its points."""
        azimuth = polar(sweep.points)[1]
        keep = np.ones(len(sweep), np.bool_)
        for middle in rng.uniform(-np.pi, np.pi, self.sectors):
            apart = np.abs((azimuth - middle + np.pi) % (2 * np.pi) - np.pi)
            keep &= apart > np.deg2rad(self.width_deg) / 2
        return sweep.select(keep)


@dataclass(frozen=True, slots=True)
class DeadRings(Checked):
    """Some of the lasers are dead. Needs rings."""

    share: Share  # of the sensor's rings, rounded to whole ones, at least one

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` without the rings, drawn from all that the sensor has.

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
    """A sensor with fewer rings: of each ``of`` neighbors the lowest ``kept`` keep their numbers. Needs rings."""

    kept: int  # rings that remain of each group
    of: Annotated[int, Between(1, 4096)]  # rings in a group

    def __post_init__(self) -> None:
        Checked.__post_init__(self)
        Between(1, self.of).check("kept", self.kept)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` without the other rings; nothing is random, and ``rng`` is left as it was.

        Raises:
            ValueError: the sweep's rings are not known.
        """
        if len(sweep) == 0:
            return sweep
        ring = rings_of_sweep(sweep).ring
        return sweep.select((ring >= 0) & (ring % self.of < self.kept))


PERIOD_S = 0.1
"""Duration of a revolution where the sweep has no times."""


@dataclass(frozen=True, slots=True)
class RangeNoise(Checked):
    """Normal noise along the ray, beyond the sensor's own."""

    sigma_m: Annotated[float, Between(0, 10)]  # its standard deviation

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` with noisy ranges."""
        return at_ranges(sweep, ranges_of(sweep) + self.sigma_m * rng.standard_normal(len(sweep)))


@dataclass(frozen=True, slots=True)
class MotionDistortion(Checked):
    """Ego motion that nobody undid: each return stays in the sensor's frame at its own time.

    The sensor drives forward and turns to a random side at constant rates; the middle of the revolution is the
    reference. Times are the sweep's own, else by azimuth: from -π to π in :data:`PERIOD_S`.
    """

    speed_mps: Annotated[float, Between(0, 100)]  # forward
    yaw_rate_degps: Annotated[float, Between(0, 360)]  # how fast it turns

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` sheared by the motion; firing azimuths and times are as before."""
        time_s = _from_middle_s(sweep)
        turned = -time_s * np.deg2rad(self.yaw_rate_degps) * (1 if rng.random() < 0.5 else -1)
        x, y, z = sweep.points.T
        x = x - self.speed_mps * time_s
        c, s = np.cos(turned), np.sin(turned)
        return sweep.replace(points=np.stack([c * x - s * y, s * x + c * y, z], axis=1).astype(np.float32))


def _from_middle_s(sweep: Sweep) -> NDArray[np.float64]:
    """Return the time of each return (N,) from the middle of the revolution, in seconds."""
    if sweep.time_s is not None and len(sweep) and np.ptp(sweep.time_s) > 0:
        time_s = sweep.time_s.astype(np.float64)
        return np.asarray(time_s - (time_s.min() + time_s.max()) / 2)
    return polar(sweep.points)[1].astype(np.float64) * (PERIOD_S / (2 * np.pi))


@dataclass(frozen=True, slots=True)
class Miscalibration(Checked):
    """Roll and pitch are wrong by a tilt about a random horizontal axis; a sweep without an attitude gets this one."""

    tilt_deg: Annotated[float, Between(0, 45)]  # angle between the vertical that is claimed and the true one

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` with a wrong attitude, and a wrong rotation of its pose; the points are as measured."""
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
    """The world bends upward: beyond a line to a random side, everything is raised in proportion to its distance."""

    grade: Annotated[float, Between(-1, 1)]  # rise over run
    start_m: Annotated[float, Between(0, 1000)]  # where the slope begins

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` sheared along the sensor's z; x, y and the rings stay."""
        return self.apply_at(sweep, self.place(sweep, rng), rng)

    def place(self, sweep: Sweep, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return the nearest point of the line where the slope begins, and one a meter up the slope from it (2, 3)."""
        heading = rng.uniform(-np.pi, np.pi)
        uphill = np.array([np.cos(heading), np.sin(heading), 0.0])
        return np.stack([self.start_m * uphill, (self.start_m + 1.0) * uphill])

    def apply_at(self, sweep: Sweep, places: NDArray[np.float64], rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` with a slope that begins at the first of ``places`` (2, 3) and rises towards the second."""
        foot, above = places[:, :2]
        beyond = (sweep.points[:, :2] - foot) @ (above - foot)
        points = sweep.points.copy()
        points[:, 2] += (self.grade * np.maximum(beyond, 0)).astype(np.float32)
        return sweep.replace(points=points)


ABOVE_GROUND_M = 0.3
"""Surfaces whose returns lie higher than this above local ground may be panes, if there are any."""

BUSH_RANGES_M = (3.0, 40.0)
"""Horizontal ranges at which bushes stand."""

BEFORE_SURFACE = (0.3, 0.9)
"""A bush stands at this share of the way to the surface that it hides."""


@dataclass(frozen=True, slots=True)
class GlassPatches(Checked):
    """Glass, mirrors and absorbers: contiguous patches of surfaces return nothing."""

    patches: Annotated[int, Between(0, 1000)]  # how many
    radius_m: Annotated[float, Between(0, 100)]  # returns within this distance of the middle of a patch are gone

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` without the patches."""
        return self.apply_at(sweep, self.place(sweep, rng), rng)

    def place(self, sweep: Sweep, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return the middles (patches, 3) of the patches: returns above the ground, where there are any."""
        if len(sweep) == 0:
            return np.zeros((0, 3))
        raised = np.flatnonzero(heights_of(sweep) > ABOVE_GROUND_M)
        chosen = rng.choice(raised if len(raised) else len(sweep), self.patches)
        return np.asarray(sweep.points[chosen], np.float64)

    def apply_at(self, sweep: Sweep, places: NDArray[np.float64], rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` without the patches around ``places`` (K, 3)."""
        keep = np.ones(len(sweep), np.bool_)
        for middle in places.astype(np.float32):
            apart = sweep.points - middle
            keep &= np.einsum("ij,ij->i", apart, apart) > self.radius_m**2
        return sweep.select(keep)


@dataclass(frozen=True, slots=True)
class Vegetation(Checked):
    """Bushes before surfaces: balls of leaves in which a beam stops after a random path (Beer's law), or passes."""

    bushes: Annotated[int, Between(0, 1000)]  # how many
    radius_m: Annotated[float, Between(0, BUSH_RANGES_M[0] - 0.5)]  # of each
    # stops per meter of path; the simulator's leaves by default
    per_m: Annotated[float, Between(0, 1e6)] = float(PER_M[material_index("leaves")])

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` with the returns that the leaves stopped moved nearer along their rays."""
        return self.apply_at(sweep, self.place(sweep, rng), rng)

    def place(self, sweep: Sweep, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return the middles (bushes, 3) of the bushes, each before a return; none where all returns are near."""
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
        for middle in places:
            self._grow(middle, direction, range_m, rng)
        return at_ranges(sweep, range_m)

    def _grow(
        self,
        middle: NDArray[np.float64],
        direction: NDArray[np.float64],
        range_m: NDArray[np.float64],
        rng: np.random.Generator,
    ) -> None:
        """Shorten the ranges (N,) of the beams that stop in the ball around ``middle``."""
        nearest = direction @ middle
        half2 = self.radius_m**2 - (middle @ middle - nearest**2)
        crossing = np.flatnonzero((half2 > 0) & (nearest > 0) & (range_m > 0))
        half = np.sqrt(half2[crossing])
        path = rng.standard_exponential(len(crossing)) / max(self.per_m, 1e-9)
        stop = nearest[crossing] - half + path
        stopped = (path < 2 * half) & (stop < range_m[crossing])
        range_m[crossing[stopped]] = stop[stopped]


REFLECTIVITY = 0.2
"""What a surface is taken to send back: its own is not known, intensities have no common scale."""

GROUND_M = 0.2
"""Returns lower than this above local ground are the ground, which may be wet."""

NO_SENSOR = (Optics(), (0.5, 100.0))
"""Optics, and minimum and maximum range in meters, of a sweep whose sensor is not known."""

FAINT = 0.05
"""A particle is given the intensity below which this share of the sweep's returns lies."""

_WEAK = 3.0


@dataclass(frozen=True, slots=True)
class Weather:
    """Conditions of the simulator on a sweep that was measured without them.

    A return of signal s was detected, with probability F(s) = 1 / (1 + s⁻⁴); in weather its signal is s' = s · wet ·
    exp(-2 α r), and it survives with probability F(s') / F(s). Particles in the air replace a return where theirs is
    the stronger signal. Range noise grows by what s' adds to √(1 + 3 / s). All as in ``sim.lidar.measurement``;
    s = 0.2 / 0.1 · (reach / r)², as the surface's own reflectivity is not known.
    """

    conditions: Conditions  # of the simulator; shares of missing beams, dead rings and sectors are not used here

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        """Return ``sweep`` as it would have been in this weather; beams without a return stay without one."""
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
        """Return, for each return, the light that the air leaves, the range of a particle before it, and its signal.

        The range is infinite where the beam meets none that would be detected.
        """
        loss, particles = air(optics, self.conditions, far_m)
        kept_light = np.interp(range_m, np.linspace(0.0, far_m, len(loss) - 1), loss[:-1])
        luck, size = rng.random((2, len(range_m)))
        particle_m = _between(particles, luck)
        reach_m = particle_reach_m(optics, self.conditions, far_m)
        return kept_light, particle_m, 1 + size / (1 - size) * (reach_m / particle_m) ** 2


def _between(table: NDArray[np.float32], luck: F64) -> F64:
    """Return the entry at each luck (N,) in [0, 1), interpolated; infinite where the next one is."""
    position = luck * (len(table) - 1)
    low = position.astype(np.intp)
    ends = table.astype(np.float64)[np.stack([low, low + 1])]
    finite = np.isfinite(ends[1])
    range_m = np.full(len(luck), np.inf)
    range_m[finite] = ends[0][finite] + (ends[1][finite] - ends[0][finite]) * (position - low)[finite]
    return np.asarray(np.maximum(range_m, 1e-3), np.float64)


def _sensor(model: LidarModel | None) -> tuple[Optics, tuple[float, float]]:
    """Return optics, minimum and maximum range in meters; one that detects everything gets an unknown one's reach."""
    if model is None:
        return NO_SENSOR
    optics = optics_of(model)
    if np.isinf(optics.reach_m):
        optics = Optics(optics.sigma_m, NO_SENSOR[0].reach_m, optics.missing_share)
    return optics, (model.min_range_m, model.max_range_m)


def _detected(signal: F64) -> F64:
    return detection_probability(signal.astype(np.float32)).astype(np.float64)


def _extra_noise(dry: F64, signal: F64, sigma_m: float, factor: float) -> F64:
    """Return the standard deviation (N,) in meters that weather adds to the noise that is there."""
    added = factor**2 * (1 + _WEAK / np.maximum(signal, 1e-3)) - (1 + _WEAK / dry)
    return np.asarray(sigma_m * np.sqrt(np.maximum(added, 0.0)), np.float64)


def _fainter(sweep: Sweep, kept_light: F64, hit: NDArray[np.bool_]) -> Sweep:
    """Return ``sweep`` with the intensities that the air leaves, and those of particles."""
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
"""Conditions by name, or those of the same name as here with other numbers."""


def _like(name: str, numbers: tuple[float, ...]) -> Conditions:
    return replace(CONDITIONS[name], **dict(zip(_COLUMNS, numbers, strict=True)))


SEVERITIES: dict[str, tuple[Corruption, ...]] = {
    **{name: tuple(Weather(CONDITIONS[one] if isinstance(one, str) else _like(name, one)) for one in rows)
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
"""By name, from severity 1 to 5; rain of 5, 10, 25, 50 and 100 mm/h, fog with 500, 200, 100, 50 and 25 m of visibility,
and snow of 1, 2, 3, 5 and 8 mm/h."""


def _of_severity(name: str, severity: int) -> Corruption:
    if isinstance(severity, bool) or severity not in (1, 2, 3, 4, 5):
        raise ValueError(f"severity must be a whole number from 1 to 5, got {severity!r}")
    return SEVERITIES[name][int(severity) - 1]


CORRUPTIONS: dict[str, Callable[[int], Corruption]] = {name: partial(_of_severity, name) for name in SEVERITIES}
"""By name: ``CORRUPTIONS[name](severity).apply(sweep, rng)``, severity from 1 to 5."""
