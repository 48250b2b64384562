"""The monitor that is shipped: the score of all families, calibrated by group on the drives set aside for that."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from viewshed.monitor.calibration import Group
from viewshed.monitor.score import EvidenceScore
from viewshed.monitor.sweep_monitor import RATES, BenignSweep, Rates, SweepMonitor
from viewshed_lab.studies.cases import generator
from viewshed_lab.studies.monitor.archive import SweepTable
from viewshed_lab.studies.monitor.plan import FRAMES, ONSET
from viewshed_lab.studies.records import BENIGN


def monitor_of(score: EvidenceScore, calibration: SweepTable, seed: int, rates: Rates = RATES) -> SweepMonitor:
    """Return a score calibrated on the benign sweeps of a table: with five earlier ones, without their poses, alone.

    What is degraded is calibrated on clear drives alone: in bad weather that verdict is no false alarm. Sensors with
    too few clear drives for the rate are left out.

    Args:
        score: of all evidence.
        calibration: drives that it was not trained on.
        seed: draws one sweep of each drive.
        rates: of false alarms.

    Raises:
        ValueError: no sensor has drives enough.
    """
    clear = np.array([drive.conditions == BENIGN for drive in calibration.drives])
    scenes = Counter(drive.sensor for drive, is_clear in zip(calibration.drives, clear, strict=True) if is_clear)
    needed = 1.0 / min(rates.inconsistent, rates.degraded) - 1.0 - 1e-9
    kept = np.array([scenes[drive.sensor] >= needed for drive in calibration.drives])
    if not kept.any():
        raise ValueError(f"a sensor must have {needed:.0f} clear drives to calibrate on, got {max(scenes.values())}")
    return SweepMonitor.calibrate(
        score, _sweeps(calibration, kept, clear), generator(seed, "monitor"), rates=rates,
        in_a_row=_in_a_row(calibration, kept),
    )  # fmt: skip


def _in_a_row(table: SweepTable, kept: NDArray[np.bool_]) -> Iterator[BenignSweep]:
    """Yield all sweeps of the kept drives (D,) before which enough was measured, in the order of time."""
    for row in np.flatnonzero((table.case == 0) & (table.frame >= ONSET) & kept[table.drive]):
        drive = table.drives[table.drive[row]]
        yield BenignSweep(drive.scene, Group(drive.sensor, "posed"), table.evidence[row].astype(np.float32))


def _sweeps(table: SweepTable, kept: NDArray[np.bool_], clear: NDArray[np.bool_]) -> Iterator[BenignSweep]:
    """Yield the benign sweeps of the kept drives (D,), each in its group; some drives (D,) are clear."""
    # With earlier sweeps only the last, before which as many lie as a stream keeps. The order of the drives means
    # nothing, and those of one domain lie side by side: they are mixed, or they would look like a drift.
    is_used = (table.frame < ONSET) | (table.frame == FRAMES - 1)
    rows = np.flatnonzero((table.case == 0) & is_used & kept[table.drive])
    places = generator(len(table.drives), "order").permutation(len(table.drives))
    for row in rows[np.argsort(places[table.drive[rows]], kind="stable")]:
        drive = table.drives[table.drive[row]]
        group = Group(drive.sensor, "posed" if table.frame[row] >= ONSET else "none")
        evidence = table.evidence[row].astype(np.float32)
        yield BenignSweep(drive.scene, group, evidence, bool(clear[table.drive[row]]))
    for number in np.argsort(places):
        drive = table.drives[number]
        if kept[number]:
            evidence = table.unposed[number].astype(np.float32)
            yield BenignSweep(drive.scene, Group(drive.sensor, "unposed"), evidence, bool(clear[number]))
