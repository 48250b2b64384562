"""Adversary: runs one of the package's attacks on the messages that agents send, from a start time on.

A name in ``ATTACKS`` forges sweeps before they are processed, one in ``OBJECT_ATTACKS`` forges detections, and one in
``VIEW_LIES`` forges the claimed field of view. All other data stays honest.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from viewshed.detections import Detections
from viewshed.fov.estimate import FovEstimate
from viewshed.geometry import Rigid
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.sweep import Sweep
from viewshed_lab._config import one_of
from viewshed_lab.threats.attacks import ATTACKS, Attack, Knowledge
from viewshed_lab.threats.attacks.points import Cluster, Frustum, Uniform
from viewshed_lab.threats.attacks.replay import PoseSpoof
from viewshed_lab.threats.object_attacks import OBJECT_ATTACKS, RunningAttack
from viewshed_lab.threats.view_attacks import VIEW_LIES, ViewLie

SWEEPS_KEPT = 5
"""Number of sweeps before the attack that are kept per agent, for attacks that replay them."""

VIEWS_KEPT = 50
"""Number of honest views that are kept per agent, for the lie ``stale``."""


_PLACED_BY_SEED = (Uniform, Cluster, Frustum, PoseSpoof)
"""Attacks that draw more of their place than an azimuth."""


@dataclass(slots=True)
class _Victim:
    """State of one agent: times of its first and last message, its honest sweeps and views, and the running attack."""

    first_s: float
    last_s: float
    earlier: list[Sweep] = field(default_factory=list)
    views: list[FovEstimate] = field(default_factory=list)
    objects: RunningAttack | None = None
    # attacks on its sweeps: number of the period between resets, its sweeps forged so far, azimuth of the attack in it
    period: int = -1
    forged: int = 0
    azimuth: float | None = None


@dataclass(slots=True)
class Adversary:
    """Forges the messages of some agents from ``start_s`` to ``end_s``; all other messages pass unchanged.

    Args:
        attack: name in ``ATTACKS``, ``OBJECT_ATTACKS`` or ``VIEW_LIES``.
        agents: attacked agents; ``car_0`` includes ``car_0/lidar``. All agents if empty.
        start_s: start of the attack, seconds after the agent's first message.
        reset_s: period in seconds after which new objects, or another part of the sweep, are attacked.
        end_s: end of the attack, seconds after the agent's first message.
        count: number of objects forged at a time.
        seed: seed of all random draws.

    Raises:
        ValueError: no attack has this name, or a number is out of range.
    """

    attack: str
    agents: frozenset[str] = frozenset()
    start_s: float = 2.0
    reset_s: float = 10.0
    end_s: float = np.inf
    count: int = 2
    seed: int = 0
    _victims: dict[str, _Victim] = field(default_factory=dict, repr=False)
    _matched: set[str] = field(default_factory=set, repr=False)

    def __post_init__(self) -> None:
        one_of("attack", self.attack, (*ATTACKS, *OBJECT_ATTACKS, *VIEW_LIES))
        if not (0.0 <= self.start_s < self.end_s and self.reset_s >= 0.1 and self.count >= 1 and self.seed >= 0):
            raise ValueError(
                "an attack must have 0 <= start_s < end_s, reset_s >= 0.1, count >= 1 and seed >= 0, got"
                f" {self.start_s:g} s, {self.end_s:g} s, {self.reset_s:g} s, {self.count} and {self.seed}"
            )

    def attacks(self, agent: str) -> bool:
        """Return whether an agent is attacked: ``agents`` is empty, or holds its name or the part before a ``/``."""
        matches = {name for name in self.agents if agent == name or agent.startswith(f"{name}/")}
        self._matched |= matches
        return not self.agents or bool(matches)

    def unmet(self) -> frozenset[str]:
        """Return the names in ``agents`` that no agent has matched so far."""
        return self.agents - self._matched

    def sweep(self, sweep: Sweep) -> Sweep:
        """Return the forged sweep; the sweep itself where it is not attacked.

        Raises:
            ValueError: the sweep lacks something that the attack needs, such as rings or a pose.
        """
        if self.attack not in ATTACKS or not self.attacks(sweep.agent):
            return sweep
        victim = self._victim(sweep.agent, None if sweep.t_ns is None else 1e-9 * sweep.t_ns)
        if not self._is_on(victim):
            victim.earlier = [*victim.earlier, sweep][-SWEEPS_KEPT:]
            return sweep
        period = int((victim.last_s - victim.first_s - self.start_s) / self.reset_s)
        if period != victim.period:
            victim.period, victim.forged, victim.azimuth = period, 0, None
        # Until the next reset the attack keeps its azimuth, and draws new noise for each sweep. One that draws more of
        # its place keeps its seed, and so its noise.
        attack: Any = ATTACKS[self.attack](knowledge=Knowledge(earlier=tuple(victim.earlier)))
        seed, is_aimed = [self.seed, period], not isinstance(attack, _PLACED_BY_SEED)
        if is_aimed and attack.azimuth is None:
            attack = replace(attack, azimuth=victim.azimuth)
        if is_aimed and attack.azimuth is not None:
            seed.append(victim.forged)
        tampered = cast(Attack, attack).apply(sweep, np.random.default_rng(seed))
        if is_aimed and tampered.wedge is not None:
            victim.azimuth = tampered.wedge.azimuth
        victim.forged += 1
        forged = tampered.sweep
        return forged if forged.agent == sweep.agent else forged.replace(agent=sweep.agent)

    def detections(self, leveled: LeveledSweep, detections: Detections) -> Detections:
        """Return the forged detections of a sweep, in its ``level`` frame."""
        t_ns, pose = leveled.sweep.t_ns, leveled.world_from_level or Rigid.identity()
        if self.attack not in OBJECT_ATTACKS or not self.attacks(leveled.sweep.agent):
            return detections
        forged = self.objects(
            leveled.sweep.agent, None if t_ns is None else 1e-9 * t_ns, detections.moved(pose), pose.translation
        )
        return forged.moved(pose.inverse())

    def objects(self, agent: str, t_s: float | None, detections: Detections, ground: NDArray[np.float64]) -> Detections:
        """Return forged detections in a static frame; ``ground`` (3,) is the point on the ground below the sensor."""
        if self.attack not in OBJECT_ATTACKS or not self.attacks(agent):
            return detections
        victim = self._victim(agent, t_s)
        if victim.objects is None:
            attack = OBJECT_ATTACKS[self.attack](
                counts="exact", mean_count=float(self.count), start_s=self.start_s, reset_s=self.reset_s
            )
            victim.objects = attack.begin(np.random.default_rng([self.seed, len(self._victims)]))
        if victim.last_s - victim.first_s >= self.end_s:
            return detections
        return victim.objects.apply(detections, victim.last_s, ground).detections

    def view(self, estimate: FovEstimate) -> FovEstimate:
        """Return the forged field of view; the estimate itself where it is not attacked."""
        if self.attack not in VIEW_LIES or not self.attacks(estimate.agent):
            return estimate
        victim = self._victim(estimate.agent, None if estimate.t_ns is None else 1e-9 * estimate.t_ns)
        victim.views = [*victim.views, estimate][-VIEWS_KEPT:]
        if not self._is_on(victim):
            return estimate
        lie, amount = VIEW_LIES[self.attack]
        azimuth = np.random.default_rng(self.seed).uniform(-np.pi, np.pi)
        return lie(victim.views, ViewLie(float(azimuth), amount))

    def _victim(self, agent: str, t_s: float | None) -> _Victim:
        """Return the state of an agent after a message at ``t_s``; a time that goes back starts a new state."""
        victim = self._victims.get(agent)
        now_s = t_s if t_s is not None else 0.0 if victim is None else victim.last_s + 0.1
        if victim is None or now_s < victim.last_s:
            victim = self._victims[agent] = _Victim(now_s, now_s)
        victim.last_s = now_s
        return victim

    def _is_on(self, victim: _Victim) -> bool:
        return self.start_s - 1e-9 <= victim.last_s - victim.first_s < self.end_s
