"""Open a recording (folder of a data set, bag, archive of ours, or file of sweeps) and iterate over its sweeps."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, cast

from viewshed._extras import plugin
from viewshed.io import read_sweeps
from viewshed.io.formats import is_recording
from viewshed.recordings.read import open_source
from viewshed.recordings.read.source import SweepSource, each_sweep
from viewshed.sweep import Sweep

MANIFEST = "manifest.json"
"""A folder with this file is an archive of ours if the file contains :data:`_ARCHIVE_MARK` at its beginning."""

_ARCHIVE_MARK, _HEAD_BYTES = b"viewshed archive", 1000


class DataSets(Protocol):
    """Plugin that reads data sets in archives (entry point of ``viewshed.recordings``)."""

    def open(self, place: Path | str) -> SweepSource:
        """Open the archive in a folder or at a URI."""
        ...

    def sweeps(self, place: Path | str, split: str | None = None) -> Iterator[tuple[str, Sweep]]:
        """Yield (scene, sweep) for the sweeps of an archive, or of one split."""
        ...


def is_data_set(place: str | Path) -> bool:
    """Return whether a place is an archive of ours: a URI, or a folder with our manifest or an empty one."""
    if "://" in str(place):
        return True
    manifest = Path(place) / MANIFEST
    if not manifest.is_file():
        return False
    with manifest.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    return not head or _ARCHIVE_MARK in head


def data_sets(place: str | Path) -> DataSets:
    """Load the plugin that reads data sets in archives.

    Raises:
        ImportError: the plugin is not installed.
    """
    return cast(DataSets, plugin("recordings", "archive", f"{place}: a data set in an archive"))


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """The sweeps of a recording, scene by scene in time order; each iteration reads them again."""

    path: Path  # its location
    sweeps: Callable[[], Iterator[Sweep]]  # starts an iteration

    def __iter__(self) -> Iterator[Sweep]:
        """Yield the sweeps one at a time, without keeping them in memory.

        Raises:
            ValueError: a file is damaged; the message names it.
        """
        return self.sweeps()


def open_recording(path: str | os.PathLike[str], *, topic: str | None = None) -> Recording:
    """Open the recording at ``path``.

    Args:
        path: a folder of nuScenes, KITTI, CARLA, OPV2V (in the layout of its publisher) or an archive of ours; a ROS
            bag or MCAP file; or a file of one or more sweeps in a format of :func:`viewshed.read_sweep`.
        topic: topic of a bag to read; None reads all topics of the preferred message type.

    Lost data, such as the end of a truncated bag, is reported as a warning.

    Raises:
        ValueError: the path holds no known recording.
        OSError: it cannot be read.
    """
    place = Path(path)
    if not is_recording(place):
        if not place.is_file():
            raise FileNotFoundError(f"{place}: no such file or folder")
        if topic is not None:
            raise ValueError(f"{place}: topic is only for bags, got {topic!r}; leave it out")
        return Recording(place, lambda: read_sweeps(place))
    source = open_sweep_source(place, topic=topic)
    for line in source.damage():
        warnings.warn(line, stacklevel=2)
    return Recording(place, lambda: (sweep for _, sweep in each_sweep(source)))


def open_sweep_source(place: Path, *, topic: str | None = None) -> SweepSource:
    """Open an archive of ours or a recording of another project; errors as :func:`open_recording`."""
    if topic is not None or not is_data_set(place):
        return open_source(place, topic=topic)
    return data_sets(place).open(place)
