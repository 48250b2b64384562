"""Read and write sweeps.

The format is known by content and name, see :data:`FORMATS`; points come out in the sensor's frame. A file that cannot
be read is a ValueError or an OSError of one line that begins with its name.
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
    """Return the sweep in a file, the first complete one where it holds several, in the sensor's frame.

    Args:
        path: the file, gzipped or not.
        format: a name in :data:`FORMATS`, or "auto" to know it by content and name.
        sensor: beam table or its name (see :func:`viewshed.lidar_model`).
        file_frame: a name in :data:`FILE_FRAMES` or ``sensor_from_file``; None is the format's own.
        sensor_height_m: mounting height above the ground, if it is known.
        attitude: quaternion (w, x, y, z) of ``level_from_sensor``, if it is known.
        world_from_sensor: pose in the map, if it is known.

    Raises:
        OSError: the file cannot be opened.
        ValueError: the file is not a sweep, or an argument is wrong.
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
    """Yield every complete sweep in a file; arguments and errors are those of :func:`read_sweep`."""
    model = lidar_model(sensor) if isinstance(sensor, str) else sensor
    frame = None if file_frame is None else file_frame_named(file_frame)
    stated: dict[str, Any] = {"sensor_height_m": sensor_height_m, "world_from_sensor": world_from_sensor}
    stated["attitude"] = None if attitude is None else np.asarray(attitude)
    stated = {name: value for name, value in stated.items() if value is not None}
    with open_input(path) as source:
        name = format_of(source) if format == "auto" else format
        if name not in all_formats():
            raise ValueError(f"format must be auto or one of {', '.join(all_formats())}, got {name!r}")
        for columns in all_formats()[name].read(source, frame):
            yield sweep_of(columns, source, model, stated)


def read_indexed(entry: IndexEntry) -> Sweep:
    """Return the sweep of an entry of :func:`read_index`, with the frame, height, pose and time that the index gives.

    Raises:
        OSError: the file cannot be opened.
        ValueError: the file is not a sweep.
    """
    sweep = read_sweep(
        entry.file, file_frame=entry.sensor_from_file,
        sensor_height_m=entry.sensor_height_m, world_from_sensor=entry.world_from_sensor,
    )  # fmt: skip
    if sweep.t_ns is not None or entry.t is None:
        return sweep
    return sweep.replace(t_ns=round(entry.t * 1e6) * 1000)


def write_sweep(sweep: Sweep, path: str | os.PathLike[str], *, format: str = "auto") -> None:  # noqa: A002
    """Write a sweep in the sensor's frame (nuScenes: in its own); a file that exists is replaced in one step.

    Only NPZ keeps everything; see :data:`FORMATS`. A path that ends in ``.gz`` is gzipped.

    Raises:
        OSError: the file cannot be written.
        ValueError: the format is not known or cannot hold the sweep.
    """
    where = os.fspath(path)
    content = writer_named(format, where)(sweep)
    if where.lower().endswith(".gz"):
        content = gzip.compress(content, compresslevel=6, mtime=0)
    write_atomic(where, content)
