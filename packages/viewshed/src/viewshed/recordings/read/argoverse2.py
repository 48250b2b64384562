"""Read the logs of the Argoverse 2 sensor data set.

- ``LOG/sensors/lidar/315966265259836000.feather``: a sweep of the two stacked sensors, in the car's frame.
- ``LOG/city_SE3_egovehicle.feather``: poses of the car in the city, by time.
- ``LOG/annotations.feather``: boxes in the car's frame at the times of sweeps; test logs have none.

Sweeps are returned in the frame of ``up_lidar``, whose mounting is the same in all logs to a few centimeters.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.io import read_sweep
from viewshed.io._columns import FILE_FRAMES
from viewshed.io._input import inside, open_input
from viewshed.io.argoverse import read_feather
from viewshed.recordings.read.source import ObjectBox, RecordingSource, SweepRef, numbered
from viewshed.sweep import Sweep

SWEEPS, POSES, BOXES = "sensors/lidar", "city_SE3_egovehicle.feather", "annotations.feather"

_POSE = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")
_SIZE = ("length_m", "width_m", "height_m")
_RETURNS = "num_interior_pts"
_MAX_BYTES = 256_000_000


class Argoverse2(RecordingSource):
    """One log, or a folder of logs; each is a scene, and its world is the frame of the city."""

    def __init__(self, place: Path) -> None:
        logs = logs_in(place)
        self.place = place
        self.problems: list[str] = []
        self.sweeps: dict[str, Sequence[SweepRef]] = {log.name: self._refs(log) for log in logs}
        self._tables: dict[Path, dict[str, NDArray[Any]] | None] = {}

    def _read(self, ref: SweepRef) -> Sweep:
        """Read a sweep with its time, and its pose if the log has it."""
        sweep = read_sweep(inside(self.place, ref.file), format="argoverse2")
        city_from_car = self._pose(ref)
        if city_from_car is None:
            return sweep.replace(t_ns=ref.t_ns)
        return sweep.replace(t_ns=ref.t_ns, world_from_sensor=city_from_car @ FILE_FRAMES["argoverse2"].inverse())

    def _boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return the annotated objects at the time of a sweep; None if the log has no annotations."""
        numbers, texts = (*_POSE, *_SIZE, "timestamp_ns"), ("category", "track_uuid")
        table = self._table(_log_of(ref) / BOXES, numbers, texts, (_RETURNS,))
        if table is None:
            return None
        # Without a pose, boxes are in the sensor's frame.
        world_from_car = self._pose(ref) or FILE_FRAMES["argoverse2"]
        rows = np.flatnonzero(table["timestamp_ns"] == ref.t_ns)
        poses, sizes = (np.stack([table[name][rows] for name in names], axis=1) for names in (_POSE, _SIZE))
        return tuple(
            ObjectBox(
                world_from_car @ Rigid.from_quaternion(pose[:4], pose[4:]), (length, width, height),
                str(table["category"][row]), str(table["track_uuid"][row]),
                int(table[_RETURNS][row]) if _RETURNS in table else None,
            )
            for row, pose, (length, width, height) in zip(rows, poses, sizes.tolist(), strict=True)
        )  # fmt: skip

    def _refs(self, log: Path) -> Sequence[SweepRef]:
        files = numbered((log / SWEEPS).glob("*.feather"), self.problems, "its nanoseconds")
        return [
            SweepRef(log.name, index, str(file), int(file.stem), sensor="up_lidar, down_lidar", key=file.stem)
            for index, file in enumerate(files)
        ]

    def _pose(self, ref: SweepRef) -> Rigid | None:
        """Return the car's pose in the city that is nearest in time, within a millisecond; else None."""
        table = self._table(_log_of(ref) / POSES, (*_POSE, "timestamp_ns"))
        if table is None or ref.t_ns is None or not len(table["timestamp_ns"]):
            return None
        difference_ns = np.abs(table["timestamp_ns"] - ref.t_ns)
        row = int(difference_ns.argmin())
        if difference_ns[row] > 1_000_000:
            return None
        pose = np.array([table[name][row] for name in _POSE])
        return Rigid.from_quaternion(pose[:4], pose[4:])

    def _table(
        self, path: Path, numbers: Sequence[str], texts: Sequence[str] = (), optional: Sequence[str] = ()
    ) -> dict[str, NDArray[Any]] | None:
        """Return a log's table by column, None if it does not exist; ``optional`` columns may be missing.

        Only the tables of one log are cached, to limit memory.
        """
        if path not in self._tables:
            self._tables = {kept: table for kept, table in self._tables.items() if kept.parent == path.parent}
            table = None
            if path.is_file():
                with open_input(inside(self.place, path)) as source:
                    table = read_feather(source.content(_MAX_BYTES), (*numbers, *optional), texts)
                    names = (*numbers, *texts)
                    missing = [name for name in names if name not in table]
                    if missing:
                        raise ValueError(f"must have the columns {', '.join(names)}, got none of {', '.join(missing)}")
            self._tables[path] = table
        return self._tables[path]


def logs_in(place: Path) -> list[Path]:
    """Return the logs at a place: itself, or folders in it."""
    return sorted({folder.parents[1] for depth in ("", "*/") for folder in place.glob(f"{depth}{SWEEPS}")})


def _log_of(ref: SweepRef) -> Path:
    return Path(ref.file).parents[2]
