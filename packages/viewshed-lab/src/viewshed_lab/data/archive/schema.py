"""Archive format: layout of all frames, footer of a shard, manifest.

An archive is a folder (or a prefix of an object store) with Parquet files, the shards, and ``manifest.json``. A shard
holds frames of one scene, one row group per frame, zstd level 1, with page checksums. Its columns
(:mod:`viewshed_lab.data.archive.columns`):

- ``about``: JSON with agent, ``t_ns``, sensor (number of a beam table in the footer), height, pose, motion; for points
  their number, columns, attitude and rarely used fields; ``clean`` of an attacked sweep.
- ``ranges``: uint16 range steps (C, R): per ring the zigzag differences along the columns, all low bytes, then all
  high bytes; null for points.
- ``intensity``: uint8 (C, R); null for points.
- ``points``: for sweeps without a range image, and for rows that an attacker added: x y z float32, then the columns
  that ``about`` names, each as all first bytes, all second bytes, and so on; else null.
- ``returns``: uint8 (targets, cells, cells): expected returns up to 255.
- ``states``: (targets, cells, cells) of 0 to 3, four per byte, the first in the lowest bits.
- ``touched``: only in attacked data sets: rows that an attacker added, rows that were removed, the wedge.
- ``masks``: (definitions + 1, cells, cells), eight per byte, the first in the highest bit; the last mask is where the
  truth is known.

The values that all frames share are in the shard's :class:`Footer`, as JSON under ``viewshed``. The :class:`Manifest`
lists the shards; while shards are being written it has ``"complete": false``. ``problems.json`` lists what was left out
of a finished data set. A damaged shard raises one line that names it; a manifest that does not fit its shards is
rejected. Checksums detect damage, not forgery: whoever can write the shards can also write the manifest.
"""

from __future__ import annotations

import contextlib
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import viewshed
from viewshed.fov.truth import Truth
from viewshed.grid import BevGrid
from viewshed.io._input import one_line
from viewshed.sensors import LidarModel, lidar_model, sensor_names
from viewshed_lab.data.archive.storage import Storage

SCHEMA_VERSION = 1
"""Version of the columns, footer and manifest; readers reject any other."""

MANIFEST = "manifest.json"
REPAIR = "run again the command that made the archive; it rewrites only what is damaged or missing"
_KIND = "viewshed archive"


def check_version(where: str, table: Any) -> None:
    """Check that the table read from ``where`` has version :data:`SCHEMA_VERSION`."""
    version = table.get("schema_version") if isinstance(table, dict) else None
    if version != SCHEMA_VERSION:
        known = f"schema_version must be {SCHEMA_VERSION}, got {version!r}"
        raise ValueError(f"{where}: {known}; read it with the version of viewshed that wrote it")


@contextlib.contextmanager
def reading(where: str) -> Iterator[None]:
    """Turn every error of a damaged file into a ValueError: one line with the file and the repair."""
    import pyarrow as pa

    try:
        yield
    except (ValueError, KeyError, TypeError, OSError, OverflowError, RecursionError, pa.ArrowException) as error:
        raise ValueError(f"{where} is damaged: {one_line(error, 200)}; {REPAIR}") from error


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of the truth, the same for all frames of an archive."""

    grid: BevGrid  # of the truth
    targets: tuple[str, ...]  # names of the truth's targets, in stored order
    definitions: tuple[str, ...]  # names of the truth's other definitions, in stored order

    @classmethod
    def of(cls, truth: Truth) -> Layout:
        """Return the layout of a truth."""
        return cls(truth.grid, tuple(sorted(truth.expected_returns)), tuple(sorted(truth.definitions)))

    @classmethod
    def from_json(cls, table: Any) -> Layout:
        """Return the layout of a table of :meth:`to_json`; raise a ValueError if it is not one."""
        try:
            x, y = table["offset_m"]
            grid = BevGrid(int(table["cells"]), float(table["half_extent_m"]), (float(x), float(y)))
            return cls(grid, tuple(table["targets"]), tuple(table["definitions"]))
        except (KeyError, TypeError) as error:
            raise ValueError(f"a layout must have grid, targets and definitions: {error!r}") from error

    def to_json(self) -> dict[str, Any]:
        """Return the layout as a table of plain values."""
        return {
            "cells": self.grid.cells,
            "half_extent_m": float(self.grid.half_extent_m),
            "offset_m": [float(value) for value in self.grid.offset_m],
            "targets": list(self.targets),
            "definitions": list(self.definitions),
        }


_LISTS = ("elevation", "azimuth_offset", "origin_m")
_SINGLES = ("name", "azimuth_columns", "min_range_m", "max_range_m", "source")


@lru_cache(maxsize=256)
def text_of_model(model: LidarModel) -> str:
    """Return a beam table as one line of JSON, angles in radians; equal tables give equal text.

    The reach of a shipped table is left out: its beams identify the table.
    """
    text = _text_of(model)
    shipped = _shipped_models().get(text)
    if model.reach_m is None or (shipped is not None and shipped.reach_m == model.reach_m):
        return text
    return _text_of(model, reach_m=model.reach_m, reach_source=model.reach_source)


def _text_of(model: LidarModel, **more: Any) -> str:
    table: dict[str, Any] = {key: getattr(model, key) for key in _SINGLES} | more
    table |= {key: getattr(model, key).tolist() for key in _LISTS}
    if not model.fires_rings:
        table["fires_rings"] = False
    return json.dumps(table, sort_keys=True, ensure_ascii=False)


@lru_cache(maxsize=256)
def model_of_text(text: str) -> LidarModel:
    """Return the beam table of a line of :func:`text_of_model`; for a shipped table, the shipped object."""
    shipped = _shipped_models().get(text)
    if shipped is not None:
        return shipped
    try:
        table = json.loads(text)
        return LidarModel(
            **{key: table[key] for key in (*_SINGLES, *_LISTS)}, fires_rings=table.get("fires_rings", True),
            reach_m=table.get("reach_m"), reach_source=table.get("reach_source", ""),
        )  # fmt: skip
    except (KeyError, TypeError) as error:
        raise ValueError(f"a beam table must have the keys {', '.join((*_SINGLES, *_LISTS))}: {error}") from error


@lru_cache(maxsize=1)
def _shipped_models() -> dict[str, LidarModel]:
    return {_text_of(model): model for model in map(lidar_model, sensor_names())}


@dataclass(slots=True)
class Sensors:
    """Beam tables of one shard, numbered in order of first use."""

    texts: list[str] = field(default_factory=list)

    def number(self, model: LidarModel | None) -> int | None:
        """Return the number of a beam table, adding it if it is new; None for None."""
        if model is None:
            return None
        text = text_of_model(model)
        if text not in self.texts:
            self.texts.append(text)
        return self.texts.index(text)

    def model(self, number: int | None) -> LidarModel | None:
        """Return the beam table with this number."""
        return None if number is None else model_of_text(self.texts[number])


@dataclass(frozen=True, slots=True)
class Footer:
    """Our entry in the Parquet footer of a shard."""

    scene: str  # of all frames
    split: str  # of the scene
    layout: Layout  # of all frames
    sensors: Sensors  # beam tables that the frames refer to by number

    def to_text(self) -> str:
        """Return the footer as JSON."""
        table = {"schema_version": SCHEMA_VERSION, "scene": self.scene, "split": self.split}
        return json.dumps(table | {"layout": self.layout.to_json(), "sensors": self.sensors.texts}, ensure_ascii=False)

    @classmethod
    def from_json(cls, table: Any) -> Footer:
        """Return the footer of a table; raise a ValueError if it is not a shard's."""
        try:
            sensors = Sensors([str(text) for text in table["sensors"]])
            return cls(str(table["scene"]), str(table["split"]), Layout.from_json(table["layout"]), sensors)
        except (KeyError, TypeError) as error:
            raise ValueError(f"the footer must have scene, split, layout and sensors: {error!r}") from error


@dataclass(frozen=True, slots=True)
class ShardFacts:
    """Entry of a shard in the manifest."""

    name: str  # of the file, relative to the archive
    scene: str  # of all frames
    split: str  # of the scene
    frames: int  # number of frames, at least 1
    bytes: int  # length of the file
    sha256: str  # of the file

    @classmethod
    def from_json(cls, table: Any) -> ShardFacts:
        """Return the facts of a table; raise a ValueError for wrong keys or types, or a count below 1."""
        types = {"name": str, "scene": str, "split": str, "frames": int, "bytes": int, "sha256": str}
        if not isinstance(table, dict) or {key: type(value) for key, value in table.items()} != types:
            raise ValueError(f"a shard must have {', '.join(types)}, got {str(table)[:100]}")
        for key in ("frames", "bytes"):
            if table[key] < 1:
                raise ValueError(f"{key} must be at least 1, got {table[key]}")
        return cls(**table)

    def to_json(self) -> dict[str, Any]:
        """Return the facts as a table of plain values."""
        return asdict(self)


def code_version(commits: Sequence[str] = ()) -> dict[str, Any]:
    """Return the version of this code, and ``commits`` of earlier runs together with its own commit, if known."""
    own = _commit([*Path(__file__).resolve().parents][:7][-1])  # an installed package may have fewer parents
    return {"version": viewshed.__version__, "commits": sorted({*commits, *([own] if own else [])})}


def _commit(checkout: Path) -> str | None:
    """Return the commit of a checkout's HEAD, read from git's files; None if it is no checkout."""
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
    """Content and origin of an archive, without machine and time."""

    recipe: Mapping[str, Any]  # how the frames were made, as plain values: command, preset, configuration, seeds
    layout: Layout  # of all frames
    shards: tuple[ShardFacts, ...] = ()  # in the order of the archive
    complete: bool = True  # False while shards are still being written
    code: Mapping[str, Any] = field(default_factory=code_version)  # version and commits of the code that wrote it

    @property
    def frames(self) -> int:
        """Number of frames."""
        return sum(shard.frames for shard in self.shards)

    def text(self) -> str:
        """Return the manifest as JSON, one line per shard."""
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
        """Write the manifest to the archive; raise an OSError on failure."""
        store.write(MANIFEST, self.text().encode())

    @classmethod
    def read(cls, store: Storage) -> Manifest:
        """Read the manifest of an archive.

        Raises:
            ValueError: it is missing, damaged, inconsistent, or of another schema version.
            OSError: it cannot be read.
        """
        where = f"{store.place}/{MANIFEST}"
        try:
            raw = store.read(MANIFEST)
        except FileNotFoundError as error:
            raise ValueError(f"{store.place} must be a data set of viewshed, but has no {MANIFEST}") from error
        with reading(where):
            table = json.loads(raw)
        check_version(where, table)
        with reading(where):
            return cls._from_json(table)

    @classmethod
    def _from_json(cls, table: dict[str, Any]) -> Manifest:
        shards = tuple(ShardFacts.from_json(shard) for shard in table["shards"])
        duplicates = [name for name, count in Counter(shard.name for shard in shards).items() if count > 1]
        if duplicates:
            raise ValueError(f"it lists {duplicates[0]} twice")
        total = sum(shard.frames for shard in shards)
        if table["frames"] != total:
            raise ValueError(f"frames must be {total}, those of all shards, got {table['frames']}")
        recipe, code = table["recipe"], table["code"]
        if table["kind"] != _KIND or not isinstance(recipe, dict) or not isinstance(code, dict):
            raise ValueError("it must have kind, recipe, code, layout and shards")
        return cls(recipe, Layout.from_json(table["layout"]), shards, table["complete"] is True, code)
