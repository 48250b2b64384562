"""Shadow map: the definition of visible, evaluated on the beams that a sweep measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from viewshed.estimators.classical import NEVER_ABSTAIN, ClassicalEstimator, checked_abstention
from viewshed.fov.visibility import CAR, Beams, Target, expected_returns, probability_of_visible
from viewshed.grid import BevGrid
from viewshed.preprocess.evidence import beam_evidence, calibrated_prob
from viewshed.preprocess.history import History
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.preprocess.no_return import no_return_beams

NoReturn = Literal["inferred", "unknown", "max_range", "fill"]

NO_RETURN_RULES: tuple[NoReturn, ...] = ("inferred", "unknown", "max_range", "fill")
"""The default first."""


@dataclass(frozen=True, slots=True)
class ShadowMap(ClassicalEstimator):
    """Range-image depth test per cell and target (shadow mapping, Williams 1978, with the sensor as the lamp).

    Counts the beams that would have met a target in the cell and whose depth reaches it: visible where at least
    ``min_returns`` returns are likelier than fewer, their number being Poisson with that mean. With ``inferred`` the
    probability is calibrated: how often a cell of which the beams say so much was visible, by exact truth
    (:func:`viewshed.preprocess.evidence.calibrated_prob`). By the other rules it is that of the count.

    ``no_return`` says what a beam without a return means: ``inferred`` (a small network guesses from its surroundings
    how far it went, see :mod:`viewshed.preprocess.no_return`), ``unknown`` (it does not count),
    ``max_range`` (nothing stands there; right in an open simulator, wrong before glass and absorbers), ``fill`` (it
    went as far as the nearer of its neighbors in the ring).

    Limits: trusts each measured depth, with ``inferred`` each that another beam confirms
    (:mod:`viewshed.preprocess.range_image`), so that removed or many far-spoofed returns open false corridors;
    needs the local ground within about 0.3 m. More obstacles never add visibility where no beam is inferred;
    with ``inferred`` the guess rests on the whole sweep, and obstacles elsewhere change it.
    """

    grid: BevGrid
    target: Target = CAR
    no_return: NoReturn = "inferred"
    name: str = "shadow_map"
    abstain_below: float = NEVER_ABSTAIN  # cells of which it is less sure than this are UNKNOWN; .5 never abstains

    def __post_init__(self) -> None:
        checked_abstention(self.abstain_below)
        if self.no_return not in NO_RETURN_RULES:
            raise ValueError(f"no_return must be one of {', '.join(NO_RETURN_RULES)}, got {self.no_return!r}")

    @property
    def uses_history(self) -> bool:
        """Beams end at the obstacles that earlier sweeps saw (:mod:`viewshed.preprocess.history`)."""
        return True

    def visible_prob(self, leveled: LeveledSweep, history: History | None) -> NDArray[np.float32]:
        """Return the probability that the beams that would have met a target in each cell are enough to show it."""
        evidence = beam_evidence(leveled, self.grid, self.target, history)
        if self.no_return == "inferred":
            return calibrated_prob(leveled, evidence)
        beams = _beams(leveled, self.no_return)
        beams = beams if history is None else history.within(beams)
        returns, _ = expected_returns(beams, leveled.sensor_height_m, leveled.ground, self.grid, self.target)
        return probability_of_visible(returns, self.target.min_returns)


def _beams(leveled: LeveledSweep, rule: NoReturn) -> Beams:
    """Return the beams by another rule than ``inferred``."""
    beams = _without_behind(leveled)
    if rule == "unknown" or len(leveled.sweep) == 0:
        return beams
    return beams + no_return_beams(leveled, fill=rule == "fill")


def _without_behind(leveled: LeveledSweep) -> Beams:
    """Return the beams of all returns but isolated ones behind another of their pixel: that beam had ended before."""
    return leveled.beams(None if leveled.range_image is None else leveled.range_image.behind)
