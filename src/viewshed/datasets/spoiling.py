"""What spoils the sweeps of a data set: an attack or a corruption, by name and with a seed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Protocol

import numpy as np

from viewshed.attacks import ATTACKS, EARLIER, PAPER_ATTACK, PAPER_INDOOR_ATTACK, Attack, Knowledge
from viewshed.attacks.adaptive import ADAPTIVE
from viewshed.corruptions import CORRUPTIONS
from viewshed.datasets.touched import Touched
from viewshed.estimate import FovEstimator
from viewshed.sweep import Sweep

History = Callable[[], tuple[Sweep, ...]]
"""Earlier sweeps of the same agent: its first and the one before, () for the first of all."""
PAPER = "paper"
_LASTING = EARLIER | {"coherent_phantom"}
_FACTORIES = ATTACKS | ADAPTIVE
_ROOM_M = 20.0


class Spoiling(Protocol):
    """Anything that changes a sweep, the same way for the same generator; it travels to other processes."""

    def apply(self, sweep: Sweep, history: History, rng: np.random.Generator) -> tuple[Sweep, Touched | None]:
        """Return the changed sweep, and what was touched where that is known.

        Raises:
            ValueError: it cannot be done to this sweep.
        """
        ...

    @property
    def command(self) -> str:
        """What makes such a data set."""
        ...

    @property
    def name(self) -> str:
        """Name in its table."""
        ...

    def config(self) -> dict[str, Any]:
        """Return all its parameters, as plain values."""
        ...


@dataclass(frozen=True, slots=True)
class AttackPlan:
    """An attack on every sweep of a data set.

    Attributes:
        attack: a name of ``ATTACKS`` or ``ADAPTIVE``, or ``paper`` for the paper's mixture.
        budget: most returns; None is the attack's own.
        mode: ``free_form`` or ``beam_constrained``; None is the attack's own.
        half_extent_m: half the side of the victim's grid.
        victim: name of the estimator that an attacker who adapts asks.
        estimator: that estimator.

    Raises:
        ValueError: there is no such attack, or it has no such budget or mode.
    """

    attack: str
    budget: int | None = None
    mode: str | None = None
    half_extent_m: float = 64.0
    victim: str | None = None
    estimator: FovEstimator | None = None

    def __post_init__(self) -> None:
        if self.attack != PAPER and self.attack not in _FACTORIES:
            raise ValueError(f"attack must be one of {', '.join((*_FACTORIES, PAPER))}, got {self.attack!r}")
        self._made((Sweep(np.zeros((0, 3), np.float32)),))

    def apply(self, sweep: Sweep, history: History, rng: np.random.Generator) -> tuple[Sweep, Touched | None]:
        """Return the attacked sweep and what was touched. Before anything was seen, nothing can be replayed."""
        earlier = history() if self.attack in _LASTING else ()
        if not earlier and self.attack in EARLIER:
            none = np.zeros(len(sweep), np.bool_)
            return sweep, Touched(none, none)
        done = self._made(earlier or (sweep,)).apply(sweep, rng)
        wedge = None if done.wedge is None else (done.wedge.azimuth, done.wedge.width)
        return done.sweep, Touched(done.added, done.removed, wedge)

    @property
    def command(self) -> str:
        """What makes such a data set."""
        return "attack"

    @property
    def name(self) -> str:
        """Name of the attack."""
        return self.attack

    def config(self) -> dict[str, Any]:
        """Return all its parameters, as plain values."""
        return {field.name: getattr(self, field.name) for field in fields(self) if field.name != "estimator"}

    def _made(self, earlier: tuple[Sweep, ...]) -> Attack:
        if self.attack == PAPER:
            if self.budget is not None or self.mode is not None:
                raise ValueError("attack paper draws its own points; leave budget and mode out")
            return PAPER_INDOOR_ATTACK if self.half_extent_m <= _ROOM_M else PAPER_ATTACK
        attack: Any = _FACTORIES[self.attack](self.budget, Knowledge(earlier, self.estimator, self.half_extent_m))
        if self.mode is None:
            return attack  # type: ignore[no-any-return]
        if "mode" not in {field.name for field in fields(attack)}:
            raise ValueError(f"attack {self.attack} must be left in its own mode, got {self.mode!r}; leave mode out")
        return replace(attack, mode=self.mode)  # type: ignore[no-any-return]


@dataclass(frozen=True, slots=True)
class CorruptionPlan:
    """A corruption of every sweep of a data set.

    Attributes:
        corruption: a name of ``CORRUPTIONS``.
        severity: 1 to 5.

    Raises:
        ValueError: there is no such corruption or severity.
    """

    corruption: str
    severity: int = 3

    def __post_init__(self) -> None:
        if self.corruption not in CORRUPTIONS:
            raise ValueError(f"corruption must be one of {', '.join(CORRUPTIONS)}, got {self.corruption!r}")
        CORRUPTIONS[self.corruption](self.severity)

    def apply(self, sweep: Sweep, history: History, rng: np.random.Generator) -> tuple[Sweep, Touched | None]:
        """Return the spoilt sweep; nobody says which returns moved."""
        return CORRUPTIONS[self.corruption](self.severity).apply(sweep, rng), None

    @property
    def command(self) -> str:
        """What makes such a data set."""
        return "corrupt"

    @property
    def name(self) -> str:
        """Name of the corruption."""
        return self.corruption

    def config(self) -> dict[str, Any]:
        """Return all its parameters, as plain values."""
        return asdict(self)
