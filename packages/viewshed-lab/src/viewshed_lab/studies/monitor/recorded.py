"""Measured sweeps of real sensors, as they are and attacked: what all evidence says of them, in the same archive."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

import numpy as np

from viewshed.grid import GRIDS
from viewshed.monitor.evidence import EVIDENCE, SECTORS, MonitoredSweep
from viewshed.monitor.score import measure_all
from viewshed.preprocess.leveling import level
from viewshed.recordings.read.source import each_sweep, open_index
from viewshed.sweep import Sweep
from viewshed_lab.studies.cases import DEFAULT, generator
from viewshed_lab.studies.monitor.archive import RECORDED, DriveEvidence
from viewshed_lab.studies.monitor.drives import sensor_of, touched_sectors
from viewshed_lab.studies.monitor.plan import ALL_ATTACKS, MonitorPlan
from viewshed_lab.studies.records import BENIGN, Case
from viewshed_lab.threats.attacks import EARLIER as NEEDS_EARLIER
from viewshed_lab.threats.attacks import Knowledge


def measure_recorded(index: Path, folder: Path, plan: MonitorPlan, without: str = "CARLA") -> int:
    """Write what all evidence says of the sweeps of an index, one file a drive; return the number of sweeps.

    Every sweep is attacked and looked at by itself: hardly any has five others of the half second before it.

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
    benign = np.stack([measure_all(MonitoredSweep(one)) for one in leveled])
    cases, evidence, touched, refused = list[Case](), [], [], list[Case]()
    for name in plan.attacks:
        case = Case("attack", name, DEFAULT)
        rows, areas = [], []
        try:
            for k, sweep in enumerate(sweeps):
                known = Knowledge(tuple(sweeps[:k][-1:]))
                if name in NEEDS_EARLIER and not k:
                    raise ValueError("there is no earlier sweep")
                tampered = ALL_ATTACKS[name](None, known).apply(sweep, generator(plan.seed, RECORDED, number, k, name))
                seen = level(tampered.sweep, grid)
                rows.append(measure_all(MonitoredSweep(seen)))
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
        benign[-1], tuple(cases), np.array(evidence, np.float32).reshape(shape),
        np.array(touched, np.bool_).reshape(-1, len(sweeps), SECTORS), tuple(refused),
    )  # fmt: skip
