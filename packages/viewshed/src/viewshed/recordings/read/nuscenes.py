"""nuScenes (v1.0): its LiDAR's keyframes and sweeps with poses and boxes, from the tables as they are handed out."""

from __future__ import annotations

from pathlib import Path

from viewshed.io import FILE_FRAMES, read_sweep
from viewshed.io._input import inside
from viewshed.recordings.read._nuscenes_boxes import Annotations
from viewshed.recordings.read._nuscenes_tables import NuscenesTables
from viewshed.recordings.read.source import ObjectBox, SweepReader, SweepRef, problems_of
from viewshed.sweep import Sweep

SENSOR = "hdl32e"
"""Beam table of nuScenes' LiDAR."""

_TABLE = "sample_data.json"


class Nuscenes(SweepReader):
    """One version of nuScenes, in the folder of its tables or the one above, where ``samples`` and ``sweeps`` lie.

    The ego frame lies on the ground, so the height of the sensor is that of its calibration.
    """

    def __init__(self, place: Path) -> None:
        versions = versions_in(place)
        if len(versions) != 1:
            names = ", ".join(version.name for version in versions)
            found = f"got {names}; name one of these folders" if versions else "got none"
            raise ValueError(f"{place}: must hold one version of nuScenes ({_TABLE} in a folder v1.0-…), {found}")
        [self._folder] = versions
        self.problems: list[str] = []
        self._tables = NuscenesTables.read(self._folder, self.problems)
        self._annotations: Annotations | None = None
        self.scenes = self._tables.scenes

    def read(self, ref: SweepRef) -> Sweep:
        """Return a sweep with ring, time, pose, height and beams."""
        tokens = self._tables.tokens[ref.key]
        file = inside(self._folder.parent, ref.file)
        with problems_of(f"{ref.file}: has no pose"):
            ego_from_file = self._tables.calibrations.pose(tokens.calibration)
            world_from_ego = self._tables.poses.pose(tokens.pose)
        sweep = read_sweep(
            file, format="nuscenes", sensor=SENSOR, sensor_height_m=float(ego_from_file.translation[2]),
            world_from_sensor=world_from_ego @ ego_from_file @ FILE_FRAMES["nuscenes"].inverse(),
        )  # fmt: skip
        return sweep if sweep.t_ns == ref.t_ns else sweep.replace(t_ns=ref.t_ns)

    def boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return the annotated objects of a keyframe, or those between the keyframes before and after a sweep.

        None for sweeps before the first or after the last keyframe, and in the test version.
        """
        refs = self.scenes[ref.scene]
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
    """Return the versions of nuScenes at a place: itself one, or those in it."""
    if (place / _TABLE).is_file() or place.name.startswith("v1.0-"):
        return [place]
    return sorted(path for path in place.glob("v1.0-*") if path.is_dir())
