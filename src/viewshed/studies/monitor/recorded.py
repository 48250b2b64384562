"""Measured sweeps of real sensors, as they are and attacked: what all evidence says of them, in the same archive."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

import numpy as np

from viewshed.datasets.recordings.source import each_sweep, open_index
from viewshed.grid import GRIDS
from viewshed.integrity.evidence import EVIDENCE, SECTORS, MonitoredSweep
from viewshed.integrity.score import measure_all
from viewshed.preprocess.leveling import LeveledSweep, level
from viewshed.studies.cases import DEFAULT, generator
from viewshed.studies.monitor.archive import RECORDED, DriveEvidence
from viewshed.studies.monitor.drives import EARLIER, sensor_of, touched_sectors
from viewshed.studies.monitor.plan import MonitorPlan
from viewshed.studies.records import BENIGN, Case
from viewshed.sweep import Sweep
from viewshed.threats.attacks import ATTACKS, Knowledge
from viewshed.threats.attacks import EARLIER as NEEDS_EARLIER

EARLIER_S = 0.6
"""Sweeps measured up to this long before a sweep are given to the evidence: five at 10 Hz."""


def measure_recorded(index: Path, folder: Path, plan: MonitorPlan, without: str = "CARLA") -> int:
    """Write what all evidence says of the sweeps of an index, one file a drive; return the number of sweeps.

    Every sweep is attacked by itself, after those before it were seen as they are.

    Args:
        index: names sweeps, see :func:`viewshed.io.read_index`.
        folder: where the files go.
        plan: whose attacks are tried.
        without: sensors whose description holds this word are left out: they were not measured.
    """
    count = 0
    for number, (scene, sweeps) in enumerate(_drives(index)):
        if without not in scene:
            measure_recorded_drive(plan, number, sweeps).save(folder)
            count += len(sweeps)
    return count


def _drives(index: Path) -> Iterator[tuple[str, list[Sweep]]]:
    for scene, found in groupby(each_sweep(open_index(index)), key=lambda each: each[0].scene):
        yield scene, [sweep for _, sweep in found]


def measure_recorded_drive(plan: MonitorPlan, number: int, sweeps: list[Sweep]) -> DriveEvidence:
    """Return what all evidence says of the sweeps of a drive, in the order of time, and of each if it is attacked."""
    grid = GRIDS["road"]
    leveled = [level(sweep, grid) for sweep in sweeps]
    benign = np.stack([_measure(leveled, k, leveled[k]) for k in range(len(sweeps))])
    cases, evidence, touched, refused = list[Case](), [], [], list[Case]()
    for name in plan.attacks:
        case = Case("attack", name, DEFAULT)
        rows, areas = [], []
        try:
            for k, sweep in enumerate(sweeps):
                known = Knowledge(tuple(sweeps[:k][-1:]))
                if name in NEEDS_EARLIER and not k:
                    raise ValueError("there is no earlier sweep")
                tampered = ATTACKS[name](None, known).apply(sweep, generator(plan.seed, RECORDED, number, k, name))
                seen = level(tampered.sweep, grid)
                rows.append(_measure(leveled, k, seen))
                areas.append(touched_sectors(tampered, leveled[k], seen))
        except ValueError:
            refused.append(case)
            continue
        cases.append(case)
        evidence.append(np.stack(rows))
        touched.append(np.stack(areas))
    shape = (-1, len(sweeps), len(EVIDENCE), SECTORS)
    return DriveEvidence(
        RECORDED, RECORDED, number, sensor_of(leveled[0]), BENIGN, tuple(EVIDENCE), benign,
        tuple(cases), np.array(evidence, np.float32).reshape(shape),
        np.array(touched, np.bool_).reshape(-1, len(sweeps), SECTORS), tuple(refused),
    )  # fmt: skip


def _measure(
    leveled: list[LeveledSweep], number: int, seen: LeveledSweep
) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """Return all evidence (E, SECTORS) of a sweep that was seen in place of one of a drive."""
    now_ns = leveled[number].sweep.t_ns
    earlier = [
        one for one in leveled[:number][-EARLIER:]
        if now_ns is not None and one.sweep.t_ns is not None and 0 < now_ns - one.sweep.t_ns <= EARLIER_S * 1e9
    ]  # fmt: skip
    return measure_all(MonitoredSweep(seen, tuple(earlier)))
