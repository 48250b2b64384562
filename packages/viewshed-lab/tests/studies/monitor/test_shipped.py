"""The monitor that is made of an archive: its groups, which drives count for which verdict, its size as a file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from viewshed.monitor.calibration import Group
from viewshed.monitor.evidence import SECTORS
from viewshed.monitor.score import EvidenceScore, SurpriseScale, features_of
from viewshed.monitor.sweep_monitor import load_sweep_monitor, save_sweep_monitor
from viewshed_lab.studies.monitor.archive import DriveEvidence, SweepTable
from viewshed_lab.studies.monitor.plan import FRAMES, ONSET
from viewshed_lab.studies.monitor.shipped import monitor_of
from viewshed_lab.studies.records import BENIGN, Case

RNG = np.random.Generator(np.random.PCG64(5))


def _drive(number: int, sensor: str, conditions: Case) -> DriveEvidence:
    shape = (1, SECTORS)
    return DriveEvidence(
        "drives", "calibration", number, sensor, conditions, ("a",), RNG.exponential(size=(FRAMES, *shape)),
        RNG.exponential(size=shape), (), np.zeros((0, FRAMES - ONSET, *shape)),
        np.zeros((0, FRAMES - ONSET, SECTORS), np.bool_), (),
    )  # fmt: skip


def _score() -> EvidenceScore:
    count = features_of(1)
    weights = np.eye(count, 2, dtype=np.float32)
    zeros = np.zeros(count, np.float32)
    scale = SurpriseScale.fit(RNG.exponential(size=(100, 1, SECTORS)))
    two = np.zeros(2, np.float32)
    return EvidenceScore(("a",), scale, zeros, zeros + 1, weights, two, np.eye(2, dtype=np.float32), two)


def test_groups_and_drives_of_each_verdict(tmp_path: Path) -> None:
    rain = Case("corruption", "rain", "5")
    drives = [_drive(n, "few", BENIGN) for n in range(50)]
    drives += [_drive(50 + n, "many", rain if n < 40 else BENIGN) for n in range(150)]
    monitor = monitor_of(_score(), SweepTable.of(drives), seed=1)
    assert set(monitor.benign) == {Group("many", earlier) for earlier in ("posed", "unposed", "none")}
    for group in monitor.benign:
        assert len(monitor.inconsistent.scores[group]) == 150
        assert len(monitor.degraded.scores[group]) == 110, "only clear drives say what is degraded"
    save_sweep_monitor(monitor, tmp_path / "monitor.npz")
    again = load_sweep_monitor(tmp_path / "monitor.npz")
    assert again.promises() == monitor.promises()


def test_worse_drives_do_not_count_for_degraded(tmp_path: Path) -> None:
    snow = Case("corruption", "snow", "5")
    drives = [_drive(n, "many", BENIGN) for n in range(110)]
    worse = [replace(_drive(110 + n, "many", snow), benign=np.full((FRAMES, 1, SECTORS), 1e3)) for n in range(40)]
    limits = []
    for several in (drives, drives + worse):
        monitor = monitor_of(_score(), SweepTable.of(several), seed=1)
        limits.append(monitor.degraded.limit(Group("many", "none")))
    highest = max(float(_score()(drive.benign[frame]).degraded) for drive in drives for frame in range(FRAMES))
    assert max(limits) <= highest


def test_too_few_drives_are_refused() -> None:
    with pytest.raises(ValueError, match="a sensor must have 99 clear drives to calibrate on, got 50"):
        monitor_of(_score(), SweepTable.of([_drive(n, "few", BENIGN) for n in range(50)]), seed=1)
