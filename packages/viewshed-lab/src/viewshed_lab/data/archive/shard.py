"""Shard: one Parquet file with frames of one scene, one row group per frame."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from itertools import chain
from typing import TYPE_CHECKING, Any

from viewshed._extras import needed_for
from viewshed_lab.data.archive.columns import BLOBS, TOUCHED, Row, row_of_sample, sample_of_row
from viewshed_lab.data.archive.schema import REPAIR, Footer, Layout, Sensors, ShardFacts, check_version, reading
from viewshed_lab.data.archive.storage import Storage
from viewshed_lab.data.sample import Sample

if TYPE_CHECKING:
    import pyarrow.parquet as pq


ZSTD_LEVEL = 1
"""Higher levels save little space and cost much time (docs/results/datasets.md)."""

_KEY = "viewshed"


def write_shard(store: Storage, name: str, samples: Iterable[Sample]) -> ShardFacts:
    """Write ``samples`` to a shard, atomically, and return its facts.

    Raises:
        ValueError: there are no samples, or they differ in scene, split, grid, targets or definitions.
        OSError: the file cannot be written.
    """
    iterator = iter(samples)
    first = next(iterator, None)
    if first is None:
        raise ValueError(f"{name} must have at least one frame; leave empty shards out")
    content, count = _encode(first, iterator)
    store.write(name, content)
    return ShardFacts(name, first.scene, first.split, count, len(content), hashlib.sha256(content).hexdigest())


def _encode(first: Sample, rest: Iterable[Sample]) -> tuple[bytes, int]:
    """Return the content of a Parquet file of samples, and their number; only one sample is in memory at a time."""
    with needed_for("a data set in an archive"):
        import pyarrow as pa
        import pyarrow.parquet as pq
    sink, layout, sensors, count = pa.BufferOutputStream(), Layout.of(first.truth), Sensors(), 0
    names = (*BLOBS, TOUCHED) if first.tampered is not None else BLOBS
    schema = pa.schema([("about", pa.string()), *((name, pa.binary()) for name in names)])
    writer = pq.ParquetWriter(
        sink, schema, compression="zstd", compression_level=ZSTD_LEVEL,
        use_dictionary=False, write_statistics=False, write_page_checksum=True, store_schema=False,
    )  # fmt: skip
    for count, sample in enumerate(chain([first], rest), 1):  # noqa: B007
        if (sample.scene, sample.split) != (first.scene, first.split):
            raise ValueError(
                f"a shard must hold one scene, got {sample.split}/{sample.scene} after {first.split}/{first.scene}; "
                "start another shard"
            )
        if (sample.tampered is None) != (first.tampered is None):
            raise ValueError("all frames of a shard must record their tampering, or none")
        row = row_of_sample(sample, layout, sensors)
        columns = [pa.array([value], kind.type) for value, kind in zip(row, schema, strict=False)]
        writer.write_batch(pa.RecordBatch.from_arrays(columns, schema=schema))
    writer.add_key_value_metadata({_KEY: Footer(first.scene, first.split, layout, sensors).to_text()})
    writer.close()
    return sink.getvalue().to_pybytes(), count


class Shard:
    """An open shard; :meth:`sample` reads one frame.

    Args:
        store: location of the archive.
        name: of the file.
        content: of the file, if already read; None reads what is needed from the store.
        metadata: of the file, if already read, for faster opening.

    Raises:
        ValueError: the file is damaged or of another schema version.
        OSError: it cannot be read.
    """

    def __init__(
        self, store: Storage, name: str, content: bytes | None = None, metadata: pq.FileMetaData | None = None
    ) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        self.name = f"{store.place}/{name}"
        file = store.open(name) if content is None else pa.BufferReader(content)
        with reading(self.name):
            self._file = pq.ParquetFile(file, metadata=metadata, page_checksum_verification=True)
            raw = (self._file.metadata.metadata or {}).get(_KEY.encode())
            if raw is None:
                raise ValueError("it is a Parquet file, but not a shard of an archive")
            table = json.loads(raw)
        check_version(self.name, table)
        with reading(self.name):
            self.footer = Footer.from_json(table)

    @property
    def metadata(self) -> pq.FileMetaData:
        """The Parquet footer."""
        return self._file.metadata

    def __len__(self) -> int:
        return int(self._file.metadata.num_row_groups)

    def check(self, facts: ShardFacts, layout: Layout) -> None:
        """Raise a ValueError if the manifest, which anybody can edit, differs from the shard's own footer."""
        rows = self._file.metadata.num_rows
        own = {
            "scene": self.footer.scene, "split": self.footer.split, "frames": len(self), "layout": self.footer.layout,
        }  # fmt: skip
        listed = {"scene": facts.scene, "split": facts.split, "frames": facts.frames, "layout": layout}
        with reading(self.name):
            for key, value in listed.items():
                if own[key] != value:
                    raise ValueError(f"{key} must be {value!r}, as in the manifest, got {own[key]!r}")
            if rows != len(self):
                raise ValueError(f"a row group must hold one frame, got {rows} rows in {len(self)}")

    def sample(self, index: int) -> Sample:
        """Return sample ``index``; its points are computed on first use."""
        with reading(self.name):
            batch = self._file.read_row_group(index, use_threads=False)
            about, *blobs = (batch.column(name)[0] for name in ("about", *BLOBS))
            touched = batch.column(TOUCHED)[0].as_buffer() if TOUCHED in batch.column_names else None
            row: Row = (about.as_py(), *(blob.as_buffer() for blob in blobs), touched)
            return sample_of_row(row, self.footer)

    def abouts(self) -> list[dict[str, Any]]:
        """Return the metadata of each frame, without reading its arrays."""
        with reading(self.name):
            return [json.loads(text) for text in self._file.read(columns=["about"]).column("about").to_pylist()]

    def close(self) -> None:
        """Close the file."""
        self._file.close(force=True)


def damage_of(store: Storage, facts: ShardFacts, layout: Layout) -> str | None:
    """Return a one-line reason why a shard differs from the manifest, or None if it does not."""
    try:
        content = store.read(facts.name)
    except OSError as error:
        return f"{error}; {REPAIR}"
    where = f"{store.place}/{facts.name} is damaged"
    if len(content) != facts.bytes:
        return f"{where}: it must have {facts.bytes} bytes, got {len(content)}; {REPAIR}"
    if hashlib.sha256(content).hexdigest() != facts.sha256:
        return f"{where}: its checksum is not the manifest's; {REPAIR}"
    try:
        Shard(store, facts.name, content).check(facts, layout)
    except ValueError as error:
        return str(error)
    return None
