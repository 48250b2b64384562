"""An archive that version 0.3 wrote gives every column of every frame bit by bit, and so does its copy."""

import hashlib
import json
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from viewshed import Archive
from viewshed.sensors import LidarModel
from viewshed_lab.data import Sample, write_archive
from viewshed_lab.data.archive.schema import text_of_model

PLACE = Path(__file__).parent / "archive"
"""Five frames: two range images, points alone, an attack stored as a range image and changes, another as points."""


def _columns(value: Any, name: str) -> Iterator[tuple[str, str]]:
    """Yield each array and each plain value below a value of the package, by its path of attributes, as text."""
    if isinstance(value, LidarModel):
        yield name, text_of_model(value)
    elif is_dataclass(value):
        for field in fields(value):
            if not field.name.startswith("_"):
                yield from _columns(getattr(value, field.name), f"{name}.{field.name}")
    elif isinstance(value, dict):
        for key in value:
            yield from _columns(value[key], f"{name}.{key}")
    elif isinstance(value, np.ndarray):
        digest = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()[:16]
        yield name, f"{value.dtype.str} {value.shape} {digest}"
    else:
        yield name, repr(value)


def columns_of(sample: Sample) -> dict[str, str]:
    parts = ("measured", "truth", "known", "scene", "split", "tampered", "clean")
    return {key: text for name in parts for key, text in _columns(getattr(sample, name), name)}


def test_every_column_is_read_as_it_was_written(tmp_path: Path) -> None:
    wanted = json.loads((PLACE / "columns.json").read_text("utf-8"))
    archive = Archive.open(PLACE)
    assert [problem for _, problem in archive.verify()] == [None] * 3
    for frames in (archive, write_archive(tmp_path / "copy", archive, archive.manifest.recipe)):
        found = [columns_of(sample) for sample in frames]
        assert [
            {key: columns.get(key) for key in recorded} for columns, recorded in zip(found, wanted, strict=True)
        ] == wanted
