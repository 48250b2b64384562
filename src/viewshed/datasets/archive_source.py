"""An archive as a recording: whoever reads it as one gets its sweeps, and nothing of its truth."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from viewshed.datasets.archive import Archive
from viewshed.datasets.manifest import MANIFEST
from viewshed.datasets.sample import Sample
from viewshed.datasets.shard import ShardFacts, damage
from viewshed.datasets.source import ObjectBox, SweepRef
from viewshed.sim.range_image import RangeImage
from viewshed.sweep import Sweep

LAYOUT = f"a folder with {MANIFEST}, made by viewshed"


@dataclass(frozen=True, slots=True, eq=False)
class ArchiveSource:
    """The sweeps of an archive, scene by scene.

    Attributes:
        archive: that holds them.
    """

    archive: Archive
    _damage: list[str] = field(default_factory=list)

    @classmethod
    def open(cls, place: Path | str) -> ArchiveSource:
        """Return the archive in a folder or at a URI.

        Raises:
            ValueError: it is no archive, not finished, damaged, or of another schema version.
            OSError: it cannot be read.
        """
        return cls(Archive.open(place))

    def scenes(self) -> tuple[str, ...]:
        """Return the names of the scenes, in order."""
        return self.archive.scenes

    def split(self, scene: str) -> str:
        """Return the name of the split that a scene belongs to."""
        return next(shard.split for shard in self.archive.shards if shard.scene == scene)

    def refs(self, scene: str) -> list[SweepRef]:
        """Return the sweeps of a scene in time order; of a shard that cannot be read there are none.

        Raises:
            ValueError: there is no such scene, or no shard of it can be read.
        """
        if scene not in self.scenes():
            raise ValueError(f"scene must be one of the {len(self.scenes())} of the archive, got {scene!r}")
        rows: list[tuple[str, int, dict[str, Any]]] = []
        problems: list[str] = []
        for facts in self.archive.of_scenes([scene]).shards:
            try:
                rows += [(facts.name, frame, about) for frame, about in enumerate(self._about(facts))]
            except (ValueError, OSError) as error:
                problems.append(str(error))
        self._damage.extend(problem for problem in problems if problem not in self._damage)
        if not rows:
            raise ValueError(problems[0])
        rows.sort(key=lambda row: row[2].get("t_ns") or 0)
        return [
            SweepRef(scene, index, f"{self.archive.store.place}/{name}", about.get("t_ns"), str(about["agent"]),
                     key=f"{name}:{frame}")
            for index, (name, frame, about) in enumerate(rows)
        ]  # fmt: skip

    def read(self, ref: SweepRef) -> Sweep:
        """Return a sweep.

        Raises:
            ValueError: its shard is damaged, or the ref is not of this archive.
            OSError: its shard cannot be read.
        """
        measured = self.measured(ref)
        return measured.sweep() if isinstance(measured, RangeImage) else measured

    def measured(self, ref: SweepRef) -> RangeImage | Sweep:
        """Return a sweep as it is stored: the range image where there is one; errors as :meth:`read`."""
        return self.archive.frame(self._place(ref))[0].measured

    def sample(self, ref: SweepRef) -> Sample:
        """Return a sweep with its truth, to compare with; errors as :meth:`read`."""
        return self.archive[self._place(ref)]

    def _place(self, ref: SweepRef) -> int:
        name, _, frame = ref.key.rpartition(":")
        start = 0
        for facts in self.archive.shards:
            if facts.name == name and frame.isdigit() and int(frame) < facts.frames:
                return start + int(frame)
            start += facts.frames
        raise ValueError(f"ref must be one of {self.archive.store.place}, got {ref.key!r}")

    def boxes(self, ref: SweepRef) -> tuple[ObjectBox, ...] | None:
        """Return None: an archive has no boxes."""
        return None

    def damage(self) -> tuple[str, ...]:
        """Return one line for each shard that could not be read so far."""
        return tuple(self._damage)

    def _about(self, facts: ShardFacts) -> list[dict[str, Any]]:
        import pyarrow.parquet as pq

        where = f"{self.archive.store.place}/{facts.name}"
        with damage(where), self.archive.store.open(facts.name) as file:
            texts = pq.read_table(file, columns=["about"]).column("about").to_pylist()
            return [json.loads(text) for text in texts]


def is_archive(place: Path) -> bool:
    """Return whether a folder holds an archive, from its names alone."""
    return (place / MANIFEST).is_file()
