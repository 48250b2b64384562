"""SOURCES: the recordings that can be read; :func:`open_source` knows which one a folder is."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from viewshed.datasets.recordings import carla, kitti, nuscenes, opv2v
from viewshed.datasets.recordings import rosbag as bags
from viewshed.datasets.recordings.source import ObjectBox, SourceKind, SweepRef, SweepSource
from viewshed.io._input import errors_named
from viewshed.sweep import Sweep

SOURCES: dict[str, SourceKind] = {
    "nuscenes": SourceKind(nuscenes.LAYOUT, nuscenes.is_nuscenes, nuscenes.open_nuscenes),
    "kitti_raw": SourceKind(kitti.RAW_LAYOUT, kitti.is_raw, kitti.KittiRaw),
    "kitti_odometry": SourceKind(kitti.ODOMETRY_LAYOUT, kitti.is_odometry, kitti.KittiOdometry),
    "kitti_object": SourceKind(kitti.OBJECT_LAYOUT, kitti.is_object, kitti.KittiObject),
    "carla": SourceKind(carla.LAYOUT, carla.is_recording, carla.CarlaRecording.open),
    "opv2v": SourceKind(opv2v.LAYOUT, opv2v.is_opv2v, opv2v.Opv2v.open),
    "bag": SourceKind(bags.LAYOUT, bags.is_bag, bags.BagRecording.open),
}
"""Name → how to recognize and open it; the first that fits is taken."""


def open_source(place: str | os.PathLike[str], kind: str = "auto") -> SweepSource:
    """Return the recording at a place on disk; whatever its readers raise is one line that names a file of it.

    Args:
        place: the folder (or file) as the recording's makers hand it out.
        kind: a name in :data:`SOURCES`, or "auto" to know it by its layout.

    Raises:
        ValueError: there is no such kind, the layout is not known, or the recording is damaged.
        OSError: it cannot be read.
    """
    path = Path(place).absolute()  # its folder's name counts too, also that of "."
    if kind != "auto" and kind not in SOURCES:
        raise ValueError(f"kind must be auto or one of {', '.join(SOURCES)}, got {kind!r}")
    if not path.exists():
        problem = "its links lead in a circle" if path.is_symlink() else "no such folder"
        raise FileNotFoundError(f"{path}: {problem}")
    with errors_named(path, path.parent):
        known = (
            SOURCES[kind] if kind != "auto" else next((known for known in SOURCES.values() if known.fits(path)), None)
        )
        if known is not None:
            return _OneLineErrors(path.parent, known.open(path))
    layouts = "; ".join(f"{known.layout} ({name})" for name, known in SOURCES.items())
    raise ValueError(f"{path}: no recording found here; looked for {layouts}")


@dataclass(frozen=True, slots=True, eq=False)
class _OneLineErrors:
    """A recording whose errors are all of one line that names a file, whatever its reader raises."""

    root: Path
    source: SweepSource

    def scenes(self) -> tuple[str, ...]:
        return self.source.scenes()

    def refs(self, scene: str) -> Sequence[SweepRef]:
        with errors_named(self.root / scene, self.root):
            return self.source.refs(scene)

    def read(self, ref: SweepRef) -> Sweep:
        with errors_named(ref.file, self.root):
            return self.source.read(ref)

    def boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        with errors_named(ref.file, self.root):
            return self.source.boxes(ref)

    def damage(self) -> tuple[str, ...]:
        return self.source.damage()
