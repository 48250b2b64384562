"""ArchiveWriter: samples of any origin into an archive."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from typing import Any

from viewshed.datasets.archive import Archive
from viewshed.datasets.layout import Layout
from viewshed.datasets.manifest import Manifest
from viewshed.datasets.sample import Sample
from viewshed.datasets.shard import ShardFacts, write_shard
from viewshed.datasets.store import Store

FRAMES_PER_SHARD = 48


class ArchiveWriter:
    """Writes samples into a new archive, shard by shard; :meth:`close` writes the manifest.

    Samples of one scene should follow each other: a shard holds one scene. Nothing can be read before ``close``.

    Args:
        place: a folder or a URI that is empty.
        recipe: how the samples were made, as plain values, for the manifest.
        frames_per_shard: at most.

    Raises:
        ValueError: the place is not empty, or ``frames_per_shard`` is below 1.
    """

    def __init__(
        self, place: str | os.PathLike[str], recipe: Mapping[str, Any], frames_per_shard: int = FRAMES_PER_SHARD
    ) -> None:
        if frames_per_shard < 1:
            raise ValueError(f"frames_per_shard must be at least 1, got {frames_per_shard}")
        self._store = Store.of(place)
        if self._store.names():
            raise ValueError(f"{self._store.place} must be empty; choose another place")
        self._recipe = dict(recipe)
        self._frames_per_shard = frames_per_shard
        self._pending: list[Sample] = []
        self._shards: list[ShardFacts] = []
        self._layout: Layout | None = None

    def add(self, sample: Sample) -> None:
        """Take one sample; a full shard is written.

        Raises:
            ValueError: its scene is empty or its truth differs in grid, targets or definitions from those before.
            OSError: the shard cannot be written.
        """
        layout = Layout.of(sample.truth)
        self._layout = self._layout or layout
        if layout != self._layout:
            raise ValueError(f"truth must have the layout of the archive, {self._layout}, got {layout}")
        last = self._pending[-1] if self._pending else sample
        if (sample.scene, sample.split) != (last.scene, last.split) or len(self._pending) >= self._frames_per_shard:
            self._flush()
        self._pending.append(sample)

    def close(self) -> Archive:
        """Write what is left and the manifest, and return the archive.

        Raises:
            ValueError: there was no sample.
            OSError: a file cannot be written.
        """
        self._flush()
        if self._layout is None:
            raise ValueError("an archive must have at least one sample, got none")
        manifest = Manifest(self._recipe, self._layout, tuple(self._shards))
        manifest.write(self._store)
        return Archive(self._store, manifest)

    def _flush(self) -> None:
        if self._pending:
            name = f"shard-{len(self._shards):05d}.parquet"
            self._shards.append(write_shard(self._store, name, self._pending))
            self._pending = []


def write_archive(place: str | os.PathLike[str], samples: Iterable[Sample], recipe: Mapping[str, Any]) -> Archive:
    """Return the archive that ``samples`` were written to; see :class:`ArchiveWriter`.

    Raises:
        ValueError: the place is not empty, there are no samples, or they differ in grid, targets or definitions.
        OSError: a file cannot be written.
    """
    writer = ArchiveWriter(place, recipe)
    for sample in samples:
        writer.add(sample)
    return writer.close()
