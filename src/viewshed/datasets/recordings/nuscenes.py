"""nuScenes (v1.0): its LiDAR's keyframes and sweeps with poses and boxes, from the tables as they are handed out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from viewshed.datasets.recordings._nuscenes_boxes import Annotations
from viewshed.datasets.recordings._nuscenes_tables import CHANNEL, Poses, SweepRow, Tables
from viewshed.datasets.recordings.source import ObjectBox, SweepRef
from viewshed.geometry import Rigid
from viewshed.io import FILE_FRAMES, read_sweep
from viewshed.io._input import inside, one_line
from viewshed.sweep import Sweep

SENSOR = "hdl32e"
"""Beam table of nuScenes' LiDAR."""

LAYOUT = "nuScenes' tables in v1.0-*/"
"""What is looked for."""

_TABLE = "sample_data.json"


class Nuscenes:
    """One version of nuScenes; see :class:`~viewshed.datasets.recordings.source.SweepSource`.

    The ego frame lies on the ground, so the height of the sensor is that of its calibration.

    Args:
        folder: the version's folder, with the tables; ``samples`` and ``sweeps`` lie beside it.

    Raises:
        OSError: a table is missing or cannot be read.
        ValueError: a table is no list of JSON objects.
    """

    def __init__(self, folder: Path) -> None:
        self._tables = Tables.read(folder)
        self._annotations: Annotations | None = None

    def scenes(self) -> tuple[str, ...]:
        """Return the names of the scenes, in the order of ``scene.json``."""
        return tuple(self._tables.scenes)

    def refs(self, scene: str) -> Sequence[SweepRef]:
        """Return the sweeps of a scene in time order, keyframes among them.

        Raises:
            ValueError: there is no such scene.
        """
        return [self._ref(scene, index, row) for index, row in enumerate(self._rows(scene))]

    def read(self, ref: SweepRef) -> Sweep:
        """Return a sweep with ring, time, pose, height and beams.

        Raises:
            ValueError: it is damaged, or its calibration or pose is missing; one line that names the file.
            OSError: its file cannot be read.
        """
        row = self._row(ref)
        file = inside(self._tables.folder.parent, ref.file)
        ego_from_file = self._pose(self._tables.calibrations, row.calibration, ref)
        world_from_ego = self._pose(self._tables.poses, row.pose, ref)
        sweep = read_sweep(
            file, format="nuscenes", sensor=SENSOR, sensor_height_m=float(ego_from_file.translation[2]),
            world_from_sensor=world_from_ego @ ego_from_file @ FILE_FRAMES["nuscenes"].inverse(),
        )  # fmt: skip
        return sweep if sweep.t_ns == ref.t_ns else sweep.replace(t_ns=ref.t_ns)

    def boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return the annotated objects of a keyframe, or those between the keyframes before and after a sweep.

        None for sweeps before the first or after the last keyframe, and in the test version.

        Raises:
            ValueError: the annotations are damaged.
            OSError: their tables cannot be read.
        """
        row = self._row(ref)
        before, after = (row, row) if row.keyframe else self._keyframes_around(ref)
        if before is None or after is None:
            return None
        if self._annotations is None:
            self._annotations = Annotations.read(self._tables.folder)
        if row.keyframe:
            return self._annotations.of(row.sample)
        share = (row.t_us - before.t_us) / max(after.t_us - before.t_us, 1)
        return self._annotations.between(before.sample, after.sample, share)

    def damage(self) -> tuple[str, ...]:
        """Return one line for each row of a table that had to be left out."""
        return self._tables.damage

    def _rows(self, scene: str) -> list[SweepRow]:
        if scene not in self._tables.scenes:
            raise ValueError(
                f"scene must be one of the {len(self._tables.scenes)} of {self._tables.folder}, got {scene!r}"
            )
        return self._tables.scenes[scene]

    def _row(self, ref: SweepRef) -> SweepRow:
        rows = self._rows(ref.scene)
        if not 0 <= ref.index < len(rows) or rows[ref.index].token != ref.key:
            raise ValueError(f"ref must be one of {self._tables.folder}, got {ref.file}")
        return rows[ref.index]

    def _keyframes_around(self, ref: SweepRef) -> tuple[SweepRow | None, SweepRow | None]:
        """Return the last keyframe before a sweep and the next after it."""
        rows = self._rows(ref.scene)
        before = (row for row in reversed(rows[: ref.index]) if row.keyframe)
        return next(before, None), next((row for row in rows[ref.index :] if row.keyframe), None)

    def _ref(self, scene: str, index: int, row: SweepRow) -> SweepRef:
        file = str(self._tables.folder.parent / row.file)
        return SweepRef(scene, index, file, row.t_us * 1000, sensor=CHANNEL, keyframe=row.keyframe, key=row.token)

    def _pose(self, poses: Poses, token: str, ref: SweepRef) -> Rigid:
        try:
            return poses.pose(token)
        except ValueError as error:
            raise ValueError(one_line(f"{ref.file}: has no pose: {error}")) from error


def open_nuscenes(place: Path) -> Nuscenes:
    """Return the version of nuScenes in a folder: the version's own, or the one above that holds a single version.

    Raises:
        OSError: a table is missing or cannot be read.
        ValueError: there is no version, there are several, or a table is damaged.
    """
    versions = _versions(place)
    if len(versions) == 1:
        return Nuscenes(versions[0])
    found = (
        f"got {', '.join(version.name for version in versions)}; name one of these folders" if versions else "got none"
    )
    raise ValueError(f"{place}: must hold one version of nuScenes ({_TABLE} in a folder v1.0-…), {found}")


def is_nuscenes(place: Path) -> bool:
    """Return whether a folder is a version of nuScenes or holds one."""
    return bool(_versions(place))


def _versions(place: Path) -> list[Path]:
    if (place / _TABLE).is_file() or place.name.startswith("v1.0-"):
        return [place]
    return sorted(path for path in place.glob("v1.0-*") if path.is_dir())
