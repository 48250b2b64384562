"""Archive: a data set in Parquet shards with a manifest, read frame by frame.

ArchiveSource reads an archive as a recording, without its truth.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from viewshed.sweep import Sweep
from viewshed_lab._config import one_of
from viewshed_lab.data.archive.schema import Layout, Manifest, ShardFacts
from viewshed_lab.data.archive.shard import Shard, damage_of
from viewshed_lab.data.archive.storage import Storage
from viewshed_lab.data.sample import Sample
from viewshed_lab.sim.lidar.stored_sweep import StoredSweep

if TYPE_CHECKING:
    import pyarrow.parquet as pq

    from viewshed.recordings.read.source import ObjectBox, SweepRef


OPEN_SHARDS = 64
"""Largest number of files that an archive keeps open."""


class Archive:
    """A data set of samples in order, from :meth:`open`; or one of its splits, or some of its scenes.

    It can be pickled and used after a fork: every process opens the files that it reads.

    Args:
        store: location of the files.
        manifest: content and origin.
        shards: the shards to use; None is all.
    """

    def __init__(self, store: Storage, manifest: Manifest, shards: Iterable[ShardFacts] | None = None) -> None:
        self.store, self.manifest = store, manifest
        self.shards = tuple(manifest.shards if shards is None else shards)
        self._ends = np.array(list(accumulate(shard.frames for shard in self.shards)), np.int64)
        self._open_shards = _OpenShards(store, manifest.layout)

    @classmethod
    def open(cls, place: str | os.PathLike[str]) -> Archive:
        """Open the archive in a folder or at a URI.

        Raises:
            ValueError: it is no archive, not finished, damaged, or of another schema version.
            OSError: it cannot be read.
        """
        store = Storage.of(place)
        manifest = Manifest.read(store)
        if not manifest.complete:
            raise ValueError(f"{store.place} is not finished; run again the command that made it")
        return cls(store, manifest)

    def __len__(self) -> int:
        return int(self._ends[-1]) if len(self._ends) else 0

    def __getitem__(self, index: int) -> Sample:
        """Return one sample; its points are computed on first use.

        Raises:
            IndexError: there is no such frame.
            ValueError: its shard is damaged, or differs from the manifest.
            OSError: its shard cannot be read.
        """
        shard, row = self.locate(index)
        return self._open_shards.shard(shard).sample(row)

    def locate(self, index: int) -> tuple[ShardFacts, int]:
        """Return the shard of a frame and the frame's row there; raise an IndexError if there is no such frame."""
        count = len(self)
        if not -count <= index < count:
            raise IndexError(f"index must lie in [{-count}, {count}), got {index}")
        index %= count
        number = int(np.searchsorted(self._ends, index, side="right"))
        shard = self.shards[number]
        return shard, index - int(self._ends[number]) + shard.frames

    def __iter__(self) -> Iterator[Sample]:
        return self.samples()

    def samples(self, on_damage: Callable[[ShardFacts, str], None] | None = None) -> Iterator[Sample]:
        """Yield the samples in order.

        Args:
            on_damage: called with an unreadable shard and the reason; the rest of that shard is left out. None raises
                instead.

        Raises:
            ValueError: a shard is damaged, and there is no ``on_damage``.
            OSError: a shard cannot be read, and there is no ``on_damage``.
        """
        for facts in self.shards:
            try:
                shard = self._open_shards.shard(facts)
                for index in range(facts.frames):
                    yield shard.sample(index)
            except (ValueError, OSError) as error:
                if on_damage is None:
                    raise
                on_damage(facts, str(error))

    def abouts(self, shard: ShardFacts) -> list[dict[str, Any]]:
        """Return the metadata of each frame of a shard; raises like ``[]``."""
        return self._open_shards.shard(shard).abouts()

    @property
    def scenes(self) -> tuple[str, ...]:
        """Names of the scenes, in order."""
        return tuple(dict.fromkeys(shard.scene for shard in self.shards))

    @property
    def splits(self) -> tuple[str, ...]:
        """Names of the splits, in order."""
        return tuple(dict.fromkeys(shard.split for shard in self.shards))

    def split(self, name: str) -> Archive:
        """Return the part of the archive with the scenes of one split.

        Raises:
            ValueError: there is no such split.
        """
        one_of("split", name, self.splits)
        return self._with(shard for shard in self.shards if shard.split == name)

    def of_scenes(self, scenes: Iterable[str]) -> Archive:
        """Return the part of the archive with some scenes.

        Raises:
            ValueError: there is no such scene.
        """
        names = set(scenes)
        if not names <= set(self.scenes):
            raise ValueError(f"scenes must be among those of the archive, got {sorted(names - set(self.scenes))}")
        return self._with(shard for shard in self.shards if shard.scene in names)

    def folds(self, count: int, seed: int = 0) -> Iterator[tuple[Archive, Archive]]:
        """Yield ``count`` pairs (rest, held_out out) for cross-validation; each scene is held_out out exactly once.

        Raises:
            ValueError: there are fewer scenes than folds, or fewer than two folds.
        """
        scenes = self.scenes
        if not 2 <= count <= len(scenes):
            raise ValueError(f"count must lie in [2, {len(scenes)}], the number of scenes, got {count}")
        order = np.random.default_rng(seed).permutation(len(scenes))
        for fold in range(count):
            held_out = {scenes[k] for k in order[fold::count]}
            yield self.of_scenes(set(scenes) - held_out), self.of_scenes(held_out)

    def verify(self) -> Iterator[tuple[ShardFacts, str | None]]:
        """Yield each shard with a one-line description of its damage, or None.

        Length, checksum and the shard's own footer are compared with the manifest. The checksum detects damage, not
        forgery: whoever can write the shards can also write the manifest.
        """
        for facts in self.shards:
            yield facts, damage_of(self.store, facts, self.manifest.layout)

    def _with(self, shards: Iterable[ShardFacts]) -> Archive:
        return Archive(self.store, self.manifest, shards)


class _OpenShards:
    """Opens shards on first use in each process; caches the last used files and all footers that were read."""

    def __init__(self, store: Storage, layout: Layout) -> None:
        self._store, self._layout = store, layout
        self._process = os.getpid()
        self._files: OrderedDict[str, Shard] = OrderedDict()
        self._footers: dict[str, pq.FileMetaData] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        return _OpenShards, (self._store, self._layout)

    def shard(self, facts: ShardFacts) -> Shard:
        """Return an open shard, checked against the manifest."""
        if self._process != os.getpid():
            self._process, self._files = os.getpid(), OrderedDict()
        name = facts.name
        if name not in self._files:
            shard = Shard(self._store, name, metadata=self._footers.get(name))
            shard.check(facts, self._layout)
            self._files[name], self._footers[name] = shard, shard.metadata
            if len(self._files) > OPEN_SHARDS:
                self._files.popitem(last=False)[1].close()
        self._files.move_to_end(name)
        return self._files[name]


@dataclass(frozen=True, slots=True, eq=False)
class ArchiveSource:
    """The sweeps of an archive, scene by scene: a :class:`~viewshed.recordings.read.source.SweepSource`."""

    archive: Archive
    _damage: list[str] = field(default_factory=list)

    @classmethod
    def open(cls, place: Path | str) -> ArchiveSource:
        """Open the archive in a folder or at a URI; raises like :meth:`Archive.open`."""
        return cls(Archive.open(place))

    def scenes(self) -> tuple[str, ...]:
        """Return the names of the scenes, in order."""
        return self.archive.scenes

    def split(self, scene: str) -> str:
        """Return the name of a scene's split."""
        return next(shard.split for shard in self.archive.shards if shard.scene == scene)

    def refs(self, scene: str) -> list[SweepRef]:
        """Return the sweeps of a scene in time order, without those of unreadable shards."""
        if scene not in self.scenes():
            raise ValueError(f"scene must be one of the {len(self.scenes())} of the archive, got {scene!r}")
        rows: list[tuple[str, int, dict[str, Any]]] = []
        problems: list[str] = []
        for facts in self.archive.of_scenes([scene]).shards:
            try:
                rows += [(facts.name, frame, about) for frame, about in enumerate(self.archive.abouts(facts))]
            except (ValueError, OSError) as error:
                problems.append(str(error))
        self._damage.extend(problem for problem in problems if problem not in self._damage)
        if not rows:
            raise ValueError(problems[0])
        from viewshed.recordings.read.source import SweepRef  # slow: imports all readers of recordings

        rows.sort(key=lambda row: row[2].get("t_ns") or 0)
        return [
            SweepRef(scene, index, f"{self.archive.store.place}/{name}", about.get("t_ns"), str(about["agent"]),
                     key=f"{name}:{frame}")
            for index, (name, frame, about) in enumerate(rows)
        ]  # fmt: skip

    def read(self, ref: SweepRef) -> Sweep:
        """Return a sweep."""
        return self.sample(ref).sweep

    def measured(self, ref: SweepRef) -> StoredSweep | Sweep:
        """Return a sweep as stored: a range image, or points."""
        return self.sample(ref).measured

    def sample(self, ref: SweepRef) -> Sample:
        """Return a sweep with its truth."""
        name, _, frame = ref.key.rpartition(":")
        start = 0
        for facts in self.archive.shards:
            if facts.name == name and frame.isdigit() and int(frame) < facts.frames:
                return self.archive[start + int(frame)]
            start += facts.frames
        raise ValueError(f"ref must be one of {self.archive.store.place}, got {ref.key!r}")

    def boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return None: an archive has no boxes."""
        return None

    def damage(self) -> tuple[str, ...]:
        """Return one line for each shard that was found unreadable so far."""
        return tuple(self._damage)

    def notes(self) -> tuple[str, ...]:
        """Return nothing: an archive is always complete."""
        return ()


class _Archives:
    """Reads archives for commands that take recordings: :class:`viewshed.recordings.recording.DataSets`."""

    def open(self, place: Path | str) -> ArchiveSource:
        """Open the archive in a folder or at a URI."""
        return ArchiveSource.open(place)

    def sweeps(self, place: Path | str, split: str | None = None) -> Iterator[tuple[str, Sweep]]:
        """Yield (scene, sweep) of an archive, or of one of its splits."""
        archive = Archive.open(place)
        for sample in archive if split is None else archive.split(split):
            yield sample.scene, sample.sweep


ARCHIVES = _Archives()
"""Entry point of ``viewshed.recordings``."""
