"""Adversary: forges what agents of a stream send, from a time on, by the name of an attack of the package.

A name of ``ATTACKS`` forges sweeps, before anything is made of them; one of ``OBJECT_ATTACKS`` forges detections, and
one of ``VIEW_LIES`` the field of view that an agent claims; the rest stays honest.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from viewshed.detections import Detections
from viewshed.fov.estimate import FovEstimate
from viewshed.geometry import Rigid
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.sweep import Sweep
from viewshed_lab._config import one_of
from viewshed_lab.threats.attacks import ATTACKS, Attack, Knowledge
from viewshed_lab.threats.object_attacks import OBJECT_ATTACKS, RunningAttack
from viewshed_lab.threats.view_attacks import VIEW_LIES, ViewLie

SWEEPS_KEPT = 5
"""Honest sweeps of an agent before the attack, for attacks that replay them."""

VIEWS_KEPT = 50
"""Honest views of an agent that a stale lie may go back to."""


@dataclass(slots=True)
class _Victim:
    """What is remembered of one agent: when it was heard first and last, and its honest past."""

    first_s: float
    last_s: float
    earlier: list[Sweep] = field(default_factory=list)
    views: list[FovEstimate] = field(default_factory=list)
    objects: RunningAttack | None = None


@dataclass(slots=True)
class Adversary:
    """Forges what some agents send; what others send, and what comes before its start, passes as it is.

    Args:
        attack: name in ``ATTACKS``, ``OBJECT_ATTACKS`` or ``VIEW_LIES``.
        agents: whose, ``car_0`` also for ``car_0/lidar``; all where none is named.
        start_s: seconds after the first that an agent sent.
        reset_s: seconds until other objects, or another place of the sweep, are attacked.
        end_s: seconds after the first at which it ends.
        count: objects that are forged at a time.
        seed: of all that is random.

    Raises:
        ValueError: there is no attack of this name, or a number is out of range.
    """

    attack: str
    agents: frozenset[str] = frozenset()
    start_s: float = 2.0
    reset_s: float = 10.0
    end_s: float = np.inf
    count: int = 2
    seed: int = 0
    _victims: dict[str, _Victim] = field(default_factory=dict, repr=False)
    _met: set[str] = field(default_factory=set, repr=False)

    def __post_init__(self) -> None:
        one_of("attack", self.attack, (*ATTACKS, *OBJECT_ATTACKS, *VIEW_LIES))
        if not (0.0 <= self.start_s < self.end_s and self.reset_s >= 0.1 and self.count >= 1 and self.seed >= 0):
            raise ValueError(
                "an attack must start at 0 s or later, before it ends, reset after .1 s or more and forge an object or"
                f" more, got {self.start_s:g} s to {self.end_s:g} s, reset_s {self.reset_s:g}, count {self.count}"
            )

    def attacks(self, agent: str) -> bool:
        """Return whether an agent is one of those that are attacked, by its name or by what its name begins with."""
        found = {name for name in self.agents if agent == name or agent.startswith(f"{name}/")}
        self._met |= found
        return not self.agents or bool(found)

    def unmet(self) -> frozenset[str]:
        """Return the names of those agents that nobody has."""
        return self.agents - self._met

    def sweep(self, sweep: Sweep) -> Sweep:
        """Return a sweep as the adversary lets others see it.

        Raises:
            ValueError: the sweep has nothing that the attack needs.
        """
        if self.attack not in ATTACKS or not self.attacks(sweep.agent):
            return sweep
        victim = self._victim(sweep.agent, None if sweep.t_ns is None else 1e-9 * sweep.t_ns)
        if not self._is_on(victim):
            victim.earlier = [*victim.earlier, sweep][-SWEEPS_KEPT:]
            return sweep
        # The same draws until the next reset: an attack keeps to its place.
        number = int((victim.last_s - victim.first_s - self.start_s) / self.reset_s)
        made: Attack = ATTACKS[self.attack](knowledge=Knowledge(earlier=tuple(victim.earlier)))
        forged = made.apply(sweep, np.random.default_rng([self.seed, number])).sweep
        return forged if forged.agent == sweep.agent else forged.replace(agent=sweep.agent)

    def detections(self, leveled: LeveledSweep, detections: Detections) -> Detections:
        """Return the detections of a sweep, in its ``level`` frame, as the adversary lets others see them."""
        t_ns, pose = leveled.sweep.t_ns, leveled.world_from_level or Rigid.identity()
        if self.attack not in OBJECT_ATTACKS or not self.attacks(leveled.sweep.agent):
            return detections
        forged = self.objects(
            leveled.sweep.agent, None if t_ns is None else 1e-9 * t_ns, detections.moved(pose), pose.translation
        )
        return forged.moved(pose.inverse())

    def objects(self, agent: str, t_s: float | None, detections: Detections, ground: NDArray[np.float64]) -> Detections:
        """Return the detections of a time, in a frame that stands still; ``ground`` (3,) lies below the sensor."""
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
        """Return a field of view as the adversary lets others see it."""
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
        """Return what is remembered of an agent, which is heard now; where its time goes back it begins anew."""
        victim = self._victims.get(agent)
        now_s = t_s if t_s is not None else 0.0 if victim is None else victim.last_s + 0.1
        if victim is None or now_s < victim.last_s:
            victim = self._victims[agent] = _Victim(now_s, now_s)
        victim.last_s = now_s
        return victim

    def _is_on(self, victim: _Victim) -> bool:
        return self.start_s - 1e-9 <= victim.last_s - victim.first_s < self.end_s
