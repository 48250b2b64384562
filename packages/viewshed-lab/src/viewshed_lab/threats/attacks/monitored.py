"""A monitor as the objective of an attacker, and how few returns it takes to make it alarm."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from viewshed.grid import BevGrid
from viewshed.monitor.evidence import MonitoredSweep
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.sweep import Sweep
from viewshed_lab.threats.attacks.adaptive import BlackBox, Trip, Value
from viewshed_lab.threats.attacks.points import Mode
from viewshed_lab.threats.attacks.spoofer import MEASURED_SPOOFER, Spoofer

BITS = (1, 2, 5, 10, 20, 50, 100, 200)
"""Budgets of an attacker who wants alarms."""


@dataclass(frozen=True, slots=True, eq=False)
class MonitorScore:
    """What a monitor of sweeps makes of one that an attacker might send: the ``score`` of ``Trip`` and ``Evade``.

    The search stands for the attacker who knows all: it is given the exact score of every plan. The score has a
    gradient in the evidence, but the evidence has none in the points: counts, quantiles and thresholds are flat almost
    everywhere and jump where one more return passes one, so that a slope by small random moves is 0 or their noise.
    """

    score: Callable[[MonitoredSweep], float]  # from what the monitor is handed to the number that it alarms on
    grid: BevGrid  # of the victim
    earlier: tuple[Sweep, ...] = ()  # sweeps of the sensor before this one, the oldest first

    def __call__(self, sweep: Sweep) -> float:
        """Return the score of a sweep."""
        earlier = tuple(_leveled(before, self.grid) for before in self.earlier)
        return float(self.score(MonitoredSweep(level(sweep, self.grid), earlier)))


@lru_cache(maxsize=16)
def _leveled(sweep: Sweep, grid: BevGrid) -> LeveledSweep:
    """Return a sweep leveled; the earlier ones are the same for every question."""
    return level(sweep, grid)


def tripped_shares(
    watched: Sequence[tuple[Sweep, Value]],
    limit: float,
    rng: np.random.Generator,
    *,
    mode: Mode = "beam_constrained",
    budgets: Sequence[int] = BITS,
    places: int = 4,
    queries: int = 40,
    spoofer: Spoofer = MEASURED_SPOOFER,
) -> NDArray[np.float64]:
    """Return the share (B,) of sweeps on which an attacker with each budget makes a monitor alarm.

    A sweep that alarms with some returns alarms with more: the attacker may keep to the fewer.

    Args:
        watched: clean sweeps, each with the score that a monitor gives to it or to an attacked one.
        limit: the monitor alarms above it.
        rng: all that is random.
        mode: how the attacker spoofs.
        budgets: returns, ascending.
        places: wedges that the attacker tries, of which the one that promises most is attacked.
        queries: most questions to the monitor for each wedge.
        spoofer: how well the beams are won.
    """
    tripped = np.zeros((len(budgets), len(watched)), np.bool_)
    for column, (sweep, score) in enumerate(watched):
        for row, budget in enumerate(budgets):
            attack = BlackBox(Trip(score), budget, queries, mode=mode, spoofer=spoofer)
            plans = [attack.search(sweep, rng) for _ in range(places)]
            if score(max(plans, key=lambda plan: plan.value).tampered.sweep) > limit:
                tripped[row:, column] = True
                break
    shares: NDArray[np.float64] = tripped.mean(axis=1)
    return shares


def smallest_budget(shares: NDArray[np.float64], budgets: Sequence[int] = BITS, share: float = 0.5) -> int | None:
    """Return the smallest of the budgets that trips at least a ``share`` of the sweeps, or None where none does.

    >>> smallest_budget(np.array([0.1, 0.4, 0.6, 0.9]), (1, 2, 5, 10))
    5
    """
    reached = np.flatnonzero(np.asarray(shares) >= share)
    return int(budgets[reached[0]]) if len(reached) else None
