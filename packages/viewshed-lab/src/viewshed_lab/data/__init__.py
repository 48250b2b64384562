"""Data sets: samples with truth, stored in archives of Parquet files, and labels for recordings."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from viewshed_lab.data.archive.archive import Archive
    from viewshed_lab.data.archive.build import write_archive
    from viewshed_lab.data.archive.schema import SCHEMA_VERSION, Manifest, ShardFacts
    from viewshed_lab.data.archive.shard import write_shard
    from viewshed_lab.data.archive.storage import Storage
    from viewshed_lab.data.release import open_release
    from viewshed_lab.data.sample import Sample

_HOMES = {
    "SCHEMA_VERSION": "archive.schema", "Archive": "archive.archive", "Manifest": "archive.schema", "Sample": "sample",
    "ShardFacts": "archive.schema", "Storage": "archive.storage", "open_release": "release",
    "write_archive": "archive.build", "write_shard": "archive.shard",
}  # fmt: skip

__all__ = [
    "SCHEMA_VERSION", "Archive", "Manifest", "Sample", "ShardFacts", "Storage", "open_release", "write_archive",
    "write_shard",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import a name on first use, so that reading a recording does not import what archives and truth need."""
    if name not in _HOMES:
        raise AttributeError(f"module 'viewshed_lab.data' has no attribute {name!r}")
    return getattr(import_module(f"viewshed_lab.data.{_HOMES[name]}"), name)
