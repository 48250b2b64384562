"""Shard: one Parquet file with some frames of one scene, one row group a frame."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from itertools import chain
from typing import TYPE_CHECKING, Any

from viewshed.datasets.archive.columns import BLOBS, TOUCHED, Frame
from viewshed.datasets.archive.schema import Layout, Sensors
from viewshed.datasets.archive.storage import Storage
from viewshed.datasets.sample import Sample

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq


SCHEMA_VERSION = 1
"""Of the columns and of the text in the footer; a reader refuses any other."""

ZSTD_LEVEL = 1
"""Higher levels save little and cost much (docs/results/datasets.md)."""

REPAIR = "run the command that made the archive again, it writes anew only what is damaged or missing"

_KEY = "viewshed"


@dataclass(frozen=True, slots=True)
class ShardFacts:
    """What a manifest says about one shard.

    Attributes:
        name: of the file, in the archive's place.
        scene: all frames are from it.
        split: that the scene belongs to.
        frames: number of frames.
        bytes: length of the file.
        sha256: of the file.
    """

    name: str
    scene: str
    split: str
    frames: int
    bytes: int
    sha256: str

    @classmethod
    def from_json(cls, table: Any) -> ShardFacts:
        """Return the facts in plain values.

        Raises:
            ValueError: there are other keys or types, or a count below 1.
        """
        types = {"name": str, "scene": str, "split": str, "frames": int, "bytes": int, "sha256": str}
        if not isinstance(table, dict) or {key: type(value) for key, value in table.items()} != types:
            raise ValueError(f"a shard must have {', '.join(types)}, got {str(table)[:100]}")
        for key in ("frames", "bytes"):
            if table[key] < 1:
                raise ValueError(f"{key} must be at least 1, got {table[key]}")
        return cls(**table)

    def to_json(self) -> dict[str, Any]:
        """Return the facts as plain values."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class Footer:
    """What the footer of a shard says, besides Parquet's own.

    Attributes:
        scene: see :class:`ShardFacts`.
        split: see :class:`ShardFacts`.
        layout: of all its frames.
        sensors: beam tables that its frames name by number.
    """

    scene: str
    split: str
    layout: Layout
    sensors: Sensors

    def text(self) -> str:
        """Return the footer as JSON."""
        table = {"schema_version": SCHEMA_VERSION, "scene": self.scene, "split": self.split}
        return json.dumps(table | {"layout": self.layout.to_json(), "sensors": self.sensors.texts}, ensure_ascii=False)

    @classmethod
    def from_json(cls, table: Any) -> Footer:
        """Return the footer in plain values.

        Raises:
            ValueError: it is not a shard's.
        """
        try:
            sensors = Sensors([str(text) for text in table["sensors"]])
            return cls(str(table["scene"]), str(table["split"]), Layout.from_json(table["layout"]), sensors)
        except (KeyError, TypeError) as error:
            raise ValueError(f"the footer must have scene, split, layout and sensors: {error!r}") from error


def check_version(where: str, table: Any) -> None:
    """Check the schema version in the plain values read from ``where``.

    Raises:
        ValueError: it is another one than :data:`SCHEMA_VERSION`, or there is none.
    """
    version = table.get("schema_version") if isinstance(table, dict) else None
    if version != SCHEMA_VERSION:
        known = f"schema_version must be {SCHEMA_VERSION}, got {version!r}"
        raise ValueError(f"{where}: {known}; read it with the version of viewshed that wrote it")


@contextlib.contextmanager
def damage(where: str) -> Iterator[None]:
    """Give whatever a damaged file raises one line that names it and the repair.

    Raises:
        ValueError: the file is damaged.
    """
    import pyarrow as pa

    try:
        yield
    except (ValueError, KeyError, OSError, OverflowError, pa.ArrowException) as error:
        text = " ".join(str(error).split())
        said = text if len(text) <= 200 else f"{text[:199]}…"
        raise ValueError(f"{where} is damaged: {said}; {REPAIR}") from error


def write_shard(store: Storage, name: str, samples: Iterable[Sample]) -> ShardFacts:
    """Return the facts of the shard that holds ``samples``, written whole or not at all.

    Raises:
        ValueError: there are no samples, or they differ in scene, split, grid, targets or definitions.
        OSError: the file cannot be written.
    """
    iterator = iter(samples)
    first = next(iterator, None)
    if first is None:
        raise ValueError(f"{name} must have at least one frame; leave empty shards out")
    frames = (_checked(sample, first) for sample in chain([first], iterator))
    return write_frames(store, name, (first.scene, first.split), frames)


def write_frames(store: Storage, name: str, place: tuple[str, str], frames: Iterable[Frame]) -> ShardFacts:
    """Return the facts of the shard that holds ``frames`` of one (scene, split), written whole or not at all.

    Raises:
        ValueError: there are no frames, or they differ in layout.
        OSError: the file cannot be written.
    """
    content, count = _encoded(place, frames)
    store.write(name, content)
    digest = hashlib.sha256(content).hexdigest()
    return ShardFacts(name, *place, count, len(content), digest)


def _checked(sample: Sample, first: Sample) -> Frame:
    if (sample.scene, sample.split) != (first.scene, first.split):
        raise ValueError(
            f"a shard must hold one scene, got {sample.split}/{sample.scene} after {first.split}/{first.scene}; "
            "start another shard"
        )
    return Frame.of(sample)


def _encoded(place: tuple[str, str], frames: Iterable[Frame]) -> tuple[bytes, int]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    iterator = iter(frames)
    first = next(iterator, None)
    if first is None:
        raise ValueError("a shard must have at least one frame; leave empty shards out")
    sink, layout, sensors, count = pa.BufferOutputStream(), Layout.of(first.truth), Sensors(), 0
    schema = _schema(first.touched is not None)
    writer = pq.ParquetWriter(
        sink, schema, compression="zstd", compression_level=ZSTD_LEVEL,
        use_dictionary=False, write_statistics=False, write_page_checksum=True, store_schema=False,
    )  # fmt: skip
    for count, frame in enumerate(chain([first], iterator), 1):  # noqa: B007
        if (frame.touched is None) != (first.touched is None):
            raise ValueError("all frames of a shard must say what was touched, or none")
        row = frame.row(layout, sensors)
        columns = [pa.array([value], kind.type) for value, kind in zip(row, schema, strict=False)]
        writer.write_batch(pa.RecordBatch.from_arrays(columns, schema=schema))
    writer.add_key_value_metadata({_KEY: Footer(*place, layout, sensors).text()})
    writer.close()
    return sink.getvalue().to_pybytes(), count


def _schema(touched: bool) -> pa.Schema:
    import pyarrow as pa

    names = (*BLOBS, TOUCHED) if touched else BLOBS
    return pa.schema([("about", pa.string()), *((name, pa.binary()) for name in names)])


def _footer_table(metadata: pq.FileMetaData) -> Any:
    raw = (metadata.metadata or {}).get(_KEY.encode())
    if raw is None:
        raise ValueError("it is a Parquet file, but not a shard of an archive")
    return json.loads(raw)


class Shard:
    """An open shard; :meth:`frame` reads one frame.

    Args:
        store: the archive's place.
        name: of the file.
        content: of the file, if it was read before; None reads what is needed from the store.
        metadata: of this file, if it was read before; opening is faster with it.

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
        with damage(self.name):
            self._file = pq.ParquetFile(file, metadata=metadata, page_checksum_verification=True)
            table = _footer_table(self._file.metadata)
        check_version(self.name, table)
        with damage(self.name):
            self.footer = Footer.from_json(table)

    @property
    def metadata(self) -> pq.FileMetaData:
        """Parquet's own footer."""
        return self._file.metadata

    def __len__(self) -> int:
        return int(self._file.metadata.num_row_groups)

    def check(self, facts: ShardFacts, layout: Layout) -> None:
        """Compare what a manifest says with the shard's own footer: a manifest is a text that anybody can edit.

        Raises:
            ValueError: they differ.
        """
        rows = self._file.metadata.num_rows
        own = {
            "scene": self.footer.scene,
            "split": self.footer.split,
            "frames": len(self),
            "layout": self.footer.layout,
        }
        listed = {"scene": facts.scene, "split": facts.split, "frames": facts.frames, "layout": layout}
        with damage(self.name):
            for key, value in listed.items():
                if own[key] != value:
                    raise ValueError(f"{key} must be {value!r}, as in the manifest, got {own[key]!r}")
            if rows != len(self):
                raise ValueError(f"a row group must hold one frame, got {rows} rows in {len(self)}")

    def frame(self, index: int) -> Frame:
        """Return the frame with this number.

        Raises:
            ValueError: the file is damaged.
        """
        with damage(self.name):
            batch = self._file.read_row_group(index, use_threads=False)
            about, *blobs = (batch.column(name)[0] for name in ("about", *BLOBS))
            touched = batch.column(TOUCHED)[0].as_buffer() if TOUCHED in batch.column_names else None
            row = (about.as_py(), *(blob.as_buffer() for blob in blobs), touched)
            return Frame.from_row(row, self.footer.layout, self.footer.sensors)

    def close(self) -> None:
        """Give the file back."""
        self._file.close(force=True)
