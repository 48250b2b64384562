"""SOURCES: the recordings that can be read; :func:`open_source` knows which one a folder is."""

from __future__ import annotations

import os
from pathlib import Path

from viewshed.datasets.recordings import carla, kitti, nuscenes, opv2v
from viewshed.datasets.recordings import rosbag as bags
from viewshed.datasets.recordings.source import SourceKind, SweepSource

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
    """Return the recording at a place on disk.

    Args:
        place: the folder (or file) as the recording's makers hand it out.
        kind: a name in :data:`SOURCES`, or "auto" to know it by its layout.

    Raises:
        ValueError: there is no such kind, the layout is not known, or the recording is damaged.
        OSError: it cannot be read.
    """
    path = Path(place).absolute()  # the folder above is told by it, also that of "."
    if kind != "auto" and kind not in SOURCES:
        raise ValueError(f"kind must be auto or one of {', '.join(SOURCES)}, got {kind!r}")
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such folder")
    if kind != "auto":
        return SOURCES[kind].open(path)
    for known in SOURCES.values():
        if known.fits(path):
            return known.open(path)
    looked = "; ".join(f"{known.layout} ({name})" for name, known in SOURCES.items())
    raise ValueError(f"{path}: no recording found here; looked for {looked}")
