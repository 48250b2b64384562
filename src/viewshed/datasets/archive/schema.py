"""Layout: what all frames of an archive have in common; Sensors: the beam tables of one shard.

Beam tables as text, exactly: an archive carries those of its own sensors.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from viewshed.fov.truth import Truth
from viewshed.grid import BevGrid
from viewshed.sensors import LidarModel, lidar_model, sensor_names

_LISTS = ("elevation", "azimuth_offset", "origin_m")

_SINGLES = ("name", "azimuth_columns", "min_range_m", "max_range_m", "source")


@lru_cache(maxsize=256)
def text_of_model(model: LidarModel) -> str:
    """Return a beam table as one line of JSON, angles in radians; equal tables give equal text."""
    table: dict[str, Any] = {key: getattr(model, key) for key in _SINGLES}
    table |= {key: getattr(model, key).tolist() for key in _LISTS}
    return json.dumps(table, sort_keys=True, ensure_ascii=False)


@lru_cache(maxsize=256)
def model_of_text(text: str) -> LidarModel:
    """Return the beam table in a line of :func:`text_of_model`; one that travels with the package is that very object.

    Raises:
        ValueError: the text is not such a line, or the table is not valid.
    """
    shipped = _shipped().get(text)
    if shipped is not None:
        return shipped
    try:
        table = json.loads(text)
        return LidarModel(**{key: table[key] for key in (*_SINGLES, *_LISTS)})
    except (KeyError, TypeError) as error:
        raise ValueError(f"a beam table must have the keys {', '.join((*_SINGLES, *_LISTS))}: {error}") from error


@lru_cache(maxsize=1)
def _shipped() -> dict[str, LidarModel]:
    return {text_of_model(model): model for model in map(lidar_model, sensor_names())}


@dataclass(frozen=True, slots=True)
class Layout:
    """What all frames of an archive have in common.

    Attributes:
        grid: where the cells are.
        targets: names of the truth's targets, in the order in which they are stored.
        definitions: names of the truth's other definitions, in that order.
    """

    grid: BevGrid
    targets: tuple[str, ...]
    definitions: tuple[str, ...]

    @classmethod
    def of(cls, truth: Truth) -> Layout:
        """Return the layout of a truth."""
        return cls(truth.grid, tuple(sorted(truth.expected_returns)), tuple(sorted(truth.definitions)))

    @classmethod
    def from_json(cls, table: Any) -> Layout:
        """Return the layout of :meth:`to_json`.

        Raises:
            ValueError: it is not one.
        """
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
