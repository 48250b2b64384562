"""Attackers who adapt to what the victim runs, by asking it (family 16) or by its gradient (family 15).

What an attacker who adapts wants, as a number for each sweep that the victim might read.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.estimate import THRESHOLD, FovEstimator
from viewshed.grid import BevGrid
from viewshed.sweep import Sweep
from viewshed.threats.attacks import NOTHING, AttackFactory, Knowledge
from viewshed.threats.attacks._search import BeamSearchSpace, Candidate, PointSearchSpace, evolution, random_search
from viewshed.threats.attacks.assembly import untouched
from viewshed.threats.attacks.base import Attack, Tampered, Wedge
from viewshed.threats.attacks.ghosts import aim_wedge
from viewshed.threats.attacks.points import MODES, MOST_FREE, Mode
from viewshed.threats.attacks.spoofer import MEASURED_SPOOFER, Spoofer, scene_of
from viewshed.threats.parameters import require, require_one_of, require_sector

Value = Callable[[Sweep], float]
"""From an attacked sweep to what it is worth to the attacker."""


class Objective(Protocol):
    """Anything that an attacker wants more of."""

    def on(self, clean: Sweep, wedge: Wedge) -> Value:
        """Return what sweeps made from ``clean`` are worth, where the attacker reaches ``wedge``."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class OverClaim:
    """Area in the wedge, in m², that the victim claims under attack and did not claim before.

    The attacker has no truth: the victim's own clean estimate stands for it.

    Attributes:
        estimator: what the victim runs.
        threshold: probability from which a cell is claimed.
    """

    estimator: FovEstimator
    threshold: float = THRESHOLD

    def on(self, clean: Sweep, wedge: Wedge) -> Value:
        """Return the objective; the victim is asked once."""
        hidden = ~self.estimator.estimate(clean).visible(self.threshold) & cells_in(self.estimator.grid, clean, wedge)
        return _Area(self.estimator, hidden, True, self.threshold)


@dataclass(frozen=True, slots=True, eq=False)
class UnderClaim:
    """Area in the wedge, in m², that the victim claimed before and no longer claims under attack.

    Attributes:
        estimator: what the victim runs.
        threshold: probability from which a cell is claimed.
    """

    estimator: FovEstimator
    threshold: float = THRESHOLD

    def on(self, clean: Sweep, wedge: Wedge) -> Value:
        """Return the objective; the victim is asked once."""
        seen = self.estimator.estimate(clean).visible(self.threshold) & cells_in(self.estimator.grid, clean, wedge)
        return _Area(self.estimator, seen, False, self.threshold)


@dataclass(frozen=True, slots=True, eq=False)
class Trip:
    """A monitor's or a defense's score: the attacker wants a false alarm.

    Attributes:
        score: from a sweep to the doubt of a monitor, or 1 for an alarm and 0 for none.
    """

    score: Value

    def on(self, clean: Sweep, wedge: Wedge) -> Value:
        """Return the score itself."""
        return self.score


@dataclass(frozen=True, slots=True, eq=False)
class Evade:
    """Another objective, worth nothing like as much where a monitor's score is above a limit.

    Attributes:
        aim: what the attacker wants.
        score: from a sweep to the doubt of a monitor, or 1 for an alarm and 0 for none.
        limit: the highest score that goes unnoticed.
        penalty: what one unit of score above the limit costs, in units of the aim.
    """

    aim: Objective
    score: Value
    limit: float = 0.0
    penalty: float = 1e6

    def __post_init__(self) -> None:
        require("penalty", self.penalty, 0.0, 1e12)

    def on(self, clean: Sweep, wedge: Wedge) -> Value:
        """Return the aim less the penalty."""
        aim = self.aim.on(clean, wedge)
        return lambda sweep: aim(sweep) - self.penalty * max(0.0, float(self.score(sweep)) - self.limit)


@dataclass(frozen=True, slots=True, eq=False)
class _Area:
    """Area of some cells, in m², that the victim claims (or does not)."""

    estimator: FovEstimator
    cells: NDArray[np.bool_]
    claimed: bool
    threshold: float

    def __call__(self, sweep: Sweep) -> float:
        claimed = self.estimator.estimate(sweep).visible(self.threshold)
        return float((self.cells & (claimed == self.claimed)).sum()) * self.estimator.grid.cell_area_m2


def cells_in(grid: BevGrid, sweep: Sweep, wedge: Wedge) -> NDArray[np.bool_]:
    """Return which cells (cells, cells) have their center in the wedge, seen from the sensor of ``sweep``."""
    rotation = scene_of(sweep).level_from_sensor.rotation
    x, y = np.moveaxis(grid.centers @ rotation[:2, :2], -1, 0)
    return wedge.holds(np.arctan2(y, x))


Method = Literal["evolution", "random"]

METHODS: tuple[Method, ...] = ("evolution", "random")


@dataclass(frozen=True, slots=True, eq=False)
class SearchResult:
    """What an attacker found.

    Attributes:
        tampered: the attacked sweep, with noise that the attacker could not know, and what was done to it.
        value: what the plan was worth to the attacker while planning.
        history: (P,) what each plan that was tried was worth, the first is doing nothing.
        queries: how often the victim was asked.
    """

    tampered: Tampered
    value: float
    history: NDArray[np.float64]
    queries: int


@dataclass(frozen=True, slots=True, eq=False)
class BlackBox:
    """Searches for the plan that is worth most, by asking the victim what it makes of attacked sweeps.

    Plans are tried with range noise and lost beams as the spoofer has them, drawn once; the attack itself meets other
    noise. A plan that is worth no more than doing nothing is not carried out.

    Attributes:
        objective: what the attacker wants.
        budget: most returns; None for every beam of the wedge.
        queries: most questions to the victim.
        sector_deg: width of the wedge.
        azimuth: middle of the wedge in the sensor's frame; None aims at an obstacle.
        aim_m: obstacles nearer than this are aimed at.
        mode: ``beam_constrained`` or ``free_form``.
        method: ``evolution`` or ``random``.
        samples: draws of the noise over which a plan's worth is averaged; each is a question.
        spoofer: how well the beams are won.
    """

    objective: Objective
    budget: int | None = 150
    queries: int = 200
    sector_deg: float = 30.0
    azimuth: float | None = None
    aim_m: float = 25.0
    mode: Mode = "beam_constrained"
    method: Method = "evolution"
    samples: int = 1
    spoofer: Spoofer = MEASURED_SPOOFER

    def __post_init__(self) -> None:
        require_sector(self.budget, self.azimuth, self.sector_deg)
        require("queries", self.queries, 1, 10_000_000)
        require("aim_m", self.aim_m, 0.5, 1000.0)
        require("samples", self.samples, 1, 1000)
        require_one_of("mode", self.mode, MODES)
        require_one_of("method", self.method, METHODS)
        if self.mode == "free_form" and (self.budget is None or self.budget > MOST_FREE):
            raise ValueError(f"budget must lie in [0, {MOST_FREE}] for free points, got {self.budget}")

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        return self.search(sweep, rng).tampered

    def search(self, sweep: Sweep, rng: np.random.Generator) -> SearchResult:
        """Return the attacked sweep with what it is worth and what it cost to find."""
        wedge = aim_wedge(sweep, self.azimuth, self.sector_deg, self.aim_m, rng)
        value_of = self.objective.on(sweep, wedge)
        nothing, seed = value_of(sweep), int(rng.integers(2**62))
        space = self._space(sweep, wedge)
        limit = max(0, (self.queries - 2) // self.samples)
        search = evolution if self.method == "evolution" else random_search
        best = search(space, lambda candidate: self._expected_value(space, candidate, value_of, seed), limit, rng)
        history = np.append(nothing, best.history)
        queries = 2 + len(best.history) * self.samples
        if best.candidate is None or best.value <= nothing:
            return SearchResult(untouched(sweep, wedge), nothing, history, queries)
        return SearchResult(space.tampered(best.candidate, rng), best.value, history, queries)

    def _space(self, sweep: Sweep, wedge: Wedge) -> BeamSearchSpace | PointSearchSpace:
        if self.mode == "free_form":
            return PointSearchSpace(sweep, wedge, self.budget or 0)
        return BeamSearchSpace.of(sweep, wedge, self.budget, self.spoofer)

    def _expected_value(
        self, space: BeamSearchSpace | PointSearchSpace, candidate: Candidate, value_of: Value, seed: int
    ) -> float:
        """Return what a plan is worth over draws of the noise that are the same for every plan."""
        values = []
        for sample in range(self.samples):
            rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, sample])))
            values.append(value_of(space.tampered(candidate, rng).sweep))
        return float(np.mean(values))


def _black_box(
    aim: Callable[[FovEstimator], Objective], mode: Mode, budget: int | None = None, knowledge: Knowledge = NOTHING
) -> Attack:
    if knowledge.estimator is None:
        raise ValueError("an attacker who adapts needs a victim, got none; give Knowledge(estimator=…)")
    return BlackBox(
        aim(knowledge.estimator), 150 if budget is None else budget, aim_m=25.0 * knowledge.scale, mode=mode
    )


ADAPTIVE: dict[str, AttackFactory] = {
    "adaptive_over_claim": partial(_black_box, OverClaim, "beam_constrained"),
    "adaptive_under_claim": partial(_black_box, UnderClaim, "beam_constrained"),
    "adaptive_over_claim_free": partial(_black_box, OverClaim, "free_form"),
    "adaptive_under_claim_free": partial(_black_box, UnderClaim, "free_form"),
}
"""Attackers of family 16 by name, as ``ATTACKS``; they need ``Knowledge(estimator=…)`` and ask it 200 times a sweep."""
