"""Public traces of spoofed drives: which sweeps the shipped monitor calls, end to end.

Allenpandas/LiDAR-Spoofing-Forensics-Datasets (Apache-2.0): real sweeps of one car, a file each in ``NAME.tar.xz``.
Which are spoofed the authors do not publish; the key is inferred from the data, where the spoofed sweeps stand out by
gaps of 10 to 25 times in single statistics.
"""

from __future__ import annotations

import tarfile
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from viewshed.grid import GRIDS
from viewshed.io import read_sweep
from viewshed.monitor import StreamMonitor
from viewshed.preprocess.leveling import level
from viewshed.preprocess.sensor_identification import UNIDENTIFIED
from viewshed.sweep import Sweep

SPOOFED = {"blackout": (130, 208, 544), "noise": (58, 325, 412)}
"""The inferred key: numbers of the spoofed sweeps of each trace."""


@dataclass(frozen=True, slots=True)
class Called:
    """What the monitor says of one sweep of a trace."""

    trace: str
    number: int
    is_spoofed: bool
    p_value: float  # NaN where too few sweeps came before
    score: float
    inconsistent: bool
    degraded: bool
    reason: str  # the first; empty for none


def trace_sweeps(archive: Path) -> Iterator[tuple[int, Sweep]]:
    """Yield the number and the sweep of each file of a trace, in the order of time.

    Raises:
        ValueError: the archive holds no sweep.
        OSError: it cannot be read.
    """
    with tarfile.open(archive, "r:xz") as packed, tempfile.TemporaryDirectory() as folder:
        packed.extractall(folder, filter="data")
        files = sorted(Path(folder).rglob("*.pcd"), key=lambda path: int(path.stem))
        if not files:
            raise ValueError(f"{archive} must hold PCD files of a sweep each, got none; give a trace's .tar.xz")
        for file in files:
            yield int(file.stem), read_sweep(file)


def call_trace(archive: Path, monitor: StreamMonitor) -> list[Called]:
    """Return what a monitor says of each sweep of a trace."""
    name, watching = archive.name.removesuffix(".tar.xz"), monitor.fresh()
    called, sensor = [], UNIDENTIFIED
    for number, sweep in trace_sweeps(archive):
        leveled = level(sweep, GRIDS["road"], sensor)
        now, sensor = watching.check(leveled).now, leveled.sensor_id
        called.append(
            Called(
                name, number, number in SPOOFED.get(name, ()), now.p_value, now.score, now.inconsistent,
                now.degraded, now.reasons[0] if now.reasons else "",
            )
        )  # fmt: skip
    return called
