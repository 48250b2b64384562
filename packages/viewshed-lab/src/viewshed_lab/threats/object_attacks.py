"""Attacks on detections: objects are fabricated, removed or moved, with a record of what was forged.

>>> attack = OBJECT_ATTACKS["fabricate_static"](counts="exact", mean_count=2.0).begin(np.random.default_rng(0))
>>> forged = [attack.apply(Detections.none(), t_s, np.zeros(3)) for t_s in (0.0, 1.9, 2.0)]
>>> [len(one.detections) for one in forged]
[0, 0, 2]

The published suite (source in docs/fusion.md): false positives around the sensor, false negatives near it, and
translated objects; each is static, walks at random, or follows a trajectory. They change the detector's output only:
the sweep and its field of view stay honest. :class:`viewshed_lab.threats.adversary.Adversary` forges whole streams.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64, Mask
from viewshed.detections import Detections, ObjectKind
from viewshed_lab._config import Ascending, Between, Checked

Motion = Literal["static", "markov", "trajectory"]
"""Stays; walks at random (the velocity starts normally distributed and changes by normal steps); follows a path."""

Counts = Literal["poisson", "exact"]

GHOST_RETURNS = 50
"""Number of returns of a fabricated detection."""

_FOLLOW_M = 2.0
"""A translated object is matched to the nearest honest detection within this distance from sweep to sweep."""


@dataclass(frozen=True, slots=True, eq=False)
class ForgedDetections:
    """Detections after an attack, with the record of what was forged.

    Raises:
        ValueError: the lengths do not match.
    """

    detections: Detections  # K objects, as reported to the others
    source: NDArray[np.int32]  # (K,) int32 index of the honest detection; -1 for fabricated ones
    ghost: NDArray[np.int64]  # (K,) int64 id of the fabricated object, constant over time; -1 for all others
    moved: Mask  # (K,) bool, honest detections at a false place
    removed: Mask  # (H,) bool, honest detections that are removed

    def __post_init__(self) -> None:
        count = len(self.detections)
        if not (self.source.shape == self.ghost.shape == self.moved.shape == (count,)):
            raise ValueError(f"source, ghost and moved must have shape {(count,)}, one value a detection")
        if (self.source >= 0).sum() != (~self.removed).sum():
            raise ValueError("each honest detection must be removed or have a row, got others")

    @classmethod
    def honest(cls, detections: Detections) -> ForgedDetections:
        """Return the record of untouched detections."""
        count = len(detections)
        return cls(
            detections, np.arange(count, dtype=np.int32), np.full(count, -1, np.int64), np.zeros(count, np.bool_),
            np.zeros(count, np.bool_),
        )  # fmt: skip


@dataclass(slots=True)
class Targets:
    """The J attacked places until the next reset; they move."""

    numbers: NDArray[np.int64]  # (J,) int64 ids, unique within an attack
    start: F64  # (J, 3) places in meters at the last reset
    places: F64  # (J, 3) places in meters now
    velocity: F64  # (J, 2) m/s of the random walk
    heading: F64  # (J,) radians, direction of the trajectory; also the yaw of fabricated boxes
    shift: F64  # (J, 2) meters, final shift of translated objects
    age_s: float = 0.0  # seconds since the reset


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectAttack(Checked, ABC):
    """Parameters of an attack on the detections of one sensor; :meth:`begin` starts it.

    Raises:
        ValueError: a value is out of range.
    """

    # objects that are forged at a time, or the mean of that number
    mean_count: Annotated[float, Between(0.0, 1000.0)] = 2.0
    counts: Counts = "poisson"  # the number is Poisson distributed or exact; an exact one must be a whole number
    motion: Motion = "static"  # of the forged objects or shifts
    start_s: Annotated[float, Between(0.0, 1e6)] = 2.0  # seconds from the first sweep to the attack
    reset_s: Annotated[float, Between(0.1, 1e6)] = 10.0  # seconds until other objects are chosen
    speed_std_mps: Annotated[float, Between(0.0, 100.0)] = 10.0  # random walk: initial velocity, each axis
    step_std_mps: Annotated[float, Between(0.0, 100.0)] = 0.5  # random walk: change of velocity per sweep, each axis
    max_speed_mps: Annotated[float, Between(0.0, 100.0)] = 30.0  # random walk: maximum speed
    # rows: seconds since the reset, meters along the heading, meters to its left; linearly interpolated
    trajectory: tuple[tuple[float, float, float], ...] = ((0.0, 0.0, 0.0), (10.0, 80.0, 0.0))

    def __post_init__(self) -> None:
        """Raise a ValueError that names the first value out of range."""
        # slots=True replaces the class, so super() without arguments fails here.
        super(ObjectAttack, self).__post_init__()
        if self.counts == "exact" and self.mean_count != int(self.mean_count):
            raise ValueError(f"mean_count must be a whole number where counts are exact, got {self.mean_count}")
        rows = np.array(self.trajectory, np.float64)
        if rows.ndim != 2 or rows.shape[1:] != (3,) or not np.isfinite(rows).all() or (np.diff(rows[:, 0]) <= 0).any():
            raise ValueError("trajectory must be rows of rising seconds, forward and left meters, all finite")

    def begin(self, rng: np.random.Generator) -> RunningAttack:
        """Return a new run of the attack, for one drive."""
        return RunningAttack(self, rng)

    def step(self, targets: Targets, dt_s: float, rng: np.random.Generator) -> None:
        """Move the targets by their motion over ``dt_s`` seconds, in place."""
        targets.age_s += dt_s
        if self.motion == "markov":
            changed = targets.velocity + rng.normal(0.0, self.step_std_mps, targets.velocity.shape)
            targets.velocity = _limited(changed, self.max_speed_mps)
            targets.places[:, :2] += targets.velocity * dt_s
        elif self.motion == "trajectory":
            t_s, forward_m, left_m = np.array(self.trajectory, np.float64).T
            forward, left = np.interp(targets.age_s, t_s, forward_m), np.interp(targets.age_s, t_s, left_m)
            cos, sin = np.cos(targets.heading), np.sin(targets.heading)
            targets.places[:, 0] = targets.start[:, 0] + cos * forward - sin * left
            targets.places[:, 1] = targets.start[:, 1] + sin * forward + cos * left

    @abstractmethod
    def choose(self, detections: Detections, ground: F64, count: int, rng: np.random.Generator) -> F64:
        """Return at most ``count`` places (J, 3) to attack; ``ground`` (3,) is on the ground below the sensor."""

    @abstractmethod
    def forge(self, detections: Detections, targets: Targets) -> ForgedDetections:
        """Return the detections of a sweep with the targets forged."""

    def draw_shift(self, count: int, rng: np.random.Generator) -> F64:
        """Return the final shift (J, 2) of each target in meters."""
        return np.zeros((count, 2))


@dataclass(slots=True, eq=False)
class RunningAttack:
    """A running attack on the detections of one drive; sweeps come in order of time."""

    attack: ObjectAttack  # parameters
    rng: np.random.Generator  # source of all random draws
    _first_s: float | None = field(default=None, repr=False)
    _last_s: float = field(default=0.0, repr=False)
    _targets: Targets | None = field(default=None, repr=False)
    _next_number: int = field(default=0, repr=False)

    def apply(self, detections: Detections, t_s: float, ground: F64) -> ForgedDetections:
        """Return the forged detections of the next sweep.

        Args:
            detections: honest ones, in a static frame.
            t_s: time of the sweep in seconds; a time that goes back restarts the attack.
            ground: (3,) point on the ground below the sensor, in the same frame.
        """
        if self._first_s is None or t_s < self._last_s:
            self._first_s, self._targets = t_s, None
        dt_s, self._last_s = t_s - self._last_s, t_s
        if t_s - self._first_s < self.attack.start_s - 1e-9:
            return ForgedDetections.honest(detections)
        if self._targets is None or self._targets.age_s + dt_s >= self.attack.reset_s - 1e-9:
            self._targets = self._draw_targets(detections, np.asarray(ground, np.float64))
        else:
            self.attack.step(self._targets, dt_s, self.rng)
        return self.attack.forge(detections, self._targets)

    def _draw_targets(self, detections: Detections, ground: F64) -> Targets:
        attack, rng = self.attack, self.rng
        max_count = int(attack.mean_count) if attack.counts == "exact" else int(rng.poisson(attack.mean_count))
        places = attack.choose(detections, ground, max_count, rng)
        count, first = len(places), self._next_number
        self._next_number += count
        return Targets(
            np.arange(first, first + count, dtype=np.int64), places.copy(), places.copy(),
            rng.normal(0.0, attack.speed_std_mps, (count, 2)), rng.uniform(-np.pi, np.pi, count),
            attack.draw_shift(count, rng),
        )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Fabricate(ObjectAttack):
    """Objects that do not exist, around the sensor."""

    spread_std_m: Annotated[float, Between(0.1, 1000.0)] = 15.0  # of their distance from the sensor, each axis
    # length, width and height of their boxes
    size_m: Annotated[tuple[float, float, float], Between(0.1, 100.0)] = (4.0, 2.0, 2.0)

    def choose(self, detections: Detections, ground: F64, count: int, rng: np.random.Generator) -> F64:
        """Return normally distributed places (count, 3) around the sensor; boxes stand on the ground."""
        places = np.tile(ground + np.array([0.0, 0.0, self.size_m[2] / 2]), (count, 1))
        places[:, :2] += rng.normal(0.0, self.spread_std_m, (count, 2))
        return places

    def forge(self, detections: Detections, targets: Targets) -> ForgedDetections:
        """Return the honest detections followed by the fabricated ones."""
        count, honest = len(targets.numbers), len(detections)
        yaw = targets.heading
        if self.motion == "markov":
            yaw = np.arctan2(targets.velocity[:, 1], targets.velocity[:, 0])
        ghosts = np.column_stack([targets.places, np.tile(self.size_m, (count, 1)), yaw])
        both = Detections(
            np.concatenate([detections.boxes, ghosts]),
            np.append(detections.kinds, np.full(count, ObjectKind.CAR, np.uint8)),
            np.append(detections.returns, np.full(count, GHOST_RETURNS, np.int32)),
        )
        source = np.append(np.arange(honest, dtype=np.int32), np.full(count, -1, np.int32))
        numbers = np.append(np.full(honest, -1, np.int64), targets.numbers)
        return ForgedDetections(both, source, numbers, np.zeros(honest + count, np.bool_), np.zeros(honest, np.bool_))


@dataclass(frozen=True, slots=True, kw_only=True)
class _OnObjects(ObjectAttack):
    """Attacks on real objects, chosen at random among those near the sensor."""

    within_m: Annotated[float, Between(0.5, 1000.0)] = 50.0  # maximum distance of the chosen objects from the sensor
    # a target is matched to the nearest detection within this distance of its place
    near_m: Annotated[float, Between(0.1, 100.0)] = 6.0

    def choose(self, detections: Detections, ground: F64, count: int, rng: np.random.Generator) -> F64:
        """Return the places (J, 3) of random objects near the sensor, without repetition."""
        apart = np.linalg.norm(detections.boxes[:, :2] - ground[:2], axis=1)
        near = np.flatnonzero(apart < self.within_m)
        return detections.boxes[rng.permutation(near)[:count], :3].astype(np.float64)

    def _nearest(self, detections: Detections, targets: Targets) -> NDArray[np.intp]:
        """Return the detection (J,) nearest to each target, -1 for none; no detection is matched twice."""
        matches = np.full(len(targets.numbers), -1, np.intp)
        if not len(detections):
            return matches
        free = np.ones(len(detections), np.bool_)
        for k, place in enumerate(targets.places):
            apart = np.where(free, np.linalg.norm(detections.boxes[:, :2] - place[:2], axis=1), np.inf)
            nearest = int(apart.argmin())
            if apart[nearest] <= self.near_m:
                matches[k], free[nearest] = nearest, False
        return matches


@dataclass(frozen=True, slots=True, kw_only=True)
class Remove(_OnObjects):
    """Objects that are no longer reported: the detection nearest to each target is dropped.

    A static or randomly walking target ignores the object's own motion, as published; on a trajectory it follows it.
    """

    def step(self, targets: Targets, dt_s: float, rng: np.random.Generator) -> None:
        """Move the targets, except on a trajectory, where they follow their objects."""
        if self.motion == "trajectory":
            targets.age_s += dt_s
        else:
            super(Remove, self).step(targets, dt_s, rng)

    def forge(self, detections: Detections, targets: Targets) -> ForgedDetections:
        """Return the detections without the removed ones."""
        matches = self._nearest(detections, targets)
        removed = np.zeros(len(detections), np.bool_)
        removed[matches[matches >= 0]] = True
        if self.motion == "trajectory":
            targets.places[matches >= 0] = detections.boxes[matches[matches >= 0], :3]
        kept = ForgedDetections.honest(detections.take(~removed))
        return replace(kept, source=np.flatnonzero(~removed).astype(np.int32), removed=removed)


@dataclass(frozen=True, slots=True, kw_only=True)
class Translate(_OnObjects):
    """Objects reported at a false place: shifted by a constant vector, a randomly walking one, or a growing one."""

    near_m: Annotated[float, Between(0.1, 100.0)] = _FOLLOW_M  # maximum motion of an object from sweep to sweep
    # minimum and maximum length of the shift; its direction is random
    shift_m: Annotated[tuple[float, float], Ascending(0.0, 100.0)] = (2.0, 6.0)
    growth_s: Annotated[float, Between(0.1, 1000.0)] = 3.0  # on a trajectory, seconds until the full shift

    def draw_shift(self, count: int, rng: np.random.Generator) -> F64:
        """Return shifts (count, 2) in meters, of random length and direction."""
        length, direction = rng.uniform(*self.shift_m, count), rng.uniform(-np.pi, np.pi, count)
        return np.column_stack([length * np.cos(direction), length * np.sin(direction)])

    def step(self, targets: Targets, dt_s: float, rng: np.random.Generator) -> None:
        """Move a randomly walking shift, limited to its maximum length; the places do not move here."""
        targets.age_s += dt_s
        if self.motion == "markov":
            changed = targets.velocity + rng.normal(0.0, self.step_std_mps, targets.velocity.shape)
            targets.velocity = _limited(changed, self.max_speed_mps)
            targets.shift = _limited(targets.shift + targets.velocity * dt_s, self.shift_m[1])

    def forge(self, detections: Detections, targets: Targets) -> ForgedDetections:
        """Return the detections with the targets' ones shifted; the targets follow the honest detections."""
        matches = self._nearest(detections, targets)
        hit = matches >= 0
        share = min(targets.age_s / self.growth_s, 1.0) if self.motion == "trajectory" else 1.0
        boxes, moved = detections.boxes.copy(), np.zeros(len(detections), np.bool_)
        targets.places[hit] = boxes[matches[hit], :3]
        boxes[matches[hit], :2] += share * targets.shift[hit]
        moved[matches[hit]] = share > 0
        forged = Detections(boxes, detections.kinds, detections.returns)
        return replace(ForgedDetections.honest(forged), moved=moved)


def _limited(vectors: F64, max_length: float) -> F64:
    """Return vectors (J, 2) scaled down to at most ``max_length``."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors * np.minimum(1.0, max_length / np.maximum(length, 1e-9)))


_STEALTHY_M = (0.3, 1.0)
"""Length of the small shifts of arXiv 2605.01301, which stay below the gates of trackers."""

_FAMILIES: dict[str, Callable[..., ObjectAttack]] = {
    "fabricate": Fabricate,
    "remove": Remove,
    "translate": Translate,
    "shift": partial(Translate, shift_m=_STEALTHY_M, speed_std_mps=0.3, step_std_mps=0.05),
}

OBJECT_ATTACKS: dict[str, Callable[..., ObjectAttack]] = {
    f"{name}_{motion}": partial(family, motion=motion)
    for name, family in _FAMILIES.items()
    for motion in get_args(Motion)
}
"""By name; each takes the parameters of its class. ``shift`` is the stealthy translation by at most a meter."""
