"""A recording as the sweeps in it: a data set's folder, a bag, an archive of ours, or a file of several sweeps."""

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
"""A folder with this file is an archive of ours, if it begins with :data:`_OURS`."""

_OURS, _HEAD_BYTES = b"viewshed archive", 1000


class DataSets(Protocol):
    """What an installed package adds to read data sets in archives: an entry point of ``viewshed.recordings``."""

    def open(self, place: Path | str) -> SweepSource:
        """Return the archive in a folder or at a URI."""
        ...

    def sweeps(self, place: Path | str, split: str | None = None) -> Iterator[tuple[str, Sweep]]:
        """Yield the sweeps of an archive, or of one of its splits, each with the name of its scene."""
        ...


def is_data_set(place: str | Path) -> bool:
    """Return whether a place is a data set of ours: a URI, or a folder with a manifest that is ours, or empty."""
    if "://" in str(place):
        return True
    manifest = Path(place) / MANIFEST
    if not manifest.is_file():
        return False
    with manifest.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    return not head or _OURS in head


def data_sets(place: str | Path) -> DataSets:
    """Return what reads data sets in archives.

    Raises:
        ImportError: the package that does is not installed.
    """
    return cast(DataSets, plugin("recordings", "archive", f"{place}: a data set in an archive"))


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """The sweeps of a recording, read anew each time that it is iterated over, scene by scene and in time order."""

    path: Path  # where it is
    sweeps: Callable[[], Iterator[Sweep]]  # begins to read

    def __iter__(self) -> Iterator[Sweep]:
        """Yield the sweeps; each is in memory only while it is used.

        Raises:
            ValueError: something is damaged; the message names the file.
        """
        return self.sweeps()


def open_recording(path: str | os.PathLike[str], *, topic: str | None = None) -> Recording:
    """Return the recording at ``path``.

    Args:
        path: a folder of nuScenes, KITTI, CARLA, OPV2V or an archive of ours as its makers hand it out; a ROS bag or
            MCAP file; or a file of one or more sweeps in a format of :func:`viewshed.read_sweep`.
        topic: of a bag, whose messages are read; None is all of the preferred type.

    What a recording lost, as one that was cut off, is a warning.

    Raises:
        ValueError: nothing that is known is there.
        OSError: it cannot be read.
    """
    place = Path(path)
    if not is_recording(place):
        if not place.is_file():
            raise FileNotFoundError(f"{place}: no such file or folder")
        if topic is not None:
            raise ValueError(f"{place}: topic goes with a bag, got {topic!r}; leave it out")
        return Recording(place, lambda: read_sweeps(place))
    source = open_sweep_source(place, topic=topic)
    for line in source.damage():
        warnings.warn(line, stacklevel=2)
    return Recording(place, lambda: (sweep for _, sweep in each_sweep(source)))


def open_sweep_source(place: Path, *, topic: str | None = None) -> SweepSource:
    """Return an archive of ours or somebody else's recording, scene by scene; errors as :func:`open_recording`."""
    if topic is not None or not is_data_set(place):
        return open_source(place, topic=topic)
    return data_sets(place).open(place)
