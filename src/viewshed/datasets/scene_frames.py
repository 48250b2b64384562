"""The frames of one scene, wherever they lie: in an archive, in a recording, in a file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np

from viewshed.bev import BevGrid
from viewshed.datasets.archive import Archive
from viewshed.datasets.frame import Frame
from viewshed.datasets.source import SweepRef, SweepSource
from viewshed.datasets.sources import open_source
from viewshed.sweep import Sweep
from viewshed.truth import Truth

ReadFile = Callable[[Path], Iterator[Sweep]]


class SceneFrames(Protocol):
    """The frames of one scene by number; it travels to other processes."""

    def __len__(self) -> int:
        """Return the number of frames."""
        ...

    def agent(self, index: int) -> str:
        """Return who measured a frame; errors as :meth:`frame`."""
        ...

    def frame(self, index: int) -> Frame:
        """Return one frame.

        Raises:
            ValueError: it is damaged.
            OSError: it cannot be read.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class ArchiveScene:
    """A scene of an archive.

    Attributes:
        archive: its frames alone; see :meth:`of`.
    """

    archive: Archive

    @classmethod
    def of(cls, archive: Archive, scene: str) -> ArchiveScene:
        """Return one scene of an archive, with no more of the manifest than it needs."""
        shards = tuple(shard for shard in archive.shards if shard.scene == scene)
        return cls(Archive(archive.store, replace(archive.manifest, shards=shards)))

    def __len__(self) -> int:
        return len(self.archive)

    def agent(self, index: int) -> str:
        """Return who measured a frame."""
        return self.frame(index).measured.agent

    def frame(self, index: int) -> Frame:
        """Return one frame, as it is stored."""
        return self.archive.frame(index)[0]


@dataclass(frozen=True, slots=True)
class RecordingScene:
    """A scene of a recording: sweeps without truth.

    Attributes:
        place: of the recording, see :func:`viewshed.datasets.sources.open_source`.
        kind: of the recording.
        scene: its name.
        grid: of the truth that is not there.
    """

    place: str
    kind: str
    scene: str
    grid: BevGrid

    def __len__(self) -> int:
        return len(self._refs())

    def agent(self, index: int) -> str:
        """Return who measured a frame."""
        return self._refs()[index].agent

    def frame(self, index: int) -> Frame:
        """Return one sweep as a frame whose truth is nowhere known."""
        return without_truth(opened(self.place, self.kind).read(self._refs()[index]), self.grid)

    def _refs(self) -> tuple[SweepRef, ...]:
        return _refs(self.place, self.kind, self.scene)


@dataclass(frozen=True, slots=True)
class FileScene:
    """A file with one sweep or several, without truth.

    Attributes:
        path: of the file.
        count: how many of its sweeps can be read.
        read: yields them.
        grid: of the truth that is not there.
    """

    path: Path
    count: int
    read: ReadFile
    grid: BevGrid

    def __len__(self) -> int:
        return self.count

    def agent(self, index: int) -> str:
        """Return who measured a frame."""
        return self.frame(index).measured.agent

    def frame(self, index: int) -> Frame:
        """Return one sweep as a frame whose truth is nowhere known."""
        return without_truth(_cursor(self.path, self.read).at(index), self.grid)


def without_truth(sweep: Sweep, grid: BevGrid) -> Frame:
    """Return a sweep as a frame whose truth is nowhere known."""
    return Frame(sweep, Truth(grid, {}, {}), np.zeros(grid.shape, np.bool_))


@lru_cache(maxsize=2)
def opened(place: str, kind: str) -> SweepSource:
    """Return the recording at a place, opened once in each process; errors as ``open_source``."""
    return open_source(place, kind)


@lru_cache(maxsize=8)
def _refs(place: str, kind: str, scene: str) -> tuple[SweepRef, ...]:
    return tuple(opened(place, kind).refs(scene))


class _Cursor:
    """Reads a file forward, and from its start again for a sweep that has passed."""

    def __init__(self, path: Path, read: ReadFile) -> None:
        self._path, self._read = path, read
        self._last: Sweep | None = None
        self._index, self._sweeps = -1, read(path)

    def at(self, index: int) -> Sweep:
        if index < self._index:
            self._index, self._sweeps = -1, self._read(self._path)
        while self._index < index:
            self._last = next(self._sweeps, None)
            self._index += 1
        if self._last is None:
            raise ValueError(f"{self._path} must have more than {index} sweeps; it changed while it was read")
        return self._last


@lru_cache(maxsize=2)
def _cursor(path: Path, read: ReadFile) -> _Cursor:
    return _Cursor(path, read)
