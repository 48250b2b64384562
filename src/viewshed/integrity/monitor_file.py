"""A fitted monitor as a file."""

from __future__ import annotations

import io
import json
import lzma
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from viewshed.atomic import write_bytes
from viewshed.bev import MAX_CELLS, BevGrid
from viewshed.integrity.deviation import NAME, DeviationMonitor

FORMAT_VERSION = 1
_BROKEN = (
    ValueError, KeyError, IndexError, TypeError, AttributeError, OverflowError, RuntimeError, EOFError, OSError,
    MemoryError, zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error,
)  # fmt: skip


def save_monitor(monitor: DeviationMonitor, path: str | Path) -> None:
    """Write a monitor to ``path`` (compressed NPZ) at once or not at all; the same monitor, the same bytes.

    Raises:
        OSError: the file cannot be written.
    """
    grid = monitor.grid
    about = {
        "version": FORMAT_VERSION,
        "monitor": NAME,
        "grid": [grid.cells, float(grid.half_extent_m), [float(v) for v in grid.offset_m]],
        "method": monitor.method,
        "limit": monitor.limit,
        "false_alarm_rate": monitor.false_alarm_rate,
        "sweeps": list(monitor.sweeps),
        "facts": dict(monitor.facts),
    }
    file = io.BytesIO()
    text = np.frombuffer(json.dumps(about).encode(), np.uint8)
    np.savez_compressed(file, about=text, thresholds=monitor.thresholds)
    write_bytes(path, file.getvalue())


def load_monitor(path: str | Path) -> DeviationMonitor:
    """Return the monitor in a file of :func:`save_monitor`; nothing is unpickled.

    Raises:
        ValueError: the file is no monitor, of another version, or damaged.
        OSError: it cannot be read.
    """
    raw = Path(path).read_bytes()
    try:
        return _monitor(*_contents(raw))
    except _BROKEN as error:
        why = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"{path} must be a whole monitor file of this version, got: {why}; fit it again") from error


def _contents(raw: bytes) -> tuple[dict[str, Any], Any]:
    limit = 4 * MAX_CELLS**2 + 4096
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        for member in archive.infolist():
            if member.file_size > limit:
                raise ValueError(f"{member.filename} must be at most {limit} bytes, got {member.file_size}")
    with np.load(io.BytesIO(raw), allow_pickle=False) as file:
        return json.loads(file["about"].tobytes()), file["thresholds"]


def _monitor(about: dict[str, Any], thresholds: Any) -> DeviationMonitor:
    if about["version"] != FORMAT_VERSION or about["monitor"] != NAME:
        raise ValueError(f"monitor {about['monitor']} of version {about['version']}, not {NAME} of {FORMAT_VERSION}")
    cells, half_extent_m, offset_m = about["grid"]
    return DeviationMonitor(
        BevGrid(int(cells), float(half_extent_m), (float(offset_m[0]), float(offset_m[1]))), thresholds,
        str(about["method"]), about["limit"], about["false_alarm_rate"], (about["sweeps"][0], about["sweeps"][1]),
        {str(key): str(value) for key, value in about["facts"].items()},
    )  # fmt: skip
