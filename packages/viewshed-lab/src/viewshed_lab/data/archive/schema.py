"""The format of an archive: what is common to all frames, what a shard's footer says, what the manifest says.

An archive is a folder (or a prefix of an object store) of Parquet files, the shards, and ``manifest.json``. A shard
holds frames of one scene, one row group a frame, zstd level 1, page checksums on. Its columns
(:mod:`viewshed_lab.data.archive.columns`):

- ``about``: JSON: agent, ``t_ns``, sensor (number of a beam table in the footer), height, pose, motion; for points
  their number, columns, attitude and what else few sweeps say; ``clean`` of an attacked sweep.
- ``ranges``: uint16 steps of range (C, R): ring by ring the zigzag differences along the columns, all low bytes, then
  all high bytes; null for points.
- ``intensity``: uint8 (C, R); null for points.
- ``points``: of sweeps without a range image, and the rows that an attacker made: x y z float32, then the columns that
  ``about`` names, each as all first bytes, all second bytes, and so on; else null.
- ``returns``: uint8 (targets, cells, cells): expected returns up to 255.
- ``states``: (targets, cells, cells) of 0 to 3, four in a byte, the first in the lowest bits.
- ``touched``: only of attacked data sets: rows that an attacker made, rows that are gone, the wedge.
- ``masks``: (definitions + 1, cells, cells), eight in a byte, the first in the highest bit; the last is where the truth
  is known.

What all its frames share is in its footer, :class:`Footer`, as JSON under ``viewshed``. The manifest lists the shards,
:class:`Manifest`; while shards are written it says ``"complete": false``, and what had to be left out of a finished
data set is in ``problems.json``. A damaged shard raises one line that names it; a manifest that does not fit its
shards is refused. A checksum finds damage, not forgery: who can write the shards can write the manifest.
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
"""Of the columns and of the text in footer and manifest; a reader refuses any other."""

MANIFEST = "manifest.json"
REPAIR = "run the command that made the archive again, it writes anew only what is damaged or missing"
_KIND = "viewshed archive"


def check_version(where: str, table: Any) -> None:
    """Check the schema version in the plain values read from ``where``: it must be :data:`SCHEMA_VERSION`."""
    version = table.get("schema_version") if isinstance(table, dict) else None
    if version != SCHEMA_VERSION:
        known = f"schema_version must be {SCHEMA_VERSION}, got {version!r}"
        raise ValueError(f"{where}: {known}; read it with the version of viewshed that wrote it")


@contextlib.contextmanager
def reading(where: str) -> Iterator[None]:
    """Make a ValueError of whatever a damaged file raises: one line that names it and the repair."""
    import pyarrow as pa

    try:
        yield
    except (ValueError, KeyError, TypeError, OSError, OverflowError, RecursionError, pa.ArrowException) as error:
        raise ValueError(f"{where} is damaged: {one_line(error, 200)}; {REPAIR}") from error


@dataclass(frozen=True, slots=True)
class Layout:
    """What all frames of an archive have in common."""

    grid: BevGrid  # where the cells are
    targets: tuple[str, ...]  # names of the truth's targets, in the order in which they are stored
    definitions: tuple[str, ...]  # names of the truth's other definitions, in that order

    @classmethod
    def of(cls, truth: Truth) -> Layout:
        """Return the layout of a truth."""
        return cls(truth.grid, tuple(sorted(truth.expected_returns)), tuple(sorted(truth.definitions)))

    @classmethod
    def from_json(cls, table: Any) -> Layout:
        """Return the layout of :meth:`to_json`; a ValueError where it is not one."""
        try:
            x, y = table["offset_m"]
            grid = BevGrid(int(table["cells"]), float(table["half_extent_m"]), (float(x), float(y)))
            return cls(grid, tuple(table["targets"]), tuple(table["definitions"]))
        except (KeyError, TypeError) as error:
            raise ValueError(f"a layout must have grid, targets and definitions: {error!r}") from error

    def to_json(self) -> dict[str, Any]:
        """Return the layout as plain values."""
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

    The reach of one that is shipped is not in it: it is that of the table by its beams.
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
    """Return the beam table in a line of :func:`text_of_model`; one that is shipped is that very object."""
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
    """The beam tables of one shard, by number in the order in which they were first met."""

    texts: list[str] = field(default_factory=list)

    def number(self, model: LidarModel | None) -> int | None:
        """Return the number of a beam table, a new one if it was not met before; None where there is none."""
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
    """What the footer of a shard says, besides Parquet's own."""

    scene: str  # all frames are from it
    split: str  # that the scene belongs to
    layout: Layout  # of all its frames
    sensors: Sensors  # beam tables that its frames name by number

    def to_text(self) -> str:
        """Return the footer as JSON."""
        table = {"schema_version": SCHEMA_VERSION, "scene": self.scene, "split": self.split}
        return json.dumps(table | {"layout": self.layout.to_json(), "sensors": self.sensors.texts}, ensure_ascii=False)

    @classmethod
    def from_json(cls, table: Any) -> Footer:
        """Return the footer in plain values; a ValueError where it is not a shard's."""
        try:
            sensors = Sensors([str(text) for text in table["sensors"]])
            return cls(str(table["scene"]), str(table["split"]), Layout.from_json(table["layout"]), sensors)
        except (KeyError, TypeError) as error:
            raise ValueError(f"the footer must have scene, split, layout and sensors: {error!r}") from error


@dataclass(frozen=True, slots=True)
class ShardFacts:
    """What a manifest says about one shard."""

    name: str  # of the file, in the archive's place
    scene: str  # all frames are from it
    split: str  # that the scene belongs to
    frames: int  # number of frames, at least 1
    bytes: int  # length of the file
    sha256: str  # of the file

    @classmethod
    def from_json(cls, table: Any) -> ShardFacts:
        """Return the facts in plain values; a ValueError where keys or types are others, or a count is below 1."""
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


def code_version(commits: Sequence[str] = ()) -> dict[str, Any]:
    """Return the version of this code and its commit, if that is known, among ``commits`` of earlier runs."""
    own = _commit([*Path(__file__).resolve().parents][:7][-1])  # a package may lie nearer to the root
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
    """What an archive holds and how it was made. It names no machine and no time."""

    recipe: Mapping[str, Any]  # how the frames were made, as plain values: the command, preset, configuration and seeds
    layout: Layout  # what all frames have in common
    shards: tuple[ShardFacts, ...] = ()  # in the order of the archive
    complete: bool = True  # False while shards are still being written
    code: Mapping[str, Any] = field(default_factory=code_version)  # version and commits of the code that wrote it

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
        """Write the manifest into the archive's place; an OSError where that cannot be."""
        store.write(MANIFEST, self.text().encode())

    @classmethod
    def read(cls, store: Storage) -> Manifest:
        """Return the manifest in a place.

        Raises:
            ValueError: it is damaged, contradicts itself, is of another schema version, or there is none.
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
