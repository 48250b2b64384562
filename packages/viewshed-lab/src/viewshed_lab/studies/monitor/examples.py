"""What the score is trained on: which sweeps count as attacked, which as degraded, and how much each weighs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viewshed_lab.studies.monitor.archive import SweepTable, over_time_of
from viewshed_lab.studies.monitor.drives import HONEST
from viewshed_lab.studies.monitor.plan import CORRUPTED, family_of
from viewshed_lab.studies.records import BENIGN, Case
from viewshed_lab.training.evidence_score import ScoreExamples

LOSSES = ("removal", "removal_aimed")
"""Attacks after which a sweep lacks a sector, as after an honest fault: degraded, and inconsistent only over time."""

DEGRADED_FROM = 4
"""Severity of a drive's corruption from which on it counts as degraded in training; below, it is left open."""


def examples_of(table: SweepTable) -> ScoreExamples:
    """Return the sweeps of a table with what is known of them; null attacks are for the test alone."""
    inconsistent = np.array([_is_inconsistent(case) for case in table.cases], np.float32)[table.case]
    touched = table.touched.any(axis=1)
    inconsistent[(inconsistent == 1) & ~touched] = np.nan
    # What begins half-way in a drive is open: what lasts must be seen without a change before it.
    of_drive = np.array([_is_degraded(drive.conditions) for drive in table.drives], np.float32)[table.drive]
    degraded = np.where(table.case == 0, of_drive, np.nan).astype(np.float32)
    sectors = np.where(inconsistent[:, None] == 1, table.touched, inconsistent[:, None]).astype(np.float32)
    return ScoreExamples(
        table.names,
        table.evidence,
        inconsistent,
        degraded,
        sectors,
        _weights(table),
        table.case == 0,
        over_time_of(table.names),
    )


def is_trained_on(table: SweepTable, left_out: str) -> NDArray[np.bool_]:
    """Return which rows (N,) a score is trained on that leaves a family out; ``ALL_FAMILIES`` leaves none out."""
    kept = [
        case.kind != "null" and (case.kind in HONEST or str(family_of(case.name)) != left_out) for case in table.cases
    ]
    return np.array(kept)[table.case]


def families_of(table: SweepTable) -> NDArray[np.str_]:
    """Return the number of the family of each case (cases,), empty for those that are no attack."""
    return np.array(["" if case.kind in HONEST else str(family_of(case.name)) for case in table.cases])


def _is_inconsistent(case: Case) -> float:
    if case.kind in ("benign", "corruption"):
        return 0.0
    return np.nan if case.kind == "null" or case.name in LOSSES else 1.0


def _is_degraded(conditions: Case) -> float:
    if conditions == BENIGN:
        return 0.0
    return 1.0 if int(conditions.level) >= DEGRADED_FROM else np.nan


def _weights(table: SweepTable) -> NDArray[np.float32]:
    """Return the weight (N,) of each sweep, 1 on average: half for all that is honest, half for families alike.

    Of the honest ones, corrupted sweeps have the weight ``CORRUPTED`` together.
    """
    families = families_of(table)[table.case]
    weight = np.zeros(len(families))
    attacks = [family for family in np.unique(families) if family]
    honest = (families == "") & ~np.array([case.kind == "null" for case in table.cases])[table.case]
    clear = np.array([drive.conditions == BENIGN for drive in table.drives])[table.drive] & (table.case == 0)
    for mask, share in ((honest & clear, 1.0 - CORRUPTED), (honest & ~clear, CORRUPTED)):
        weight[mask] = (0.5 if attacks else 1.0) * share / max(mask.sum(), 1)
    for family in attacks:
        of_family = families == family
        weight[of_family] = 0.5 / len(attacks) / of_family.sum()
    return (weight * len(weight)).astype(np.float32)
