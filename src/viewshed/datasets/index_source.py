"""An index of sweeps as a recording: the files that it names, drive by drive."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from viewshed.datasets.source import ObjectBox, SweepRef
from viewshed.io import IndexEntry, read_index, read_indexed
from viewshed.sweep import Sweep


@dataclass(frozen=True, slots=True, eq=False)
class IndexSource:
    """The sweeps that an index names, from :meth:`open`; those of one drive are a scene, each other one its own."""

    _scenes: Mapping[str, tuple[IndexEntry, ...]]

    @classmethod
    def open(cls, index: str | os.PathLike[str]) -> IndexSource:
        """Return the sweeps of an index file.

        Raises:
            ValueError: it is no index, or names no sweep.
            OSError: it cannot be read.
        """
        drives: dict[str, list[IndexEntry]] = {}
        for entry in read_index(index):
            if entry.points:
                drives.setdefault(_scene(entry, Path(index).resolve().parent), []).append(entry)
        if not drives:
            raise ValueError(f"{index} must name at least one sweep, got none")
        return cls({name: tuple(sorted(entries, key=_time)) for name, entries in drives.items()})

    def scenes(self) -> tuple[str, ...]:
        """Return the names of the drives, and of the files that belong to none, in the index's order."""
        return tuple(self._scenes)

    def refs(self, scene: str) -> Sequence[SweepRef]:
        """Return the sweeps of a drive in time order.

        Raises:
            ValueError: there is no such drive.
        """
        return [
            SweepRef(scene, k, str(entry.file), None if entry.t is None else round(entry.t * 1e6) * 1000, key=str(k))
            for k, entry in enumerate(self._entries(scene))
        ]

    def read(self, ref: SweepRef) -> Sweep:
        """Return a sweep with what the index tells about it.

        Raises:
            ValueError: its file is not a sweep, or the ref is not of this index.
            OSError: its file cannot be read.
        """
        entries = self._entries(ref.scene)
        if not 0 <= ref.index < len(entries) or str(entries[ref.index].file) != ref.file:
            raise ValueError(f"ref must be one of the index, got {ref.file}")
        return read_indexed(entries[ref.index])

    def boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return None: an index has no boxes."""
        return None

    def damage(self) -> tuple[str, ...]:
        """Return nothing: an index that is damaged cannot be opened."""
        return ()

    def _entries(self, scene: str) -> tuple[IndexEntry, ...]:
        if scene not in self._scenes:
            raise ValueError(f"scene must be one of the {len(self._scenes)} of the index, got {scene!r}")
        return self._scenes[scene]


def _scene(entry: IndexEntry, folder: Path) -> str:
    """Return the drive and sensor of an entry, or its own name where it belongs to no drive."""
    name = entry.file.relative_to(folder).as_posix()
    return name if entry.seq is None else f"{entry.seq} ({entry.sensor})"


def _time(entry: IndexEntry) -> tuple[float, str]:
    return (0.0 if entry.t is None else entry.t, str(entry.file))
