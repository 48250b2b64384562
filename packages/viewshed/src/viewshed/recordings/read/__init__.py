"""SOURCES: the supported kinds of recordings; :func:`open_source` detects the kind of a folder and opens it."""

from __future__ import annotations

import os
from pathlib import Path

from viewshed.io._input import errors_with_path
from viewshed.recordings.read import argoverse2, bag_files, carla, kitti, nuscenes, opv2v, rosbag
from viewshed.recordings.read.source import SourceKind, SweepSource

SOURCES: dict[str, SourceKind] = {
    "nuscenes": SourceKind("nuScenes' tables in v1.0-*/", nuscenes.versions_in, nuscenes.Nuscenes),
    "kitti_raw": SourceKind("KITTI's drives with velodyne_points/data/", kitti.drives_in, kitti.KittiRaw),
    "kitti_odometry": SourceKind("KITTI's sequences/*/velodyne/", kitti.sequences_in, kitti.KittiOdometry),
    "kitti_object": SourceKind("KITTI's training/velodyne/ or testing/velodyne/", kitti.parts_in, kitti.KittiObject),
    "argoverse2": SourceKind("Argoverse 2's LOG/sensors/lidar/", argoverse2.logs_in, argoverse2.Argoverse2),
    "carla": SourceKind(
        "folders AGENT/000123.ply (or .npy) with AGENT/poses.csv (or .jsonl)",
        carla.recordings_in, carla.CarlaRecording,
    ),
    "opv2v": SourceKind(
        "folders SCENARIO/AGENT/000068.pcd with 000068.yaml", opv2v.scenarios_in, opv2v.Opv2v
    ),
    "bag": SourceKind(
        "a .bag or .mcap file, a folder with metadata.yaml, or a folder of these",
        bag_files.bags_in, rosbag.BagRecording.open,
    ),
}  # fmt: skip
"""Name → how to detect and open it; the first match is used."""


def open_source(place: str | os.PathLike[str], kind: str = "auto", *, topic: str | None = None) -> SweepSource:
    """Open the recording at a path; errors of its readers are one line that names a file of it.

    Args:
        place: the folder (or file), in the layout of its publisher.
        kind: a name in :data:`SOURCES`, or "auto" to detect it by its layout.
        topic: topic of a bag to read; None reads all topics of the preferred message type.

    Raises:
        ValueError: the kind or the layout is unknown, or the recording is damaged.
        OSError: it cannot be read.
    """
    path = Path(place).absolute()  # absolute: the folder's name is used as scene name, also for "."
    if kind != "auto" and kind not in SOURCES:
        raise ValueError(f"kind must be auto or one of {', '.join(SOURCES)}, got {kind!r}")
    if not path.exists():
        problem = "its links lead in a circle" if path.is_symlink() else "no such file or folder"
        raise FileNotFoundError(f"{path}: {problem}")
    with errors_with_path(path, path.parent):
        if topic is not None:
            if not SOURCES["bag"].fits(path):
                raise ValueError(f"{path}: topic is only for bags, got {topic!r}; leave it out")
            return rosbag.BagRecording.open(path, topic)
        for known in SOURCES.values() if kind == "auto" else (SOURCES[kind],):
            if kind != "auto" or known.fits(path):
                source = known.open(path)
                if not source.sweeps:
                    raise ValueError(f"{path}: must hold {known.layout}, got none")
                return source
    layouts = "; ".join(f"{known.layout} ({name})" for name, known in SOURCES.items())
    raise ValueError(f"{path}: no recording found here; looked for {layouts}")
