"""The published small data set: ``viewshed simulate release`` makes it from its seed; recorded hashes verify it."""

from __future__ import annotations

import hashlib
import json
import os
from collections import Counter
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

from viewshed_lab.data.archive.archive import Archive
from viewshed_lab.data.archive.schema import ShardFacts

NAME = "release"
CARD = "README.md"
"""File of the data card, beside the shards."""


@dataclass(frozen=True, slots=True)
class Published:
    """Recorded hashes of the published data set."""

    shards: dict[str, str]  # SHA-256 of each shard, by file name
    made_with: dict[str, str]  # versions of the packages that determine the bytes, by name


@cache
def published() -> Published:
    """Return the hashes that the package ships."""
    text = resources.files("viewshed_lab.data").joinpath("release.json").read_text(encoding="utf-8")
    return Published(**json.loads(text))


def other_shards(archive: Archive) -> list[str]:
    """Return the names of the shards that differ from the published ones, are missing, or are new."""
    listed = {shard.name: shard.sha256 for shard in archive.manifest.shards}
    expected = published().shards
    return sorted(name for name in {*listed, *expected} if listed.get(name) != expected.get(name))


def open_release(place: str | os.PathLike[str]) -> Archive:
    """Open the published data set; read every shard once and check that it equals the published one byte by byte.

    Raises:
        ValueError: the data set is missing, another one, or damaged.
        OSError: a file cannot be read.
    """
    archive = Archive.open(place)
    other = other_shards(archive)
    if other:
        raise ValueError(
            f"{archive.store.place} must be the published data set, got {len(other)} other shards"
            f" ({', '.join(other[:3])}…); make it with: viewshed simulate {NAME}"
        )
    damaged = [problem for _, problem in archive.verify() if problem is not None]
    if damaged:
        raise ValueError(f"{archive.store.place} is damaged: {damaged[0]}")
    return archive


def card(archive: Archive) -> str:
    """Return the data card as Markdown: content, origin, and uses that it is not suited for."""
    recipe: dict[str, Any] = archive.manifest.recipe["config"]
    shards = archive.manifest.shards
    text = resources.files("viewshed_lab.data").joinpath("release_card.md").read_text(encoding="utf-8")
    sizes = Counter[str]()
    for shard in shards:
        sizes[shard.split] += shard.frames
    scenes = Counter(shard.split for shard in {shard.scene: shard for shard in shards}.values())
    rows = [f"| {split} | {scenes[split]} | {sizes[split]} |" for split in archive.splits]
    targets = archive.manifest.recipe["targets"].values()
    grid = archive.manifest.layout.grid
    return text.format(
        sweeps=len(archive), scenes=sum(scenes.values()), megabytes=f"{sum(one.bytes for one in shards) / 1e6:.0f}",
        splits="\n".join(rows), worlds=", ".join(recipe["worlds"]), sensors=", ".join(recipe["sensors"]),
        conditions=", ".join(recipe["conditions"]), seed=recipe["seed"], moving=recipe["moving"],
        cells=grid.cells, cell_m=f"{grid.cell_m:g}", version=archive.manifest.code["version"],
        targets="; ".join(
            f"{one['name']} ({one['length_m']:g} × {one['width_m']:g} × {one['height_m']:g} m, seen by"
            f" {one['min_returns']} returns)" for one in targets
        ),
        made_with=", ".join(f"{name} {version}" for name, version in published().made_with.items()),
        digest=digest_of(shards),
    )  # fmt: skip


def digest_of(shards: tuple[ShardFacts, ...]) -> str:
    """Return one SHA-256 over the hashes of all shards, ordered by name."""
    lines = sorted(f"{shard.sha256}  {shard.name}\n" for shard in shards)
    return hashlib.sha256("".join(lines).encode()).hexdigest()
