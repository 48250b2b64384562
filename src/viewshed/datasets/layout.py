"""Layout: what all frames of an archive have in common; Sensors: the beam tables of one shard."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from viewshed.bev import BevGrid
from viewshed.datasets.beam_text import model_of_text, text_of_model
from viewshed.sensors import LidarModel
from viewshed.truth import Truth


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
