"""The monitor of a sweep: verdicts at their rates, sectors, reasons, its file, and what it refuses."""

from functools import cache

import numpy as np
import pytest
from tests.integrity.benign import HDL, VLP, benign_sweeps, evidence_of, score_by_hand

from viewshed import BevGrid
from viewshed.integrity import SweepMonitor
from viewshed.integrity.sweep_monitor import Rates


@cache
def _monitor() -> SweepMonitor:
    sweeps = benign_sweeps(150, 1) + benign_sweeps(99, 2, HDL, scale=3.0)
    return SweepMonitor.calibrate(
        score_by_hand(), sweeps, np.random.default_rng(0), rates=Rates(0.01, 0.02, 0.1), facts={"viewnet": "abc"}
    )


def _attacked(seed: int = 5) -> tuple[np.ndarray, slice]:
    evidence, wedge = evidence_of(np.random.default_rng(seed)), slice(20, 30)
    evidence[0, wedge] = np.linspace(60.0, 70.0, 10)
    return evidence, wedge


def test_an_attacked_wedge_is_inconsistent_and_found_with_its_reason() -> None:
    evidence, wedge = _attacked()
    grid = BevGrid(40, 20.0)
    report = _monitor().report(evidence, VLP, grid)
    assert report.inconsistent
    assert not report.degraded
    assert report.p_value == pytest.approx(1 / 151)
    assert report.suspect[wedge].all()
    assert report.suspect.sum() <= 12
    assert report.suspect_cells.any()
    assert report.reasons[0].endswith("at -32° have no neighbor at a similar range")
    assert report.monitor == "sweep"
