"""Certificates: the part of a claim that no attack of a given strength can have opened."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from viewshed.arrays import Mask
from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.grid import BevGrid
from viewshed.guarantees.envelope import Envelope, Given, Threat
from viewshed.preprocess.leveling import LeveledSweep

ADDED = Threat()


@dataclass(frozen=True, slots=True, eq=False)
class Certificate:
    """Certificate of one sweep's claim under a threat.

    Attributes:
        grid: of the cells.
        threat: the assumed attack.
        claim: (cells, cells) the estimate's claim inside the envelope.
        over_claim_m2: upper bound of the area of ``claim`` that an attack within the threat can have opened: cells that
            the envelope of the sweep without the attack does not claim.
        certified_visible: (cells, cells) cells of ``claim`` that no such attack can have opened. Empty if anything was
            inferred from the sweep itself, unless the caller trusts that.
        assumptions: that must hold, one line each.
        inferred: names of the inputs that were inferred from the sweep itself.
    """

    grid: BevGrid
    threat: Threat
    claim: Mask
    over_claim_m2: float
    certified_visible: Mask
    assumptions: tuple[str, ...]
    inferred: tuple[str, ...]

    @property
    def certified_m2(self) -> float:
        """Area of the certified cells."""
        return float(self.certified_visible.sum()) * self.grid.cell_area_m2

    @property
    def line(self) -> str:
        """One line that states what is certified."""
        against = f"against {self.threat.words}"
        if self.certified_visible.any():
            over = (
                f"; at most {self.over_claim_m2:.0f} m² of the claim can be caused by it" if self.over_claim_m2 else ""
            )
            return f"{self.certified_m2:.0f} m² certified {against}{over}"
        if self.inferred:
            named = ", ".join(self.inferred)
            return (
                f"nothing certified: {named} inferred from the sweep itself, which an attacker may control; give"
                " the known values with the sweep"
            )
        return f"nothing certified {against}: no claimed cell has enough beams to spare"

    def withdraw(self, estimate: FovEstimate) -> FovEstimate:
        """Return the estimate with all other claimed cells set to UNKNOWN."""
        return without(estimate, estimate.visible() & ~self.certified_visible)


def without(estimate: FovEstimate, lost: Mask) -> FovEstimate:
    """Return an estimate whose ``lost`` cells are UNKNOWN and not claimed."""
    below = np.nextafter(np.float32(estimate.threshold), np.float32(0.0))
    return replace(
        estimate,
        state=np.where(lost, np.uint8(CellState.UNKNOWN), estimate.state),
        visible_prob=np.where(lost, np.minimum(estimate.visible_prob, below), estimate.visible_prob),
    )


def certify(
    leveled: LeveledSweep,
    estimate: FovEstimate,
    threat: Threat = ADDED,
    given: Given | None = None,
    *,
    trust_inferred: bool = False,
) -> Certificate:
    """Return the certificate of an estimate.

    Args:
        leveled: the sweep that was estimated.
        estimate: by any estimator.
        threat: the assumed attack.
        given: inputs that the envelope takes for granted; None takes them from the sweep (:meth:`Given.of`).
        trust_inferred: certify even if sensor, attitude or height were inferred from the sweep itself.

    Raises:
        ValueError: no beam table is known, the sensor fires no rings, or it is tilted by more than 15°.
    """
    given = Given.of(leveled) if given is None else given
    envelope = Envelope.of(leveled, given, estimate.grid, estimate.target)
    claim = estimate.visible() & envelope.claim
    over_m2, changes = envelope.changeable(threat, claim, opens=False)
    certified = claim & ~changes
    if given.inferred and not trust_inferred:
        certified = np.zeros_like(certified)
    return Certificate(
        estimate.grid, threat, claim, over_m2, certified, _assumptions(given, threat), given.inferred
    )  # fmt: skip


def _assumptions(given: Given, threat: Threat) -> tuple[str, ...]:
    """Return the assumptions of a certificate, one line each."""
    ground = "the plane on which the sensor stands upright" if given.ground is None else "the given height map"
    tilt = "level" if given.tilt < 1e-6 else f"tilted by {np.rad2deg(given.tilt):.1f}°"
    return (
        f"the beams go where the table of {given.model.name} says, {given.model.azimuth_columns} columns a turn",
        f"the sensor is {tilt} and {given.height_m:.2f} m above the ground",
        f"the ground deviates by a slope of at most {given.grade:g} from {ground}",
        "objects that a beam meets before the target reflect it (no glass, no absorber)",
        f"the attacker has no more than {threat.words}",
        *(f"the {what}, inferred from this sweep, is correct" for what in given.inferred),
    )
