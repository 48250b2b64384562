"""Attackers who adapt to what the victim runs, by asking it (family 16) or by its gradient (family 15).

What an attacker who adapts wants, as a number for each sweep that the victim might read.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Protocol

import numpy as np
from numpy.typing import NDArray

from viewshed.arrays import F64
from viewshed.fov.estimate import THRESHOLD, FovEstimator
from viewshed.grid import BevGrid
from viewshed.sweep import Sweep
from viewshed_lab.threats.attacks._search import BeamSearchSpace, PointSearchSpace, evolution
from viewshed_lab.threats.attacks.assembly import untouched
from viewshed_lab.threats.attacks.base import NOTHING, Attack, AttackFactory, Knowledge, Tampered, Wedge
from viewshed_lab.threats.attacks.ghosts import FarWall
from viewshed_lab.threats.attacks.placement import Placement
from viewshed_lab.threats.attacks.points import Mode, check_free_budget
from viewshed_lab.threats.attacks.spoofer import MEASURED_SPOOFER, Spoofer, scene_of
from viewshed_lab.threats.parameters import Azimuth, Between, Budget, Checked, Range, Sector

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
    """

    estimator: FovEstimator  # what the victim runs
    threshold: float = THRESHOLD  # probability from which a cell is claimed

    def on(self, clean: Sweep, wedge: Wedge) -> Value:
        """Return the objective; the victim is queried once."""
        return _changed_area(self, clean, wedge, claimed=True)


@dataclass(frozen=True, slots=True, eq=False)
class UnderClaim(OverClaim):
    """Area in the wedge, in m², that the victim claimed before and no longer claims under attack.

    Its attributes are those of :class:`OverClaim`.
    """

    def on(self, clean: Sweep, wedge: Wedge) -> Value:
        """Return the objective; the victim is queried once."""
        return _changed_area(self, clean, wedge, claimed=False)


def _changed_area(aim: OverClaim, clean: Sweep, wedge: Wedge, claimed: bool) -> Value:
    """Return the area in m² of the wedge's cells that become ``claimed`` and were not, for any sweep."""
    grid = aim.estimator.grid

    def claims(sweep: Sweep) -> NDArray[np.bool_]:
        return np.asarray(aim.estimator.estimate(sweep).visible(aim.threshold) == claimed)

    others = ~claims(clean) & cells_in(grid, clean, wedge)
    return lambda sweep: float((others & claims(sweep)).sum()) * grid.cell_area_m2


@dataclass(frozen=True, slots=True, eq=False)
class Evade(Checked):
    """Another objective, worth nothing like as much where a monitor's score is above a limit."""

    aim: Objective  # what the attacker wants
    score: Value  # from a sweep to the doubt of a monitor, or 1 for an alarm and 0 for none
    limit: float = 0.0  # the highest score that goes unnoticed
    # what one unit of score above the limit costs, in units of the aim
    penalty: Annotated[float, Between(0.0, 1e12)] = 1e6

    def on(self, clean: Sweep, wedge: Wedge) -> Value:
        """Return the aim less the penalty."""
        aim = self.aim.on(clean, wedge)
        return lambda sweep: aim(sweep) - self.penalty * max(0.0, float(self.score(sweep)) - self.limit)


def cells_in(grid: BevGrid, sweep: Sweep, wedge: Wedge) -> NDArray[np.bool_]:
    """Return which cells (cells, cells) have their center in the wedge, seen from the sensor of ``sweep``."""
    rotation = scene_of(sweep).level_from_sensor.rotation
    x, y = np.moveaxis(grid.centers @ rotation[:2, :2], -1, 0)
    return wedge.holds(np.arctan2(y, x))


@dataclass(frozen=True, slots=True, eq=False)
class SearchResult:
    """What an attacker found."""

    tampered: Tampered  # the attacked sweep, with noise that the attacker could not know, and what was done to it
    value: float  # what the plan was worth to the attacker while planning
    history: NDArray[np.float64]  # (P,) what each plan that was tried was worth, the first is doing nothing
    queries: int  # how often the victim was queried


@dataclass(frozen=True, slots=True, eq=False)
class BlackBox(Checked):
    """Searches for the plan that is worth most, by asking the victim what it makes of attacked sweeps.

    Plans are tried with range noise and lost beams as the spoofer has them, drawn once; the attack itself meets other
    noise. A plan that is worth no more than doing nothing is not carried out.
    """

    objective: Objective  # what the attacker wants
    budget: Budget = 150  # most returns; None for every beam of the wedge
    queries: Annotated[int, Between(1, 10_000_000)] = 200  # most questions to the victim
    sector_deg: Sector = 30.0  # width of the wedge
    # middle of the wedge in the sensor's frame; None aims at an obstacle as a far wall is aimed
    azimuth: Azimuth = None
    aim_m: Range = 25.0  # obstacles nearer than this are aimed at
    placement: Placement = "random"  # how that is aimed, see :class:`WedgeAttack`
    mode: Mode = "beam_constrained"  # ``beam_constrained`` or ``free_form``
    spoofer: Spoofer = MEASURED_SPOOFER  # how well the beams are won

    def __post_init__(self) -> None:
        Checked.__post_init__(self)
        check_free_budget(self.mode, self.budget)

    def apply(self, sweep: Sweep, rng: np.random.Generator) -> Tampered:
        """Return the attacked sweep and what was done to it."""
        return self.search(sweep, rng).tampered

    def search(self, sweep: Sweep, rng: np.random.Generator) -> SearchResult:
        """Return the attacked sweep with what it is worth and what it cost to find."""
        aimed = FarWall(self.budget, self.sector_deg, self.azimuth, self.placement, near_m=self.aim_m)
        wedge = aimed.aim(sweep, rng)
        value_of = self.objective.on(sweep, wedge)
        nothing, seed = value_of(sweep), int(rng.integers(2**62))
        space = self._space(sweep, wedge)

        def worth(candidate: F64) -> float:
            """Return what a plan is worth under noise that is the same for every plan."""
            noise = np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, 0])))
            return float(value_of(space.tampered(candidate, noise).sweep))

        best = evolution(space, worth, max(0, self.queries - 2), rng)
        history = np.append(nothing, best.history)
        queries = 2 + len(best.history)
        if best.candidate is None or best.value <= nothing:
            return SearchResult(untouched(sweep, wedge), nothing, history, queries)
        return SearchResult(space.tampered(best.candidate, rng), best.value, history, queries)

    def _space(self, sweep: Sweep, wedge: Wedge) -> BeamSearchSpace | PointSearchSpace:
        if self.mode == "free_form":
            return PointSearchSpace(sweep, wedge, self.budget or 0)
        return BeamSearchSpace.of(sweep, wedge, self.budget, self.spoofer)


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
