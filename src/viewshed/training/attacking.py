"""The attack on one training frame: which, how strong, and what becomes of the sweep."""

from __future__ import annotations

from collections.abc import Callable
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
    at_severity,
)
from viewshed.sweep import Sweep
from viewshed.training.config import PAPER, TrainConfig


def attacked(
    config: TrainConfig, sweep: Sweep, earlier: Callable[[], tuple[Sweep, ...]], rng: np.random.Generator
) -> Sweep:
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
        return sweep
    name = config.attacks[rng.integers(len(config.attacks))]
    try:
        return _made(config, name, earlier, rng).apply(sweep, rng).sweep
    except ValueError:
        return sweep


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
