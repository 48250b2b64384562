"""Data sets: samples with truth, in archives of Parquet files."""

from viewshed.datasets.archive import Archive
from viewshed.datasets.manifest import Manifest
from viewshed.datasets.sample import Sample
from viewshed.datasets.shard import SCHEMA_VERSION, ShardFacts, write_shard
from viewshed.datasets.store import Store
from viewshed.datasets.writer import ArchiveWriter, write_archive

__all__ = [
    "SCHEMA_VERSION",
    "Archive",
    "ArchiveWriter",
    "Manifest",
    "Sample",
    "ShardFacts",
    "Store",
    "write_archive",
    "write_shard",
]
