"""Data sets: samples with truth, in archives of Parquet files."""

from __future__ import annotations

from viewshed.datasets.archive.archive import Archive
from viewshed.datasets.archive.build import ArchiveWriter, write_archive
from viewshed.datasets.archive.schema import SCHEMA_VERSION, Manifest, ShardFacts
from viewshed.datasets.archive.shard import write_shard
from viewshed.datasets.archive.storage import Storage
from viewshed.datasets.sample import Sample

__all__ = [
    "SCHEMA_VERSION",
    "Archive",
    "ArchiveWriter",
    "Manifest",
    "Sample",
    "ShardFacts",
    "Storage",
    "write_archive",
    "write_shard",
]
