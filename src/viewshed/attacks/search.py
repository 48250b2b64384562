"""Search without gradients: random draws, and an evolution strategy that starts from the best of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Genome = NDArray[np.float64]
DRAWN_SHARE = 0.3
"""Share of the queries of an evolution that its random draws may use."""
OFFSPRING = 6
_GROWS, _SHRINKS = 1.6, 0.88
_STEPS = (0.03, 2.0)


class Space(Protocol):
    """What can be searched."""

    def draw(self, number: int, rng: np.random.Generator) -> Genome:
        """Return a random plan; the first few may be good guesses, by their number."""
        ...

    def mutated(self, parent: Genome, step: float, rng: np.random.Generator) -> Genome:
        """Return a plan near another."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Best:
    """The best plan that was met.

    Attributes:
        genome: the plan, or None where no query was left.
        value: what it is worth.
        history: (Q,) what each plan that was tried is worth, in order.
    """

    genome: Genome | None
    value: float
    history: NDArray[np.float64]


class _Tried:
    """Counts what is tried and keeps the best; of equals the later, so that a plateau is crossed."""

    def __init__(self, value_of: Callable[[Genome], float], most: int) -> None:
        self._value_of, self._most = value_of, most
        self.genome: Genome | None = None
        self.value = -np.inf
        self.history: list[float] = []

    @property
    def left(self) -> int:
        return self._most - len(self.history)

    def attempt(self, genome: Genome) -> bool:
        """Return whether a plan is better than all before."""
        value = self._value_of(genome)
        self.history.append(value)
        better = value > self.value
        if value >= self.value:
            self.genome, self.value = genome, value
        return better

    def best(self) -> Best:
        return Best(self.genome, self.value, np.array(self.history))


def random_search(space: Space, value_of: Callable[[Genome], float], most: int, rng: np.random.Generator) -> Best:
    """Return the best of ``most`` random draws."""
    tried = _Tried(value_of, most)
    for number in range(most):
        tried.attempt(space.draw(number, rng))
    return tried.best()


def evolution(space: Space, value_of: Callable[[Genome], float], most: int, rng: np.random.Generator) -> Best:
    """Return the best plan of ``most``: random draws, then a (1 + λ) evolution strategy with λ = 6 from the best.

    The step grows after a success and shrinks otherwise (Rechenberg 1973). Never worse than the best of its draws.
    """
    tried, step = _Tried(value_of, most), 0.6
    for number in range(int(np.ceil(DRAWN_SHARE * most))):
        tried.attempt(space.draw(number, rng))
    while tried.left > 0 and tried.genome is not None:
        parent = tried.genome
        children = [space.mutated(parent, step, rng) for _ in range(min(OFFSPRING, tried.left))]
        won = [tried.attempt(child) for child in children]
        step = float(np.clip(step * (_GROWS if any(won) else _SHRINKS), *_STEPS))
    return tried.best()
