"""Attacks on objects: detections are fabricated, removed or moved, and reports say what was forged.

>>> attack = OBJECT_ATTACKS["fabricate_static"](counts="exact", mean_count=2.0).begin(np.random.default_rng(0))
>>> forged = [attack.apply(Detections.none(), t_s, np.zeros(3)) for t_s in (0.0, 1.9, 2.0)]
>>> [len(one.detections) for one in forged]
[0, 0, 2]

The published suite (docs/fusion.md has its source): false positives about the sensor, false negatives among the objects
near it, translated objects; each stays, walks at random, or keeps to a trajectory. They work on the detector's answer:
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
"""Stays; walks at random (velocity with a normal start and normal steps); keeps to a path."""

Counts = Literal["poisson", "exact"]

GHOST_RETURNS = 50
"""Returns that a fabricated detection claims."""

_FOLLOW_M = 2.0
"""A moved object is followed by the nearest honest detection within this distance from sweep to sweep."""


@dataclass(frozen=True, slots=True, eq=False)
class ForgedDetections:
    """Detections after an attack, with what the attacker did to them.

    Raises:
        ValueError: the lengths do not fit.
    """

    detections: Detections  # K objects, what everybody else is shown
    source: NDArray[np.int32]  # (K,) int32 number of the honest detection that each was; -1 for fabricated ones
    ghost: NDArray[np.int64]  # (K,) int64 number of the fabricated object, the same over time; -1 for all others
    moved: Mask  # (K,) bool, honest detections at a false place
    removed: Mask  # (H,) bool of the honest detections, those that are gone

    def __post_init__(self) -> None:
        count = len(self.detections)
        if not (self.source.shape == self.ghost.shape == self.moved.shape == (count,)):
            raise ValueError(f"source, ghost and moved must have shape {(count,)}, one value a detection")
        if (self.source >= 0).sum() != (~self.removed).sum():
            raise ValueError("each honest detection must be removed or have a row, got others")

    @classmethod
    def honest(cls, detections: Detections) -> ForgedDetections:
        """Return detections that nobody touched."""
        count = len(detections)
        return cls(
            detections, np.arange(count, dtype=np.int32), np.full(count, -1, np.int64), np.zeros(count, np.bool_),
            np.zeros(count, np.bool_),
        )  # fmt: skip


@dataclass(slots=True)
class Targets:
    """What an attacker works on until the next reset: J places that move."""

    numbers: NDArray[np.int64]  # (J,) int64, never given twice in one attack
    start: F64  # (J, 3) places in meters at the last reset
    places: F64  # (J, 3) places in meters now
    velocity: F64  # (J, 2) m/s of a random walk
    heading: F64  # (J,) radians, where a trajectory points; also the yaw of fabricated boxes
    shift: F64  # (J, 2) meters by which translated objects are moved in the end
    age_s: float = 0.0  # seconds since the reset


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectAttack(Checked, ABC):
    """An attack on the detections of one sensor; :meth:`begin` starts it.

    Raises:
        ValueError: a value is out of range.
    """

    # objects that are forged at a time, or the mean of their number
    mean_count: Annotated[float, Between(0.0, 1000.0)] = 2.0
    counts: Counts = "poisson"  # the number is Poisson distributed, or exact (then a whole number)
    motion: Motion = "static"  # of what is forged
    start_s: Annotated[float, Between(0.0, 1e6)] = 2.0  # seconds from the first sweep to the attack
    reset_s: Annotated[float, Between(0.1, 1e6)] = 10.0  # seconds until other objects are chosen
    speed_std_mps: Annotated[float, Between(0.0, 100.0)] = 10.0  # of each axis of a random walk's first velocity
    step_std_mps: Annotated[float, Between(0.0, 100.0)] = 0.5  # of each axis of its change from sweep to sweep
    max_speed_mps: Annotated[float, Between(0.0, 100.0)] = 30.0  # that it never exceeds
    # rows of seconds since the reset, meters along the heading and to its left; straight lines between
    trajectory: tuple[tuple[float, float, float], ...] = ((0.0, 0.0, 0.0), (10.0, 80.0, 0.0))

    def __post_init__(self) -> None:
        """Raise a ValueError that names the first value out of range."""
        # With slots the class of the body is another one: super() alone would not find it.
        super(ObjectAttack, self).__post_init__()
        if self.counts == "exact" and self.mean_count != int(self.mean_count):
            raise ValueError(f"mean_count must be a whole number where counts are exact, got {self.mean_count}")
        rows = np.array(self.trajectory, np.float64)
        if rows.ndim != 2 or rows.shape[1:] != (3,) or not np.isfinite(rows).all() or (np.diff(rows[:, 0]) <= 0).any():
            raise ValueError("trajectory must be rows of rising seconds, forward and left meters, all finite")

    def begin(self, rng: np.random.Generator) -> RunningAttack:
        """Return the attack at its beginning, for one drive."""
        return RunningAttack(self, rng)

    def step(self, targets: Targets, dt_s: float, rng: np.random.Generator) -> None:
        """Move the targets by their motion."""
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
        """Return the places (J, 3) that are worked on, ``count`` at most; ``ground`` (3,) is below the sensor."""

    @abstractmethod
    def forge(self, detections: Detections, targets: Targets) -> ForgedDetections:
        """Return the detections of a sweep with the targets forged."""

    def draw_shift(self, count: int, rng: np.random.Generator) -> F64:
        """Return by how many meters (J, 2) each target is moved."""
        return np.zeros((count, 2))


@dataclass(slots=True, eq=False)
class RunningAttack:
    """An attack on the detections of one drive: sweep after sweep, in the order of time."""

    attack: ObjectAttack  # its parameters
    rng: np.random.Generator  # draws all that is random
    _first_s: float | None = field(default=None, repr=False)
    _last_s: float = field(default=0.0, repr=False)
    _targets: Targets | None = field(default=None, repr=False)
    _given: int = field(default=0, repr=False)

    def apply(self, detections: Detections, t_s: float, ground: F64) -> ForgedDetections:
        """Return the detections of the next sweep as the attacker lets others see them.

        Args:
            detections: honest ones, in a frame that stands still.
            t_s: time of the sweep; where it goes back, the attack begins anew.
            ground: (3,) place on the ground below the sensor, in the same frame.
        """
        if self._first_s is None or t_s < self._last_s:
            self._first_s, self._targets = t_s, None
        dt_s, self._last_s = t_s - self._last_s, t_s
        if t_s - self._first_s < self.attack.start_s - 1e-9:
            return ForgedDetections.honest(detections)
        if self._targets is None or self._targets.age_s + dt_s >= self.attack.reset_s - 1e-9:
            self._targets = self._draw(detections, np.asarray(ground, np.float64))
        else:
            self.attack.step(self._targets, dt_s, self.rng)
        return self.attack.forge(detections, self._targets)

    def _draw(self, detections: Detections, ground: F64) -> Targets:
        attack, rng = self.attack, self.rng
        most = int(attack.mean_count) if attack.counts == "exact" else int(rng.poisson(attack.mean_count))
        places = attack.choose(detections, ground, most, rng)
        count, first = len(places), self._given
        self._given += count
        return Targets(
            np.arange(first, first + count, dtype=np.int64), places.copy(), places.copy(),
            rng.normal(0.0, attack.speed_std_mps, (count, 2)), rng.uniform(-np.pi, np.pi, count),
            attack.draw_shift(count, rng),
        )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Fabricate(ObjectAttack):
    """Objects that are not there, about the sensor."""

    spread_std_m: Annotated[float, Between(0.1, 1000.0)] = 15.0  # of their places about the sensor, each axis
    # length, width and height of their boxes
    size_m: Annotated[tuple[float, float, float], Between(0.1, 100.0)] = (4.0, 2.0, 2.0)

    def choose(self, detections: Detections, ground: F64, count: int, rng: np.random.Generator) -> F64:
        """Return places about the sensor; boxes stand on the ground."""
        places = np.tile(ground + np.array([0.0, 0.0, self.size_m[2] / 2]), (count, 1))
        places[:, :2] += rng.normal(0.0, self.spread_std_m, (count, 2))
        return places

    def forge(self, detections: Detections, targets: Targets) -> ForgedDetections:
        """Return the honest detections and the fabricated ones after them."""
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
    """Attacks on objects that are there, chosen at random among those near the sensor."""

    within_m: Annotated[float, Between(0.5, 1000.0)] = 50.0  # of the sensor, the objects that may be chosen
    # an object is found again as the nearest detection within this distance of its place
    near_m: Annotated[float, Between(0.1, 100.0)] = 6.0

    def choose(self, detections: Detections, ground: F64, count: int, rng: np.random.Generator) -> F64:
        """Return the places of objects near the sensor, each once."""
        apart = np.linalg.norm(detections.boxes[:, :2] - ground[:2], axis=1)
        near = np.flatnonzero(apart < self.within_m)
        return detections.boxes[rng.permutation(near)[:count], :3].astype(np.float64)

    def _nearest(self, detections: Detections, targets: Targets) -> NDArray[np.intp]:
        """Return the detection (J,) at each target, -1 for none; none is taken twice."""
        found = np.full(len(targets.numbers), -1, np.intp)
        if not len(detections):
            return found
        free = np.ones(len(detections), np.bool_)
        for k, place in enumerate(targets.places):
            apart = np.where(free, np.linalg.norm(detections.boxes[:, :2] - place[:2], axis=1), np.inf)
            nearest = int(apart.argmin())
            if apart[nearest] <= self.near_m:
                found[k], free[nearest] = nearest, False
        return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Remove(_OnObjects):
    """Objects that are no longer reported: at each target's place the nearest detection is dropped.

    The place stays or walks at random as published, whatever the object does; on a trajectory it follows the object.
    """

    def step(self, targets: Targets, dt_s: float, rng: np.random.Generator) -> None:
        """Move the places, but those that follow their objects."""
        if self.motion == "trajectory":
            targets.age_s += dt_s
        else:
            super(Remove, self).step(targets, dt_s, rng)

    def forge(self, detections: Detections, targets: Targets) -> ForgedDetections:
        """Return the detections that are left."""
        found = self._nearest(detections, targets)
        removed = np.zeros(len(detections), np.bool_)
        removed[found[found >= 0]] = True
        if self.motion == "trajectory":
            targets.places[found >= 0] = detections.boxes[found[found >= 0], :3]
        kept = ForgedDetections.honest(detections.take(~removed))
        return replace(kept, source=np.flatnonzero(~removed).astype(np.int32), removed=removed)


@dataclass(frozen=True, slots=True, kw_only=True)
class Translate(_OnObjects):
    """Objects that are reported at a false place: by a fixed vector, one that walks at random, or one that grows."""

    near_m: Annotated[float, Between(0.1, 100.0)] = _FOLLOW_M  # how far an object may move from sweep to sweep
    # shortest and longest vector; the direction is random
    shift_m: Annotated[tuple[float, float], Ascending(0.0, 100.0)] = (2.0, 6.0)
    growth_s: Annotated[float, Between(0.1, 1000.0)] = 3.0  # on a trajectory, seconds until the whole vector is reached

    def draw_shift(self, count: int, rng: np.random.Generator) -> F64:
        """Return vectors (J, 2) of random direction."""
        length, direction = rng.uniform(*self.shift_m, count), rng.uniform(-np.pi, np.pi, count)
        return np.column_stack([length * np.cos(direction), length * np.sin(direction)])

    def step(self, targets: Targets, dt_s: float, rng: np.random.Generator) -> None:
        """Let a vector that walks at random do so, never longer than the longest."""
        targets.age_s += dt_s
        if self.motion == "markov":
            changed = targets.velocity + rng.normal(0.0, self.step_std_mps, targets.velocity.shape)
            targets.velocity = _limited(changed, self.max_speed_mps)
            targets.shift = _limited(targets.shift + targets.velocity * dt_s, self.shift_m[1])

    def forge(self, detections: Detections, targets: Targets) -> ForgedDetections:
        """Return the detections with those of the targets moved; the targets follow the honest ones."""
        found = self._nearest(detections, targets)
        hit = found >= 0
        share = min(targets.age_s / self.growth_s, 1.0) if self.motion == "trajectory" else 1.0
        boxes, moved = detections.boxes.copy(), np.zeros(len(detections), np.bool_)
        targets.places[hit] = boxes[found[hit], :3]
        boxes[found[hit], :2] += share * targets.shift[hit]
        moved[found[hit]] = share > 0
        forged = Detections(boxes, detections.kinds, detections.returns)
        return replace(ForgedDetections.honest(forged), moved=moved)


def _limited(vectors: F64, most: float) -> F64:
    """Return vectors (J, 2), those longer than ``most`` cut to that length."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors * np.minimum(1.0, most / np.maximum(length, 1e-9)))


_STEALTHY_M = (0.3, 1.0)
"""The small shifts of arXiv 2605.01301, which stay below the gates of trackers."""

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
"""By name; each takes the parameters of its class. ``shift`` is the stealthy translation by less than a meter."""
