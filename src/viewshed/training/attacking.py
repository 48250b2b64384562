"""The attack on one training frame: which, how strong, and what becomes of the sweep."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from viewshed.attacks import (
    ATTACKS,
    BUDGETS,
    EARLIER,
    PAPER_ATTACK,
    PAPER_INDOOR_ATTACK,
    SEVERITIES,
    Attack,
    Knowledge,
    Wedge,
    at_severity,
)
from viewshed.geometry import Rigid
from viewshed.sweep import Sweep
from viewshed.training.config import PAPER, TrainConfig


@dataclass(frozen=True, slots=True, eq=False)
class Struck:
    """A sweep as the network is shown it.

    Attributes:
        sweep: attacked, or as it was measured.
        attack: what was done to it, None for nothing.
        wedge: where the attacker works, None if anywhere.
    """

    sweep: Sweep
    attack: Attack | None = None
    wedge: Wedge | None = None

    def before(self, earlier: Sequence[Sweep], rng: np.random.Generator) -> tuple[Sweep, ...]:
        """Return earlier sweeps as if the attack had lasted: each attacked as well, in the same direction of the map.

        One that does not allow the attack stays as it is.
        """
        return tuple(self._struck(sweep, rng) for sweep in earlier)

    def _struck(self, sweep: Sweep, rng: np.random.Generator) -> Sweep:
        attack, now, then = self.attack, self.sweep.world_from_sensor, sweep.world_from_sensor
        if attack is None:
            return sweep
        if self.wedge is not None and hasattr(attack, "azimuth") and now is not None and then is not None:
            attack = replace(attack, azimuth=_wrapped(self.wedge.azimuth + _heading(now) - _heading(then)))  # type: ignore[type-var]
        try:
            return attack.apply(sweep, rng).sweep
        except ValueError:
            return sweep


def attacked(
    config: TrainConfig, sweep: Sweep, earlier: Callable[[], tuple[Sweep, ...]], rng: np.random.Generator
) -> Struck:
    """Return the sweep as the network is shown it: attacked by one of the config's attacks, or as it is.

    Attacks are drawn evenly, and so is the strength of each, from its budgets and its severities in the study. One
    that this sweep does not allow leaves it as it is.

    Args:
        config: says which attacks, and how often.
        sweep: the clean sweep, not modified.
        earlier: returns earlier sweeps of the same sensor; asked only where the attack needs one.
        rng: all that is random.
    """
    if not config.attacks or rng.random() >= config.attack_share:
        return Struck(sweep)
    name = config.attacks[rng.integers(len(config.attacks))]
    try:
        attack = _made(config, name, earlier, rng)
        found = attack.apply(sweep, rng)
    except ValueError:
        return Struck(sweep)
    return Struck(found.sweep, attack, found.wedge)


def _heading(pose: Rigid) -> float:
    return float(np.arctan2(pose.rotation[1, 0], pose.rotation[0, 0]))


def _wrapped(azimuth: float) -> float:
    return float((azimuth + np.pi) % (2 * np.pi) - np.pi)


def _made(config: TrainConfig, name: str, earlier: Callable[[], tuple[Sweep, ...]], rng: np.random.Generator) -> Attack:
    if name == PAPER:
        return PAPER_INDOOR_ATTACK if config.indoor else PAPER_ATTACK
    strengths = strengths_of(name)
    strength = strengths[rng.integers(len(strengths))]
    before = earlier() if name in EARLIER else ()
    knowledge = Knowledge(before, half_extent_m=config.half_extent_m)
    if isinstance(strength, tuple):
        return at_severity(name, *strength, knowledge)
    return ATTACKS[name](strength, knowledge)


@lru_cache(maxsize=64)
def strengths_of(name: str) -> tuple[int | tuple[str, float] | None, ...]:
    """Return how strong an attack may be drawn: None its default, a budget, or an attribute with a value.

    >>> strengths_of("ghost_car")
    (None, 50, 100, 150, 200, 1000, 1000000000)
    """
    budgets = tuple(budget for budget in BUDGETS[name] if budget)
    return (None, *budgets, *SEVERITIES.get(name, ()))
