"""Read nuScenes (v1.0): keyframes and sweeps of its LiDAR with poses and boxes, from the published tables."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, replace
from pathlib import Path
from sys import intern

import numpy as np
from numpy.typing import NDArray

from viewshed.geometry import Rigid
from viewshed.io import FILE_FRAMES, read_sweep
from viewshed.io._input import inside, one_line
from viewshed.recordings.read._nuscenes_tables import NuscenesTables, floats_of, rows_of_table
from viewshed.recordings.read.source import ObjectBox, RecordingSource, SweepRef, error_prefix
from viewshed.recordings.read.tf_tree import between
from viewshed.sweep import Sweep

SENSOR = "hdl32e"
"""Beam table of nuScenes' LiDAR."""

_TABLE = "sample_data.json"

_MAX_RETURNS = 1 << 31


@dataclass(frozen=True, slots=True, eq=False)
class Annotations:
    """The rows of ``sample_annotation``, grouped by sample."""

    place: Path  # file of the table
    rows: dict[str, array[int]]  # token of the sample → rows of ``values`` and ``instances``
    # (N, 10) float64: quaternion (w, x, y, z), center and width, length, height in meters; not finite if damaged
    values: NDArray[np.float64]
    instances: list[str]  # token of the object (instance), by row
    returns: array[int]  # number of LiDAR returns in the box, by row; -1 if unknown
    categories: dict[str, str]  # token of the object → name of its category

    @classmethod
    def read(cls, folder: Path) -> Annotations:
        """Read the annotations of the version in a folder."""
        names = {str(row.get("token")): str(row.get("name")) for row in rows_of_table(folder / "category.json")}
        objects = (
            (str(row.get("token")), str(row.get("category_token"))) for row in rows_of_table(folder / "instance.json")
        )
        categories = {token: names[category] for token, category in objects if category in names}
        place = folder / "sample_annotation.json"
        rows: dict[str, array[int]] = {}
        values, instances, returns = array("d"), [], array("q")
        for number, row in enumerate(rows_of_table(place)):
            rows.setdefault(str(row.get("sample_token")), array("q")).append(number)
            instances.append(intern(str(row.get("instance_token"))))
            count = row.get("num_lidar_pts")
            returns.append(count if isinstance(count, int) and 0 <= count <= _MAX_RETURNS else -1)
            values.extend(floats_of([row.get(key) for key in ("rotation", "translation", "size")], (4, 3, 3)))
        return cls(place, rows, np.array(values).reshape(-1, 10), instances, returns, categories)

    def of(self, sample: str) -> tuple[ObjectBox, ...] | None:
        """Return the boxes of a sample; None if the version has no annotations."""
        return tuple(self._box(row) for row in self.rows.get(sample, ())) if self.rows else None

    def between(self, before: str, after: str, share: float) -> tuple[ObjectBox, ...] | None:
        """Interpolate boxes at ``share`` in [0, 1] between two samples, for objects that are in both.

        Centers are interpolated linearly, headings along the shorter arc, and the size is that of ``after``, as in
        ``get_boxes`` of the development kit. Objects only in ``after`` are dropped; the kit shows them at that pose.
        """
        first = {self.instances[row]: row for row in self.rows.get(before, ())}
        pairs = ((first.get(self.instances[row]), row) for row in self.rows.get(after, ()))
        boxes = tuple(self._interpolated(old, new, share) for old, new in pairs if old is not None)
        return boxes if self.rows else None

    def _interpolated(self, old: int, new: int, share: float) -> ObjectBox:
        earlier, later = self._box(old), self._box(new)
        pose = between(earlier.world_from_box, later.world_from_box, share)
        return replace(later, world_from_box=pose, returns=None)

    def _box(self, row: int) -> ObjectBox:
        instance = self.instances[row]
        if instance not in self.categories:
            raise ValueError(one_line(f"{self.place}: row {row} names no object with a category, {instance!r}"))
        quaternion, center, (width, length, height) = np.split(self.values[row], (4, 7))
        with error_prefix(f"{self.place}: row {row}"):
            pose = Rigid.from_quaternion(quaternion, center)
            size_m = (float(length), float(width), float(height))
            returns = None if self.returns[row] < 0 else self.returns[row]
            return ObjectBox(pose, size_m, self.categories[instance], instance, returns)


class Nuscenes(RecordingSource):
    """One version of nuScenes, in the folder of its tables or its parent, which has ``samples`` and ``sweeps``.

    The ego frame is on the ground, so the sensor height is z of its calibration.
    """

    def __init__(self, place: Path) -> None:
        versions = versions_in(place)
        if len(versions) != 1:
            names = ", ".join(version.name for version in versions)
            got = f"got {names}; name one of these folders" if versions else "got none"
            raise ValueError(f"{place}: must hold one version of nuScenes ({_TABLE} in a folder v1.0-…), {got}")
        self.place, [self._folder] = place, versions
        self.problems: list[str] = []
        self._tables = NuscenesTables.read(self._folder, self.problems)
        self._annotations: Annotations | None = None
        self.sweeps = self._tables.scenes

    def _read(self, ref: SweepRef) -> Sweep:
        """Read a sweep with ring, time, pose, sensor height and beam table."""
        tokens = self._tables.tokens[ref.key]
        file = inside(self._folder.parent, ref.file)
        with error_prefix(f"{ref.file}: has no pose"):
            ego_from_file = self._tables.calibrations.pose(tokens.calibration)
            world_from_ego = self._tables.poses.pose(tokens.pose)
        sweep = read_sweep(
            file, format="nuscenes", sensor=SENSOR, sensor_height_m=float(ego_from_file.translation[2]),
            world_from_sensor=world_from_ego @ ego_from_file @ FILE_FRAMES["nuscenes"].inverse(),
        )  # fmt: skip
        return sweep if sweep.t_ns == ref.t_ns else sweep.replace(t_ns=ref.t_ns)

    def _boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return the annotated objects of a keyframe, or interpolated between the keyframes around another sweep.

        None before the first and after the last keyframe, and in the test version.
        """
        refs = self.sweeps[ref.scene]
        before = next((other for other in reversed(refs[: ref.index + 1]) if other.keyframe), None)
        after = next((other for other in refs[ref.index :] if other.keyframe), None)
        if before is None or after is None:
            return None
        if self._annotations is None:
            self._annotations = Annotations.read(self._folder)
        first, last = (self._tables.tokens[keyframe.key].sample for keyframe in (before, after))
        if ref.keyframe:
            return self._annotations.of(first)
        t_ns, start_ns, end_ns = (other.t_ns or 0 for other in (ref, before, after))
        return self._annotations.between(first, last, (t_ns - start_ns) / max(end_ns - start_ns, 1))


def versions_in(place: Path) -> list[Path]:
    """Return the versions of nuScenes at a place: itself, or folders in it."""
    if (place / _TABLE).is_file() or place.name.startswith("v1.0-"):
        return [place]
    return sorted(path for path in place.glob("v1.0-*") if path.is_dir())
