"""Runs the shipped monitor end to end on public traces of spoofed drives.

Allenpandas/LiDAR-Spoofing-Forensics-Datasets (Apache-2.0): real sweeps of one car, one file per sweep in
``NAME.tar.xz``. The authors do not publish which sweeps are spoofed; the key is inferred from the data, where the
spoofed sweeps stand out by gaps of 10 to 25 times in single statistics.
"""

from __future__ import annotations

import lzma
import tarfile
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from viewshed.cli._places import files_in
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
    """The monitor's verdict on one sweep of a trace."""

    trace: str
    number: int
    is_spoofed: bool | None  # None without a key
    p_value: float  # NaN after too few earlier sweeps
    score: float
    inconsistent: bool
    degraded: bool
    reason: str  # the first; empty for none


def trace_sweeps(trace: Path) -> Iterator[tuple[int, Sweep]]:
    """Yield number and sweep of each file of a trace, an archive or a folder, in the order of their numbers.

    Files are numbered from 0 if not all their names are numbers.

    Raises:
        ValueError: the trace is not an archive, or holds no sweep.
        OSError: a file cannot be read.
    """
    with _unpacked(trace) as folder:
        holders = sorted({file.parent for file in folder.rglob("*.pcd")})
        files = [file for holder in holders for file in files_in(holder) if file.suffix == ".pcd"]
        if not files:
            raise ValueError(f"{trace} must hold one PCD file per sweep, got none; give a trace's .tar.xz or folder")
        are_numbers = all(file.stem.isdecimal() for file in files)
        for place, file in enumerate(files):
            yield int(file.stem) if are_numbers else place, read_sweep(file)


@contextmanager
def _unpacked(trace: Path) -> Iterator[Path]:
    """Yield the folder of a trace; an archive is extracted to a temporary one."""
    if trace.is_dir():
        yield trace
        return
    with tempfile.TemporaryDirectory() as folder:
        try:
            with tarfile.open(trace) as packed:
                packed.extractall(folder, filter="data")
        except (tarfile.TarError, lzma.LZMAError, EOFError) as error:
            raise ValueError(
                f"{trace} must be a .tar.xz of PCD files, or a folder of them, got another or a damaged file"
            ) from error
        yield Path(folder)


def call_trace(trace: Path, monitor: StreamMonitor, key: Collection[int] | None = None) -> list[Called]:
    """Return a monitor's verdict on each sweep of a trace; ``key`` has the spoofed numbers, by default ``SPOOFED``."""
    name, watching = trace.name.removesuffix(".tar.xz"), monitor.fresh()
    given, key = key or (), SPOOFED.get(name) if key is None else key
    called, sensor = [], UNIDENTIFIED
    for number, sweep in trace_sweeps(trace):
        leveled = level(sweep, GRIDS["road"], sensor)
        now, sensor = watching.check(leveled).now, leveled.sensor_id
        called.append(
            Called(
                name, number, None if key is None else number in key, now.p_value, now.score, now.inconsistent,
                now.degraded, now.reasons[0] if now.reasons else "",
            )
        )  # fmt: skip
    if unknown := set(given) - {one.number for one in called}:
        raise ValueError(f"--key must be numbers of sweeps of {trace}, got {min(unknown)}, which is none of them")
    return called
