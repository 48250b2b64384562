"""Reactions to a monitor's findings: which claims to withdraw, whether to query other agents, how fast to drive.

:func:`react` is a pure function from finding and state to the next state. Its caution determines which claims
:func:`withdraw` removes; :func:`speed_for_view` gives the speed for the rest. Caution rises at once and falls by one
step after ``recover_sweeps`` calm sweeps in a row.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import IntEnum
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from viewshed.fov.estimate import CellState, FovEstimate
from viewshed.grid import BevGrid
from viewshed.guarantees.certificate import without
from viewshed.monitor.evidence.base import SECTORS
from viewshed.monitor.report import cells_of_sectors


class Caution(IntEnum):
    """How far the view is trusted; each step claims no more than the step below it."""

    KEEP = 0
    """Every claim holds."""
    ASK = 1
    """The view is worse than usual: every claim holds; other agents are queried."""
    WIDEN = 2
    """The stream is inconsistent in known sectors: these and their neighbors are UNKNOWN. After an alarm without known
    sectors, cells that no earlier sweep confirms stay UNKNOWN too."""
    CONFIRMED = 3
    """It is inconsistent in more than half of all sectors, or in unknown ones: cells that no earlier sweep confirms are
    UNKNOWN too."""
    STALE = 4
    """The newest sweep or pose is too old: nothing is claimed, and the vehicle stops."""


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """Findings on one sweep, the input of :func:`react`."""

    degraded: bool = False  # the view is worse than usual or missing, or an object in it is suspicious
    inconsistent: bool = False  # the sweep or its stream is inconsistent
    accused: bool = False  # a center of many agents accuses this one: only claims confirmed by earlier sweeps hold
    # (SECTORS,) bool, inconsistent sectors; none if they are not known
    suspect: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(SECTORS, np.bool_))
    stale: bool = False  # the view is too old to be claimed, whatever the other findings


@dataclass(frozen=True, slots=True)
class ReactionRules:
    """When caution changes.

    Raises:
        ValueError: a number is out of range.
    """

    recover_sweeps: int = 10  # consecutive calm sweeps after which caution falls by one step
    widen_sectors: int = 1  # number of sectors on either side of a suspect one that are not trusted either
    most_suspect: float = 0.5  # maximum share of suspect sectors at which the others are still trusted

    def __post_init__(self) -> None:
        if self.recover_sweeps < 1 or self.widen_sectors < 0 or not 0.0 <= self.most_suspect <= 1.0:
            raise ValueError(
                f"recover_sweeps must be 1 or more, widen_sectors 0 or more, most_suspect in [0, 1], got {self}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class ReactionState:
    """State of the reactions between sweeps."""

    caution: Caution = Caution.KEEP  # current caution
    calm: int = 0  # consecutive sweeps that require less caution
    # (SECTORS,) bool, sectors of all alarms since caution was last below WIDEN
    suspect: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(SECTORS, np.bool_))
    unplaced: bool = False  # whether one of these alarms had no known sectors
    of_sweeps: Caution = Caution.KEEP  # caution by the findings alone, kept while ``caution`` is STALE


RULES = ReactionRules()


def react(finding: Finding, state: ReactionState, rules: ReactionRules = RULES) -> ReactionState:
    """Return the next state after the finding on a sweep.

    A stale view also counts as degraded: after it, caution returns to what it was before, but at least ASK.
    """
    before = state.of_sweeps if state.caution == Caution.STALE else state.caution
    suspect, unplaced = (
        (state.suspect, state.unplaced) if before >= Caution.WIDEN else (np.zeros(SECTORS, np.bool_), False)
    )
    if finding.inconsistent:
        suspect = suspect | finding.suspect
        is_placed = finding.suspect.any() and not finding.accused
        unplaced = unplaced or not is_placed
        is_narrow = suspect.mean() <= rules.most_suspect
        required = Caution.WIDEN if is_placed and is_narrow else Caution.CONFIRMED
    else:
        required = Caution.ASK if finding.degraded or finding.stale else Caution.KEEP
    # Caution rises at once and falls by one step after enough calm sweeps in a row; a stale one is not calm.
    caution, calm = required, 0
    if required < before:
        calm = 0 if finding.stale else state.calm + 1
        caution, calm = (Caution(before - 1), 0) if calm >= rules.recover_sweeps else (before, calm)
    return ReactionState(Caution.STALE if finding.stale else caution, calm, suspect, bool(unplaced), caution)


def withdraw(
    estimate: FovEstimate,
    state: ReactionState,
    confirmed: NDArray[np.bool_] | None = None,
    rules: ReactionRules = RULES,
    certified: NDArray[np.bool_] | None = None,
    *,
    certified_only: bool = False,
) -> FovEstimate:
    """Return an estimate whose withdrawn cells are UNKNOWN, whatever their state was.

    Args:
        estimate: of the sweep.
        state: after the sweep.
        confirmed: (cells, cells) bool, claims confirmed by earlier sweeps; None means none.
        rules: number of neighboring sectors that are not trusted.
        certified: (cells, cells) bool, claims that no attack of the certificate's threat can have opened
            (:mod:`viewshed.guarantees.certificate`): they stay until the view is stale. None means none.
        certified_only: withdraw all other claims, even without an alarm.
    """
    if certified_only:
        estimate = without(estimate, estimate.visible() if certified is None else estimate.visible() & ~certified)
    if state.caution < Caution.WIDEN:
        return estimate
    suspect = state.suspect
    untrusted = suspect.copy()
    for step in range(1, rules.widen_sectors + 1):
        untrusted |= np.roll(suspect, step) | np.roll(suspect, -step)
    lost = cells_of_sectors(untrusted, estimate.grid)
    if state.caution == Caution.STALE:
        lost[:] = True
    elif state.caution == Caution.CONFIRMED or state.unplaced:
        lost |= True if confirmed is None else ~confirmed
    if certified is not None and state.caution != Caution.STALE:
        lost &= ~certified
    return without(estimate, lost)


@dataclass(frozen=True, slots=True)
class Vehicle:
    """Braking model of a vehicle; the defaults are a car's.

    Raises:
        ValueError: a number is out of range.
    """

    front_m: float = 4.0  # distance from the sensor to the front of the vehicle; nearer cells need not be seen
    half_width_m: float = 1.25  # half width of the lane that must be free
    delay_s: float = 0.5  # reaction time before the brakes act
    braking_mps2: float = 3.0  # deceleration

    def __post_init__(self) -> None:
        finite = all(
            math.isfinite(value) for value in (self.front_m, self.half_width_m, self.delay_s, self.braking_mps2)
        )
        if not (finite and self.half_width_m > 0.0 and self.delay_s >= 0.0 and self.braking_mps2 > 0.0):
            raise ValueError(
                f"half_width_m and braking_mps2 must be positive, delay_s 0 or more, all of them finite, got {self}"
            )


VEHICLE = Vehicle()


def speed_for_view(estimate: FovEstimate, vehicle: Vehicle = VEHICLE, heading: float = 0.0) -> float:
    """Return the highest speed in m/s from which a vehicle can stop within the free cells ahead.

    Solves v · delay + v² / (2 · braking) = distance, the assured clear distance ahead: up to the first cell of the lane
    that is not FREE.

    Args:
        estimate: of the sensor on the vehicle.
        vehicle: its braking model.
        heading: of the vehicle, radians counter-clockwise from x of ``level``.
    """
    front_m, braking_mps2 = vehicle.front_m, vehicle.braking_mps2
    cells, near_side_m, end_m = _lane(estimate.grid, front_m, vehicle.half_width_m, heading)
    blocked_m = near_side_m[estimate.state.ravel()[cells] != CellState.FREE]
    clear_m = max(float(blocked_m.min(initial=end_m)) - front_m, 0.0)
    delay_mps = braking_mps2 * vehicle.delay_s
    return float(np.sqrt(delay_mps**2 + 2 * braking_mps2 * clear_m) - delay_mps)


@lru_cache(maxsize=16)
def _lane(
    grid: BevGrid, front_m: float, half_width_m: float, heading: float
) -> tuple[NDArray[np.intp], NDArray[np.float64], float]:
    """Return the cells (K,) that the lane ahead touches, how far ahead each begins (K,), and where the grid ends it.

    Cells outside the grid are not seen: a lane that begins outside ends at the vehicle's front.
    """
    ahead, left = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
    half_cell_m = grid.cell_m / 2 * float(np.abs(ahead).sum())
    centers = grid.centers.reshape(-1, 2)
    along_m, across_m = centers @ ahead, centers @ left
    cells = np.flatnonzero((along_m > front_m) & (np.abs(across_m) < half_width_m + half_cell_m))
    # Each side of the lane ends at the first border of the grid.
    low = np.array(grid.origin_m)
    high, ends_m = low + 2 * grid.half_extent_m, list[float]()
    for side_m in (-half_width_m, half_width_m):
        begin = front_m * ahead + side_m * left
        if ((begin < low) | (begin > high)).any():
            return cells[:0], along_m[:0], front_m
        with np.errstate(divide="ignore"):
            to_border_m = np.where(np.abs(ahead) > 1e-9, (np.where(ahead > 0, high, low) - begin) / ahead, np.inf)
        ends_m.append(front_m + float(to_border_m.min()))
    return cells, along_m[cells] - half_cell_m, min(ends_m)
