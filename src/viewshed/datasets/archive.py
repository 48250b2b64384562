"""Archive: a data set in Parquet shards with a manifest, read frame by frame."""

from __future__ import annotations

import hashlib
import os
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import accumulate
from typing import TYPE_CHECKING

import numpy as np

from viewshed.datasets.frame import Frame
from viewshed.datasets.manifest import Manifest
from viewshed.datasets.sample import Sample
from viewshed.datasets.shard import REPAIR, Shard, ShardFacts
from viewshed.datasets.store import Store

if TYPE_CHECKING:
    import pyarrow.parquet as pq

OPEN_SHARDS = 64
"""Files that an archive keeps open at a time."""


class Archive:
    """A data set of samples in order, from :meth:`open`; also one of its splits or some of its scenes.

    It may be sent to other processes and used after a fork: files are opened by the process that reads them.

    Args:
        store: where it lies.
        manifest: what it holds and how it was made.
        shards: those that belong to it; None is all.
    """

    def __init__(self, store: Store, manifest: Manifest, shards: Iterable[ShardFacts] | None = None) -> None:
        self.store = store
        self.manifest = manifest
        self.shards = tuple(manifest.shards if shards is None else shards)
        self._ends = np.array(list(accumulate(shard.frames for shard in self.shards)), np.int64)
        self._files = _Files(store)

    @classmethod
    def open(cls, place: str | os.PathLike[str]) -> Archive:
        """Return the archive in a folder or at a URI.

        Raises:
            ValueError: it is no archive, not finished, damaged, or of another schema version.
            OSError: it cannot be read.
        """
        store = Store.of(place)
        manifest = Manifest.read(store)
        if not manifest.complete:
            raise ValueError(f"{store.place} is not finished; run the command that makes it again")
        return cls(store, manifest)

    def __len__(self) -> int:
        return int(self._ends[-1]) if len(self._ends) else 0

    def __getitem__(self, index: int) -> Sample:
        """Return one sample.

        Raises:
            IndexError: there is no such frame.
            ValueError: its shard is damaged.
            OSError: its shard cannot be read.
        """
        frame, shard = self.frame(index)
        return frame.sample(shard.scene, shard.split)

    def frame(self, index: int) -> tuple[Frame, ShardFacts]:
        """Return one frame as it is stored, its points not made yet, and the shard that it is in; errors as ``[]``."""
        count = len(self)
        if not -count <= index < count:
            raise IndexError(f"index must lie in [{-count}, {count}), got {index}")
        index %= count
        number = int(np.searchsorted(self._ends, index, side="right"))
        facts = self.shards[number]
        return self._files.shard(facts.name).frame(index - int(self._ends[number]) + facts.frames), facts

    def __iter__(self) -> Iterator[Sample]:
        return self.samples()

    def samples(self, on_damage: Callable[[ShardFacts, str], None] | None = None) -> Iterator[Sample]:
        """Yield the samples in order.

        Args:
            on_damage: is told of a shard that cannot be read and why, and the rest of that shard is left out; None
                raises instead.

        Raises:
            ValueError: a shard is damaged, and nobody is told of it.
            OSError: a shard cannot be read, and nobody is told of it.
        """
        for facts in self.shards:
            try:
                shard = self._files.shard(facts.name)
                for index in range(facts.frames):
                    yield shard.frame(index).sample(facts.scene, facts.split)
            except (ValueError, OSError) as error:
                if on_damage is None:
                    raise
                on_damage(facts, str(error))

    @property
    def scenes(self) -> tuple[str, ...]:
        """Names of the scenes, in order."""
        return tuple(dict.fromkeys(shard.scene for shard in self.shards))

    @property
    def splits(self) -> tuple[str, ...]:
        """Names of the splits, in order."""
        return tuple(dict.fromkeys(shard.split for shard in self.shards))

    def split(self, name: str) -> Archive:
        """Return the scenes of one split.

        Raises:
            ValueError: there is no such split.
        """
        if name not in self.splits:
            raise ValueError(f"split must be one of {', '.join(self.splits)}, got {name!r}")
        return self._with(shard for shard in self.shards if shard.split == name)

    def of_scenes(self, scenes: Iterable[str]) -> Archive:
        """Return the frames of some scenes.

        Raises:
            ValueError: there is no such scene.
        """
        wanted = set(scenes)
        if not wanted <= set(self.scenes):
            raise ValueError(f"scenes must be among those of the archive, got {sorted(wanted - set(self.scenes))}")
        return self._with(shard for shard in self.shards if shard.scene in wanted)

    def folds(self, count: int, seed: int = 0) -> Iterator[tuple[Archive, Archive]]:
        """Yield ``count`` pairs (rest, held out) for cross-validation; no scene is in both, each is held out once.

        Raises:
            ValueError: there are fewer scenes than folds, or fewer than two folds.
        """
        scenes = self.scenes
        if not 2 <= count <= len(scenes):
            raise ValueError(f"count must lie in [2, {len(scenes)}], the number of scenes, got {count}")
        order = np.random.default_rng(seed).permutation(len(scenes))
        for fold in range(count):
            held = {scenes[k] for k in order[fold::count]}
            yield self.of_scenes(set(scenes) - held), self.of_scenes(held)

    def verify(self) -> Iterator[tuple[ShardFacts, str | None]]:
        """Yield each shard with what is wrong with it in one line, or None: its length and checksum are compared."""
        for facts in self.shards:
            yield facts, damage_of(self.store, facts)

    def _with(self, shards: Iterable[ShardFacts]) -> Archive:
        return Archive(self.store, self.manifest, shards)


def damage_of(store: Store, facts: ShardFacts) -> str | None:
    """Return one line that says why a shard is not the one that was written, or None if it is."""
    try:
        content = store.read(facts.name)
    except OSError as error:
        return f"{error}; {REPAIR}"
    where = f"{store.place}/{facts.name} is damaged"
    if len(content) != facts.bytes:
        return f"{where}: it must have {facts.bytes} bytes, got {len(content)}; {REPAIR}"
    if hashlib.sha256(content).hexdigest() != facts.sha256:
        return f"{where}: its checksum is not the manifest's; {REPAIR}"
    return None


@dataclass(slots=True)
class _Open:
    """What one process has open: files (a few, the last used) and footers (all that were read)."""

    process: int
    files: OrderedDict[str, Shard]
    footers: dict[str, pq.FileMetaData]


class _Files:
    """Opens shards when they are first read, again in each process."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._open = _Open(os.getpid(), OrderedDict(), {})

    def __getstate__(self) -> Store:
        return self._store

    def __setstate__(self, store: Store) -> None:
        self.__init__(store)  # type: ignore[misc]

    def shard(self, name: str) -> Shard:
        """Return an open shard."""
        if self._open.process != os.getpid():
            self._open = _Open(os.getpid(), OrderedDict(), self._open.footers)
        files, footers = self._open.files, self._open.footers
        if name not in files:
            files[name] = Shard(self._store, name, footers.get(name))
            footers[name] = files[name].metadata
            if len(files) > OPEN_SHARDS:
                files.popitem(last=False)[1].close()
        files.move_to_end(name)
        return files[name]
