"""What follows from what a monitor finds: which claims still hold, whom to ask, how fast to drive.

A pure function from finding and state to the next state (:func:`react`), and what its caution does to an estimate
(:func:`withdraw`) and to the speed (:func:`speed_for_view`). Caution rises at once and falls by one step after some
calm sweeps in a row, so that between two rises to the same step there are always more sweeps than that.
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
    """How far the view is trusted; each step claims no more than the one before."""

    KEEP = 0
    """Every claim holds."""
    ASK = 1
    """The view is worse than usual: every claim holds; other agents are queried."""
    WIDEN = 2
    """Something is impossible, and it is known where: the suspect sectors, and those beside them, are UNKNOWN. After an
    alarm of unknown place, what no earlier sweep confirms stays UNKNOWN on this step as well."""
    CONFIRMED = 3
    """It is impossible in more than half of all sectors, or at an unknown place: what no earlier sweep confirms is
    UNKNOWN as well."""
    STALE = 4
    """The newest sweep or pose is too old: nothing is claimed, and the vehicle stops."""


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """What was found in one sweep, as far as reactions need it."""

    degraded: bool = False  # the view is worse than usual, there is none, or an object of it is suspicious
    inconsistent: bool = False  # something is impossible in this sweep, or in the stream
    accused: bool = False  # a center of many agents accuses this one: nothing of its view holds that it alone saw now
    # (SECTORS,) bool, where; nowhere where that is not known
    suspect: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(SECTORS, np.bool_))
    stale: bool = False  # the view is too old to be claimed, whatever else was found in it


@dataclass(frozen=True, slots=True)
class ReactionRules:
    """When caution changes.

    Raises:
        ValueError: a number is out of range.
    """

    recover_sweeps: int = 10  # calm sweeps in a row after which caution falls by one step
    widen_sectors: int = 1  # sectors on both sides of a suspect one that are not trusted either
    most_suspect: float = 0.5  # share of all sectors that may be suspect while the others are still trusted

    def __post_init__(self) -> None:
        if self.recover_sweeps < 1 or self.widen_sectors < 0 or not 0.0 <= self.most_suspect <= 1.0:
            raise ValueError(
                f"recover_sweeps must be 1 or more, widen_sectors 0 or more, most_suspect in [0, 1], got {self}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class ReactionState:
    """What is remembered from sweep to sweep."""

    caution: Caution = Caution.KEEP  # now
    calm: int = 0  # sweeps in a row that ask for less caution
    # (SECTORS,) bool, sectors of all alarms since caution was last below WIDEN
    suspect: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(SECTORS, np.bool_))
    unplaced: bool = False  # whether one of these alarms had no known place
    of_sweeps: Caution = Caution.KEEP  # caution that the sweeps ask for, whatever their age, where ``caution`` is STALE


RULES = ReactionRules()


def react(found: Finding, state: ReactionState, rules: ReactionRules = RULES) -> ReactionState:
    """Return the state after what was found in the next sweep.

    A stale view is degraded as well: with the next fresh one caution is what it was before, but ASK at least.
    """
    before = state.of_sweeps if state.caution == Caution.STALE else state.caution
    suspect, unplaced = (
        (state.suspect, state.unplaced) if before >= Caution.WIDEN else (np.zeros(SECTORS, np.bool_), False)
    )
    if found.inconsistent:
        suspect = suspect | found.suspect
        is_known_where = found.suspect.any() and not found.accused
        unplaced = unplaced or not is_known_where
        is_narrow = suspect.mean() <= rules.most_suspect
        wanted = Caution.WIDEN if is_known_where and is_narrow else Caution.CONFIRMED
    else:
        wanted = Caution.ASK if found.degraded or found.stale else Caution.KEEP
    # Caution rises at once, and falls by one step after enough calm sweeps in a row; a stale one is not calm.
    caution, calm = wanted, 0
    if wanted < before:
        calm = 0 if found.stale else state.calm + 1
        caution, calm = (Caution(before - 1), 0) if calm >= rules.recover_sweeps else (before, calm)
    return ReactionState(Caution.STALE if found.stale else caution, calm, suspect, bool(unplaced), caution)


def withdraw(
    estimate: FovEstimate,
    state: ReactionState,
    confirmed: NDArray[np.bool_] | None = None,
    rules: ReactionRules = RULES,
    certified: NDArray[np.bool_] | None = None,
    *,
    certified_only: bool = False,
) -> FovEstimate:
    """Return an estimate without what does not hold: these cells are UNKNOWN, whatever they were.

    Args:
        estimate: what was estimated.
        state: after the sweep.
        confirmed: (cells, cells) bool, what earlier sweeps saw as well; None where there are none: nothing is.
        rules: how many sectors beside a suspect one are not trusted.
        certified: (cells, cells) bool, the claims that no attack of the certificate's threat can have opened
            (:mod:`viewshed.guarantees.certificate`): they stay whatever is found, until the view is stale. None: none.
        certified_only: whether no other claim holds, be there an alarm or not.
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
    """How a vehicle stops; a car unless its own numbers are given.

    Raises:
        ValueError: a number is out of range.
    """

    front_m: float = 4.0  # from the sensor to the front of the vehicle; what lies nearer need not be seen
    half_width_m: float = 1.25  # half of the width of the lane that must be free
    delay_s: float = 0.5  # until the brakes act
    braking_mps2: float = 3.0  # how hard it brakes

    def __post_init__(self) -> None:
        finite = all(
            math.isfinite(value) for value in (self.front_m, self.half_width_m, self.delay_s, self.braking_mps2)
        )
        if not (finite and self.half_width_m > 0.0 and self.delay_s >= 0.0 and self.braking_mps2 > 0.0):
            raise ValueError(
                f"half_width_m and braking_mps2 must be positive, delay_s 0 or more, all of them finite, got {self}"
            )


VEHICLE = Vehicle()


def speed_for_view(estimate: FovEstimate, vehicle: Vehicle = VEHICLE) -> float:
    """Return the speed in m/s from which a vehicle stops within what it sees free ahead of it, along x of ``level``.

    The root of v · delay + v² / (2 · braking) = distance (the assured clear distance ahead), which ends at the first
    cell of the lane that is not FREE.

    Args:
        estimate: of the sensor on the vehicle.
        vehicle: how it stops.
    """
    front_m, braking_mps2 = vehicle.front_m, vehicle.braking_mps2
    lane, near_side_m = _lane(estimate.grid, front_m, vehicle.half_width_m)
    blocked = (estimate.state[lane] != CellState.FREE).any(axis=1)
    clear_m = max(float(near_side_m[np.append(blocked, True).argmax()]) - front_m, 0.0)
    lost_mps = braking_mps2 * vehicle.delay_s
    return float(np.sqrt(lost_mps**2 + 2 * braking_mps2 * clear_m) - lost_mps)


@lru_cache(maxsize=16)
def _lane(grid: BevGrid, front_m: float, half_width_m: float) -> tuple[tuple[slice, slice], NDArray[np.float64]]:
    """Return the cells that the lane ahead touches, and where each of their rows begins (rows + 1,) in meters.

    A cell blocks from its near side on; the last value is where the grid ends. What lies beside the grid is not seen: a
    lane that is not whole on it ends at the vehicle's front.
    """
    (x0_m, y0_m), side_m = grid.origin_m, 2 * grid.half_extent_m
    if x0_m > front_m or y0_m > -half_width_m or y0_m + side_m < half_width_m:
        return (slice(0), slice(0)), np.array([front_m])
    x_m, y_m = grid.centers[:, 0, 0], grid.centers[0, :, 1]
    rows, columns = x_m > front_m, np.abs(y_m) < half_width_m + grid.cell_m / 2
    begin_x, begin_y = int(rows.argmax()) if rows.any() else len(rows), int(columns.argmax())
    near_side_m = np.append(x_m[begin_x:] - grid.cell_m / 2, x0_m + side_m)
    return (slice(begin_x, None), slice(begin_y, begin_y + int(columns.sum()))), near_side_m
