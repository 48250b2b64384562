"""Manifest: what an archive holds and how it was made, in ``manifest.json``."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import viewshed
from viewshed.datasets.archive.schema import Layout
from viewshed.datasets.archive.shard import SCHEMA_VERSION, ShardFacts, check_version, damage
from viewshed.datasets.archive.storage import Storage

MANIFEST = "manifest.json"

_KIND = "viewshed archive"


def code_version(commits: Sequence[str] = ()) -> dict[str, Any]:
    """Return the version of this code and its commit, if that is known, among ``commits`` of earlier runs."""
    own = _commit(Path(viewshed.__file__).resolve().parents[2])
    return {"version": viewshed.__version__, "commits": sorted({*commits, *([own] if own else [])})}


def _commit(checkout: Path) -> str | None:
    """Return the commit that a checkout's HEAD names, read from git's own files; None where it is no checkout."""
    git = checkout / ".git"
    try:
        head = (git / "HEAD").read_text(encoding="utf-8").strip()
        if not head.startswith("ref: "):
            return head
        ref = head.removeprefix("ref: ")
        if (git / ref).is_file():
            return (git / ref).read_text(encoding="utf-8").strip()
        packed = (git / "packed-refs").read_text(encoding="utf-8").splitlines()
    except OSError:
        return None
    return next((line.split()[0] for line in packed if line.endswith(f" {ref}")), None)


@dataclass(frozen=True, slots=True)
class Manifest:
    """What an archive holds and how it was made. It names no machine and no time.

    Attributes:
        recipe: how the frames were made, as plain values: the command, preset, configuration and seeds.
        layout: what all frames have in common.
        shards: in the order of the archive.
        complete: False while shards are still being written.
        code: version and commits of the code that wrote it.
    """

    recipe: Mapping[str, Any]
    layout: Layout
    shards: tuple[ShardFacts, ...] = ()
    complete: bool = True
    code: Mapping[str, Any] = field(default_factory=code_version)

    @property
    def frames(self) -> int:
        """Number of frames."""
        return sum(shard.frames for shard in self.shards)

    def text(self) -> str:
        """Return the manifest as JSON, one shard a line."""
        about = {
            "kind": _KIND,
            "schema_version": SCHEMA_VERSION,
            "complete": self.complete,
            "code": dict(self.code),
            "recipe": dict(self.recipe),
            "layout": self.layout.to_json(),
            "frames": self.frames,
        }
        head = json.dumps(about, indent=1, ensure_ascii=False)[: -len("\n}")]
        lines = ",\n".join(f"  {json.dumps(shard.to_json(), ensure_ascii=False)}" for shard in self.shards)
        return f'{head},\n "shards": [\n{lines}\n ]\n}}\n'

    def write(self, store: Storage) -> None:
        """Write the manifest into the archive's place.

        Raises:
            OSError: it cannot be written.
        """
        store.write(MANIFEST, self.text().encode())

    @classmethod
    def read(cls, store: Storage) -> Manifest:
        """Return the manifest in a place.

        Raises:
            ValueError: it is damaged, of another schema version, or there is none.
            OSError: it cannot be read.
        """
        where = f"{store.place}/{MANIFEST}"
        try:
            raw = store.read(MANIFEST)
        except FileNotFoundError as error:
            raise ValueError(f"{store.place} must be an archive, but has no {MANIFEST}") from error
        with damage(where):
            table = json.loads(raw)
        check_version(where, table)
        with damage(where):
            return cls._of(table)

    @classmethod
    def _of(cls, table: dict[str, Any]) -> Manifest:
        shards = tuple(ShardFacts.from_json(shard) for shard in table["shards"])
        twice = [name for name, count in Counter(shard.name for shard in shards).items() if count > 1]
        if twice:
            raise ValueError(f"it lists {twice[0]} twice")
        total = sum(shard.frames for shard in shards)
        if table["frames"] != total:
            raise ValueError(f"frames must be {total}, those of all shards, got {table['frames']}")
        recipe, code = table["recipe"], table["code"]
        if table["kind"] != _KIND or not isinstance(recipe, dict) or not isinstance(code, dict):
            raise ValueError("it must have kind, recipe, code, layout and shards")
        return cls(recipe, Layout.from_json(table["layout"]), shards, table["complete"] is True, code)
