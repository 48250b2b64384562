"""Shadow map: the definition of visible, evaluated on the measured beams of a sweep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from viewshed.estimators.classical import NEVER_ABSTAIN, ClassicalEstimator, checked_abstention
from viewshed.fov.visibility import CAR, Beams, Target, expected_returns, probability_of_visible
from viewshed.grid import BevGrid
from viewshed.preprocess.evidence import beam_evidence
from viewshed.preprocess.history import History
from viewshed.preprocess.leveling import LeveledSweep
from viewshed.preprocess.no_return import no_return_beams

NoReturn = Literal["inferred", "unknown", "max_range", "fill"]

NO_RETURN_RULES: tuple[NoReturn, ...] = ("inferred", "unknown", "max_range", "fill")
"""All rules, the default first."""


@dataclass(frozen=True, slots=True)
class ShadowMap(ClassicalEstimator):
    """Range-image depth test per cell and target (shadow mapping, Williams 1978, with the sensor as light source).

    Counts the beams that would hit a target in the cell and whose depth reaches it. The number of returns is Poisson
    with this mean, and the probability of visible is P(N ≥ ``min_returns``). With ``inferred`` it is corrected: the
    share of visible cells among cells with such counts, by exact truth
    (``visible_prob`` of :class:`viewshed.preprocess.evidence.BeamEvidence`).

    ``no_return`` is the rule for no-return beams: ``inferred`` (a small network infers their depth from the surrounding
    beams, see :mod:`viewshed.preprocess.no_return`), ``unknown`` (they do not count), ``max_range`` (free up to the
    maximum range; right in an open simulator, wrong before glass and absorbers), ``fill`` (depth of the nearer of the
    two neighbors in the ring).

    Limits: trusts each measured depth (with ``inferred``: each depth that another beam confirms, see
    :mod:`viewshed.preprocess.range_image`), so removed returns or many far-spoofed ones open false corridors; needs the
    local ground within about 0.3 m. More obstacles never add visibility, except with ``inferred``: the network uses the
    whole sweep, so obstacles elsewhere change its result.
    """

    grid: BevGrid
    target: Target = CAR
    no_return: NoReturn = "inferred"
    name: str = "shadow_map"
    abstain_below: float = NEVER_ABSTAIN  # cells with max(p, 1 - p) below this are UNKNOWN; .5 never abstains

    def __post_init__(self) -> None:
        checked_abstention(self.abstain_below)
        if self.no_return not in NO_RETURN_RULES:
            raise ValueError(f"no_return must be one of {', '.join(NO_RETURN_RULES)}, got {self.no_return!r}")

    @property
    def uses_history(self) -> bool:
        """True: beams end at the obstacles of earlier sweeps (:mod:`viewshed.preprocess.history`)."""
        return True

    def visible_prob(self, leveled: LeveledSweep, history: History | None) -> NDArray[np.float32]:
        """Return the probability (cells, cells) that a target in each cell gives at least ``min_returns`` returns."""
        evidence = beam_evidence(leveled, self.grid, self.target, history)
        if self.no_return == "inferred":
            return evidence.visible_prob
        beams = _beams(leveled, self.no_return)
        beams = beams if history is None else history.within(beams)
        returns, _ = expected_returns(beams, leveled.sensor_height_m, leveled.ground, self.grid, self.target)
        return probability_of_visible(returns, self.target.min_returns)


def _beams(leveled: LeveledSweep, rule: NoReturn) -> Beams:
    """Return the beams by a rule other than ``inferred``."""
    # Drop isolated returns behind another return of their pixel: the beam ended at the nearer one.
    beams = leveled.beams(None if leveled.range_image is None else leveled.range_image.behind)
    if rule == "unknown" or len(leveled.sweep) == 0:
        return beams
    return beams + no_return_beams(leveled, fill=rule == "fill")
