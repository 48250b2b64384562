"""Read and write sweeps.

The format is detected from content and file name (see :data:`FORMATS`). Points are returned in the sensor's frame.
Errors are a ValueError or an OSError with a one-line message that begins with the path.
"""

from __future__ import annotations

import gzip
import os
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from viewshed._files import write_atomic
from viewshed.geometry import Rigid
from viewshed.io._columns import FILE_FRAMES, Columns, file_frame_named, sweep_of
from viewshed.io._input import open_input
from viewshed.io.formats import FORMATS, Format, all_formats, format_of, writer_named
from viewshed.io.index import IndexEntry, read_index
from viewshed.sensors import LidarModel, lidar_model
from viewshed.sweep import Sweep

__all__ = [
    "FILE_FRAMES", "FORMATS", "Columns", "Format", "IndexEntry",
    "read_index", "read_indexed", "read_sweep", "read_sweeps", "write_sweep",
]  # fmt: skip


def read_sweep(
    path: str | os.PathLike[str],
    *,
    format: str = "auto",  # noqa: A002
    sensor: str | LidarModel | None = None,
    file_frame: str | Rigid | None = None,
    sensor_height_m: float | None = None,
    attitude: ArrayLike | None = None,
    world_from_sensor: Rigid | None = None,
) -> Sweep:
    """Read the first complete sweep of a file, in the sensor's frame.

    Args:
        path: the file, gzipped or not.
        format: a name in :data:`FORMATS`, or "auto" to detect it from content and file name.
        sensor: beam table or its name (see :func:`viewshed.lidar_model`).
        file_frame: a name in :data:`FILE_FRAMES` or a ``sensor_from_file`` transform; None is the format's default.
        sensor_height_m: mounting height above the ground, if known.
        attitude: quaternion (w, x, y, z) of ``level_from_sensor``, if known.
        world_from_sensor: pose in the map, if known.

    Raises:
        OSError: the file cannot be opened.
        ValueError: the file holds no valid sweep, or an argument is invalid.
        ImportError: the format needs an extra that is not installed.
    """
    return next(read_sweeps(
        path, format=format, sensor=sensor, file_frame=file_frame, sensor_height_m=sensor_height_m, attitude=attitude,
        world_from_sensor=world_from_sensor,
    ))  # fmt: skip


def read_sweeps(
    path: str | os.PathLike[str],
    *,
    format: str = "auto",  # noqa: A002
    sensor: str | LidarModel | None = None,
    file_frame: str | Rigid | None = None,
    sensor_height_m: float | None = None,
    attitude: ArrayLike | None = None,
    world_from_sensor: Rigid | None = None,
) -> Iterator[Sweep]:
    """Yield every complete sweep of a file; arguments and errors as in :func:`read_sweep`."""
    model = lidar_model(sensor) if isinstance(sensor, str) else sensor
    frame = None if file_frame is None else file_frame_named(file_frame)
    given: dict[str, Any] = {"sensor_height_m": sensor_height_m, "world_from_sensor": world_from_sensor}
    given["attitude"] = None if attitude is None else np.asarray(attitude)
    given = {name: value for name, value in given.items() if value is not None}
    with open_input(path) as source:
        name = format_of(source) if format == "auto" else format
        if name not in all_formats():
            raise ValueError(f"format must be auto or one of {', '.join(all_formats())}, got {name!r}")
        for columns in all_formats()[name].read(source, frame):
            yield sweep_of(columns, source, model, given)


def read_indexed(entry: IndexEntry) -> Sweep:
    """Read the sweep of an entry of :func:`read_index`, with the frame, height, pose and time given in the index.

    Raises:
        OSError: the file cannot be opened.
        ValueError: the file holds no valid sweep.
    """
    sweep = read_sweep(
        entry.file, file_frame=entry.sensor_from_file,
        sensor_height_m=entry.sensor_height_m, world_from_sensor=entry.world_from_sensor,
    )  # fmt: skip
    if sweep.t_ns is not None or entry.t is None:
        return sweep
    return sweep.replace(t_ns=round(entry.t * 1e6) * 1000)


def write_sweep(sweep: Sweep, path: str | os.PathLike[str], *, format: str = "auto") -> None:  # noqa: A002
    """Write a sweep in the sensor's frame (nuScenes: in nuScenes' frame); an existing file is replaced atomically.

    Only NPZ is lossless; see :data:`FORMATS`. The file is gzipped if the path ends in ``.gz``.

    Raises:
        OSError: the file cannot be written.
        ValueError: the format is unknown or cannot store the sweep.
    """
    file_path = os.fspath(path)
    content = writer_named(format, file_path)(sweep)
    if file_path.lower().endswith(".gz"):
        content = gzip.compress(content, compresslevel=6, mtime=0)
    write_atomic(file_path, content)
